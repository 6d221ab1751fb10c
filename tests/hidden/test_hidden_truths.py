"""Rigs of another structure: the oracle, and one case of each kind that the diagnosis must not get wrong."""

from __future__ import annotations

import numpy as np
import pytest

from tests.hidden import truths, truths_run
from tests.hidden.truths import Question

pytestmark = [pytest.mark.hidden, pytest.mark.skipif(
    not truths.TRUTHS.is_dir(), reason="../shared/truths is absent: these rigs are no part of the project")]


def test_nothing_hidden_has_no_clean_response_and_a_gain_is_mostly_the_sessions() -> None:
    nothing = truths.draw(Question("truth1", ("null",), 7))
    assert nothing.separation == 0.0
    assert nothing.adapted_n == 0.0
    changed = truths.draw(Question("truth1", ("gain_e",), 7))
    alone = float(np.sqrt(np.mean(changed.clean**2)))
    # 3 to 8 % of END is far beyond the 0.3 % between sessions, and yet the session imitates nearly all of it
    assert changed.separation > truths.SEPARABLE
    assert changed.adapted_n < 0.2 * alone


@pytest.mark.exhaustive
def test_a_change_within_the_trial_is_named_on_a_rig_of_another_structure() -> None:
    told = truths_run.answer(Question("truth1", ("fdrift",), 1006))
    assert told.named[0] == "friction_drift"


@pytest.mark.exhaustive
def test_an_altered_structure_without_an_effect_gets_no_name() -> None:
    assert truths_run.answer(Question("truth1", ("null_alt",), 1021)).among == ()
