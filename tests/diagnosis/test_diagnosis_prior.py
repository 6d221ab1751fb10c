"""What is known beforehand of several parameters together, and fits that keep to it and to their bounds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from diagnosis.problem.blocks import Block
from diagnosis.problem.deviations import repeated
from diagnosis.problem.fit import Fit, Problem, solve
from diagnosis.problem.loops import settled
from diagnosis.problem.prior import NOTHING_TOGETHER, Free, Prior
from physics.relations.measured import Signals
from physics.relations.relation import RELATIONS

SHARED = Prior(("cable", "fabric"), np.array([[1.0, -0.99], [-0.99, 1.0]]))
"""The friction of both together is known, which of them has it is not."""
CABLE, FABRIC, OTHER, UNKNOWN = (Free(n, -9.0, 9.0, 0.0, s, 1.0) for n, s in (
    ("cable", 1.0), ("fabric", 1.0), ("other", 0.5), ("unknown", math.inf)))


def penalty(prior: Prior, free: tuple[Free, ...], *at: float) -> float:
    return float(np.array(at) @ prior.precision(free) @ np.array(at))


def test_what_two_share_is_known_and_how_they_share_it_is_not() -> None:
    both = (CABLE, FABRIC)
    assert penalty(SHARED, both, 1.0, -1.0) == pytest.approx(2.0 / 1.99)
    assert penalty(SHARED, both, 1.0, 1.0) == pytest.approx(2.0 / 0.01)
    assert penalty(NOTHING_TOGETHER, both, 1.0, 1.0) == pytest.approx(2.0)


def test_of_a_parameter_that_is_free_nothing_is_said_of_the_others() -> None:
    free = Free("fabric", -9.0, 9.0, 0.0, math.inf, 1.0)
    precision = SHARED.precision((CABLE, free, OTHER, UNKNOWN))
    np.testing.assert_allclose(precision, np.diag([1.0, 0.0, 4.0, 0.0]), atol=1e-12)


def test_a_band_made_wider_than_what_was_learnt_is_so_by_itself() -> None:
    wide = Free("cable", -9.0, 9.0, 0.0, 2.0, 1.0)
    np.testing.assert_allclose(SHARED.together((wide, FABRIC)), [[4.0, -0.99], [-0.99, 1.0]])


def test_a_band_narrower_than_what_was_learnt_leaves_a_penalty_that_no_step_makes_negative() -> None:
    narrow = Free("cable", -9.0, 9.0, 0.0, 0.1, 1.0)
    np.testing.assert_allclose(SHARED.together((narrow, FABRIC)), [[0.01, -0.099], [-0.099, 1.0]])
    assert np.linalg.eigvalsh(SHARED.precision((narrow, FABRIC))).min() > 0.0


def test_what_is_expected_of_one_beside_the_other_is_the_conditional() -> None:
    mean, sigma = SHARED.expected(CABLE, (CABLE, FABRIC, OTHER, UNKNOWN), {"fabric": 0.5, "other": 3.0, "unknown": 1.0})
    assert mean == pytest.approx(-0.99 * 0.5)
    assert sigma == pytest.approx(math.sqrt(1.0 - 0.99**2))
    assert SHARED.expected(CABLE, (), {}) == pytest.approx((0.0, 1.0))


@dataclass(frozen=True)
class Plane(Block):
    """Lines of a matrix times the parameters, less what was measured."""

    matrix: np.ndarray
    measured: np.ndarray
    names: tuple[str, ...]

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        return self.matrix @ np.array([values[n] for n in self.names]) - self.measured


def plane(matrix: np.ndarray, measured: np.ndarray, names: tuple[str, ...]) -> Plane:
    rows = np.arange(measured.size)
    return Plane(RELATIONS["drive_force"], Signals({}, np.zeros(rows.size, dtype=bool), rows / rows.size), rows, rows,
                 frozenset(names), matrix, measured, names)


def fitted(matrix: np.ndarray, measured: np.ndarray, free: tuple[Free, ...], start: float = 0.0) -> Fit:
    names = tuple(f.name for f in free)
    return solve(Problem([plane(matrix, measured, names)], {"drive_force": 1.0}), dict.fromkeys(names, start), free,
                 thorough=True, enough=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_a_fit_between_bounds_is_the_best_there_is(seed: int) -> None:
    """Columns that nearly share a direction; the minimum lies on bounds that steps reach and must leave again."""
    rng = np.random.default_rng(seed)
    size = 6
    matrix = rng.normal(size=(30, size)) + 5.0 * rng.normal(size=(30, 1))
    measured = matrix @ rng.normal(scale=3.0, size=size) + rng.normal(size=30)
    free = tuple(Free(f"p{i}", -1.0, 1.0, 0.0, math.inf, 1.0) for i in range(size))
    best = lsq_linear(matrix, measured, (-1.0, 1.0), method="bvls")
    found = fitted(matrix, measured, free, start=1.0)
    assert found.cost == pytest.approx(best.cost, rel=1e-5)


def test_a_fit_moves_far_along_what_two_parameters_share() -> None:
    """A step damped by each parameter's own curvature would be a thousandth of the way, and taken for the arrival."""
    matrix = np.array([[1e3, 1e3], [1.0, -1.0]])
    found = fitted(matrix, np.array([0.0, 10.0]), (CABLE, FABRIC))
    # the 1σ of one about zero, against 1 of the difference: 10/2 less a third
    assert found.values["cable"] == pytest.approx(10.0 / 3.0, rel=1e-3)
    assert found.values["fabric"] == pytest.approx(-10.0 / 3.0, rel=1e-3)


class Hills(Plane):
    """A loop with two minima: at 2 nothing is left, at −2 nearly nothing."""

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        at = values["bandwidth"]
        return np.array([at**2 - 4.0, 0.1 * (at - 2.0), values["shared"]])


def test_a_loop_that_one_relation_alone_reads_is_learnt_in_its_better_minimum() -> None:
    rows = np.arange(3)
    signals = Signals({}, np.zeros(3, dtype=bool), rows / 3.0)
    loop = Hills(RELATIONS["servo"], signals, rows, rows, frozenset({"bandwidth", "shared"}), np.eye(3), rows, ())
    other = dataclasses.replace(loop, relation=RELATIONS["drive_force"], uses=frozenset({"shared"}))
    problem = Problem([loop, other], {"servo": 1e-3, "drive_force": 1.0})
    free = (Free("bandwidth", -5.0, 5.0, -2.0, 2.0, 0.1), Free("shared", -5.0, 5.0, 1.0, 1.0, 0.1))
    start = {"bandwidth": -2.0, "shared": 1.0}
    assert settled(problem, start, free) == {"bandwidth": pytest.approx(2.0, abs=1e-3)}
    # in a search it stays in the minimum that it was learnt in
    assert settled(problem, start, free, corners=False) == {"bandwidth": pytest.approx(-2.0, abs=0.1)}


def test_what_comes_again_in_each_cycle_counts_once() -> None:
    rng = np.random.default_rng(0)
    cycle = np.repeat(np.arange(8), 100)
    lacking, noise = np.tile(np.sin(np.linspace(0.0, 6.0, 100)), 8), rng.normal(size=800)
    assert repeated([lacking], [cycle]) == pytest.approx(8.0)
    # white noise repeats by chance alone: twenty places scatter by a fifth
    assert repeated([noise], [cycle]) < 1.6
    assert repeated([], []) == 1.0
