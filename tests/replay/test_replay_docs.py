"""What docs/replay.md names exists, and its tables are the code's."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trial.playback import TRANSITIONS

TEXT = (Path(__file__).parents[2] / "docs" / "replay.md").read_text(encoding="utf-8")
COMMANDS = [line.split("#")[0].split()[1:] for line in TEXT.split("```")[1].splitlines() if line.startswith("bowden")]


def test_the_page_has_the_player_s_table() -> None:
    rows = re.findall(r"^\| (\w+) \| (\w+) \| (\w+) \|$", TEXT, re.MULTILINE)
    assert rows == [(state.value, command.value, then.value) for (state, command), then in TRANSITIONS.items()]


@pytest.mark.exhaustive
def test_the_page_s_commands_run(
    bowden: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    statuses = []
    for words in COMMANDS:
        if "socketcan" in words:
            place = words.index("--interface")
            words = [*words[:place], *words[place + 4:]]  # the virtual bus in the kernel's place
        statuses.append(bowden(*words).status)
    assert statuses == [0, 0, 0, 1, 0, 0]
