"""A trial runs end to end on the virtual bus, with END out of the loop, twice the same."""

from __future__ import annotations

import gc
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eds.cia402 import State, state_of
from master import settings
from master.network.host_computer import collector_frozen
from physics.calibration import nominal
from physics.end_discrepancy import COUNT, EndDiscrepancy
from trial.signals import COLUMNS

if TYPE_CHECKING:
    from conftest import Composer, Ran

SYNC, TARGETS, CONTROLWORDS, SERVO_TPDO, END_TPDO = 0x080, 0x201, 0x301, 0x181, 0x184


@pytest.fixture(scope="module")
def plain(module_composer: Composer) -> Ran:
    """A trial of two gait cycles by the paper's controller."""
    return module_composer.run()


def test_a_trial_completes_and_the_force_follows(composer: Composer) -> None:
    """The paper reports 2.5 % on its own bench; on the nominal one the printed controller must do no worse."""
    ran = composer.run(cycles=3, period_s=2.0, serial=0)
    assert (ran.result.outcome, ran.result.stop_reason) == ("completed", None)
    assert ran.result.missed_cycles == ran.result.stale_inputs == 0
    found = ran.figures(40.0, 3)
    assert found["true_relative_rmse_percent"] is not None
    assert found["true_relative_rmse_percent"] < 2.53
    assert found["true_max_idle_tension_n"] is not None
    assert found["true_max_idle_tension_n"] < 1.0


@pytest.mark.parametrize("controller", ["paper", pytest.param("extended", marks=pytest.mark.exhaustive)])
def test_a_soft_start_raises_the_peak_over_unnumbered_cycles(composer: Composer, plain: Ran, controller: str) -> None:
    """Thirds of 40 N, then 40 N, and no target steps further from one control cycle to the next than without."""
    plain = plain if controller == "paper" else composer.run(controller=controller)
    soft = composer.run(controller=controller, soft_start=2)
    walked = ~np.isnan(soft.trial.columns["gait_percent"])
    desired, phase = (soft.trial.columns[name][walked] for name in ("desired_force_n", "gait_percent"))
    peaks = [float(part.max()) for part in np.split(desired, np.flatnonzero(np.diff(phase) < 0.0) + 1)]
    assert peaks == pytest.approx([0.0, 40.0 / 3.0, 80.0 / 3.0, 40.0, 40.0, 0.0], abs=0.01)
    assert set(soft.trial.columns["cycle"]) == {-1.0, 0.0, 1.0}
    steps = [float(np.max(np.abs(np.diff(ran.trial.columns["servo_target_m"])))) for ran in (plain, soft)]
    assert steps[1] <= 1.05 * steps[0], "noise moves the largest of some thousand steps by a few per cent"


def test_every_cycle_is_one_sync_four_inputs_and_one_frame_of_targets(plain: Ran) -> None:
    trial = plain.trial
    frames = trial.frames
    ids = frames["can_id"]
    cycles = len(trial.time_ns)
    first, last = trial.time_ns[0], trial.time_ns[-1]
    inside = (frames["time_ns"] >= first) & (frames["time_ns"] < last)
    for can_id in (SYNC, TARGETS, SERVO_TPDO, END_TPDO):
        assert int((ids[inside] == can_id).sum()) == cycles - 1
    assert set(trial.columns) == set(COLUMNS)
    unknown = {name for name in COLUMNS if np.isnan(trial.columns[name]).all()}
    assert unknown == {"step_duration_ns", "estimated_end_half_n"}, "virtual time; the paper's estimate has no interval"


def test_drives_are_enabled_after_the_bring_up_only_and_end_disabled(plain: Ran) -> None:
    word = np.uint16(plain.sent(SERVO_TPDO)[:, 0]) | np.uint16(plain.sent(SERVO_TPDO)[:, 1]) << 8
    states = [state_of(int(value)) for value in word]
    assert states[0] is State.SWITCH_ON_DISABLED
    assert State.OPERATION_ENABLED in states
    assert states[-1] is State.SWITCH_ON_DISABLED
    assert plain.trial.columns["tension_start_n"][-50:].max() < settings.Limits().unwound_n


