"""`bowden compare TABLE --controllers`: which controller serves a bench best."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import bowden as library
from bowden.sweep import summary

Run = Callable[..., Any]


def row(controller: str, error: float | None, stopped: str = "") -> dict[str, str]:
    figures = {"true_max_idle_tension_n": "0.5", "true_peak_jump_n": "1.0"}
    return {"gait.controller": controller, "outcome": "stopped" if stopped else "completed", "stop_reason": stopped,
            "true_relative_rmse_percent": "" if error is None else repr(error), **figures}


def test_the_best_comes_first_and_one_that_stopped_behind_all_that_did_not() -> None:
    rows = [row("paper", 2.0), row("mine", 0.2), row("paper", 3.0), row("mine", None, "START beyond its limit"),
            row("extended", 0.7), row("extended", 0.5), row("never", None, "no"), row("never", None, "no")]
    found = summary.ranked(rows)
    assert [one.controller for one in found] == ["extended", "paper", "mine", "never"]
    assert found[0].error_percent == pytest.approx(0.6)
    assert (found[1].least, found[1].worst) == (2.0, 3.0)
    assert found[2].stopped == {"START beyond its limit": 1}
    assert found[3].error_percent is None


@pytest.fixture
def table(here: Path) -> Path:
    """A table of two controllers as `bowden sweep` writes it."""
    rows = [row("paper", 2.15), row("extended", 0.65)]
    with (here / "table.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return here / "table.csv"


def test_the_command_ranks_and_draws(bowden: Run, table: Path, here: Path) -> None:
    told = bowden("compare", table, "--controllers", "--picture", here / "ranks.svg")
    assert told.status == 0
    assert told.stdout.index("extended") < told.stdout.index("paper")
    picture = (here / "ranks.svg").read_text(encoding="utf-8")
    assert "<svg" in picture
    ranks = json.loads(bowden("compare", table, "--controllers", "--json").stdout)["controllers"]
    assert [one["controller"] for one in ranks] == ["extended", "paper"]


@pytest.mark.parametrize(("words", "says"), [
    (("none.csv", "--controllers"), "no such file"), (("table.csv", "x.mcap", "--controllers"), "leave x.mcap out"),
    (("a.mcap", "b.mcap", "--picture", "p.png"), "give --controllers"),
    (("table.csv", "--controllers", "--picture", "p.txt"), "p.txt")])
def test_bad_input_is_one_sentence(bowden: Run, table: Path, here: Path, monkeypatch: pytest.MonkeyPatch,
                                   words: tuple[str, ...], says: str) -> None:
    monkeypatch.chdir(here)
    told = bowden("compare", *words)
    assert told.status == 2
    assert says in told.stderr


@pytest.mark.exhaustive
def test_a_real_sweep_is_ranked(tmp_path: Path) -> None:
    made = library.sweep.over({"controller": ["none", "extended"], "period": [1.1], "cycles": [1], "settle": [0]},
                              tmp_path / "table.csv", workers=1)
    assert len(made) == 2
    found = summary.ranked(summary.ranked_rows(tmp_path / "table.csv"))
    assert [one.controller for one in found] == ["extended", "none"]
