"""Comparison of two trials: their settings, their results, and the differences between their signals.

Signals are compared row by row if both trials have the same rows, else at the same gait phase, else at the same time;
`matched` names which. Differences are A minus B, and whatever only one trial has is listed.
"""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trial.read import Trial

Floats = NDArray[np.float64]


class FieldDifference(NamedTuple):
    """One differing entry; `a` or `b` equals None if that trial does not have the key."""

    key: str
    a: object
    b: object


class SignalDifference(NamedTuple):
    """Difference of A's signal from B's over `rows` of A: RMS, mean, largest magnitude, and the time of the largest
    (s)."""

    name: str
    unit: str
    rows: int
    rms: float
    mean: float
    largest: float
    largest_at_s: float


@dataclass
class TrialComparison:
    """Differences between two trials; `same` if every channel is the same, bit for bit."""

    same: bool
    matched: str
    metadata: list[FieldDifference] = field(default_factory=list)
    attachments: dict[str, list[FieldDifference]] = field(default_factory=dict)
    result: list[FieldDifference] = field(default_factory=list)
    signals: list[SignalDifference] = field(default_factory=list)
    only_a: list[str] = field(default_factory=list)
    only_b: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, object]:
        """Return the comparison with nothing that JSON lacks; the signals as objects by their names."""
        return {
            "same": self.same, "matched": self.matched,
            "metadata": [row._asdict() for row in self.metadata],
            "attachments": {name: [row._asdict() for row in rows] for name, rows in self.attachments.items()},
            "result": [row._asdict() for row in self.result],
            "signals": {row.name: {key: value for key, value in row._asdict().items() if key != "name"}
                        for row in self.signals},
            "only_a": self.only_a, "only_b": self.only_b,
        }


def compare(a: Trial, b: Trial) -> TrialComparison:
    """Compare two trials; the result lists every figure of both, the rest only what differs."""
    matched, row_of_b = _match(a, b)
    names = [name for name in a.columns if name in b.columns]
    found = TrialComparison(a.digest() == b.digest(), matched, _differences(a.metadata, b.metadata))
    found.attachments = _attachments(a, b)
    found.result = _all(a.result or {}, b.result or {})
    for name in names:
        row = _signal(name, a, b, matched, row_of_b)
        if row is not None:
            found.signals.append(row)
    found.only_a = [name for name in a.columns if name not in b.columns]
    found.only_b = [name for name in b.columns if name not in a.columns]
    return found


def _all(a: Mapping[str, object], b: Mapping[str, object]) -> list[FieldDifference]:
    return [FieldDifference(key, a.get(key), b.get(key)) for key in dict.fromkeys([*a, *b])]


def _differences(a: Mapping[str, object], b: Mapping[str, object]) -> list[FieldDifference]:
    return [row for row in _all(a, b) if row.a != row.b]


def _attachments(a: Trial, b: Trial) -> dict[str, list[FieldDifference]]:
    """Return what differs in each attached file: by key where it is TOML, else by line; one row where one has it."""
    found = {}
    for name in dict.fromkeys([*a.attachments, *b.attachments]):
        one, other = a.attachments.get(name), b.attachments.get(name)
        if one is None or other is None:
            found[name] = [FieldDifference("file", _size(one), _size(other))]
        elif differences := _differences(_entries(name, one), _entries(name, other)):
            found[name] = differences
    return found


def _size(data: bytes | None) -> str | None:
    return None if data is None else f"{len(data)} bytes"


def _entries(name: str, data: bytes) -> dict[str, object]:
    text = data.decode(errors="replace")
    if name.endswith(".toml"):
        try:
            return dict(_flat("", tomllib.loads(text)))
        except tomllib.TOMLDecodeError:
            pass
    return {f"line {number}": line for number, line in enumerate(text.splitlines(), start=1)}


def _flat(prefix: str, table: Mapping[str, object]) -> list[tuple[str, object]]:
    rows: list[tuple[str, object]] = []
    for key, value in table.items():
        rows += _flat(f"{prefix}{key}.", value) if isinstance(value, Mapping) else [(f"{prefix}{key}", value)]
    return rows


def _match(a: Trial, b: Trial) -> tuple[str, tuple[Floats, Floats]]:
    """Return how rows are matched, and the abscissae of A and B that are the same there."""
    since_start = [(side.time_ns - side.time_ns[:1].sum()) / 1e9 for side in (a, b)]
    if np.array_equal(*since_start):
        return "row by row", (since_start[0], since_start[1])
    phases = [_phase(side) for side in (a, b)]
    if phases[0] is not None and phases[1] is not None:
        return "by gait phase", (phases[0], phases[1])
    return "by time", (since_start[0], since_start[1])


def _phase(side: Trial) -> Floats | None:
    """Return gait cycles since the start, or None where they are unknown or do not rise."""
    if "cycle" not in side.columns or "gait_percent" not in side.columns:
        return None
    phase = side.columns["cycle"] + side.columns["gait_percent"] / 100
    good = phase[np.isfinite(phase)]
    return phase if len(good) > 1 and (np.diff(good) > 0).all() else None


def _signal(
    name: str, a: Trial, b: Trial, matched: str, along: tuple[Floats, Floats]
) -> SignalDifference | None:
    """Compare one signal; None if no row has both values, or if rows must be interpolated and the signal is a count."""
    one, other = a.columns[name], b.columns[name]
    if matched != "row by row":
        if a.units[name] == "1":
            return None
        other = _at(along[0], along[1], other)
    error = one - other
    rows = np.flatnonzero(np.isfinite(error))
    if len(rows) == 0 or a.units[name] != b.units[name]:
        return None
    known = error[rows]
    worst = rows[np.abs(known).argmax()]
    return SignalDifference(name, a.units[name], len(rows), math.sqrt(float(np.mean(known**2))), float(known.mean()),
                            float(abs(error[worst])), float(a.time_ns[worst] - a.time_ns[0]) / 1e9)


def aligned(a: Trial, b: Trial, name: str) -> tuple[str, Floats, Floats, Floats]:
    """Return how rows are matched, A's abscissa (s, or gait cycles), and a signal of A and of B along it."""
    matched, (along_a, along_b) = _match(a, b)
    other = b.columns[name] if matched == "row by row" else _at(along_a, along_b, b.columns[name])
    return matched, along_a, a.columns[name], other


def _at(wanted: Floats, along: Floats, values: Floats) -> Floats:
    """Return `values` interpolated at `wanted`; NaN outside the range and beside an unknown sample."""
    good = np.isfinite(along)
    between = np.interp(wanted, along[good], values[good], left=np.nan, right=np.nan)
    return np.where(np.isfinite(wanted), between, np.nan)
