"""Residuals of a diagnosis as arrays: before and after, by trial, binned along other signals and by rope direction.

The models compared are the reference condition and the chosen model, on the data of the likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.compared_signals import Compared
from physics.laws import Array

BINS: Final = 50
"""Largest number of bins along a signal."""
LEAST_IN_BIN: Final = 5
"""Fewest samples of a bin with a mean."""
STILL_M_S: Final = 1e-3
"""Rope speed, m/s, up to which the rope counts as still."""


def joined(parts: Sequence[Compared], name: str) -> tuple[Array, Array, Array]:
    """Return a signal and the residuals before and after, of all trials concatenated, at samples where it is finite."""
    along = np.concatenate([p.along(name) for p in parts])
    before, after = (np.concatenate([getattr(p, which) for p in parts]) for which in ("before", "after"))
    known = np.isfinite(along)
    return along[known], before[known], after[known]


def bins_of(samples: int) -> int:
    """Return the number of bins for a number of samples, with 2·`LEAST_IN_BIN` samples per bin or more on average."""
    return max(1, min(BINS, samples // (2 * LEAST_IN_BIN)))


def binned(along: Array, residual: Array, bins: int) -> tuple[Array, Array, Array]:
    """Return centres, mean and root mean square of `residual` in equal bins of `along`; NaN in bins of few samples."""
    edges = np.linspace(float(along.min()), float(along.max()), bins + 1)
    place = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins).astype(np.float64)
    full = count >= LEAST_IN_BIN
    safe = np.where(full, count, 1.0)
    mean = np.bincount(place, residual, bins) / safe
    square = np.bincount(place, residual**2, bins) / safe
    centres = 0.5 * (edges[:-1] + edges[1:])
    return centres, np.where(full, mean, np.nan), np.where(full, np.sqrt(square), np.nan)


def directions(parts: Sequence[Compared]) -> dict[str, NDArray[np.bool_]]:
    """Return masks of the samples with the rope pulled, paid out or still; {} if a trial has no rope speed."""
    if not all("rope_m_s" in p.signals for p in parts):
        return {}
    speed = np.concatenate([p.along("rope_m_s") for p in parts])
    return {"pulled": speed > STILL_M_S, "paid out": speed < -STILL_M_S, "still": np.abs(speed) <= STILL_M_S}


def rms(residual: Array) -> float:
    """Return the root mean square of residuals; NaN for an empty array."""
    return float(np.sqrt(np.mean(residual**2))) if residual.size else float("nan")
