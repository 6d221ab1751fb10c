"""Scatter of a bench about the nominal one: by manufacture (serial number), and from session to session.

Sizes are in the table of parameters (`made`, `daily`), draws are made here. Each parameter draws from a separate
stream, named by the parameter, so that a further row in a table changes no other draw. Serial 0 is the nominal bench,
day 0 the session of the identification.
"""

import zlib
from collections.abc import Callable, Container, Mapping
from typing import Final, NamedTuple

import numpy as np

from physics.parameters import PARAMETERS, Parameter, Tolerance

SENSOR: Final = {"start": "start_sensor", "end": "end_sensor"}


class Spread(NamedTuple):
    """One scattered parameter: its distribution `law`, which maps a number u drawn evenly from −1 … 1, and its size."""

    group: str
    name: str
    law: str
    size: float
    source: str

    @property
    def label(self) -> str:
        """Return group and name, such as "plant.mu1"."""
        return f"{self.group}.{self.name}"


LAWS: Final = {
    "factor": "value · (1 + size · u)",
    "offset": "value + size · u",
    "excess": "value + size · (1 + u) / 2",
    "set": "size, whatever u is",
}

def _spreads(tolerance: Callable[[Parameter], Tolerance | None]) -> tuple[Spread, ...]:
    return tuple(Spread(group, name, *said) for p in PARAMETERS.values() if (said := tolerance(p)) is not None
                 for key in p.plant.split() for group, name in (key.split("."),))


SERIAL: Final = _spreads(lambda p: p.made)
"""Manufacturing tolerances, drawn by the serial number."""
DAY: Final = _spreads(lambda p: p.daily)
"""Parameters that change from session to session, drawn by `--day`."""

Tables = dict[str, dict[str, float]]


def scattered(
    nominal: Mapping[str, Mapping[str, float]], serial: int, day: int, steady: Container[str] = ()
) -> Tables:
    """Return the tables of parameters, by group, of bench `serial` on `day`; the parameters `steady` do not change."""
    tables = {group: dict(values) for group, values in nominal.items()}
    if serial:
        for spread in SERIAL:
            _apply(tables[spread.group], spread, draw("serial", spread, serial))
    if day:
        for spread in DAY:
            if spread.label not in steady:
                _apply(tables[spread.group], spread, draw("day", spread, serial, day))
    return tables


def draw(occasion: str, spread: Spread, *numbers: int) -> float:
    """Return a parameter's random number, −1 … 1; `numbers`: serial, or serial and day, which seed its own stream."""
    return 2.0 * float(stream(f"{occasion} {spread.group} {spread.name}", *numbers).random()) - 1.0


def stream(name: str, *numbers: int) -> np.random.Generator:
    """Return the random-number generator of a name, seeded by `numbers`; other names and numbers have independent ones.
    """
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([zlib.crc32(name.encode()), *numbers])))


def _apply(table: dict[str, float], spread: Spread, u: float) -> None:
    value = table[spread.name]
    table[spread.name] = {
        "factor": value * (1.0 + spread.size * u),
        "offset": value + spread.size * u,
        "excess": value + spread.size * (1.0 + u) / 2.0,
        "set": spread.size,
    }[spread.law]
