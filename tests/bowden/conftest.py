"""A command line as a user types it: exit status, stdout, stderr."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from bowden.cli.app import run


class Told(NamedTuple):
    status: int
    stdout: str
    stderr: str


@pytest.fixture
def bowden(capsys: pytest.CaptureFixture[str]) -> Callable[..., Told]:
    """Run one command line in this process."""

    def command(*arguments: object) -> Told:
        status = run([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return Told(status, out, err)

    return command


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path
