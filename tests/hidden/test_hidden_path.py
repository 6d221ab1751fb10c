"""Effects hidden in cable, fabric and joint, in CSV's columns: a case each, fixed seeds."""

from __future__ import annotations

import pytest

from tests.hidden import quick
from tests.hidden.answers import Answer


@pytest.fixture(scope="module")
def told() -> list[Answer]:
    return quick.ask(quick.jobs("one", 0, quick.PATH))


def test_no_wrong_name_is_given(told: list[Answer]) -> None:
    wrong = quick.of(told, lambda a: a.named and a.hidden[0] not in a.rivals)
    # quadratic moment arm and eccentric drum look alike over eight cycles: one of these fifteen goes by the other's name
    assert len(wrong) <= 1, wrong


def test_the_truth_is_in_the_class(told: list[Answer]) -> None:
    counted = [a for a in told if a.counts]
    missed = quick.of(counted, lambda a: a.hidden[0] not in a.rivals)
    # what lies near the limit of eight cycles may be missed: a third of these, measured
    assert len(counted) >= 8
    assert len(missed) <= 3, missed
