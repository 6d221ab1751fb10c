"""Rigs of other kinds by the evidence core: constants of the reference fit, repeats, changes of known size."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.findings import Findings
from estimation.data.table import Table, table
from estimation.joint_fit import fit_reference
from estimation.path_model import can_be_of_bench
from estimation.reference_fit import ReferenceFit
from estimation.rig_model import RigModel
from parameters import InputError
from physics.effects.catalogue import CATALOGUE
from tests.diagnosis import rigs

GRAVITY_NM = 0.5 * 9.81 * 0.15


def pendulum(seed: int, mass_kg: float = 0.5) -> Table:
    return table(f"pendulum_{seed}", rigs.pendulum(seed, mass_kg))


def known(reference: list[Table]) -> EvidenceFinder:
    """Return the diagnosis by evidence of the rig that these reference trials are of."""
    return EvidenceFinder(reference, model=RigModel(reference))


@cache
def swung() -> EvidenceFinder:
    return known([pendulum(1), pendulum(2)])


def seal(columns: rigs.Columns, rubs: float = 6.0) -> Table:
    """Return a rod between two forces: a load that differs little, and friction of `rubs` N each way."""
    time = np.arange(0.0, 20.0, 0.01)
    at = 0.02 * np.sin(2.0 * np.pi * 0.3 * time)
    end = 50.0 + 2.0 * np.sin(2.0 * np.pi * 0.05 * time)
    noise = 0.05 * np.random.default_rng(int(columns["seed"][0])).standard_normal((2, time.size))
    start = end + rubs * np.tanh(np.gradient(at, time) / 1e-3)
    return table("seal", {"time_s": time, "servo_position_m": at, "tension_start_n": start + noise[0],
                          "tension_end_n": end + noise[1]})


def on_a_cam(seed: int, rubs: float = 6.0) -> Table:
    """Return a rod on a cam: the ratio of its forces rises by 30 % over the stroke of 40 mm."""
    time = np.arange(0.0, 24.0, 0.01)
    random = np.random.default_rng(seed)
    at = 0.02 * np.sin(2.0 * np.pi * (0.3 * time + random.random()))
    end = 50.0 + 15.0 * np.sin(2.0 * np.pi * (0.11 * time + random.random()))
    start = end * (1.0 + 0.3 * at / 0.04) + rubs * np.tanh(np.gradient(at, time) / 1e-3)
    noise = 0.05 * random.standard_normal((2, time.size))
    return table(f"cam_{seed}", {"time_s": time, "servo_position_m": at, "tension_start_n": start + noise[0],
                                 "tension_end_n": end + noise[1]})


@pytest.mark.slow
def test_a_ratio_may_change_with_the_position() -> None:
    finder = known([on_a_cam(1), on_a_cam(2)])
    nothing, rubbed = finder.diagnose([on_a_cam(3)]), finder.diagnose([on_a_cam(3, 9.0)])
    shifts = (nothing.evidence or {})["shifts"]
    assert shifts["ratio_slope"]["from"] == pytest.approx(0.3, rel=0.02)
    assert nothing.verdict == "none"
    assert nothing.relations["tension_start_n"].rmse_before < 0.3  # noise and low-pass; the ratio alone would leave 1 N
    assert "cable_friction" in rubbed.rivals


def numbered(seed: int) -> rigs.Columns:
    return {"seed": np.array([float(seed)])}


def test_the_outputs_follow_from_the_columns() -> None:
    sprung = table("elastic", rigs.series_elastic(1))
    assert RigModel([pendulum(1)]).outputs == ("servo_force_n",)
    assert RigModel([sprung]).outputs == ("tension_start_n", "servo_force_n")
    assert RigModel([seal(numbered(1))]).outputs == ("tension_start_n",)
    for model in (RigModel([pendulum(1)]), RigModel([sprung]), RigModel([seal(numbered(1))])):
        assert set(model.hypotheses) <= set(CATALOGUE)
        for effect, hypothesis in model.hypotheses.items():
            assert all(len(model.limits(effect, parameter)) == 3 for parameter in hypothesis.reads)


def test_a_gait_is_a_benchs_and_a_turning_axis_is_not() -> None:
    time = np.arange(0.0, 10.0, 0.01)
    gait = table("gait", {"time_s": time, "gait_percent": 100.0 * (time % 1.0), "servo_position_m": np.sin(time),
                          "tension_start_n": 20.0 + np.sin(time), "knee_angle_rad": np.sin(time)})
    assert can_be_of_bench([gait])
    assert not can_be_of_bench([pendulum(1)])


@cache
def swung_fit() -> tuple[RigModel, ReferenceFit, dict[str, float]]:
    return fitted([pendulum(1), pendulum(2)])


def fitted(trials: list[Table]) -> tuple[RigModel, ReferenceFit, dict[str, float]]:
    model = RigModel(trials)
    fit = fit_reference(model, model.sessions([model.record(t) for t in trials]))
    q = fit.origin.copy()
    q[list(model.constants.free)] += fit.bench.mean[:len(model.constants.free)]
    return model, fit, model.constants.named(q)


def test_the_reference_fit_has_the_constants_that_the_pendulum_was_made_with() -> None:
    _, fit, constants = swung_fit()
    assert len(fit.identified) == 2
    assert constants["unbalance"] == pytest.approx(GRAVITY_NM, rel=0.01)
    assert constants["unbalance_phase"] == pytest.approx(0.5 * np.pi - 0.2, abs=0.01)
    assert constants["inertia"] == pytest.approx(0.5 * 0.15**2 + 2e-3, rel=0.03)


def test_trials_of_unlike_condition_are_one_session() -> None:
    quick, slow = rigs.pendulum(1), rigs.pendulum(2)
    slow = {**slow, "time_s": 2.0 * slow["time_s"]}
    trials = [table("quick", quick), table("slow", slow)]
    model = RigModel(trials)
    assert len(model.sessions([model.record(t) for t in trials])) == 1


def test_another_motion_of_the_same_pendulum_is_none() -> None:
    assert swung().diagnose([pendulum(3)]).verdict == "none"


def held(seed: int, mass_kg: float = 0.5, counts: float = 1.5e-3) -> Table:
    """Return a pendulum that is held for 3 s where it turns, by a torque that wanders within the static friction.

    `counts`: of the encoder, rad.
    """
    columns = rigs.pendulum(seed, mass_kg)
    angle, torque, time = (columns[n] for n in ("servo_position_rad", "servo_torque_nm", "time_s"))
    turn = 800 + int(np.argmin(np.abs(np.gradient(angle))[800:1600]))
    stands = np.arange(600)
    wanders = torque[turn] + 0.04 * np.sin(2.0 * np.pi * stands / 400.0)
    at = np.concatenate([angle[:turn], np.full(600, angle[turn]), angle[turn:]])
    return table(f"held_{seed}", {
        "time_s": time[0] + 0.005 * np.arange(at.size), "servo_position_rad": counts * np.round(at / counts),
        "servo_torque_nm": np.concatenate([torque[:turn], wanders, torque[turn:]])})


@pytest.mark.slow
def test_where_a_drive_stands_its_force_does_not_count() -> None:
    reference = [held(1), held(2)]
    model, _, constants = fitted(reference)
    assert model.record(reference[0]).stands.mean() == pytest.approx(3.0 / 23.0, abs=0.04)
    # with these data counted, as before, it is 0.67 N·m of 0.74
    assert constants["unbalance"] == pytest.approx(GRAVITY_NM, rel=0.02)
    finder = known(reference)
    assert finder.diagnose([held(3)]).verdict == "none"
    # friction is 7 % of gravity here, and all that tells a heavier mass from a stronger drive
    assert set(finder.diagnose([held(4, 0.6)]).rivals) == {"unbalance", "demand_gain"}


def test_the_motion_of_a_coarse_encoder_is_smoothed_more() -> None:
    assert RigModel([pendulum(1)]).motion_hz == 40.0
    assert RigModel([held(1, counts=5e-3)]).motion_hz < 40.0


def test_a_faster_motion_is_beyond_the_reference_trials_and_another_zero_of_the_encoder_is_not() -> None:
    model, fit, _ = swung_fit()
    same = pendulum(3)
    far = table("far", {**same.columns, "servo_position_m": same["servo_position_m"] + 20.0})
    quick = table("quick", {**same.columns, "time_s": 0.5 * same["time_s"]})
    beyond = [fit.observe(model.record(given)).beyond for given in (same, far, quick)]
    assert beyond[0] == pytest.approx(beyond[1], abs=1e-6)
    assert beyond[2] > 0.4 + beyond[0]


def test_an_axis_that_never_moves_counts_whole() -> None:
    model, still = RigModel([pendulum(1)]), pendulum(2)
    angle = np.full_like(still["servo_position_m"], 0.3)
    recorded = model.record(table("still", {**still.columns, "servo_position_m": angle}))
    assert not recorded.stands.any()


def heavier() -> Findings:
    return swung().diagnose([pendulum(4, 0.6)])


def test_a_mass_on_a_pendulum_is_told_within_five_per_cent_with_what_it_was() -> None:
    found = heavier()
    assert found.causes[0]["effect"] == "unbalance"
    told = found.causes[0]["parameters"]["unbalance"]
    assert told["value"] - GRAVITY_NM == pytest.approx(0.2 * GRAVITY_NM, rel=0.05)
    assert told["low"] <= 1.2 * GRAVITY_NM <= told["high"]
    assert found.causes[0]["was"]["unbalance"] == pytest.approx(GRAVITY_NM, rel=0.01)
    assert found.part == "drive"
    assert told["unit"] == "N·m"


RESISTANCE_OHM, TORQUE_CONSTANT_NM_A = 4.0, 0.4


def by_voltage(seed: int, mass_kg: float = 0.5) -> Table:
    """The pendulum with its motor's voltage, u = R·τ/kt + kt·ω, in place of the torque; rig in V, rad and s."""
    swung_by = rigs.pendulum(seed, mass_kg)
    speed = np.gradient(swung_by["servo_position_rad"], swung_by["time_s"])
    volts = RESISTANCE_OHM / TORQUE_CONSTANT_NM_A * swung_by.pop("servo_torque_nm") + TORQUE_CONSTANT_NM_A * speed
    return table(f"pendulum_{seed}", {**swung_by, "motor_voltage_v": volts})


