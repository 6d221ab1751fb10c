"""From a diagnosis to a better loop, as it is typed: experiments, plans, models for simulator and controller."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import trial as trials
from physics.effects.catalogue import CATALOGUE

Run = Callable[..., Any]
RUBBING = "[effects.cable_friction]\nmu1 = { value = 0.16, low = 0.15, high = 0.17, unit = '' }\n"


def test_an_experiment_is_an_ordinary_trial_under_its_name(bowden: Run, here: Path) -> None:
    told = bowden("trial", "--experiment", "two_peaks", "--json", "-o", "peaks.mcap")
    assert told.status == 0, told.stderr
    result = json.loads(told.stdout)
    assert result["outcome"] == "completed"
    assert result["relative_rmse_percent"] is None
    recorded = trials.open(here / "peaks.mcap")
    assert recorded.metadata["experiment"] == "two_peaks"
    assert np.array_equal(np.unique(recorded.columns["cycle"]), np.arange(-1, 10))


@pytest.mark.parametrize(("options", "says"), [
    (["--experiment", "dead_weight"], "needs an operator: hang the weight"),
    (["--experiment", "waltz"], "locked_angles"),
    (["--experiment", "two_peaks", "--dry-run"], "--dry-run moves nothing"),
    (["--controller-model", "none.toml"], "none.toml: no such file"),
    (["--plant", "nowhere:create"], "cannot be imported"),
])
def test_what_cannot_be_run_leaves_no_file(options: list[str], says: str, bowden: Run, here: Path) -> None:
    told = bowden("trial", *options, "-o", "trial.mcap")
    assert (told.status, told.stdout) == (2, "")
    assert says in told.stderr
    assert not list(here.iterdir())


def test_a_controller_model_of_no_effect_is_refused(bowden: Run, here: Path) -> None:
    (here / "model.toml").write_text("[effects.gremlin]\n", encoding="utf-8")
    told = bowden("trial", "--controller-model", "model.toml", "-o", "trial.mcap")
    assert told.status == 2
    assert "model.toml: effects: gremlin is not in the catalogue" in told.stderr


def test_knowing_what_is_at_work_pays_in_the_loop_and_is_replayed(bowden: Run, here: Path) -> None:
    (here / "model.toml").write_text(RUBBING, encoding="utf-8")
    told = bowden("verify", "model.toml", "--plant-model", "model.toml", "--serial", 0, "--cycles", 2, "--period", 1.5,
                  "--json", "-o", "verify.mcap")
    assert told.status == 0, told.stderr
    result = json.loads(told.stdout)
    assert result["effects"] == {"cable_friction": {"mu1": 0.16}}
    assert result["judged_by"] == "true_relative_rmse_percent"
    assert result["gain_percent"] > 20.0
    after = trials.open(here / "verify-after.mcap")
    assert after.metadata["controller_model"] == "cable_friction"
    assert after.attachments["controller_model.toml"] == RUBBING.encode()
    assert "controller_model.toml" not in trials.open(here / "verify-before.mcap").attachments
    replayed = bowden("replay", "verify-after.mcap", "--onto", "controller")
    assert replayed.status == 0, replayed.stdout + replayed.stderr


@pytest.mark.exhaustive
def test_a_plan_says_the_smallest_of_each_effect(bowden: Run, here: Path) -> None:
    told = bowden("diagnose", "--plan", "two_peaks", "--noise", 0.3, "--json")
    assert told.status == 0, told.stderr
    assert told.stdout.count("\n") == 1
    result = json.loads(told.stdout)
    assert result["experiment"] == "two_peaks"
    rows = {row["effect"]: row for row in result["effects"]}
    assert set(rows) | set(result["blind"]) == set(CATALOGUE)
    friction = rows["cable_friction"]
    low, high = CATALOGUE["cable_friction"].parameters[0].likely
    assert 0.0 < friction["smallest"] < high - low
    assert friction["unit"] == ""
    # a locked knee shows the knee's geometry by the shift of its zero alone, far beyond a likely change
    assert rows["moment_arm"]["smallest"] > 2.0 * max(map(abs, CATALOGUE["moment_arm"].parameters[0].likely))
    assert not list(here.iterdir())


@pytest.mark.parametrize(("arguments", "says"), [
    (["--plan", "two_peaks", "trial.mcap"], "leave TRIAL out"),
    (["--plan", "two_peaks", "-o", "x.toml"], "leave -o out"),
    (["--plan", "dead_weight"], "needs an operator"),
    (["trial.mcap", "--noise", "0.1"], "--noise belongs to --plan"),
    (["--json"], "no trial given"),
    (["trial.mcap", "--tracked", "a.mcap", "b.mcap"], "name one with --report"),
])
def test_options_that_do_not_belong_together(arguments: list[str], says: str, bowden: Run, here: Path) -> None:
    told = bowden("diagnose", *arguments)
    assert (told.status, told.stdout) == (2, "")
    assert says in told.stderr
