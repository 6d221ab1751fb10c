"""Set-up check of a bench against independent measures: a known weight at each load cell, a goniometer at the knee.

The checks of a trial compare signals with each other. A fault that all of them have from power-on shows only against an
independent measure. The results are in the calibration's file.
"""

import datetime
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from parameters import InputError, read_toml

TABLE: Final = "setup_check"
_ROWS: Final = re.compile(rf"(?m)^\[\[{TABLE}\]\]\n(?:(?!\[).*(?:\n|\Z))*")
FORCE_N, FORCE_SHARE = 0.5, 0.03
"""Deviation of a load cell that passes: 0.5 N and 3 % of the weight. 0.2 N is the offset of a session, 0.1 N the
resolution of a spring scale; 3 % are 1.2 N of a 40 N trial, a fifth of what friction leaves open between START and
END. A wider tolerance lets END exceed its desired force unseen."""
LEAST_N: Final = 10.0
"""Least weight of a check, N. With a smaller one a gain that is 5 % wrong passes within `FORCE_N`."""
ANGLE_RAD: Final = math.radians(3.0)
"""Deviation of the knee's angle that passes: 3 degrees, the reading error of a universal goniometer at a knee."""
SPAN_RAD: Final = math.radians(40.0)
"""Least difference of two checked knee angles: a scale that is 15 % off departs there by 6 degrees."""
VALID_H: Final = 24.0
"""Age beyond which a check does not count, hours: one day of trials. A rope that is changed, a sensor that is mounted
again and a drive that is parametrised again fall between days, and a bench is checked before a person is put in."""


@dataclass(frozen=True)
class SetupCheck:
    """One comparison: `of` is a load cell or the joint, `unit` N or rad; `reference` is the independent measure.

    `date` is ISO 8601 to the minute.
    """

    of: str
    reference: float
    reading: float
    unit: str
    date: str

    @property
    def deviation(self) -> float:
        """Return reading minus reference, N or rad."""
        return self.reading - self.reference

    @property
    def tolerance(self) -> float:
        """Return the largest absolute deviation that passes, N or rad."""
        return FORCE_N + FORCE_SHARE * abs(self.reference) if self.unit == "N" else ANGLE_RAD

    @property
    def passed(self) -> bool:
        """Return whether the deviation is within the tolerance; a NaN is not."""
        return abs(self.deviation) <= self.tolerance

    def age_h(self, now: datetime.datetime) -> float:
        """Return the hours since the check."""
        return (now - datetime.datetime.fromisoformat(self.date)).total_seconds() / 3600.0

    def in_words(self) -> str:
        """Return reading, reference and deviation with their unit; angles in degrees."""
        unit, factor = ("N", 1.0) if self.unit == "N" else ("°", math.degrees(1.0))
        return (f"{self.of} reads {factor * self.reading:.2f} {unit} at {factor * self.reference:.2f} {unit}, "
                f"{factor * self.deviation:+.2f} {unit} (tolerance {factor * self.tolerance:.2f} {unit})")


def read(path: str | Path) -> tuple[SetupCheck, ...]:
    """Return the set-up checks in a calibration's file; raises `InputError` for a row that makes no sense."""
    rows = read_toml(Path(path)).get(TABLE, [])
    if not isinstance(rows, list):
        raise InputError(f"{path}: {TABLE} is no array of tables; write [[{TABLE}]], or run bowden check bench.")
    return tuple(_row(row, f"{path} [[{TABLE}]] {number}") for number, row in enumerate(rows, 1))


def _row(row: Any, where: str) -> SetupCheck:
    known = ("of", "reference", "reading", "unit", "date")
    if not isinstance(row, Mapping) or not all(name in row for name in known):
        raise InputError(f"{where}: expected the keys {', '.join(known)}; run bowden check bench again.")
    numbers = [row["reference"], row["reading"]]
    if not all(isinstance(number, int | float) and math.isfinite(number) for number in numbers):
        raise InputError(f"{where}: reference and reading are {numbers}, expected two numbers; run bowden check bench "
                         "again.")
    if row["unit"] not in ("N", "rad"):
        raise InputError(f"{where}: unit = {row['unit']!r}, expected N or rad; run bowden check bench again.")
    try:
        datetime.datetime.fromisoformat(str(row["date"]))
    except ValueError:
        raise InputError(f"{where}: date = {row['date']!r} is no ISO 8601 date; run bowden check bench "
                         "again.") from None
    return SetupCheck(str(row["of"]), float(row["reference"]), float(row["reading"]), row["unit"], str(row["date"]))


def merged(before: Iterable[SetupCheck], new: Sequence[SetupCheck]) -> list[SetupCheck]:
    """Return the checks after a run: those of a sensor that was checked again are replaced."""
    again = {check.of for check in new}
    return [*(check for check in before if check.of not in again), *new]


def rows(checks: Iterable[SetupCheck]) -> str:
    """Return the checks as TOML tables."""
    return "".join(f'\n[[{TABLE}]]\nof = "{check.of}"\nreference = {check.reference!r}\nreading = {check.reading!r}\n'
                   f'deviation = {check.deviation!r}\nunit = "{check.unit}"\ndate = "{check.date}"\n'
                   for check in checks)


def without_rows(text: str) -> str:
    """Return a calibration's text without its set-up checks: each ends where the next table begins."""
    return _ROWS.sub("", text).rstrip("\n") + "\n"


def refusal(
    checks: Sequence[SetupCheck], cells: Sequence[str], joints: Sequence[str], now: datetime.datetime
) -> str | None:
    """Return why these checks do not clear a bench for a limb, in half a sentence; None if they do."""
    for check in checks:
        if check.of in (*cells, *joints) and not check.passed:
            return f"{check.in_words()}; mend the sensor or its scaling"
    recent = [check for check in checks if 0.0 <= check.age_h(now) <= VALID_H]
    for of in (*cells, *joints):
        own = [check for check in checks if check.of == of]
        if own and not any(check.of == of for check in recent):
            return f"the check of {of} is {own[-1].age_h(now):.0f} h old, {VALID_H:g} h count"
    for cell in cells:
        if not any(check.of == cell and check.reference >= LEAST_N for check in recent):
            return f"{cell} was not checked with a weight of at least {LEAST_N:g} N"
    for joint in joints:
        angles = [check.reference for check in recent if check.of == joint]
        if not angles or max(angles) - min(angles) < SPAN_RAD:
            return (f"{joint} was not checked with a goniometer at two angles at least {math.degrees(SPAN_RAD):g}° "
                    "apart")
    return None
