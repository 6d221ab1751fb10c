"""Description of the residual that remains after a diagnosis: equation, size, gait phase, load, direction, cycles.

The description names no cause.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.compared_signals import Compared
from diagnosis.findings import Findings
from diagnosis.report.residuals import directions, joined, rms
from trial.report.page import number

SIDES: Final = (("gait_percent", "{} … {} % of gait"), ("tension_start_n", "START at {} … {} N"))
HALF: Final = 0.5
"""Share of the squared residual in the reported stretch of a signal."""
BINS: Final = 50
"""Number of bins of a signal in which such a stretch is searched."""


def where(found: Findings, sides: Mapping[str, Sequence[Compared]]) -> str:
    """Return sentences on the largest residual relative to the reference RMSE; "" without a reference RMSE."""
    above = {name: f.rmse_after / f.floor for name, f in found.relations.items()
             if f.floor and f.rmse_after is not None and sides.get(name)}
    if not above:
        return ""
    name = max(above, key=lambda relation: above[relation])
    figures, parts = found.relations[name], sides[name]
    unit = figures.unit
    return (f"What is left is largest in {name}: {number(figures.rmse_after, 3)} {unit} on cycles that no fit has "
            f"seen, {number(above[name], 2)} times what healthy trials leave ({number(figures.floor, 3)} {unit}). Half "
            f"of its square lies at {_places(parts)}.{_direction(parts, unit)} {_cycles(parts, unit)}")


def _places(parts: Sequence[Compared]) -> str:
    told = []
    for signal, words in SIDES:
        along, _, after = joined(parts, signal)
        if along.size and float(np.ptp(along)) > 0.0:
            low, high = concentrated(along, after)
            told.append(words.format(number(low, 2), number(high, 2)))
    return " and ".join(told) or "no place that a column tells"


def concentrated(along: NDArray[np.float64], residual: NDArray[np.float64]) -> tuple[float, float]:
    """Return both ends of the narrowest stretch of `along`, in whole bins, with half of the squared residual."""
    edges = np.linspace(float(along.min()), float(along.max()), BINS + 1)
    place = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, BINS - 1)
    total = np.concatenate(([0.0], np.cumsum(np.bincount(place, residual**2, BINS))))
    first = np.arange(BINS)
    last = np.searchsorted(total, total[:-1] + HALF * total[-1])
    width = np.where(last <= BINS, last - first, BINS + 1)
    at = int(np.argmin(width))
    return float(edges[at]), float(edges[min(int(last[at]), BINS)])


def _direction(parts: Sequence[Compared], unit: str) -> str:
    masks: Mapping[str, NDArray[Any]] = directions(parts)
    after = np.concatenate([p.after for p in parts])
    if not masks or not all(masks[word].any() for word in ("pulled", "paid out")):
        return ""
    pulled, paid = (number(rms(after[masks[word]]), 3) for word in ("pulled", "paid out"))
    return f" It is {pulled} {unit} while the rope is pulled and {paid} {unit} while it is paid out."


def _cycles(parts: Sequence[Compared], unit: str) -> str:
    each = [rms(p.after[p.cycle == c]) for p in parts for c in np.unique(p.cycle)]
    return f"From cycle to cycle it is {number(min(each), 3)} to {number(max(each), 3)} {unit}."
