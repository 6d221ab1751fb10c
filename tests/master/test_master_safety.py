"""Safety's table: every condition has a reaction, and none of them holds the rope."""

from __future__ import annotations

import pytest

from eds.bench.bench_network import MONITOR, Network, wire
from master.cycle.inputs import END, KNEE, SERVO, START
from master.cycle.safety import REACTIONS, Condition, Reaction, StopError, reaction_to


def test_every_condition_has_a_row() -> None:
    assert {condition for condition, _ in REACTIONS} == set(Condition)


@pytest.mark.parametrize("condition", list(Condition))
def test_a_knee_that_is_named_is_neither_held_nor_braked(condition: Condition) -> None:
    """Neither drive nor angle of a named knee can be trusted, whatever is wrong with it."""
    assert REACTIONS[condition, KNEE] is Reaction.RELEASE_BOTH


@pytest.mark.parametrize(
    "condition", [Condition.NODE_LOST, Condition.LEFT, Condition.EMERGENCY, Condition.STALE, Condition.BOOTED])
def test_the_rope_is_unwound_only_while_start_servo_and_knee_are_there(condition: Condition) -> None:
    by_place = {place: REACTIONS[condition, place] for place in (SERVO, KNEE, START, END)}
    assert by_place == {SERVO: Reaction.RELEASE, KNEE: Reaction.RELEASE_BOTH, START: Reaction.RELEASE,
                        END: Reaction.UNWIND}


def test_a_node_that_is_not_of_the_bench_unwinds() -> None:
    assert reaction_to(StopError(Condition.EMERGENCY, "node 9", 9), wire(Network()).paths) is Reaction.UNWIND


def test_the_text_says_what_and_how_much() -> None:
    assert str(StopError(Condition.END_LIMIT, "95.1 N of 90 N", END)) == "END tension above its limit: 95.1 N of 90 N"


def test_the_master_opposes_no_torque_off_of_the_safety_monitor() -> None:
    paths = wire(Network()).paths
    assert reaction_to(StopError(Condition.EMERGENCY, "END beyond its bound", MONITOR), paths) is Reaction.RELEASE_BOTH
