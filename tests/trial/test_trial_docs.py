"""The examples of docs/trials.md run."""

from __future__ import annotations

import os
import re
from pathlib import Path

import example_trials
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "trials.md"
TEXT = PAGE.read_text(encoding="utf-8")
EXAMPLES = [block for block in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL) if "LogReader" not in block]


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # three lines leave closing to the interpreter
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_examples_run_and_leave_the_trial_as_it_was(
        number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = example_trials.write(tmp_path / "trial.mcap", cycles=5).read_bytes()
    monkeypatch.chdir(tmp_path)
    exec(compile(EXAMPLES[number], f"{os.fspath(PAGE)} example {number}", "exec"), {})
    assert Path("trial.mcap").read_bytes() == whole
