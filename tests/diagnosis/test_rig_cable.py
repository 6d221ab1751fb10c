"""A plain Bowden cable with a load cell at each end: the exact capstan, and each of its changes by its name."""

from __future__ import annotations

import math

import pytest

from diagnosis.finder import Finder
from estimation import rig_fit
from estimation.data.table import Table, table
from tests.diagnosis import rigs

pytestmark = pytest.mark.exhaustive

FRICTION = {"cable_friction", "load_dependent_friction", "viscous_friction"}
"""Names of friction: with the zeros of another session, viscous friction is like a fifth less of it."""
GAIN = {"start_gain", "end_gain", "start_offset"}
"""Names of a gain at one end: the other end's gain is its reciprocal, and a zero is one at a load that differs little.
"""


def cable(seed: int, **changed: float) -> Table:
    return table(f"cable_{seed}.csv", rigs.cable(seed, **changed))


@pytest.fixture(scope="module")
def known() -> Finder:
    return Finder().fit([cable(seed) for seed in (1, 2, 3)])


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_another_session_of_the_cable_is_none(known: Finder, seed: int) -> None:
    found = known.diagnose([cable(seed)])
    assert found.verdict == "none"
    # the load cells' noise on a bin is 0.06 N; a linear ratio with friction left 1.0 N
    error = found.relations["tension_start_n"].rmse_session
    assert error is not None
    assert error < 0.12


@pytest.mark.parametrize(("changed", "allowed"), [
    ({"wrap": 0.50}, FRICTION), ({"wrap": 0.42}, FRICTION), ({"wrap": 0.28}, FRICTION),
    ({"drag": 90.0}, {"viscous_friction", "cable_friction"}), ({"start_gain": 1.06}, GAIN),
    ({"start_gain": 0.94}, GAIN), ({"travel": 8e-4}, {"presliding"})])
def test_a_change_of_the_cable_has_its_name(known: Finder, changed: dict[str, float], allowed: set[str]) -> None:
    found = known.diagnose([cable(7, **changed)])
    assert found.verdict in ("found", "ambiguous")
    assert set(found.rivals) <= allowed


def test_the_exponent_is_the_capstans() -> None:
    found = rig_fit.fit([cable(1), cable(2)], [cable(3)], [cable(1), cable(2)])
    told = found.constants["mu1"]
    # a coefficient is reported at the bend of the nominal bench, a quarter turn; each session has 1 % of its own
    assert told.low <= 0.35 / (0.5 * math.pi) <= told.high
    assert told.high - told.low < 0.2 * told.value
