"""Table of the constants of a forward model: coordinates in which each is Gaussian, its priors, and its value in SI.

A constant is a function of a coordinate q that a Gaussian describes: q = 0 is the value of the population's middle,
`bench_sd` the 1σ between benches and `session_sd` the 1σ between two sessions of one bench, both in units of q.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from physics.laws import Array

LARGEST: Final = {"log": 4.0, "logit": 2.0}
"""Largest departure of a coordinate by form: beyond, a force balance is badly conditioned."""
SOFTENED: Final = 4.0
"""Range before a bound, in session σ and at most a tenth of the bounds' distance, in which a value approaches it.

A value cut off at its bound would be flat beyond it, and a difference across the bound would give a wrong slope."""


class ModelConstant(NamedTuple):
    """One constant: name, unit, population middle, form, spread between benches and between sessions, meaning.

    `form`: "linear" (value = middle + q), "log" (middle·e^q), "logit" (a share), "positive" (a smooth maximum of
    middle + q and 0, rounded over `rounding`).  `bench_sd` 0: absent in the reference condition, moved by effects only.
    """

    name: str
    unit: str
    middle: float
    form: str
    bench_sd: float
    session_sd: float
    meaning: str
    rounding: float = 0.0
    step: float = 0.0


class ConstantTable:
    """Rows of constants with what follows from them; `bounds`: of the values of linear constants, and of the
    coordinates of others, by name.

    `free`: rows of the constants that differ between benches in the reference condition.  `step`: finite-difference
    step of each coordinate, 0.01 session σ; with 0.1 the truncation error stops descents 7 nats above the mode.
    """

    def __init__(self, rows: Sequence[ModelConstant], bounds: Mapping[str, tuple[float, float]] | None = None) -> None:
        self.rows = tuple(rows)
        self.bounds = dict(bounds or {})
        self.names = tuple(row.name for row in rows)
        self.index = {name: i for i, name in enumerate(self.names)}
        self.bench_sd: Array = np.array([row.bench_sd for row in rows])
        self.session_sd: Array = np.array([row.session_sd for row in rows])
        self.step: Array = np.array([0.01 * row.session_sd if row.session_sd else row.step for row in rows])
        self.free = tuple(i for i, row in enumerate(rows) if row.bench_sd)
        self._form = np.array([row.form for row in rows])
        self._columns: Array = np.array([(row.middle, *self._limits(row), row.rounding) for row in rows]).T

    def __len__(self) -> int:
        return len(self.rows)

    def values(self, q: Array) -> Array:
        """Return the constants, SI, of coordinates `q`, both of shape (rows, …)."""
        q = np.asarray(q, dtype=np.float64)
        column = (-1, *[1] * (q.ndim - 1))
        middle, low, high, width, rounding = (each.reshape(column) for each in self._columns)
        at = middle + q
        out = _bent(np.where((self._form == "linear").reshape(column), at, q), low, high, width)
        of = {form: self._form == form for form in ("log", "logit", "positive")}
        out[of["log"]] = middle[of["log"]] * np.exp(out[of["log"]])
        out[of["logit"]] = 1.0 / (1.0 + (1.0 / middle[of["logit"]] - 1.0) * np.exp(-out[of["logit"]]))
        smooth = at[of["positive"]]
        out[of["positive"]] = 0.5 * (smooth + np.sqrt(smooth**2 + rounding[of["positive"]] ** 2))
        return np.asarray(out)

    def _limits(self, row: ModelConstant) -> tuple[float, float, float]:
        """Return lower and upper bound of a coordinate, and the width in which `_bent` rounds each."""
        most = LARGEST.get(row.form, np.inf)
        low, high = self.bounds.get(row.name, (-most, most))
        return low, high, min(SOFTENED * row.session_sd, 0.1 * (high - low)) if row.session_sd else 0.0

    def _before(self, row: ModelConstant, value: float) -> float:
        """Return the coordinate of `value`: the inverse of `_bent`, which saturates smoothly at the bounds."""
        low, high, width = self._limits(row)
        if width == 0.0 or low + width <= value <= high - width:
            return value
        sign, edge = (1.0, high - width) if value > high - width else (-1.0, low + width)
        return edge - sign * width * float(np.log1p(-min(sign * (value - edge) / width, 0.999)))

    def lifted(self, q: Array) -> Array:
        """Return coordinates with those of "positive" constants raised to the range in which the value follows them.

        Below, the smooth maximum is flat: a slope there is not that of a constant that acts.
        """
        least = [0.5 * row.rounding - row.middle if row.form == "positive" else -np.inf for row in self.rows]
        return np.maximum(q, least)

    def slope(self, q: Array) -> Array:
        """Return dv/dq of each "positive" constant at coordinates `q`, 1 for the other forms, shape (rows,)."""
        out = np.ones(len(self.rows))
        for i, row in enumerate(self.rows):
            if row.form == "positive":
                at = row.middle + q[i]
                out[i] = 0.5 * (1.0 + at / np.sqrt(at**2 + row.rounding**2))
        return out

    def coordinates_of(self, constants: Array) -> Array:
        """Return the coordinates of constants inside their bounds, the inverse of `values`, shape (rows,)."""
        out = np.empty_like(constants)
        for i, row in enumerate(self.rows):
            v = constants[i]
            if row.form == "log":
                out[i] = self._before(row, float(np.log(v / row.middle)))
            elif row.form == "logit":
                out[i] = self._before(row, float(np.log(v / (1.0 - v)) - np.log(row.middle / (1.0 - row.middle))))
            elif row.form == "positive":
                out[i] = v - row.rounding**2 / (4.0 * v) - row.middle
            else:
                out[i] = self._before(row, v) - row.middle
        return out

    def coordinate(self, name: str, value: float) -> float:
        """Return the coordinate of one constant's value."""
        constants = self.values(np.zeros(len(self)))
        constants[self.index[name]] = value
        return float(self.coordinates_of(constants)[self.index[name]])

    def named(self, q: Array) -> dict[str, float]:
        """Return the constants of one vector of coordinates by name."""
        return dict(zip(self.names, self.values(q).tolist(), strict=True))


def _bent(at: Array, low: Array, high: Array, width: Array) -> Array:
    """Return values that stay inside the bounds `low` and `high` and approach them exponentially within `width`."""
    inside = np.clip(at, low + width, high - width)
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = width * (np.expm1((np.minimum(at - low, width) - width) / width)
                        - np.expm1((np.minimum(high - at, width) - width) / width))
    return np.asarray(inside + np.where(width > 0.0, bend, 0.0))
