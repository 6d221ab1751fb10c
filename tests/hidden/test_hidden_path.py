"""Effects hidden in cable, fabric and joint, in CSV's columns: fixed seeds."""

from __future__ import annotations

import pytest

from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS
from tests.hidden import quick
from tests.hidden.answers import Answer


@pytest.fixture(scope="module")
def told() -> list[Answer]:
    return quick.ask(quick.one(quick.PATH))


def test_no_wrong_name_is_given(told: list[Answer]) -> None:
    wrong = quick.of(told, quick.wrong)
    assert not wrong, wrong


def test_the_truth_is_in_the_class(told: list[Answer]) -> None:
    missed = quick.of(told, lambda a: not quick.right(a))
    # right when the seeds were fixed; a change may cost one that lies near the limit of eight cycles, not two
    assert len(missed) <= 1, missed


def test_an_experiment_is_proposed_that_the_bench_runs_by_itself(told: list[Answer]) -> None:
    undecided = [a for a in told if a.verdict == "ambiguous"]
    assert undecided
    for a in undecided:
        named = [CATALOGUE[name].experiment for name in a.rivals]
        alone = [name for name in named if not EXPERIMENTS[name].by_hand]
        assert a.experiment == (alone or named)[0]
