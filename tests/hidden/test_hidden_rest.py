"""Healthy benches, effects outside the catalogue, pairs and faults of the wire, in CSV's columns: fixed seeds."""

from __future__ import annotations

import pytest

from tests.hidden import quick
from tests.hidden.answers import Answer


@pytest.fixture(scope="module")
def healthy() -> list[Answer]:
    return quick.ask(quick.jobs("none", 200, [""] * 12))


@pytest.fixture(scope="module")
def outside() -> list[Answer]:
    return quick.ask(quick.jobs("outside", 300, ("thump", "temperature", "resonance", "thump")))


@pytest.fixture(scope="module")
def pairs() -> list[Answer]:
    return quick.ask(quick.jobs("two", 400, [""] * 4))


@pytest.fixture(scope="module")
def wires() -> list[Answer]:
    return quick.ask(quick.jobs("wire", 500, ("lost_pdo", "late_pdo", "quantisation")))


def test_nothing_is_found_on_healthy_benches(healthy: list[Answer]) -> None:
    alarms = quick.of(healthy, lambda a: a.verdict != "none")
    # the bar is 2 %: of twelve, none
    assert not alarms, alarms


def test_what_no_catalogue_has_is_not_named(outside: list[Answer]) -> None:
    named = quick.of(outside, lambda a: a.named)
    assert not named, named
    unexplained = [a for a in outside if a.counts and a.verdict == "unexplained"]
    assert len(unexplained) == sum(a.counts for a in outside) >= 3


def test_of_two_effects_no_third_is_named(pairs: list[Answer]) -> None:
    wrong = quick.of(pairs, lambda a: a.named and not set(a.hidden) & set(a.rivals))
    assert not wrong, wrong


def test_a_fault_of_the_wire_is_no_effect_of_the_bench(wires: list[Answer]) -> None:
    wrong = quick.of(wires, lambda a: a.named and a.hidden[0] not in a.rivals)
    assert not wrong, wrong