def test_a_mass_is_told_by_the_motors_voltage_as_by_its_torque() -> None:
    found = known([by_voltage(1), by_voltage(2)]).diagnose([by_voltage(4, 0.6)])
    told, per_nm = found.causes[0]["parameters"]["unbalance"], RESISTANCE_OHM / TORQUE_CONSTANT_NM_A
    assert found.causes[0]["effect"] == "unbalance"
    assert told["value"] - per_nm * GRAVITY_NM == pytest.approx(0.2 * per_nm * GRAVITY_NM, rel=0.05)
    assert told["unit"] == "V"
    assert found.relations["servo_force_n"].unit == "V"
    for finder, other, column in ((known([by_voltage(1)]), pendulum(4), "motor_voltage_v"),
                                  (swung(), by_voltage(4), "servo_torque_nm")):
        with pytest.raises(InputError, match=f"pendulum_4: has no column {column}"):
            finder.diagnose([other])
    with pytest.raises(InputError, match="servo_torque_nm and motor_voltage_v; give one of them"):
        table("both", {**rigs.pendulum(1), "motor_voltage_v": rigs.pendulum(1)["servo_torque_nm"]})


def test_the_shift_of_a_constant_is_said_though_nothing_is_named() -> None:
    found = swung().diagnose([pendulum(5, 0.502)])
    assert found.evidence is not None
    shift = found.evidence["shifts"]["unbalance"]
    assert found.verdict == "none"
    assert shift["low"] <= 1.004 * GRAVITY_NM <= shift["high"]
    assert shift["from"] == pytest.approx(GRAVITY_NM, rel=0.01)


