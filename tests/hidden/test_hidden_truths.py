"""Rigs of another structure: the oracle, and one case of each kind that the diagnosis must not get wrong."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.evidence.decision import NAMED_NATS
from tests.hidden import truths, truths_run
from tests.hidden.truths import Question

pytestmark = [pytest.mark.hidden, pytest.mark.skipif(
    not truths.TRUTHS.is_dir(), reason="../shared/truths is absent: these rigs are no part of the project")]


def test_nothing_hidden_has_no_clean_response() -> None:
    nothing = truths.draw(Question("truth1", ("null",), 7))
    assert nothing.separation == 0.0
    assert all(np.array_equal(nothing.trial[name], nothing.without[name]) for name in nothing.trial)


@pytest.mark.exhaustive
@pytest.mark.parametrize("hidden", ["gain_e", "fdrift"])
def test_a_stated_gain_is_that_on_a_further_trial(hidden: str) -> None:
    said, _, further = truths_run.answer(Question("truth2", (hidden,), 7)).gains
    assert said == pytest.approx(further, abs=5.0)


@pytest.mark.exhaustive
def test_a_change_within_the_trial_is_named_on_a_rig_of_another_structure() -> None:
    told = truths_run.answer(Question("truth1", ("fdrift",), 1006))
    assert told.named[0] == "friction_drift"


@pytest.mark.exhaustive
@pytest.mark.parametrize(("hidden", "seed", "effect"), [
    ("presl", 7506, "presliding"),  # with its lag left to the session 9.7 nats
    ("strib", 7416, "stribeck")])  # its fits from another Stribeck speed ended below the null
def test_a_change_of_the_friction_curve_explains_a_rig_of_another_structure_best(
        hidden: str, seed: int, effect: str) -> None:
    best, nats = next(iter(truths_run.answer(Question("truth1", (hidden,), seed)).nats.items()))
    assert (best, nats >= NAMED_NATS) == (effect, True)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("structure", "hidden", "seed"), [
    ("truth1", "null_alt", 1021),
    ("truth1", "null_alt", 6711),  # zeros that wander: fabric_creep had 18 nats
    ("truth2", "null", 6816)])  # another minimum of the reference trials: stribeck had 13 nats
def test_no_effect_gets_no_name(structure: str, hidden: str, seed: int) -> None:
    assert truths_run.answer(Question(structure, (hidden,), seed)).among == ()
