"""The controller's steps once more over a recorded trial: the same, bit for bit, or where not."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bowden.replay.onto_controller import OUTPUTS, replay, walked
from bowden.trials.recorded import experiment
from master.control.controller import CONTROLLERS
from master.settings import Impedance
from parameters import InputError
from trial.read import Trial
from trial.read import open as opened
from trial.record import TrialContent, write

CURVE = 100


def rewritten(trial: Trial, path: Path, **columns: Any) -> Trial:
    """The same trial with other columns."""
    content = TrialContent(trial.time_ns, {**trial.columns, **columns}, trial.frames, [tuple(e) for e in trial.events])
    write(path, content, metadata=trial.metadata, result=trial.result or {}, attachments=trial.attachments)
    return opened(path)


@pytest.mark.parametrize("controller", [
    pytest.param(name, marks=() if name in ("paper", "extended") else pytest.mark.exhaustive) for name in CONTROLLERS])
def test_every_controller_says_the_same_again(recorded: Callable[..., Trial], controller: str) -> None:
    trial = recorded("--controller", controller, "--cycles", 2)
    found = replay(trial, experiment(trial))
    assert found.same, found
    assert found.rows == len(walked(trial)) > 2 * 1100
    assert found.frames == found.rows


def test_a_changed_controller_is_told_by_its_first_cycle_and_both_values(recorded: Callable[..., Trial]) -> None:
    trial = recorded()
    planned = experiment(trial)
    softer = dataclasses.replace(planned, impedance=Impedance(stiffness_n_m=301.0))
    found = replay(trial, softer)
    assert not found.same
    first = found.first
    assert first is not None
    assert first.signal in ("servo_target_m", "impedance_dx_m")
    changed = trial.columns["impedance_dx_m"] != 0.0
    assert first.row == walked(trial).start + int(np.argmax(changed[walked(trial).start:]))
    assert first.recorded == trial.columns[first.signal][first.row] != first.replayed
    assert "feedforward_m" not in found.differing  # END, START and the impedance play no part in it


@pytest.mark.parametrize("signal", OUTPUTS)
def test_one_bit_of_any_output_is_seen(recorded: Callable[..., Trial], tmp_path: Path, signal: str) -> None:
    trial = recorded()
    row = walked(trial).start + 700
    column = trial.columns[signal].copy()
    column[row] = np.nextafter(column[row], 1e300) if np.isfinite(column[row]) else 0.0
    found = replay(rewritten(trial, tmp_path / "changed.mcap", **{signal: column}), experiment(trial))
    assert found.differing == {signal: 1}
    assert found.first is not None
    assert (found.first.row, found.first.signal) == (row, signal)
    assert found.first.recorded == column[row]
    np.testing.assert_array_equal(found.first.replayed, trial.columns[signal][row])


def test_a_changed_byte_on_the_wire_is_seen(recorded: Callable[..., Trial], tmp_path: Path) -> None:
    trial = recorded()
    frames = trial.frames.copy()
    targets = np.flatnonzero(frames["can_id"] == 0x201)
    place = targets[np.searchsorted(frames["time_ns"][targets], trial.time_ns[walked(trial).start + 300])]
    frames["data"][place, 2] ^= 1
    content = TrialContent(trial.time_ns, trial.columns, frames)
    path = tmp_path / "changed.mcap"
    write(path, content, metadata=trial.metadata, result=trial.result or {}, attachments=trial.attachments)
    found = replay(opened(path), experiment(trial))
    assert found.differing == {"targets_frame": 1}
    assert found.first is not None
    assert found.first.row == walked(trial).start + 300


def test_inputs_that_were_not_there_are_held_again(recorded: Callable[..., Trial], tmp_path: Path) -> None:
    faults = tmp_path / "faults.toml"
    faults.write_text("".join(
        f'[[fault]]\nkind = "drop"\ncob_id = {0x183}\nstart_s = {at}\nstop_s = {at + 0.002}\n'
        for at in (5.6, 6.2, 6.9)))
    trial = recorded("--interface", "bowden", "--option", f"faults={faults}")
    assert trial.columns["held"].sum() >= 3
    assert replay(trial, experiment(trial)).same


def test_a_reference_from_files_travels_with_the_trial(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], tmp_path: Path
) -> None:
    percent = np.arange(CURVE) * 100 / CURVE
    force = 30 * np.clip(np.sin(2 * np.pi * (percent - 5) / 60), 0, None) * (percent < 35)
    curve = tmp_path / "force.csv"
    np.savetxt(curve, np.column_stack([percent, force]), delimiter=",", header="gait_percent,desired_force_n",
               comments="")
    trial = recorded("--desired", curve)
    curve.unlink()
    assert trial.metadata["course"] != recorded().metadata["course"]
    assert replay(trial, experiment(trial)).same
    told = bowden("replay", trial.path, "--onto", "controller", "--json")
    assert told.status == 0, told
    assert json.loads(told.stdout)["same"] is True


def test_a_controller_model_travels_with_the_trial(recorded: Callable[..., Trial], tmp_path: Path) -> None:
    model = tmp_path / "extended.toml"
    model.write_text("[effects.moment_arm]\nrope_per_knee_quadratic = 0.004\n")
    trial = recorded("--controller", "extended", "--cycles", 2, "--controller-model", model)
    plain = recorded("--controller", "extended", "--cycles", 2)
    model.unlink()
    assert not np.array_equal(trial.columns["servo_target_m"], plain.columns["servo_target_m"])
    assert replay(trial, experiment(trial)).same


def test_the_command_fails_where_the_replay_differs(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], tmp_path: Path
) -> None:
    trial = recorded()
    column = trial.columns["servo_target_m"].copy()
    column[walked(trial).start + 5] += 1e-6
    path = rewritten(trial, tmp_path / "changed.mcap", servo_target_m=column).path
    told = bowden("replay", path, "--onto", "controller")
    assert told.status == 1
    assert f"row {walked(trial).start + 5}" in told.stdout
    assert "servo_target_m" in told.stdout


def test_a_trace_that_an_older_trial_lacks_is_not_compared(recorded: Callable[..., Trial]) -> None:
    trial = recorded()
    older = dataclasses.replace(trial, columns={k: v for k, v in trial.columns.items() if k != OUTPUTS[-1]})
    assert replay(older, experiment(older)).same


def test_what_cannot_be_stepped_again_is_refused(recorded: Callable[..., Trial], tmp_path: Path) -> None:
    trial = recorded("--controller", "extended", "--cycles", 2)
    chosen = experiment(trial)
    no_day = dataclasses.replace(trial, result={})
    for broken, why in (
        (no_day, "has no day"),
        (dataclasses.replace(trial, lost_cycles=1), "control cycles are missing"),
        (dataclasses.replace(trial, columns={k: v for k, v in trial.columns.items() if k != "held"}), "no column held"),
        (dataclasses.replace(trial, columns={**trial.columns, "gait_percent": np.full(len(trial.time_ns), np.nan)}),
         "made no step"),
    ):
        with pytest.raises(InputError, match=why):
            replay(broken, chosen)
    with pytest.raises(InputError, match="motion or force it was run with"):
        experiment(dataclasses.replace(trial, metadata={**trial.metadata, "course": "0123456789abcdef"}))
    with pytest.raises(InputError, match="not a gait"):
        experiment(dataclasses.replace(trial, metadata={}))
    with pytest.raises(InputError, match=r"calibration\.toml is not attached"):
        experiment(dataclasses.replace(trial, attachments={"bench.toml": trial.attachments["bench.toml"]}))
