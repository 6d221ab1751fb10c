"""The catalogue's experiments on the bench: they do what their words say, lap by lap, and end safely."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from master import settings
from master.motion import scripted_experiments
from master.motion.experiment_run import ExperimentSetup
from master.network.link import Link
from parameters import InputError
from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS, SCRIPTED
from physics.reference import paper_reference
from trial import read
from trial.record import Recorder
from virtual_bus.bus import BowdenBus

CHANNELS = itertools.count()
BY_HAND = ["known_bend", "dead_weight", "swapped_sensors", "log_current"]
LONG = ("rest_repeat", "hold_return", "three_speeds", "slack_swing", "two_speeds", "dither", "full_turns")
"""What takes longer than its test is worth every time."""


def ran(name: str, path: Path, cycles: int = 2) -> read.Trial:
    channel = f"experiments-{next(CHANNELS)}"
    bus, tap = BowdenBus(channel, serial=2), BowdenBus(channel)
    recorder = Recorder(path, metadata={}, attachments={}, threaded=False)
    chosen = ExperimentSetup(paper_reference(40.0, 1.1), gait=settings.Gait(period_s=1.1, cycles=cycles))
    result = scripted_experiments.run(Link(bus, bus.time_ns), tap, recorder, chosen, name)
    recorder.close({})
    tap.shutdown()
    bus.shutdown()
    assert (result.outcome, result.stop_reason) == ("completed", None)
    assert result.missed_cycles == 0
    return read.open(path)


def laps(trial: read.Trial, column: str) -> list[np.ndarray]:
    """A column, lap by lap."""
    numbers = trial.columns["cycle"]
    return [trial.columns[column][numbers == n] for n in np.unique(numbers[numbers >= 0])]


def test_every_experiment_of_the_catalogue_is_run_or_needs_hands() -> None:
    by_hand = [name for name, one in EXPERIMENTS.items() if one.by_hand]
    assert by_hand == [name for name, one in EXPERIMENTS.items() if one.around] == BY_HAND
    assert set(SCRIPTED) == set(EXPERIMENTS) - set(BY_HAND)
    assert {effect.experiment for effect in CATALOGUE.values()} <= set(EXPERIMENTS)


@pytest.mark.parametrize("name", BY_HAND)
def test_what_needs_hands_is_refused_with_what_they_do(name: str) -> None:
    with pytest.raises(InputError, match=f"{name} needs an operator: {EXPERIMENTS[name].by_hand}"):
        scripted_experiments.checked(name, where="--experiment")


def test_an_unknown_experiment_names_the_known() -> None:
    with pytest.raises(InputError, match="locked_angles"):
        scripted_experiments.checked("waltz", where="--experiment")


def test_locked_angles_pull_and_release_at_three_angles(tmp_path: Path) -> None:
    trial = ran("locked_angles", tmp_path / "t.mcap")
    starts, knees = laps(trial, "tension_start_n"), laps(trial, "knee_angle_rad")
    assert len(starts) == scripted_experiments.laps("locked_angles", 0) == 12
    # the pull stops when START has passed 50 N; two cycles and the drive's lag at 60 mm/s are a millimetre: 4 N
    assert all(50.0 < start.max() < 56.0 and 5.0 < start.min() < 12.0 for start in starts)
    assert [round(math.degrees(float(np.median(knee)))) for knee in knees[::4]] == [-10, -30, -60]
    assert all(np.ptp(knee) < math.radians(0.1) for knee in knees)


def test_two_peaks_reach_both(tmp_path: Path) -> None:
    tops = [start.max() for start in laps(ran("two_peaks", tmp_path / "t.mcap"), "tension_start_n")]
    assert all(20.0 < top < 26.0 for top in tops[:5])
    assert all(60.0 < top < 66.0 for top in tops[5:])


def test_reversals_shrink_as_told(tmp_path: Path) -> None:
    travel = [np.ptp(rope) for rope in laps(ran("amplitude_sweep", tmp_path / "t.mcap"), "servo_position_m")]
    told = np.repeat([0.1e-3, 0.2e-3, 0.5e-3, 1e-3, 2e-3, 5e-3], 3)
    # the drive's lag of 8 ms at 2 mm/s rounds each end off
    np.testing.assert_allclose(travel, told, atol=30e-6)


def test_a_locked_motor_leaves_the_rope_where_it_is(tmp_path: Path) -> None:
    trial = ran("locked_motor", tmp_path / "t.mcap")
    # the held rope gives by the servo's own softness only
    assert max(np.ptp(rope) for rope in laps(trial, "servo_position_m")[1:]) < 0.1e-3
    swung = [np.ptp(knee) for knee in laps(trial, "knee_angle_rad")]
    np.testing.assert_allclose(np.degrees(swung), np.repeat([2.0, 4.0, 10.0], 3), rtol=0.03)


def test_unloading_goes_slack_and_comes_back(tmp_path: Path) -> None:
    trial = ran("unload", tmp_path / "t.mcap")
    assert all(rope.max() - rope.min() > 10e-3 for rope in laps(trial, "servo_position_m"))
    # the reading that ends a pull is the first of the next lap
    assert all(start.min() < 1.0 and start.max() > 19.0 for start in laps(trial, "tension_start_n"))


def test_the_bus_log_is_any_gait(tmp_path: Path) -> None:
    trial = ran("bus_log", tmp_path / "t.mcap")
    assert len(laps(trial, "time_s")) == 2
    assert np.nanmax(trial.columns["desired_force_n"]) == pytest.approx(40.0, abs=0.1)


def test_a_step_is_numbered_step_by_step(tmp_path: Path) -> None:
    numbers = ran("step", tmp_path / "t.mcap").columns["cycle"]
    assert np.array_equal(np.unique(numbers), np.arange(-1, scripted_experiments.laps("step", 0)))


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", LONG)
def test_the_long_ones_number_their_laps(name: str, tmp_path: Path) -> None:
    numbers = ran(name, tmp_path / "t.mcap").columns["cycle"]
    assert np.array_equal(np.unique(numbers), np.arange(-1, scripted_experiments.laps(name, 0)))
