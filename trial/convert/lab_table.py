"""Tables of files: names, numbers and units, before columns are assigned to signals.

A column is numeric or not; a fault in a column is an error only if that column is used. A row keeps the number that
an editor, or the program that wrote the file, gives it.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from parameters import InputError

Floats = NDArray[np.float64]

SQUARED = 1e100
"""Largest magnitude that a cell may have, in the file's unit. Larger: the mean square of a column overflows."""
TO_SI = {  # unit of a file: (unit of a signal, factor)
    "m": ("m", 1.0), "mm": ("m", 1e-3), "cm": ("m", 1e-2), "um": ("m", 1e-6), "µm": ("m", 1e-6), "in": ("m", 0.0254),
    "m/s": ("m/s", 1.0), "mm/s": ("m/s", 1e-3), "rad": ("rad", 1.0), "deg": ("rad", math.pi / 180),
    "°": ("rad", math.pi / 180), "mdeg": ("rad", math.pi / 180e3), "mrad": ("rad", 1e-3), "N": ("N", 1.0),
    "mN": ("N", 1e-3), "cN": ("N", 1e-2), "dN": ("N", 0.1), "daN": ("N", 10.0), "kN": ("N", 1e3),
    "kgf": ("N", 9.80665), "kp": ("N", 9.80665), "g": ("N", 9.80665e-3), "mg": ("N", 9.80665e-6),
    "lbf": ("N", 4.4482216152605), "ozf": ("N", 0.27801385095378125), "s": ("s", 1.0),
    "ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6), "ns": ("ns", 1.0), "min": ("s", 60.0), "%": ("%", 1.0),
    "1": ("1", 1.0),
}
_SPELT = {  # other spellings, in lower case
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "sek": "s", "msec": "ms", "millisecond": "ms",
    "milliseconds": "ms", "usec": "us", "microseconds": "us", "nanoseconds": "ns", "minutes": "min", "degree": "deg",
    "degrees": "deg", "grad": "deg", "radian": "rad", "radians": "rad", "newton": "N", "newtons": "N", "n": "N",
    "kn": "kN", "metre": "m", "meter": "m", "meters": "m", "metres": "m", "millimeter": "mm", "millimetre": "mm",
    "percent": "%", "prozent": "%", "pct": "%", "μm": "µm", "μs": "µs", "inch": "in", "lb": "lbf", "lbs": "lbf",
    "kg": "kgf", "kilopond": "kp", "gf": "g", "grf": "g", "gr": "g", "gram": "g", "grams": "g", "gramm": "g",
    "pond": "g", "mgf": "mg", "cn": "cN", "dn": "dN", "dan": "daN", "oz": "ozf",
}


def unit_of(text: str) -> str:
    """Return the unit of `TO_SI` for a file's spelling of it, brackets or not; empty for an unsupported one."""
    bare = text.strip().strip("[](){}<>").strip()
    if bare in TO_SI:
        return bare
    return _SPELT.get(bare.lower(), bare.lower() if bare.lower() in TO_SI else "")


@dataclass
class LabTable:
    """A table: `names` and, of equal length, `values`; `units` are those of the file, empty if it states none.

    `rows[i]` is the number of row i in the file. `faults` gives, by column, the first cell that is not a number, with
    its row. `begins_ns` is, by name, the time since 1970 at which a column of absolute times is 0. `remarks` lists the
    detections, as sentences; `dialect` has the detected values of a map's [csv]: of a workbook its sheet, {} of a file
    of another format. `left_out` gives, by name, the reason why a column or sheet of the file is not in the table.
    """

    path: Path
    names: list[str]
    values: list[Floats]
    units: list[str]
    rows: NDArray[np.int64] | range
    faults: dict[str, tuple[int, str]] = field(default_factory=dict)
    begins_ns: dict[str, int] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    header_row: int = 1
    dialect: dict[str, str | int] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._place = {name: place for place, name in enumerate(self.names)}
        self._twice = {name for name, count in Counter(self.names).items() if count > 1}

    def __contains__(self, name: str) -> bool:
        return name in self._place

    def __len__(self) -> int:
        return len(self.rows)

    def column(self, name: str) -> Floats:
        """Return a column; raises `InputError` where the name stands twice or a cell is no number."""
        if name in self._twice:
            count = self.names.count(name)
            raise InputError(f"{self.path}: row {self.header_row} names the column {name!r} {count} times; keep one.")
        if name in self.faults:
            row, cell = self.faults[name]
            shown = cell if len(cell) <= 40 else cell[:40] + "…"
            where = f"{self.path}: row {row}: {name} = "
            if math.isinf(_float(cell)):
                raise InputError(f"{where}{shown} is not finite; leave an unknown cell empty.")
            raise InputError(f"{where}{shown!r} is not a number; mend that cell.")
        values = self.values[self._place[name]]
        beyond = np.flatnonzero(np.abs(values) > SQUARED)
        if len(beyond):
            raise InputError(f"{self.path}: row {self.rows[beyond[0]]}: {name} = {values[beyond[0]]:g} is larger than "
                             "any measured value; leave an unknown cell empty.")
        return values

    def unit(self, name: str) -> str:
        """Return the unit that the file states for a column, as `TO_SI` spells it; empty where it states none."""
        return unit_of(self.units[self._place[name]])

    def written_unit(self, name: str) -> str:
        """Return the unit that the file states for a column, as the file writes it, without brackets."""
        return self.units[self._place[name]].strip().strip("[](){}<>").strip()


def _float(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def unique(names: Sequence[str], reserved: Callable[[str], bool]) -> list[str]:
    """Return the names with a number behind repeated ones; a `reserved` one stays as it is and is found twice."""
    seen: Counter[str] = Counter()
    found = []
    for place, name in enumerate(names, start=1):
        name = name or f"column {place}"
        seen[name] += 1
        found.append(name if seen[name] == 1 or reserved(name) else f"{name} ({seen[name]})")
    return found
