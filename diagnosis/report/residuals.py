"""Residuals of a diagnosis: arrays before and after, binned along other signals and by rope direction, and in words.

The models compared are the reference condition and the chosen model, on the data of the likelihood.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.compared_signals import SignalResiduals
from diagnosis.findings import Findings
from estimation.simulation import directions
from physics.laws import Array
from trial.report.page import number
from trial.report.words import words


def joined(parts: Sequence[SignalResiduals], name: str) -> tuple[Array, Array, Array]:
    """Return a signal and the residuals before and after, of all trials concatenated, at samples where it is finite."""
    along = np.concatenate([p.along(name) for p in parts])
    before, after = (np.concatenate([getattr(p, which) for p in parts]) for which in ("before", "after"))
    known = np.isfinite(along)
    return along[known], before[known], after[known]


def bins_of(samples: int, most: int = 50) -> int:
    """Return the number of bins for a number of samples: ten samples per bin on average, and at most `most` bins."""
    return max(1, min(most, samples // 10))


def binned(along: Array, residual: Array, bins: int, span: tuple[float, float] | None = None
           ) -> tuple[Array, Array, Array]:
    """Return centres, mean and root mean square of `residual` in equal bins of `along`; NaN in bins of one sample.

    `span`: ends of the first and of the last bin (None: smallest and largest value of `along`).
    """
    edges = np.linspace(*(span or (float(along.min()), float(along.max()))), bins + 1)
    place = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    mean, square = (np.where(count > 1, np.bincount(place, values, bins) / np.maximum(count, 1), np.nan)
                    for values in (residual, residual**2))
    return 0.5 * (edges[:-1] + edges[1:]), mean, np.sqrt(square)


def by_direction(parts: Sequence[SignalResiduals]) -> dict[str, NDArray[np.bool_]]:
    """Return masks of the samples with the rope pulled, paid out or still; {} if a trial has no rope speed."""
    if not all("rope_m_s" in p.signals for p in parts):
        return {}
    return directions(np.concatenate([p.along("rope_m_s") for p in parts]))


def rms(residual: Array) -> float:
    """Return the root mean square of residuals; NaN for an empty array."""
    return float(np.sqrt(np.mean(residual**2))) if residual.size else float("nan")


def where(found: Findings) -> str:
    """Return sentences on the largest residual relative to the reference RMSE; "" without a reference RMSE.

    They state its size, the gait phase and the load of half of its square, and its size by rope direction and by
    cycle.  They name no cause.
    """
    above = {name: f.rmse_last / f.floor for name, f in found.relations.items()
             if f.floor and f.rmse_last is not None and found.traces.get(name)}
    if not above:
        return ""
    name = max(above, key=lambda relation: above[relation])
    figures, parts = found.relations[name], found.traces[name]
    unit, places = figures.unit, []
    for signal, place in (("gait_percent", "{} … {} % of gait"), ("tension_start_n", "START at {} … {} N")):
        along, _, after = joined(parts, signal)
        if along.size and float(np.ptp(along)) > 0.0:
            places.append(place.format(*(number(end, 2) for end in concentrated(along, after))))
    told = (f"The residual is largest in {words(name)}: {number(figures.rmse_last or 0.0, 3)} {unit} on cycles that no "
            f"fit has seen, {number(above[name], 2)} times that of reference trials ({number(figures.floor, 3)} "
            f"{unit}). "
            f"Half of its square lies at {' and '.join(places) or 'no place that a column tells'}.")
    after = np.concatenate([p.after for p in parts])
    ways = {word: number(rms(after[mask]), 3) for word, mask in by_direction(parts).items() if mask.any()}
    if {"pulled", "paid out"} <= set(ways):
        told += f" It is {ways['pulled']} {unit} while the rope is pulled and {ways['paid out']} {unit} while it is "\
                "paid out."
    each = [rms(p.after[p.cycle == c]) for p in parts for c in np.unique(p.cycle)]
    return f"{told} From cycle to cycle it is {number(min(each), 3)} to {number(max(each), 3)} {unit}."


def concentrated(along: Array, residual: Array) -> tuple[float, float]:
    """Return both ends of the narrowest stretch of `along` with half of the squared residual."""
    order = np.argsort(along)
    place, total = along[order], np.cumsum(residual[order] ** 2)
    last = np.searchsorted(total, total - residual[order] ** 2 + 0.5 * total[-1])
    width = np.where(last < place.size, place[np.minimum(last, place.size - 1)] - place, np.inf)
    first = int(np.argmin(width))
    return float(place[first]), float(place[last[first]])
