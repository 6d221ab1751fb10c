"""What healthy trials teach: what like benches have in common, and how far each one stands from it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from diagnosis.data.table import table
from diagnosis.problem.blocks import TAUT_N, Block, blocks_of
from diagnosis.problem.deviations import deviating
from diagnosis.problem.fit import Problem, solve
from diagnosis.problem.healthy_reference import of_bench
from tests.hidden.bench import Bench
from tests.hidden.walk import trial

APART_M = 4e-4
KNEE_RAD = 1e-3
"""What a fit leaves of a knee angle on a bench of other laws: it only scales the weights."""
REFERENCE = of_bench(None)
ZERO = next(f for f in REFERENCE.nuisance if f.name == "rope_zero")
AT = {**REFERENCE.values, "rope_zero@0": 0.0, "rope_zero@1": 0.0}


@pytest.fixture(scope="module")
def benches() -> list[Block]:
    """The knee's relation on two benches that differ in the encoder's zero alone."""
    walked = [trial(Bench(zero=zero), seed=1, cycles=3) for zero in (0.0, APART_M)]
    return [blocks_of([table("walk.csv", columns)], ["kinematics"], TAUT_N)[0] for columns in walked]


def test_a_bench_s_own_deviation_is_added_to_what_is_common_and_to_no_other_bench(benches: list[Block]) -> None:
    first, second = (deviating(block, i, [ZERO]) for i, block in enumerate(benches))
    moved = {**AT, "rope_zero@0": 1e-4}
    assert np.array_equal(first.residual(moved), benches[0].residual({**AT, "rope_zero": AT["rope_zero"] + 1e-4}))
    assert np.array_equal(second.residual(moved), benches[1].residual(AT))


def test_what_two_benches_differ_by_is_found_beside_what_they_have_in_common(benches: list[Block]) -> None:
    common = [f for f in REFERENCE.nuisance if f.name in ("stiffness_scale", "stiffness_shape", "toe")]
    own = [dataclasses.replace(ZERO, name=f"rope_zero@{i}", low=-3.0 * ZERO.sigma, high=3.0 * ZERO.sigma, mean=0.0)
           for i in range(2)]
    blocks = [deviating(block, i, [ZERO]) for i, block in enumerate(benches)]
    values = solve(Problem(blocks, {"kinematics": KNEE_RAD}), AT, [*common, *own], thorough=True).values
    # more rope on the drum at the same encoder's word is a zero that lies lower; noise of END leaves some per cent
    assert values["rope_zero@0"] - values["rope_zero@1"] == pytest.approx(APART_M, rel=0.1)
