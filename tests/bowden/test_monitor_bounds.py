"""`bowden monitor-bounds`: a bench that a person's file would stop sets what is the bench's in it, and runs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bowden.bench.monitor_bounds import BENCH_MARGIN, SLOWEST_HZ
from safety_monitor import packaged, read
from trial.record import Recorder
from trial.signals import SIGNALS

WALK = ("--serial", "0", "--cycles", "1", "--settle", "0")
NAMES = [signal.name for signal in SIGNALS]


@pytest.fixture
def person(here: Path) -> Path:
    """Bounds that the packaged bench breaks at START and keeps elsewhere."""
    path = here / "person.toml"
    path.write_text(packaged().read_text().replace("start_n = 65.0", "start_n = 45.0"))
    return path


def recorded(path: Path, rope_m: Any, start_n: Any, *, rate_hz: float = 1000.0, gait: bool = True,
             bench: str = "", reason: str | None = None, dry_run: bool = False) -> Path:
    """Write a trial with this course of rope and START."""
    recorder = Recorder(path, metadata={"dry_run": str(dry_run).lower()},
                        attachments={"bench.toml": bench.encode()}, threaded=False)
    values = np.zeros((len(rope_m), len(SIGNALS)))
    values[:, NAMES.index("servo_position_m")] = rope_m
    values[:, NAMES.index("tension_start_n")] = start_n
    values[:, NAMES.index("gait_percent")] = 0.0 if gait else np.nan
    recorder.cycles(np.arange(len(values)) * round(1e9 / rate_hz), values)
    recorder.close({"outcome": "stopped" if reason else "completed", "stop_reason": reason})
    return path


def test_a_bench_that_a_persons_file_stops_runs_with_the_bounds_of_its_own_trial(
        bowden: Callable[..., Any], person: Path, here: Path) -> None:
    status, _, err = bowden("trial", *WALK, "--monitor", person, "-o", "stopped.mcap")
    assert status == 1, err
    assert bowden("trial", *WALK, "--day", "1", "-o", "bench.mcap").status == 0
    status, out, err = bowden("monitor-bounds", "bench.mcap", "--person", person, "-o", "P.toml")
    assert status == 0, err
    assert "larger now: start_n 45 to" in out
    before, after = read(person), read(here / "P.toml")
    assert before.start_n < after.start_n
    assert {key: value for key, value in vars(after).items() if value != getattr(before, key)}.keys() == {
        "start_n", "sha256"}
    assert bowden("trial", *WALK, "--monitor", "P.toml", "-o", "whole.mcap").status == 0
    status, _, err = bowden("monitor-bounds", "stopped.mcap", "--person", person, "-o", "Q.toml")
    assert (status, (here / "Q.toml").exists()) == (2, False)
    assert "stopped.mcap: was stopped (emergency message: node 126" in err


def test_each_bound_is_a_margin_above_what_the_monitor_would_see(
        bowden: Callable[..., Any], person: Path, here: Path) -> None:
    t = np.arange(3000) * 1e-3
    recorded(here / "own.mcap", 0.1 * np.sin(2 * np.pi * t), 40.0 + 10.0 * np.sin(2 * np.pi * 20.0 * t))
    status, out, err = bowden("monitor-bounds", "own.mcap", "--person", person, "-o", "P.toml", "--json")
    assert status == 0, err
    largest = {key: bound["largest"] for key, bound in json.loads(out)["bounds"].items()}
    rope_ahead = 0.1 * 2 * np.pi * np.hypot(1.0, 2 * np.pi * 6e-3)  # speed with 6 ms of its acceleration ahead
    rise = 10.0 * 2 * np.pi * 20.0
    assert largest == pytest.approx({"start_n": 50.0, "force_rate_n_s": rise, "rope_m_s": rope_ahead},
                                    rel=0.02)  # 3 ms chords of a sine of 50 ms: 0.6 %; 1 ms grid of the speed: 0.1 %
    after = read(here / "P.toml")
    for key, value in largest.items():
        assert getattr(after, key) == pytest.approx(max(getattr(read(person), key), BENCH_MARGIN * value), rel=0.01)


@pytest.mark.parametrize(("how", "sentence"), [
    ({"gait": False}, "has no gait at 333 control cycles a second or more"),
    ({"rate_hz": 0.9 * SLOWEST_HZ}, "has no gait at 333 control cycles a second or more"),
    ({"bench": '[record]\nlimb = "P03, left"\n'}, "moved a limb ([record] limb)"),
    ({"dry_run": True}, "is a dry run, in which the drives were off"),
    ({"reason": "START beyond its limit"}, "was stopped (START beyond its limit)"),
    ({"start_n": 100.0}, "start_n would be 125 N (1.25 times 100), a person's file may have 120"),
])
def test_a_trial_that_says_nothing_of_the_healthy_bench_is_refused(
        bowden: Callable[..., Any], person: Path, here: Path, how: dict[str, Any], sentence: str) -> None:
    recorded(here / "own.mcap", np.zeros(1000), how.pop("start_n", 0.0), **how)
    status, out, err = bowden("monitor-bounds", "own.mcap", "--person", person, "-o", "P.toml")
    assert (status, out, (here / "P.toml").exists()) == (2, "", False)
    assert "own.mcap: " in err
    assert sentence in err


def test_a_bound_that_cannot_be_rewritten_is_not_said_to_be_larger(
        bowden: Callable[..., Any], person: Path, here: Path) -> None:
    person.write_text(person.read_text().replace("start_n = 45.0", '"start_n" = 45.0'))
    recorded(here / "own.mcap", np.zeros(1000), 50.0)
    status, out, err = bowden("monitor-bounds", "own.mcap", "--person", person, "-o", "P.toml")
    assert (status, out, (here / "P.toml").exists()) == (2, "", False)
    assert "person.toml: the line of start_n cannot be rewritten" in err
