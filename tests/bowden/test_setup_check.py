"""Set-up checks: a bench that errs from power-on is refused before a limb is in it."""

from __future__ import annotations

import datetime
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bowden import Experiment, simulated
from bowden.bench import configuration
from bowden.trials import setup_checks
from parameters import InputError
from physics import setup_check
from physics.calibration import nominal, read, write
from trial.read import open as opened

CHECKS = ("--start", "20", "--end", "20", "--knee", "0", "--knee", "-60")
WALK = ("--cycles", "1", "--settle", "0", "--period", "1.1")
FAULTS = {
    "START gain -20 %": ("[start_sensor]\ngain = 0.8\n", "start"),
    "START and END -20 % alike": ("[start_sensor]\ngain = 0.8\n[end_sensor]\ngain = 0.8\n", "start"),
    "START, END and torque -50 %": ("[start_sensor]\ngain = 0.5\n[end_sensor]\ngain = 0.5\n", "start"),
    "knee zero -10 degrees": (f"[knee_encoder]\nzero_rad = {math.radians(-10.0)!r}\n", "knee"),
    "knee scale +15 %": ("[knee_encoder]\nscale = 1.15\n", "knee"),
}
"""Faults that are there from power-on, and the sensor that the check names. No drive is enabled, so that the scale of
the torque does not enter."""


@pytest.fixture
def bench(here: Path) -> Path:
    """A configuration with a limb, and a calibration beside it."""
    (here / "calibration.toml").write_text(write(nominal()))
    (here / "bench.toml").write_text('[record]\nlimb = "P03, left"\n')
    return here


def checked(bowden: Callable[..., Any], *more: str, checks: tuple[str, ...] = CHECKS) -> Any:
    return bowden("check", "bench", "--calibration", "calibration.toml", "--serial", "0", *checks, *more)


def walked(bowden: Callable[..., Any]) -> Any:
    return bowden("trial", "--config", "bench.toml", "--calibration", "calibration.toml", "--serial", "0", *WALK, "-o",
                  "trial.mcap")


def test_a_trial_with_a_limb_runs_on_a_checked_bench_alone(bowden: Callable[..., Any], bench: Path) -> None:
    status, out, err = walked(bowden)
    assert (status, out) == (2, "")
    assert "start was not checked with a weight of at least 10 N; run bowden check bench" in err
    status, out, err = checked(bowden)
    assert status == 0, out + err
    assert write(read(bench / "calibration.toml")) == write(nominal())
    status, _, err = walked(bowden)
    assert status == 0, err
    assert "[[setup_check]]" in opened(bench / "trial.mcap").attachments["setup_check.toml"].decode()


@pytest.mark.slow
def test_the_library_refuses_a_limb_on_a_bench_that_was_not_checked(bowden: Callable[..., Any], bench: Path) -> None:
    """Before, `bowden.run` ran it: only the command looked."""
    walk = Experiment(configuration=bench / "bench.toml", model=bench / "calibration.toml", cycles=1, settle=0)
    with pytest.raises(InputError, match="start was not checked with a weight of at least 10 N"):
        walk.prepared(simulated(serial=0))
    with pytest.raises(InputError, match="a trial with a limb needs a checked bench, and no --calibration is given"):
        replace(walk, model=None).prepared(simulated(serial=0))
    assert checked(bowden)[0] == 0
    assert "setup_check.toml" in walk.prepared(simulated(serial=0)).files


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.slow
def test_a_fault_from_power_on_is_refused(bowden: Callable[..., Any], bench: Path, name: str) -> None:
    model, of = FAULTS[name]
    (bench / "fault.toml").write_text(model)
    status, out, _ = checked(bowden, "--plant-model", "fault.toml", "--json")
    assert status == 1
    assert of in [one["of"] for one in json.loads(out)["checks"] if not one["passed"]]
    status, out, err = walked(bowden)
    assert (status, out) == (2, "")
    assert f"a trial with a limb (P03, left) needs a checked bench: {of} reads" in err


@pytest.mark.parametrize(("age_h", "knee", "sentence"), [
    (25.0, (0.0, -1.05), "the check of start is 25 h old, 24 h count"),
    (1.0, (0.0, -0.3), "knee was not checked with a goniometer at two angles at least 40° apart"),
])
def test_an_old_or_narrow_check_does_not_count(bench: Path, age_h: float, knee: tuple[float, ...], sentence: str
                                               ) -> None:
    now = datetime.datetime(2026, 11, 26, 12, 0)
    date = (now - datetime.timedelta(hours=age_h)).isoformat(timespec="minutes")
    made = [setup_check.SetupCheck(of, 20.0, 20.1, "N", date) for of in ("start", "end")]
    made += [setup_check.SetupCheck("knee", angle, angle, "rad", date) for angle in knee]
    setup_checks.enter(bench / "calibration.toml", made)
    assert list(setup_check.read(bench / "calibration.toml")) == made
    with pytest.raises(InputError, match=sentence):
        setup_checks.refuse_unchecked(configuration.read(bench / "bench.toml"), bench / "calibration.toml", now)


def test_a_sensor_that_is_checked_again_replaces_its_check(bowden: Callable[..., Any], bench: Path) -> None:
    assert checked(bowden, checks=("--start", "20")).status == 0
    assert checked(bowden, checks=("--start", "30")).status == 0
    assert checked(bowden, checks=("--end", "20")).status == 0
    found = setup_check.read(bench / "calibration.toml")
    assert [(one.of, one.reference) for one in found] == [("start", 30.0), ("end", 20.0)]
