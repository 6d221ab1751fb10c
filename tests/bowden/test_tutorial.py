"""`docs/tutorial.md` runs by copy and paste: every block, in its order, in an empty folder."""

from __future__ import annotations

import re
import runpy
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.exhaustive
PAGE = (Path(__file__).parents[2] / "docs" / "tutorial.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r'```(sh|toml title="([^"]+)"|python title="([^"]+)")\n(.*?)```', PAGE, re.DOTALL)


def commands(block: str) -> list[list[str]]:
    """The command lines of a block, as a shell splits them; `|| true` says that any status will do."""
    return [shlex.split(line) for line in block.splitlines() if line.strip()]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Run all blocks; returns what each command printed, by its words."""
    import contextlib
    import io
    import os

    from bowden.cli.app import run

    folder, before = tmp_path_factory.mktemp("tutorial"), Path.cwd()
    said: dict[str, str] = {}
    os.chdir(folder)
    try:
        for kind, toml, script, text in BLOCKS:
            if kind != "sh":
                Path(toml or script).write_text(text, encoding="utf-8")
                continue
            for words in commands(text):
                program, *arguments = words[:-2] if words[-2:] == ["||", "true"] else words
                out = io.StringIO()
                with contextlib.redirect_stdout(out):
                    status: Any = run(arguments) if program == "bowden" else runpy.run_path(arguments[0]) and 0
                assert status == 0 or words[-1] == "true", (words, out.getvalue())
                said[" ".join(arguments)] = out.getvalue()
    finally:
        os.chdir(before)
    return said


def said_by(told: dict[str, str], start: str) -> str:
    """What the one command that begins so printed."""
    [text] = [text for words, text in told.items() if words.startswith(start)]
    return text


def test_there_is_something_to_run() -> None:
    assert sum(kind == "sh" for kind, *_ in BLOCKS) >= 6


def test_the_worn_sensor_is_named(told: dict[str, str]) -> None:
    assert "START gain" in " ".join(said_by(told, "diagnose worn.mcap").split())


def test_the_foreign_table_is_a_trial(told: dict[str, str]) -> None:
    assert "tension_start_n" in said_by(told, "info lab.mcap")


def test_what_was_found_gains(told: dict[str, str], bowden: Callable[..., Any]) -> None:
    assert "before" in said_by(told, "verify extended.toml").lower()
