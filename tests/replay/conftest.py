"""Short trials on the simulated bench, recorded by the command line, each made once."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from bowden.cli.app import run
from trial import read


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., read.Trial]:
    """A trial of one gait cycle, by the options of `bowden trial`; the same options give the same file."""
    folder = tmp_path_factory.mktemp("trials")
    made: dict[tuple[str, ...], Path] = {}

    def record(*options: object) -> read.Trial:
        words = tuple(str(option) for option in options)
        if words not in made:
            path = folder / f"{len(made)}.mcap"
            with redirect_stdout(io.StringIO()):
                assert run(["trial", "--cycles", "1", "--settle", "0", "--period", "1.1", *words, "-o", str(path)]) == 0
            made[words] = path
        return read.open(made[words])

    return record
