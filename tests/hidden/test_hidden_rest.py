"""Healthy benches, effects outside the catalogue, pairs and faults of the wire, in CSV's columns: fixed seeds."""

from __future__ import annotations

import pytest

from tests.hidden import quick

pytestmark = pytest.mark.hidden


def test_nothing_is_found_on_healthy_benches() -> None:
    alarms = quick.of(quick.ask(quick.drawn(quick.HEALTHY_SEEDS, "none")), lambda a: not quick.right(a))
    # the bar is 2 %: of twelve, none
    assert not alarms, alarms


def test_what_no_catalogue_has_is_unexplained() -> None:
    named = quick.of(quick.ask(quick.one(quick.OUTSIDE, "outside")), lambda a: not quick.right(a))
    assert not named, named


def test_two_effects_are_both_in_the_class() -> None:
    told = quick.ask(quick.drawn(quick.PAIRS, "two"))
    assert not quick.of(told, quick.wrong), quick.of(told, quick.wrong)
    # pairs may hide each other: the bar is 85 %
    missed = quick.of(told, lambda a: not quick.right(a))
    assert len(missed) <= 1, missed


def test_a_fault_of_the_wire_is_no_effect_of_the_bench() -> None:
    told = quick.ask(quick.one(quick.WIRE, "wire"))
    assert not quick.of(told, quick.wrong), quick.of(told, quick.wrong)
    assert not quick.of(told, lambda a: a.verdict == "none")
