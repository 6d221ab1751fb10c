"""The experiment that decides is proposed by simulating this bench, and not again once it has been run."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis.evidence.experiment_prediction import motion_of
from estimation.path_model import PATH_MODEL
from physics.effects.separating_experiments import EXPERIMENTS
from physics.forward.path_constants import TABLE

GAIT = ("--cycles", "3", "--period", "1.2", "--serial", "3")


@pytest.mark.parametrize("name", [n for n, one in EXPERIMENTS.items() if one.script and one.waypoints])
def test_the_rope_is_led_until_end_is_what_the_waypoints_ask_for(name: str) -> None:
    from estimation.data.table import table

    time = np.arange(0.0, 2.0, 0.01)
    like = PATH_MODEL.record(table("like", {
        "time_s": time, "servo_position_m": 0.01 * np.sin(time), "knee_angle_rad": -0.5 + 0.1 * np.sin(time),
        "tension_start_n": 5.0 + np.sin(time), "tension_end_n": 4.0 + np.sin(time)}))
    made = motion_of(name, np.zeros(len(TABLE)), like)
    points = EXPERIMENTS[name].waypoints
    at = 1.0 + np.cumsum([p.seconds for p in points])
    end = np.interp(at, made.time_s, made.measured("tension_end_n"))
    held = [k for k, p in enumerate(points) if p.seconds >= 0.5 and p.end_n >= 5.0 and at[k] < made.time_s[-1] - 0.2]
    assert np.abs(end - [p.end_n for p in points])[held].max(initial=0.0) < 3.0


@pytest.mark.exhaustive
def test_an_ambiguous_trial_gets_an_experiment_and_none_twice(tmp_path: Path, bowden: Callable[..., Any]) -> None:
    (tmp_path / "bench.toml").write_text("[effects.fabric_friction]\nmu2 = 0.36\n", encoding="utf-8")
    changed = ["--day", "2", "--plant-model", str(tmp_path / "bench.toml")]
    for name, words in (("a", ["--day", "0"]), ("b", ["--day", "1"]), ("trial", [*changed, "--period", "1.4"])):
        assert bowden("trial", *GAIT, *words, "-o", tmp_path / f"{name}.mcap", "--json").status == 0
    asked = ("--healthy", tmp_path / "a.mcap", "--healthy", tmp_path / "b.mcap", "--json")
    status, out, err = bowden("plan", tmp_path / "trial.mcap", *asked)
    assert status == 0, err
    found = json.loads(out)
    assert found["verdict"] == "ambiguous"
    assert "fabric_friction" in found["class"]
    chances = [one["sure"] for one in found["experiments"]]
    assert all(0.0 <= chance <= 1.0 for chance in chances)
    names = [one["name"] for one in found["experiments"]]
    assert "repeat" in names  # of a reference trial's motion
    first = next(name for name in names if name != "repeat")
    assert bowden("trial", "--experiment", first, "--serial", 3, *changed, "-o", tmp_path / "second.mcap",
                  "--json").status == 0
    status, out, err = bowden("plan", tmp_path / "trial.mcap", tmp_path / "second.mcap", *asked)
    assert status == 0, err
    again = json.loads(out)
    assert again["tried"] == [first]
    assert first not in [one["name"] for one in again["experiments"]]


@pytest.mark.parametrize(("words", "said"), [
    (("plan",), "bowden plan TRIAL… | --logbook DIR | --model FILE"),
    (("plan", "x.mcap", "--model", "m.toml"), "leave trials, --healthy, --logbook and --path out"),
    (("plan", "--model", "m.toml"), "states no effect"),
    (("plan", "x.mcap", "--healthy", "x.mcap"), "no reference trial beside the trials themselves"),
    (("plan", "--logbook", "none"), "holds no logbook"),
    (("plan", "--logbook", "book"), "no reference session"),
], ids=lambda given: " ".join(given) if isinstance(given, tuple) else "")
def test_a_plan_that_cannot_be_made_is_refused_in_one_sentence(here: Path, bowden: Callable[..., Any],
                                                               words: tuple[str, ...], said: str) -> None:
    assert bowden("logbook", "init", "book").status == 0
    Path("m.toml").write_text("[plant]\n", encoding="utf-8")
    status, out, err = bowden(*words)
    assert (status, out) == (2, "")
    assert said in err
