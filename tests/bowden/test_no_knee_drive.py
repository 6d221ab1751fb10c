"""A bench without a knee drive runs from its packaged declaration: an encoder measures the joint, a hand moves it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

import bowden as api
from bowden.bench import configuration
from bowden.trials.recorded import sections
from eds.declaration import packaged, text_of
from parameters import InputError
from physics.plant.bench_plant import BowdenPlant, Outputs, PlantParameters
from trial.read import open as opened

Command = Callable[..., tuple[int, str, str]]
SHAPE = "bench_no_knee_drive"
FROZEN_NS = 4_000_000_000
COUNT_RAD = 2.0 * np.pi / 65536


def ran_with(folder: Path, cycles: int = 2, output: Path | None = None, **bus: object) -> api.Trial:
    """Run a short gait trial on the bench that the folder's bench.toml declares."""
    experiment = api.Experiment(peak_n=20, period_s=1, cycles=cycles, rate_hz=500, controller="extended",
                                configuration=folder / "bench.toml")
    return api.run(experiment, bus=api.simulated(**bus), output=output)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the configuration, a trial of three gait cycles, and its figures as JSON."""
    folder = tmp_path_factory.mktemp("no_knee_drive")
    (folder / "bench.toml").write_text(configuration.as_template(shape=SHAPE))
    told = ran_with(folder, cycles=3, output=folder / "trial.mcap")
    (folder / "figures.json").write_text(json.dumps(told.figures))
    return folder


@pytest.fixture
def declared(here: Path) -> Path:
    """The current folder, with the declaration as bench.toml."""
    (here / "bench.toml").write_text(text_of(SHAPE))
    return here


def test_the_extended_controller_follows_the_measured_joint(ran: Path) -> None:
    figures = json.loads((ran / "figures.json").read_text())
    assert (figures["outcome"], figures["missed_cycles"], figures["stale_inputs"]) == ("completed", 0, 0)
    assert figures["true_relative_rmse_percent"] < 1.5
    columns = opened(ran / "trial.mcap").columns
    asked, measured = columns["knee_target_rad"], columns["knee_angle_rad"]
    assert 0.02 < np.abs(asked - measured).max() < 0.3  # a hand is behind
    assert np.abs(measured / COUNT_RAD - np.round(measured / COUNT_RAD)).max() < 1e-6


def test_the_encoder_has_no_statusword_and_takes_nothing(ran: Path) -> None:
    trial = opened(ran / "trial.mcap")
    assert np.isnan(trial.columns["knee_statusword"]).all()
    frames = trial.frames
    assert set(frames["dlc"][frames["can_id"] == 0x182].tolist()) == {4}
    assert set(frames["dlc"][frames["can_id"] == 0x301].tolist()) == {2}
    assert sections(trial)["network"].bench == packaged(SHAPE)


def test_the_controller_s_steps_are_made_again(ran: Path, bowden: Command) -> None:
    status, out, _ = bowden("replay", ran / "trial.mcap", "--onto", "controller", "--json")
    assert (status, json.loads(out)["same"]) == (0, True)


def test_the_plant_gives_the_same_trial_again(ran: Path, bowden: Command) -> None:
    status, out, _ = bowden("replay", ran / "trial.mcap", "--onto", "plant", "--json")
    assert (status, json.loads(out)["same"]) == (0, True)


@pytest.mark.slow
def test_report_and_diagnosis_have_no_knee_drive(ran: Path, bowden: Command) -> None:
    assert bowden("report", ran / "trial.mcap", "-o", ran / "report.html")[0] == 0
    status, out, _ = bowden("diagnose", ran / "trial.mcap", "--json")
    assert status == 0
    assert json.loads(out)["verdict"] != "refused"


def test_a_lost_encoder_lets_the_rope_go(declared: Path) -> None:
    told = ran_with(declared, faults=[{"kind": "cut", "node": 2, "start_s": 3.0}])
    assert told.outcome == "stopped"
    assert "knee missed" in str(told.figures["stop_reason"])


class FrozenEncoder(BowdenPlant):
    """The simulated bench, whose joint angle stands still for who measures it from 4 s on."""

    __slots__ = ("angle_rad",)

    def advance(self, until_ns: int, servo_torque_nm: float, knee_torque_nm: float) -> Outputs:
        """Run on; the angle stays."""
        felt = super().advance(until_ns, servo_torque_nm, knee_torque_nm)
        if until_ns >= FROZEN_NS:
            felt = felt._replace(knee_angle_rad=self.angle_rad)
        self.angle_rad = felt.knee_angle_rad
        return felt


def frozen_encoder(parameters: Mapping[str, float], seed: int) -> FrozenEncoder:
    """Make the plant of a name in `bowden.simulated(plant=…)`."""
    return FrozenEncoder(PlantParameters(**parameters))


def test_an_encoder_that_stands_still_is_contradicted_by_the_stretch(declared: Path) -> None:
    told = ran_with(declared, plant=f"{__name__}:frozen_encoder", output=declared / "frozen.mcap")
    assert told.outcome == "stopped"
    assert "knee angle" in str(told.figures["stop_reason"])
    assert np.nanmax(opened(declared / "frozen.mcap").columns["tension_end_n"]) < 22.0


def test_a_slow_hand_is_waited_for_and_reminded(declared: Path) -> None:
    told = ran_with(declared, output=declared / "slow.mcap", hand_lag_ms=1000)
    assert told.outcome == "completed"
    said = [event.text for event in opened(declared / "slow.mcap").events if event.kind == "operator"]
    assert said
    assert said[0].startswith("bring the knee to ")


def test_commands_of_the_knee_are_refused(declared: Path, bowden: Command) -> None:
    status, out, err = bowden("jog", "knee", "--by", -5, "--speed", 5, "--config", "bench.toml", "--interface",
                              "bowden", "--channel", "no knee drive")
    assert status == 1
    assert "the declared bench has no drive of the knee; move it by hand" in out + err
    with pytest.raises(InputError, match="emergency_stop at node = 2, which is no drive of the declared bench"):
        ran_with(declared, faults=[{"kind": "emergency_stop", "node": 2, "start_s": 3.0}])


def test_neither_end_nor_knee_drive_is_refused_and_its_wire_planned(here: Path, bowden: Command) -> None:
    text = text_of("bench_start_only").replace("joint_drive", "joint_encoder").replace("driven_by", "measured_by")
    (here / "bench.toml").write_text(text)
    status, out, err = bowden("trial", "--config", "bench.toml", "-o", "trial.mcap")
    assert (status, out) == (2, "")
    assert "has no end, and no drive moves its joint" in err
    assert bowden("check", "config", "bench.toml")[0] == 1  # its wire is planned, and no command runs it


@pytest.mark.exhaustive
def test_it_is_identified_controlled_and_diagnosed(declared: Path, bowden: Command) -> None:
    assert bowden("identify", "all", "--config", "bench.toml", "-o", "own.toml")[0] == 0
    (declared / "gain.toml").write_text("[end_sensor]\ngain = 1.05\n")
    status, out, _ = bowden("trial", "--config", "bench.toml", "--calibration", "own.toml", "--controller", "extended",
                            "--peak", 40, "--cycles", 6, "--plant-model", "gain.toml", "-o", "trial.mcap", "--json")
    assert status == 0
    assert json.loads(out)["true_relative_rmse_percent"] < 0.2
    _, out, _ = bowden("diagnose", "trial.mcap", "--calibration", "own.toml", "--json")
    assert "end_gain" in {each["effect"] for each in json.loads(out)["causes"]}
