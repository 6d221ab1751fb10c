"""What a fit keeps, copies or prepares once is what it would have calculated."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from diagnosis.data.table import table
from diagnosis.problem.blocks import blocks_of
from diagnosis.problem.deviations import deviating
from diagnosis.problem.fit import Problem, solve
from diagnosis.problem.prior import NOTHING_TOGETHER, Free
from diagnosis.problem.zero_phase import ORDER, SHARE, thinning
from physics.parameters import ideal


@pytest.mark.parametrize("stride", [2, 5, 8, 20])
def test_the_thinning_is_scipys_filter_forward_and_back(stride: int) -> None:
    values = np.cumsum(np.random.default_rng(stride).normal(size=4001))
    expected = sosfiltfilt(butter(ORDER, SHARE / stride, output="sos"), values)[::stride]
    np.testing.assert_allclose(thinning(stride)(values), expected, rtol=1e-12, atol=1e-12 * np.abs(values).max())


def two_rigs() -> Problem:
    """Two trials of a frictionless transmission, END and START with offsets of their own."""
    rng, blocks = np.random.default_rng(0), []
    for i, (ratio, offset) in enumerate(((1.2, 3.0), (1.25, 2.0))):
        time = np.arange(1500) / 100.0
        end = 20.0 + 10.0 * np.sin(0.7 * np.pi * time)
        trial = table(f"rig {i}", {
            "time_s": time, "cycle": np.floor(time / 2.0), "servo_position_m": 0.01 * np.sin(np.pi * time),
            "tension_end_n": end, "tension_start_n": ratio * end + offset + rng.normal(0.0, 0.05, time.size)})
        blocks += [deviating(b, i, FREE) for b in blocks_of([trial], ["friction"])]
    return Problem(blocks, {"friction": 0.1})


FREE = (Free("tension_ratio", 0.5, 2.0, 1.0, math.inf, 0.1), Free("start_offset", -20.0, 20.0, 0.0, math.inf, 1.0),
        Free("mu1", 0.0, 1.0, 0.0, 0.1, 0.02))
OWN = tuple(Free(f"{f.name}@{i}", -5.0, 5.0, 0.0, 0.1, 0.1 * f.scale) for i in range(2) for f in FREE[:2])


def test_a_deviations_slope_is_its_slots_where_it_is_inside_the_bounds() -> None:
    problem, values = two_rigs(), ideal() | {f.name: 0.0 for f in OWN} | {"mu1@0": 0.0, "mu1@1": 0.0}
    residuals = problem.residuals(values)
    for i, block in enumerate(problem.blocks):
        for slot in FREE[:2]:
            own = next(f for f in OWN if f.name == f"{slot.name}@{i}")
            assert block.like(own.name, values) == slot.name
            np.testing.assert_allclose(problem.slope(i, values, residuals[i], own),
                                       problem.slope(i, values, residuals[i], slot), rtol=1e-6, atol=1e-6)
            assert block.like(own.name, {**values, own.name: 1e9}) is None
    assert problem.blocks[0].like("mu1", values) is None


def test_the_curvature_is_of_the_slopes_that_a_fit_ends_with() -> None:
    start = ideal() | {f.name: 0.0 for f in OWN} | {"mu1@0": 0.0, "mu1@1": 0.0}
    fit = solve(two_rigs(), start, (*FREE, *OWN))
    assert fit.steps > 2
    rows = fit.every_slope()
    expected = NOTHING_TOGETHER.precision(fit.free) + rows @ rows.T
    # what a fit holds of its slopes is of single precision
    np.testing.assert_allclose(fit.curvature, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    assert fit.values["tension_ratio"] + fit.values["tension_ratio@0"] == pytest.approx(1.2, abs=0.01)


def test_slopes_of_half_the_width_lead_to_the_same_place() -> None:
    problem, start = two_rigs(), ideal() | {f.name: 0.0 for f in OWN} | {"mu1@0": 0.0, "mu1@1": 0.0}
    near = solve(problem, start, (*FREE, *OWN))
    assert {rows.dtype for rows in near.slopes} == {np.dtype(np.float32)}
    whole = solve(problem, start, near.free, thorough=True)
    half = solve(problem, start, near.free, known=near, thorough=True)
    assert half.cost == pytest.approx(whole.cost, rel=1e-6)
