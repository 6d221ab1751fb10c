"""The command line of a first day: grouped help, where a bad option points, completion, a bench that nothing runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from bowden.bench.configuration import as_template
from bowden.cli import options
from bowden.cli.app import PANELS, whole

Run = Callable[..., tuple[int, str, str]]


def test_each_command_is_in_one_panel_of_the_help(bowden: Run) -> None:
    listed = [name for names in PANELS.values() for name in names]
    assert sorted(listed) == sorted(whole().commands)
    _, out, _ = bowden("--help")
    titles = [line[:-1] for line in out.splitlines() if line.endswith(":") and not line.startswith((" ", "Options"))]
    assert titles == list(PANELS)


@pytest.mark.parametrize("words", [("trial",), ("diagnose",), ("node", "read"), ("check", "config")])
def test_a_bad_option_points_to_the_command_s_own_help(bowden: Run, words: tuple[str, ...]) -> None:
    status, out, err = bowden(*words, "--no-such-option")
    assert (status, out) == (2, "")
    assert err.endswith(f"see bowden {' '.join(words)} --help.\n")


def test_values_are_completed(here: Path) -> None:
    assert options.effects("cable_f") == ["cable_friction"]
    assert options.experiments("two") == ["two_peaks", "two_speeds"]
    assert "extended" in options.controllers("ex")
    assert options.serials("1")[:2] == ["1", "10"]
    assert options.declared_paths("") == []
    (here / "bench.toml").write_text(as_template(shape="bench_two_legs"))
    assert options.declared_paths("r") == ["right"]


def test_a_bench_that_no_command_runs_is_no_clean_check(here: Path, bowden: Run) -> None:
    text = as_template(shape="bench")
    (here / "bench.toml").write_text(text)
    assert bowden("check", "config", "bench.toml")[0] == 0
    (here / "bench.toml").write_text(text.replace('\nstart = "start"', '\nstart = "start"\nacts = "extends"'))
    status, out, err = bowden("check", "config", "bench.toml")
    assert (status, "no command runs this bench" in " ".join((out + err).split())) == (1, True), out + err
