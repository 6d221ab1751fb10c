"""Effects hidden in sensors and drive, in CSV's columns: a case each, fixed seeds."""

from __future__ import annotations

import pytest

from tests.hidden import quick
from tests.hidden.answers import Answer


@pytest.fixture(scope="module")
def told() -> list[Answer]:
    return quick.ask(quick.jobs("one", 100, quick.SENSED))


def test_no_wrong_name_is_given(told: list[Answer]) -> None:
    wrong = quick.of(told, lambda a: a.named and a.hidden[0] not in a.rivals)
    assert not wrong, wrong


def test_the_truth_is_in_the_class(told: list[Answer]) -> None:
    counted = [a for a in told if a.counts]
    missed = quick.of(counted, lambda a: a.hidden[0] not in a.rivals)
    # each of them is seen in one relation alone; one may fall with the last digit of another processor
    assert len(counted) >= 12
    assert len(missed) <= 1, missed