def turning(seed: int, viscous: float, slower: float = 1.0) -> Table:
    """Return an axis with an inertia of 0.02 kg·m², Dahl's friction of 0.3 N·m and `viscous` N·m·s/rad."""
    time = np.arange(0.0, 24.0, 0.002)
    angle = np.sin(3.1 * slower * time) + 0.3 * np.sin(7.2 * time)
    speed = np.gradient(angle, time)
    friction = np.zeros(time.size)
    for k, step in enumerate(np.diff(angle)):
        friction[k + 1] = friction[k] + (step - abs(step) * friction[k]) / 0.01
    torque = 0.02 * np.gradient(speed, time) + 0.3 * friction + viscous * speed
    noise = 0.003 * np.random.default_rng(seed).standard_normal(time.size)
    return table(f"axis_{seed}", {"time_s": time, "servo_position_rad": angle, "servo_torque_nm": torque + noise})


@pytest.mark.slow
def test_a_large_change_of_viscous_friction_is_not_said_as_two() -> None:
    finder = known([turning(1, 0.05), turning(2, 0.05, 1.3)])
    found = finder.diagnose([turning(3, 0.12)])
    assert [cause["effect"] for cause in found.causes] == ["drive_viscous"]
    assert (found.verdict, found.rivals) == ("found", ["drive_viscous"])
    told = found.causes[0]["parameters"]["drive_viscous"]
    assert told["low"] < 0.12 < told["high"]


@pytest.mark.exhaustive
@pytest.mark.parametrize(("rubs", "share"), [(24.0, 2.0), (6.0, 0.5)])
def test_friction_that_doubles_or_halves_is_named(rubs: float, share: float) -> None:
    finder = known([table(f"seal_{k}", rigs.seal(k)) for k in (1, 2)])
    assert finder.diagnose([table("same", rigs.seal(3))]).verdict == "none"
    found = finder.diagnose([table("other", rigs.seal(4, rubs))])
    assert found.rivals[0] == "drive_coulomb"
    told = found.causes[0]["parameters"]["drive_coulomb"]
    assert told["low"] <= share * 12.0 <= told["high"]


@pytest.mark.exhaustive
def test_friction_between_two_forces_is_named_in_its_part() -> None:
    finder = known([seal(numbered(k)) for k in (1, 2)])
    assert finder.diagnose([seal(numbered(3))]).verdict == "none"
    found = finder.diagnose([seal(numbered(4), 14.0)])
    assert found.part == "friction path"
    assert "cable_friction" in found.rivals


@pytest.mark.exhaustive
def test_an_encoders_zero_is_nothing_and_a_softer_spring_is_named() -> None:
    finder = known([table(f"elastic_{k}", rigs.series_elastic(k)) for k in (1, 2)])
    moved = rigs.series_elastic(3)
    assert finder.diagnose([table("moved", {**moved, "servo_position_m": moved["servo_position_m"] + 9e-3})]
                           ).verdict == "none"
    softer = finder.diagnose([table("softer", rigs.series_elastic(4, 6e3))])
    assert softer.rivals == ["stiffness"]
    # (10) is 0.3 mm/N at scale 1
    assert softer.causes[0]["parameters"]["stiffness_scale"]["value"] == pytest.approx(1.8, rel=0.03)
