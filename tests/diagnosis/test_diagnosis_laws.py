"""The relations' laws agree with one another, and with themselves at any sampling."""

from __future__ import annotations

import math

import numpy as np
import pytest

from diagnosis.data.table import table
from diagnosis.problem.blocks import SETTLE_S, blocks_of
from physics.parameters import healthy
from physics.path_laws import presliding_shaped
from physics.plant.leg import KNEE_AT_FIT
from physics.relations import transmission
from physics.relations.drive_relations import arm
from physics.relations.measured import Signals
from physics.relations.relation import RELATIONS
from physics.relations.tension_chain import UNSURE_N, from_motion, read_at_start, recalled
from tests.hidden.bench import Bench
from tests.hidden.walk import trial

STEP_S = 1e-3


def pulled(values: dict[str, float]) -> Signals:
    """Signals of a bench that keeps the model's own laws: rope wound in and paid out five times, knee at rest."""
    time = np.arange(0.0, 5.0, STEP_S)
    angle = np.full(time.size, KNEE_AT_FIT)
    rope = values["rope_zero"] + 4e-3 * (1.0 - np.cos(2.0 * np.pi * time))
    columns = {"time_s": time, "knee_angle_rad": angle, "servo_position_m": rope, "rope_m": rope,
               "rope_m_s": np.gradient(rope, time), "strain_m_s": np.gradient(rope, time),
               "tension_end_n": np.zeros(time.size), "end_rate": np.zeros(time.size)}
    fresh = np.zeros(time.size, dtype=np.bool_)
    fresh[0] = True
    signals = Signals(columns, fresh, time / time[-1])
    columns["tension_end_n"], columns["tension_start_n"] = _answer(signals, values)
    columns["end_rate"] = np.gradient(columns["tension_end_n"], time)
    return Signals(columns, fresh, time / time[-1])


