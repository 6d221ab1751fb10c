"""Cross-validation over complete cycles: the folds, and squared residuals of each fold after a fit to the others.

Every figure in a verdict comes from a full refit on the other cycles, never from the fit that it judges.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.problem.blocks import Block
from diagnosis.problem.fit import Fit, Problem, solve
from physics.laws import Array

FOLDS: Final = 5


def folds_of(cycles: NDArray[np.intp]) -> list[frozenset[int]]:
    """Assign complete cycles to at most `FOLDS` sets; neighbouring cycles are in different sets."""
    labels = np.unique(cycles)
    count = min(FOLDS, len(labels))
    return [frozenset(int(c) for c in labels[k::count]) for k in range(count)]


class CycleSquares:
    """Sums of squared residuals by equation and complete cycle, from which intervals are resampled.

    `fitted`: parameter values of each fold's fit.
    """

    def __init__(self) -> None:
        self.sums: dict[str, dict[int, tuple[float, int]]] = {}
        self.fitted: list[dict[str, float]] = []

    def add(self, block: Block, residual: Array, cycles: NDArray[np.intp]) -> None:
        held = self.sums.setdefault(block.relation.name, {})
        for c in np.unique(cycles):
            inside = cycles == c
            total, count = held.get(int(c), (0.0, 0))
            part = residual[inside]
            held[int(c)] = (total + float(part @ part), count + part.size)

    def arrays(self, relation: str) -> tuple[Array, Array]:
        held = self.sums[relation]
        return (np.array([held[c][0] for c in sorted(held)]), np.array([held[c][1] for c in sorted(held)], dtype=float))

    def rmse(self, relation: str) -> float:
        squares, counts = self.arrays(relation)
        return math.sqrt(squares.sum() / counts.sum())

    def chi_square(self, weights: Mapping[str, float]) -> dict[str, float]:
        """Return χ² by equation: the sum of squares divided by the square of the equation's weight."""
        return {name: float(self.arrays(name)[0].sum()) / weights[name] ** 2 for name in weights if name in self.sums}


def unseen(problem: Problem, folds: Sequence[frozenset[int]], fit: Fit) -> CycleSquares:
    """Return the squared residuals of each fold's held-out cycles after a full refit on the other cycles."""
    squares = CycleSquares()
    everything = frozenset().union(*folds)
    for fold in folds:
        part = Problem(problem.blocks, problem.weights, problem.prior, (everything - fold) or fold)
        values = solve(part, fit.values, fit.free, known=fit).values
        squares.fitted.append(values)
        for block in problem.blocks:
            inside = np.isin(block.cycle, list(fold))
            if inside.any():
                squares.add(block, block.residual(values)[inside], block.cycle[inside])
    return squares
