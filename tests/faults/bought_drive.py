"""Bought servo drive of CiA 402 alone: its EDS without the objects of this project, and a simulated node without them.

The rule of this file: the node keeps the objects of the standard and loses what a stock drive does not have: START's
tension and its limits, the torque bound without START, and the comparisons of velocity with position (7305h) and with
the torque's sign (7122h).
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from eds.bench.bench_network import SERVO
from eds.declaration import ROPE_DRIVE
from eds.dictionary import packaged
from nodes.drives import axis_law as law
from nodes.drives.servo import ServoDrive

STOCK: frozenset[int] = frozenset(range(0x2000, 0x3000))
"""Objects that a stock drive does not have."""
NAME = "stock_servo.eds"
TABLE = f'[servo]\nfile = "{NAME}"\ntension = ""\n'
"""Mapping of such a drive in `bench.toml`: it does not listen to START."""


def write_eds(folder: Path) -> Path:
    """Write the EDS of a stock drive: the packaged one without the manufacturer's objects."""
    text = packaged(ROPE_DRIVE.file).read_text(encoding="latin-1")
    sections = re.split(r"(?m)^(?=\[)", text)
    kept = [section for section in sections if not _stock(section)]
    path = folder / NAME
    path.write_text("".join(kept), encoding="latin-1")
    return path


def _stock(section: str) -> bool:
    """Return whether a section of an EDS is of a manufacturer's object, or lists such objects."""
    title = re.match(r"\[([^\]]*)\]", section)
    name = title[1] if title else ""
    index = re.match(r"([0-9A-Fa-f]{4})(sub|$)", name)
    return name == "ManufacturerObjects" or (index is not None and int(index[1], 16) in STOCK)


class BoughtServo(ServoDrive):
    """Servo drive that watches position, speed, torque and following error as the standard says, and no tension."""

    def configure(self) -> None:
        """Leave out what only this project's firmware does."""
        super().configure()
        self._limit = self._trip = math.inf
        self.axis.g[[law.TENSION_LIMIT, law.HOLD_TORQUE, law.UNTRUSTED_TORQUE, law.APART_LIMIT,
                     law.GAINED_LIMIT]] = math.inf


def fit(bench: Any) -> None:
    """Put the firmware of a bought drive into the servo of a simulated bench, before its power-on."""
    bench.nodes[SERVO].device.application.__class__ = BoughtServo