def _answer(signals: Signals, values: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    wound = transmission.wound(signals, values, signals["rope_m"])
    anchored = transmission.anchored(
        signals, signals["knee_angle_rad"], 0.0, values["rope_per_knee"], values["rope_per_knee_quadratic"])
    end, start = from_motion(
        wound, anchored, signals["time_s"], signals.fresh, transmission.fabric_exponent(signals, values),
        transmission.cable_exponent(signals, values), transmission.STRETCH_LINEAR, transmission.STRETCH_BEND, 0.0,
        transmission.cable_compliance(values), 0.0, 1.0, values["presliding"], values["presliding"], 1.0, 0.0,
        values["stribeck_ratio"], values["stribeck_speed"], values["stribeck_memory"])
    return end, start


BREAKS_AWAY = {"stribeck_ratio": 1.6, "stribeck_speed": 0.015, "stribeck_memory": 0.02}


@pytest.mark.parametrize(("more", "scale"), [({}, 1.0), (BREAKS_AWAY, 2.0)])
def test_friction_elasticity_and_kinematics_hold_together_on_one_bench(more: dict[str, float], scale: float) -> None:
    values = {**healthy(), **more}
    signals = pulled(values)
    taut = signals["tension_end_n"] > 5.0
    assert taut.sum() > 1000
    for name in ("friction", "elasticity", "kinematics"):
        relation = RELATIONS[name]
        left = (signals[relation.output] - relation.law(signals, values))[taut]
        # friction: the low-pass on what slides the fabric, where the rope turns; kinematics: one law sums the fabric's
        # stretch by segments, the other by mean tensions, which is of second order in mu2; both grow with the friction
        bound = {"friction": 0.04, "elasticity": 1e-3, "kinematics": 2e-4}[name]
        assert np.sqrt(np.mean(left**2)) < scale * bound, name


def test_friction_remembers_the_sliding_speed_for_its_time() -> None:
    recent = 0.0
    for _ in range(20):
        recent = recalled(recent, 0.05, 0.05, 1e-3, 20e-3)
    assert recent == pytest.approx(0.05 * (1.0 - np.exp(-1.0)))
    assert recalled(0.05, -0.02, 0.05, 1e-3, 0.0) == -0.02


@pytest.mark.parametrize("shape", [0.0, 0.5, 0.9999, 1.0, 1.3])
def test_a_slide_is_the_same_in_one_step_and_in_many(shape: float) -> None:
    for s in (-0.9, 0.0, 0.6):
        whole, parts = presliding_shaped(s, 1.5e-4, 1e-4, shape), s
        for _ in range(10):
            parts = presliding_shaped(parts, 1.5e-5, 1e-4, shape)
        assert parts == pytest.approx(whole, abs=1e-9)
        assert -1.0 <= whole <= 1.0


def test_the_shape_goes_from_a_stop_to_an_exponential() -> None:
    assert presliding_shaped(0.0, 0.5e-4, 1e-4, 0.0) == pytest.approx(0.5)
    assert presliding_shaped(0.0, 2e-4, 1e-4, 0.0) == 1.0
    assert presliding_shaped(0.0, 1e-4, 1e-4, 1.0) == pytest.approx(1.0 - math.exp(-1.0))
    assert presliding_shaped(0.0, 1e-4, 1e-4, 0.998) == pytest.approx(presliding_shaped(0.0, 1e-4, 1e-4, 1.0), abs=1e-3)


def test_drag_at_the_edge_of_slack_is_what_start_says_and_elsewhere_all_of_it() -> None:
    values = {**healthy(), "viscous": 10.0, "viscous_tension": 5.0}
    signals = pulled(values)
    edge = signals["tension_end_n"] < 0.5
    predicted = transmission.friction(signals, values)
    drag = 10.0 * signals["rope_m_s"]
    # START says that nothing is dragged there: inside what drag allows, so nothing is left
    allowed = edge & (drag > 0.0) & (signals["tension_start_n"] < 0.5)
    assert allowed.any()
    assert np.abs((predicted - signals["tension_start_n"])[allowed]).max() < 0.05
    sliding = (signals["tension_end_n"] > 10.0) & (drag > 0.1)
    assert (predicted - signals["tension_start_n"])[sliding] == pytest.approx(drag[sliding], abs=0.05)


def test_a_rope_drags_as_it_is_pressed_to_its_sheath() -> None:
    values = {**healthy(), "viscous": 10.0, "viscous_tension": 30.0}
    signals = pulled(values)
    start = transmission.friction(signals, {**values, "viscous": 0.0})
    taut = signals["tension_end_n"] > 10.0
    assert start[taut].min() < 25.0 < 35.0 < start[taut].max()
    drag = 10.0 * signals["rope_m_s"] * np.minimum(start / 30.0, 1.0)
    assert (transmission.friction(signals, values) - start)[taut] == pytest.approx(drag[taut], abs=1e-9)


def test_the_arm_of_an_eccentric_drum_is_the_rope_that_it_draws_per_metre_of_its_turn() -> None:
    values = {**healthy(), "eccentricity": 0.4e-3, "eccentricity_phase": 0.7}
    signals = pulled(values)
    turned = signals["servo_position_m"]
    drawn = transmission.wound(signals, values, turned)
    moving = np.abs(np.gradient(turned)) > 1e-6
    assert np.ptp(arm(signals, values)) > 0.005
    # the virtual work of START tension: differences of one sample's length
    per_metre = np.gradient(drawn)[moving] / np.gradient(turned)[moving]
    assert arm(signals, values)[moving] == pytest.approx(per_metre, abs=1e-4)


def test_what_rates_of_one_side_would_judge_is_left_out() -> None:
    for block in blocks_of([table("walk.csv", trial(Bench(), seed=1, cycles=3))], ["friction", "drive_force"]):
        time = block.signals["time_s"]
        kept = time[block.keep]
        assert kept[0] >= time[0] + SETTLE_S
        assert kept[-1] <= time[-1] - SETTLE_S


def test_of_the_servo_force_is_left_out_what_the_rate_does_not_resolve() -> None:
    time = np.arange(0.0, 6.0, 0.01)
    smooth = 0.02 * np.sin(2.0 * np.pi * time)
    jerked = smooth + 0.1 * np.maximum(time - 3.0, 0.0)
    zeros = np.zeros(time.size)

    def kept(position: np.ndarray) -> np.ndarray:
        columns = {"time_s": time, "servo_position_m": position, "servo_force_n": zeros, "tension_start_n": zeros}
        block, = blocks_of([table("drive.csv", columns)], ["drive_force"], taut_n=5.0, rate_hz=100.0)
        return np.asarray(block.signals["time_s"][block.keep])

    lost = np.setdiff1d(kept(smooth), kept(jerked))
    assert lost.size > 0
    # two samples of the velocity's and of the acceleration's difference each, and one of the neighbours'
    assert np.abs(lost - 3.0).max() < 0.06


def test_of_the_servo_force_a_spike_is_left_out_that_the_position_does_not_show_and_a_reversal_is_not() -> None:
    time = np.arange(0.0, 6.0, 0.01)
    position = 0.02 * np.sin(2.0 * np.pi * time)
    friction = 5.0 * np.sign(np.cos(2.0 * np.pi * time))
    spiked = friction.copy()
    spiked[[330, 331]] += 8.0

    def kept(force: np.ndarray) -> np.ndarray:
        columns = {"time_s": time, "servo_position_m": position, "servo_force_n": force,
                   "tension_start_n": np.zeros(time.size)}
        block, = blocks_of([table("drive.csv", columns)], ["drive_force"], taut_n=5.0, rate_hz=100.0)
        return np.asarray(block.keep)

    lost = np.setdiff1d(kept(friction), kept(spiked))
    assert set(lost) == {329, 330, 331, 332}
    # a force that steps with the motion is friction
    assert np.isin([24, 25, 26, 74, 75, 76], kept(friction)).all()


@pytest.mark.parametrize("speed", [-0.12, 0.12])
@pytest.mark.parametrize("measured", [-0.1, 0.6, 3.0])
@pytest.mark.parametrize("pressed_n", [0.0, 20.0])
def test_what_start_reads_at_the_edge_of_slack_has_no_step(speed: float, measured: float, pressed_n: float) -> None:
    tension = np.linspace(-1.0, 4.0 * UNSURE_N, 50_001)
    viscous, gain = 20.0, 1.1
    read = read_at_start(tension, np.full(tension.size, speed), np.full(tension.size, measured),
                         np.zeros(tension.size), viscous, pressed_n, 0.3, gain, 0.2, 0.0)
    # the steepest parts: the tension itself, drag put on over half a newton, what is open closed over `UNSURE_N`
    steepest = gain * (1.0 + abs(viscous * speed) * (2.0 + 1.0 / UNSURE_N))
    assert np.abs(np.diff(read)).max() <= steepest * (tension[1] - tension[0]) * (1.0 + 1e-6)
