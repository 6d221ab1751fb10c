"""Effects hidden in sensors and drive, in CSV's columns: fixed seeds."""

from __future__ import annotations

import pytest

from tests.hidden import quick
from tests.hidden.answers import Answer

pytestmark = pytest.mark.hidden


@pytest.fixture(scope="module")
def told() -> list[Answer]:
    return quick.ask(quick.one(quick.SENSED))


def test_no_wrong_name_is_given(told: list[Answer]) -> None:
    wrong = quick.of(told, quick.wrong)
    assert not wrong, wrong


def test_the_truth_is_in_the_class(told: list[Answer]) -> None:
    missed = quick.of(told, lambda a: not quick.right(a))
    # right when the seeds were fixed; a change may cost one that lies near the limit of eight cycles, not two
    assert len(missed) <= 1, missed
