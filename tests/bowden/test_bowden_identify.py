"""`bowden identify`: what is measured, and what is fitted again to its recording, is one calibration."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Told


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with stiffness.toml, its recording and its picture, of bench 3."""
    from bowden.cli.app import run

    folder = tmp_path_factory.mktemp("identified")
    assert run(["identify", "stiffness", "--serial", "3", "--json", "-o", str(folder / "stiffness.toml"),
                "--picture", str(folder / "stiffness.png")]) == 0
    return folder


def test_a_recording_gives_the_same_calibration_again(
    bowden: Callable[..., Told], measured: Path, tmp_path: Path
) -> None:
    again = tmp_path / "again.toml"
    told = bowden("identify", "stiffness", "--from", measured / "stiffness.mcap", "-o", again, "--json")
    assert told.status == 0, told
    assert again.read_text() == (measured / "stiffness.toml").read_text()
    stiffness, written = json.loads(told.stdout)["scalars"]["stiffness_b"], tomllib.loads(again.read_text())
    assert stiffness["low"] < stiffness["value"] < stiffness["high"]
    assert stiffness["r_squared"] == written["parameters"]["stiffness_b"]["r_squared"]
    assert not again.with_suffix(".mcap").exists()


@pytest.mark.exhaustive
def test_a_recording_of_gait_trials_gives_the_same_discrepancy_again(
    bowden: Callable[..., Told], tmp_path: Path
) -> None:
    """What homing found before each gait trial is in the recording, too."""
    first, again = tmp_path / "first.toml", tmp_path / "again.toml"
    assert bowden("identify", "gait", "--serial", 3, "-o", first).status == 0
    assert bowden("identify", "gait", "--from", first.with_suffix(".mcap"), "-o", again).status == 0
    assert again.read_text() == first.read_text()
    assert tomllib.loads(again.read_text())["parameters"]["homed_softness"]["value"] != 1.0


def test_the_picture_is_drawn(measured: Path) -> None:
    assert (measured / "stiffness.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("arguments", "said"), [
    (("swing",), "no swing experiment among those recorded"),
    (("knees",), "identify knees: expected one of sensors, stiffness, swing, friction, gait, all"),
    (("stiffness", "--serial", 3), "--serial belongs to measuring a bench; leave it out with --from"),
    (("stiffness", "--interface", "socketcan"), "--interface belongs to measuring a bench"),
    (("sensors", "--picture", "p.png"), "measures no loop of Figs. 9 and 10"),
])
def test_what_the_recording_does_not_tell_is_refused(
    bowden: Callable[..., Told], measured: Path, here: Path, arguments: tuple[object, ...], said: str
) -> None:
    told = bowden("identify", *arguments, "--from", measured / "stiffness.mcap", "-o", "c.toml")
    assert (told.status, told.stdout) == (2, "")
    assert said in told.stderr
    assert not list(here.iterdir())


def test_trials_of_two_benches_are_refused(bowden: Callable[..., Told], measured: Path, here: Path) -> None:
    assert bowden("identify", "sensors", "--serial", 4, "-o", "other.toml", "--json").status == 0
    both = ("--from", measured / "stiffness.mcap", "--from", "other.mcap")
    told = bowden("identify", "stiffness", *both, "-o", "c.toml")
    assert told.status == 2
    assert "the trials are of different benches, virtual 3 and virtual 4" in told.stderr


def test_a_trial_that_is_no_identification_is_refused(bowden: Callable[..., Told], here: Path) -> None:
    assert bowden("trial", "--cycles", 1, "--settle", 0, "--period", 1, "--dry-run", "-o", "gait.mcap",
                  "--json").status == 0
    told = bowden("identify", "stiffness", "--from", "gait.mcap", "-o", "c.toml")
    assert told.status == 2
    assert "records no experiment of an identification; give a trial of bowden identify" in told.stderr