def test_end_is_out_of_the_loop(composer: Composer, plain: Ran) -> None:
    """END's frames corrupted, within what friction allows, leave every byte that the master sends as it was.

    END moves nothing; a lie of it that contradicts START stops the trial, and until then no byte is another one.
    """
    noisy = composer.run(plant_model={"end_sensor": {"noise_n": 1.0, "gain": 0.95}})
    assert not np.array_equal(plain.sent(END_TPDO), noisy.sent(END_TPDO))
    for can_id in (TARGETS, CONTROLWORDS):
        np.testing.assert_array_equal(plain.sent(can_id), noisy.sent(can_id))
    lying = composer.run(plant_model={"end_sensor": {"gain": 0.4}})
    assert "START is 2" in str(lying.result.stop_reason)
    until = int(np.searchsorted(lying.trial.time_ns, _stopped_ns(lying))) - 1
    np.testing.assert_array_equal(plain.sent(TARGETS)[:until], lying.sent(TARGETS)[:until])


def test_end_is_out_of_the_loop_of_a_calibration_with_a_discrepancy(composer: Composer) -> None:
    """What identification told of END is in every target; what END says in the trial is in none."""
    covariance = tuple(tuple(row) for row in (1e-6 * np.eye(COUNT)).tolist())
    told = EndDiscrepancy((0.03,) * COUNT, covariance, (5.0, 60.0), (0.1, 1.0), 0.5, 0.03, 0.01)
    given = {"controller": "extended", "experiment": {"calibration": replace(nominal(), discrepancy=told)}}
    plain = composer.run(**given)
    noisy = composer.run(**given, plant_model={"end_sensor": {"noise_n": 1.0, "gain": 0.95}})
    assert not np.array_equal(plain.sent(END_TPDO), noisy.sent(END_TPDO))
    for can_id in (TARGETS, CONTROLWORDS):
        np.testing.assert_array_equal(plain.sent(can_id), noisy.sent(can_id))
    without = composer.run(controller="extended")
    assert not np.array_equal(plain.sent(TARGETS), without.sent(TARGETS))


def _stopped_ns(ran: Ran) -> int:
    return next(event.time_ns for event in ran.trial.events if event.kind == "safety")


def test_the_same_seed_gives_the_same_trial_and_another_another(composer: Composer, plain: Ran) -> None:
    same, another = (composer.run(seed=seed).trial.digest() for seed in (0, 1))
    assert plain.trial.digest() == same != another


def test_a_dry_run_moves_everything_but_the_drives(composer: Composer) -> None:
    ran = composer.run(cycles=1, experiment={"dry_run": True})
    assert ran.result.outcome == "completed"
    assert not np.any(ran.sent(CONTROLWORDS)[:, 0] & 0x08)
    assert np.ptp(ran.trial.columns["knee_angle_rad"]) < 1e-3
    assert ran.trial.columns["gait_percent"][-1] > 0.0


def test_the_collector_is_frozen_only_during_the_cycle(composer: Composer) -> None:
    """Objects that the program has exempted itself stay exempt."""
    assert gc.isenabled()
    gc.unfreeze()
    composer.run(cycles=1)
    assert (gc.isenabled(), gc.get_freeze_count()) == (True, 0)
    gc.freeze()
    with collector_frozen():
        assert not gc.isenabled()
    assert gc.isenabled()
    assert gc.get_freeze_count() > 0


def test_lost_inputs_are_held_counted_and_told(composer: Composer) -> None:
    """One START frame in a thousand lost: the cycle holds, the trial counts it, and goes on."""
    ran = composer.run(faults=[{"kind": "drop", "cob_id": 0x183, "probability": 0.005, "start_s": 3.0}])
    assert ran.result.outcome == "completed"
    columns = ran.trial.columns
    gone = columns["missed_inputs"] > 0
    assert 0 < int(gone.sum()) == ran.result.missed_cycles == len(ran.said("miss"))
    in_gait = gone & (columns["cycle"] >= 0)
    assert in_gait.any()
    assert np.all(columns["held"][in_gait] == 1.0)
    later = np.flatnonzero(in_gait)
    np.testing.assert_array_equal(columns["servo_target_m"][later], columns["servo_target_m"][later - 1])
    assert np.all(columns["start_pdo_age_ns"][later] >= 1_000_000)
    assert ran.result.stale_inputs == 0


def test_a_late_sync_is_seen_as_jitter_not_as_a_miss(composer: Composer) -> None:
    ran = composer.run(cycles=1, faults=[{"kind": "late_sync", "delay_us": 150.0, "start_s": 3.0, "stop_s": 3.05}])
    assert ran.result.outcome == "completed"
    assert 140_000 < ran.trial.columns["sync_jitter_ns"].max() < 160_000
