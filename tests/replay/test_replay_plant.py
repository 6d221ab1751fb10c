"""A trial's commands into the simulation: nothing is left over on its own bench, something on another."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bowden.replay.onto_plant import PREFIX, commands, origin_ns, residuals
from bowden.replay.player import plan
from parameters import InputError
from trial.read import Trial
from trial.read import open as opened
from trial.record import TrialContent, write

SECOND_NS = 1_000_000_000


@pytest.mark.parametrize("options", [
    (), ("--serial", 4, "--day", 2, "--seed", 9),
    pytest.param(("--controller", "extended", "--cycles", 2), marks=pytest.mark.exhaustive),
    ("--rate", 500, "--bitrate", 800_000),
], ids=str)
def test_on_its_own_bench_nothing_is_left_over(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], options: tuple[Any, ...]
) -> None:
    trial = recorded(*options)
    bench = options if "--serial" in options else ()
    told = bowden("replay", trial.path, "--onto", "plant", *bench, "--json")
    assert told.status == 0, told
    result = json.loads(told.stdout)
    assert result["same"] is True
    assert result["rows"] >= len(trial.time_ns)
    for name in ("servo_position_m", "servo_force_n", "knee_angle_rad", "tension_start_n", "tension_end_n",
                 "servo_target_m", "knee_target_rad", "servo_statusword", "end_pdo_arrival_ns"):
        row = result["residuals"][name]
        assert row["rows"] >= len(trial.time_ns) - 1, name
        assert (row["differing"], row["one_sided"], row["rms"], row["largest"]) == (0, 0, 0.0, 0.0), name


def test_on_another_bench_something_is_and_it_is_written(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], tmp_path: Path
) -> None:
    trial, target = recorded(), tmp_path / "residuals.mcap"
    told = bowden("replay", trial.path, "--onto", "plant", "--serial", 3, "-o", target, "--json")
    assert told.status == 1, told
    figures = json.loads(told.stdout)["residuals"]
    assert figures["servo_target_m"]["differing"] == 0
    assert figures["tension_start_n"]["differing"] > 1000
    left = opened(target)
    for name, row in figures.items():
        column = left.columns[f"{PREFIX}{name}"]
        assert np.sqrt(np.nanmean(column**2)) == pytest.approx(row["rms"], rel=1e-12), name  # summed in another order
        assert left.units[f"{PREFIX}{name}"] == row["unit"]
    walked = left.columns["cycle"] >= 0
    assert np.count_nonzero(walked) == np.count_nonzero(trial.columns["cycle"] >= 0)
    start = left.columns[f"{PREFIX}tension_start_n"]
    assert np.sqrt(np.mean(start[walked] ** 2)) == pytest.approx(figures["tension_start_n"]["gait_rms"], rel=1e-12)
    assert left.metadata["experiment"] == "residuals"
    assert bowden("replay", trial.path, "--onto", "plant", "-o", target).status == 2  # kept


def test_a_trial_that_was_stamped_by_the_day_is_replayed_at_its_phase(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], tmp_path: Path
) -> None:
    trial = recorded()
    epoch = 1_760_000_000 * SECOND_NS
    frames = trial.frames.copy()
    frames["time_ns"] += epoch
    path = tmp_path / "dated.mcap"
    write(path, TrialContent(trial.time_ns + epoch, trial.columns, frames), metadata=trial.metadata, result={},
          attachments=trial.attachments)
    told = bowden("replay", path, "--onto", "plant", "--json")
    assert told.status == 0, told


def test_one_changed_bit_is_left_over(recorded: Callable[..., Trial]) -> None:
    from eds.bench.bench_network import Network, wire

    trial, described = recorded(), wire(Network())
    assert residuals(trial, trial.frames, described).same
    changed = trial.frames.copy()
    place = np.flatnonzero(changed["can_id"] == 0x184)[2000]
    changed["data"][place, 0] ^= 1
    found = residuals(trial, changed, described)
    assert not found.same
    assert {name for name, row in found.figures.items() if row.differing} == {"tension_end_n"}
    assert found.figures["tension_end_n"].differing == 1
    assert found.figures["tension_end_n"].largest == pytest.approx(0.01)  # one count of 7130h
    lost = np.delete(trial.frames, place)
    assert residuals(trial, lost, described).figures["tension_end_n"].one_sided == 1


def test_commands_are_what_the_recording_computer_sent(recorded: Callable[..., Trial]) -> None:
    from eds.bench.bench_network import Network, wire

    frames = recorded().frames
    chosen = plan(frames, commands(wire(Network())))
    assert chosen.frames["sent"].all()
    assert len(chosen) == np.count_nonzero(frames["sent"])


@pytest.mark.parametrize(("first_ns", "command_ns", "expected"), [
    (66_000, 250_000_000, 66_000), (7 * SECOND_NS + 66_000, 250_000_000, 66_000),
    (66_000, 0, SECOND_NS + 66_000), (3 * SECOND_NS + 200_000_000, 0, 200_000_000),
])
def test_the_bench_has_booted_and_every_phase_is_kept(first_ns: int, command_ns: int, expected: int) -> None:
    assert origin_ns(first_ns, command_ns) == expected


def test_only_simulated_benches_and_trials_with_frames(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], tmp_path: Path
) -> None:
    trial = recorded()
    told = bowden("replay", trial.path, "--onto", "plant", "--interface", "virtual")
    assert (told.status, told.stdout) == (2, "")
    assert "--interface means nothing to --onto plant" in told.stderr
    path = tmp_path / "columns.mcap"
    write(path, TrialContent(trial.time_ns, trial.columns), metadata=trial.metadata, result={})
    told = bowden("replay", path, "--onto", "plant")
    assert (told.status, told.stdout) == (2, "")
    assert "no CAN frames" in told.stderr
    from eds.bench.bench_network import Network, wire

    with pytest.raises(InputError, match="no SYNC"):
        residuals(opened(path), trial.frames[:10], wire(Network()))
