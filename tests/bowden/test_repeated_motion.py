"""A trial that repeats the motion of a recorded one: the same rope and knee motion, whatever changed on the bench."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bowden.bench import configuration
from bowden.cli.app import run
from trial import read

GAIT = ("--cycles", "3", "--period", "1.2", "--serial", "3")
CHANGED = "[effects.cable_friction]\nmu1 = 0.14\n"


@pytest.fixture
def ran(tmp_path: Path, bowden: Callable[..., Any]) -> Path:
    """A reference trial, and a day later a trial of its motion on a bench whose cable rubs more."""
    (tmp_path / "bench.toml").write_text(CHANGED, encoding="utf-8")
    assert bowden("trial", *GAIT, "-o", tmp_path / "good.mcap", "--json").status == 0
    status, _, err = bowden("trial", "--motion-of", tmp_path / "good.mcap", "--serial", 3, "--day", 1, "--plant-model",
                            tmp_path / "bench.toml", "-o", tmp_path / "again.mcap", "--json")
    assert status == 0, err
    return tmp_path


def test_rope_and_knee_move_as_they_did_and_the_controller_replays(ran: Path, bowden: Callable[..., Any]) -> None:
    good, again = (read.open(ran / name) for name in ("good.mcap", "again.mcap"))
    walked = [np.isfinite(one.columns["gait_percent"]) for one in (good, again)]
    for name in ("servo_target_m", "knee_target_rad", "desired_force_n", "gait_percent"):
        first, second = (one.columns[name][rows] for one, rows in zip((good, again), walked, strict=True))
        assert np.array_equal(first, second), name
    rope, repeated = (one.columns["servo_position_m"][rows] for one, rows in zip((good, again), walked, strict=True))
    assert np.std(rope - repeated) < 0.01 * np.std(rope)
    # another friction: the forces are not the same
    assert np.ptp(good.columns["tension_start_n"][walked[0]] - again.columns["tension_start_n"][walked[1]]) > 3.0
    status, out, err = bowden("replay", ran / "again.mcap", "--onto", "controller", "--json")
    assert (status, json.loads(out)["differing"]) == (0, {}), err
    status, out, err = bowden("diagnose", ran / "again.mcap", "--healthy", ran / "good.mcap", "--json")
    assert status == 0, err
    told = json.loads(out)
    assert "cable_friction" in told["class"]
    assert any("good.mcap has the motion of the trial: only their difference" in said for said in told["warnings"])
    assert any("good.mcap alone does not show how far sessions differ" in said for said in told["warnings"])


def test_every_force_path_moves_as_it_did_and_replays(
        tmp_path: Path, bowden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bench.toml").write_text(configuration.as_template(shape="bench_antagonists"), encoding="utf-8")
    bench = ("trial", "--config", "bench.toml", "--json")
    assert bowden(*bench, "--cycles", 1, "--settle", 0, "--period", 1.2, "-o", "good.mcap").status == 0
    status, _, err = bowden(*bench, "--motion-of", "good.mcap", "--day", 1, "-o", "again.mcap")
    assert status == 0, err
    good, again = (read.open(Path(name)).columns for name in ("good.mcap", "again.mcap"))
    for path in ("flexor", "extensor"):
        walked = [np.isfinite(one[f"{path}.gait_percent"]) for one in (good, again)]
        for name in ("servo_target_m", "knee_target_rad"):
            first, second = (one[f"{path}.{name}"][rows] for one, rows in zip((good, again), walked, strict=True))
            assert np.array_equal(first, second), (path, name)
        status, out, err = bowden("replay", "again.mcap", "--path", path, "--onto", "controller", "--json")
        assert (status, json.loads(out)["differing"]) == (0, {}), err


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a short trial and a dry run."""
    folder = tmp_path_factory.mktemp("recorded")
    for name, more in (("good.mcap", ()), ("dry.mcap", ("--dry-run",))):
        assert run(["trial", "--cycles", "1", "--settle", "0", "--period", "1.2", *more, "-o", str(folder / name),
                    "--json"]) == 0
    (folder / "legs.toml").write_text(configuration.as_template(shape="bench_two_legs"), encoding="utf-8")
    return folder


@pytest.mark.parametrize(("words", "said"), [
    (("--experiment", "repeat"), "name it with --motion-of"),
    (("--motion-of", "good.mcap", "--peak", "40", "--soft-start", "1"), "leave --peak, --soft-start out"),
    (("--motion-of", "good.mcap", "--strides", "4", "--set", "a=1"), "leave --set, --strides out"),
    (("--motion-of", "good.mcap", "--experiment", "step"), "leave --experiment out"),
    (("--motion-of", "dry.mcap"), "needs a trial that moved the bench to its end"),
    (("--motion-of", "good.mcap", "--rate", "500"), "say --rate 1000"),
    (("--motion-of", "none.mcap"), "none.mcap"),
    (("--motion-of", "good.mcap", "--config", "legs.toml"), "records a single force path, this bench has the force"),
], ids=lambda given: " ".join(given) if isinstance(given, tuple) else "")
def test_a_motion_that_cannot_be_repeated_is_refused_in_one_sentence(
    recorded: Path, bowden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(recorded)
    status, out, err = bowden("trial", *words, "-o", "again.mcap")
    assert (status, out) == (2, "")
    assert said in err
    assert err.count("\n") <= 2
    assert not Path("again.mcap").exists()
