"""Quantities that follow from the constants of a fit, each with its 1σ after and before the fit."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from estimation.reference_fit import ReferenceFit

Values = Mapping[str, float]


class FittedQuantity(NamedTuple):
    """Value of a quantity, its posterior 1σ `sd` and its prior 1σ."""

    value: float
    sd: float
    prior_sd: float

    @property
    def determined(self) -> bool:
        """Whether trials hold more information on the quantity than its prior: 1/σ² − 1/σ₀² > 1/σ₀²."""
        return 0.0 < 2.0 * self.sd**2 < self.prior_sd**2

    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval."""
        return self.value - 1.96 * self.sd, self.value + 1.96 * self.sd


def quantities(fit: ReferenceFit, convert: Callable[[Values], Values], steps: float = 30.0
               ) -> dict[str, FittedQuantity]:
    """Return what `convert` makes of the constants of a fit, by name.

    1σ is √(gᵀΣg), g the gradient by the free coordinates, by differences over so many `steps` of the table.
    """
    table, here = fit.model.constants, fit.bench_coordinates()
    free = list(table.free)
    base = convert(table.named(here))
    slopes = np.zeros((len(base), len(free)))
    for k, i in enumerate(free):
        moved = here.copy()
        moved[i] += steps * table.step[i]
        values = convert(table.named(moved))
        slopes[:, k] = [(values[name] - base[name]) / (steps * table.step[i]) for name in base]
    after, before = (np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, of, slopes), 0.0)).tolist() for of in (
        fit.bench.covariance[:len(free), :len(free)], np.diag(table.bench_sd[free] ** 2)))
    return {name: FittedQuantity(value, sd, prior) for (name, value), sd, prior in zip(base.items(), after, before,
                                                                                 strict=True)}
