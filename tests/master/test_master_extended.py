"""The extended controller: its model undone exactly, learning that converges, the day found from START."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from estimation.transfer import homing_fit
from estimation.transfer.homing_fit import HomingFit
from master.control import extended, friction_following, learning
from master.control.controller_io import ControllerInput
from master.control.friction_following import FrictionChange
from master.control.gait_table import tabulate
from master.motion import gait
from master.settings import Impedance
from physics import inverse, laws
from physics.calibration import nominal
from physics.path_laws import presliding
from physics.reference import paper_reference

SAMPLES, PERIOD_S = 2000, 1e-3
SLOPES_N_M = (2500.0, 3300.0, 6100.0, 10_400.0)
"""Stiffness of the path from slack to 60 N, by (10)."""
BACK_AND_FORTH = np.concatenate([np.linspace(0.0, 45.0, 700), np.linspace(45.0, 1.0, 700)])


def configured(day: HomingFit | None = None) -> extended.ExtendedConfig:
    knee, desired = gait.sampled(paper_reference(40.0, 2.0), SAMPLES)
    table = tabulate(nominal(), knee, desired, PERIOD_S, 2e-3)
    return extended.configure(nominal(), day or HomingFit(), table, Impedance())


def test_start_of_a_force_leads_back_to_the_force() -> None:
    """`behind` undoes `path`: the END force that was asked for comes back from START and position."""
    law = inverse.law(nominal(), PERIOD_S)
    knee = np.full(BACK_AND_FORTH.size, -0.5)
    asked = inverse.path(law, BACK_AND_FORTH, knee, laps=1)
    end, position = inverse.end_from_start(law, asked.position, asked.start, knee)
    sliding = (asked.rope_slip > 0.99) | (asked.rope_slip < -0.99)
    assert np.abs(end - BACK_AND_FORTH)[sliding].max() < 0.05
    assert np.abs(position - asked.position)[sliding].max() < 20e-6


def test_without_friction_the_model_is_ten_and_eleven() -> None:
    law = inverse.law(nominal(), PERIOD_S, friction=0.0)
    knee = np.linspace(-0.6, -0.3, 50)
    force = np.linspace(5.0, 60.0, 50)
    path = inverse.path(law, force, knee, laps=1)
    swung = laws.swing_displacement(knee) - laws.swing_displacement(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT))
    np.testing.assert_allclose(path.position, laws.stiffness_displacement(force) + swung, atol=1e-12)
    np.testing.assert_allclose(path.start, force)


def test_sliding_friction_is_series_friction() -> None:
    law = inverse.law(nominal(), PERIOD_S)
    asked = inverse.path(law, np.linspace(0.0, 50.0, 2000), np.full(2000, -0.5), laps=1)
    fabric = law.fabric_offset + 0.5 * law.fabric_slope
    assert asked.start[-1] == pytest.approx(laws.series_input(50.0, law.cable_exponent, 1.0, fabric, 1.0), rel=1e-6)


def test_pre_sliding_turns_over_with_travel_not_with_steps() -> None:
    whole = presliding(1.0, -3e-4, 1e-4)
    parts = 1.0
    for _ in range(30):
        parts = presliding(parts, -1e-5, 1e-4)
    assert parts == pytest.approx(whole, abs=1e-12)
    assert whole == pytest.approx(-1.0 + 2.0 * math.exp(-3.0))


def found(residue: HomingFit, noise_n: float = 0.15) -> HomingFit:
    """The day that `adapt` finds in a pull and release of the model on that day."""
    calibration = nominal()
    rng = np.random.default_rng(1)
    knee = np.full(BACK_AND_FORTH.size, float(laws.knee_angle(13.0)))
    law = inverse.law(calibration, PERIOD_S, residue.friction, residue.softness)
    path = inverse.path(law, BACK_AND_FORTH, knee, laps=1)
    start = path.start + residue.start_offset_n + rng.normal(0.0, noise_n, path.start.size)
    work = homing_fit.adapt(calibration, PERIOD_S, path.position + residue.zero_m, start, knee, residue.start_offset_n)
    while True:
        try:
            next(work)
        except StopIteration as done:
            return done.value  # type: ignore[no-any-return]


@pytest.mark.parametrize("residue", [
    HomingFit(), HomingFit(1.1, 1.0, 0.0, 0.0), HomingFit(0.9, 0.97, 1e-4, 0.2), HomingFit(1.25, 1.1, -2e-3, -0.2)])
def test_the_day_is_found_from_start_alone(residue: HomingFit) -> None:
    """Friction within 2 % and stretch within 1 %: under 0.2 N at 40 N each, a third of the learnt error."""
    day = found(residue)
    assert day.friction == pytest.approx(residue.friction, abs=0.02)
    assert day.softness == pytest.approx(residue.softness, abs=0.01)
    assert day.zero_m == pytest.approx(residue.zero_m, abs=40e-6)


def contraction(
    slope_n_m: float, delay_s: float, lag_s: float, lead_s: float, cutoff_hz: float = learning.CUTOFF_HZ
) -> float:
    """Return the greatest |Q·(1 − γ·z^d·T)| over frequency: below 1 the correction converges.

    The plant is `slope_n_m` behind a dead time and a first-order lag; the feedback is 1/(B·s + K).
    """
    frequency = np.linspace(0.01, 60.0, 4000)
    s = 2j * np.pi * frequency
    loop = slope_n_m * np.exp(-s * delay_s) / (1.0 + s * lag_s) / (100.0 * s + 300.0)
    turned = 1.0 - learning.GAIN * np.exp(s * lead_s) * loop / (1.0 + loop)
    return float(np.max(learning.passes(frequency, cutoff_hz) * np.abs(turned)))


@pytest.mark.parametrize("slope", SLOPES_N_M)
@pytest.mark.parametrize("delays", [1.0, 2.0])
def test_learning_contracts_even_at_twice_the_delay(slope: float, delays: float) -> None:
    config = configured()
    lead_s = config.filter.lead * PERIOD_S
    lag_s = config.lag * PERIOD_S
    delay_s = delays * config.ahead * PERIOD_S
    assert contraction(slope, delay_s, lag_s, lead_s) < 0.75


def test_the_bound_sees_a_filter_that_passes_too_much() -> None:
    assert contraction(27_000.0, 4e-3, 7.5e-3, 9.5e-3, cutoff_hz=20.0) > 1.0


def learnt(slope: float, cycles: int, disturbance: np.ndarray) -> list[float]:
    """RMS of the force error by gait cycle: a linear plant with delay and lag under feedback and learning."""
    config = configured()
    delay, decay = config.ahead, math.exp(-1.0 / config.lag)
    correction: tuple[float, ...] = ()
    errors = []
    deviation, followed = 0.0, 0.0
    sent = [0.0] * (delay + 1)
    for _ in range(cycles):
        added, squares = np.zeros(SAMPLES), 0.0
        for i in range(SAMPLES):
            followed += (1.0 - decay) * (sent[-1 - delay] - followed)
            error = float(disturbance[i]) - slope * followed
            squares += error * error
            deviation = config.decay * deviation + config.gain_m_n * error
            added[i] = deviation
            sent.append(deviation + (correction[i] if correction else 0.0))
        correction = learning.learn(correction, added, config.filter)
        errors.append(math.sqrt(squares / SAMPLES))
    return errors


@pytest.mark.parametrize("slope", SLOPES_N_M)
def test_learning_converges_as_the_bound_says(slope: float) -> None:
    """What stays is what Q does not pass: (1 − Q)/(1 − Q·(1 − γ)), 2 % of it at 1 Hz and 12 % at 2.5 Hz."""
    phase = np.linspace(0.0, 2.0 * np.pi, SAMPLES, endpoint=False)
    errors = learnt(slope, 8, 3.0 * np.sin(2.0 * phase) + np.cos(5.0 * phase))
    assert errors[-1] < 0.12 * errors[0]
    assert all(later <= 0.75 * before for before, later in itertools.pairwise(errors) if before > 0.2 * errors[0])


def test_step_is_pure_and_sees_no_end() -> None:
    config = configured()
    state = extended.ExtendedState(config.law)
    for sample in range(-20, 40):
        look = ControllerInput(sample, 0.01, 5.0, config.gait.knee[sample % SAMPLES], 0.1)
        first = extended.step(look, state, config)
        assert extended.step(look, state, config) == first
        state = first[1]
    assert not any("end" in name for name in ControllerInput._fields)


def test_feedback_rests_while_the_friction_turns_over() -> None:
    """Around the peak START jumps and END does not: no correction may come of it."""
    config = configured()
    state = extended.ExtendedState(config.law)
    moved = []
    for sample in range(180, 520):
        look = ControllerInput(sample, 0.0, 0.0, config.gait.knee[sample], 60.0)
        _, after, _trace = extended.step(look, state, config)
        if after.resting:
            moved.append(after.deviation_m - state.deviation_m)
        state = after
    assert len(moved) > 10
    assert not np.any(np.array(moved) * (np.array(moved) > 0.0))


def test_knee_ahead_of_its_reference_is_led() -> None:
    """A knee that runs off at a constant speed is met where it will be when the target acts."""
    config = dataclasses.replace(configured(), gain_m_n=0.0, lag=0.0)
    state, knee, rope = extended.ExtendedState(config.law), config.gait.knee, nominal().rope_zero
    for sample in range(1200, 1300):
        off = 0.05 + 0.2 * (sample - 1200) * PERIOD_S
        outputs, state, _ = extended.step(ControllerInput(sample, rope, 0.0, knee[sample] + off, 0.0), state, config)
        rope += 0.1 * (outputs.servo_target_m - rope)
    then = 1299 + config.ahead
    expected = nominal().rope_zero - config.gait.slack[then] + nominal().rope_per_knee * (
        knee[then] + 0.05 + 0.2 * (then - 1200) * PERIOD_S - float(laws.knee_angle(13.0)))
    assert outputs.servo_target_m == pytest.approx(expected, abs=5e-6)


def test_no_target_is_farther_from_the_rope_than_the_drive_follows() -> None:
    """A stretch of 5 mm in the first newton asks for a leap; the drive would stop with a following error."""
    config = configured()
    config = dataclasses.replace(config, law=config.law._replace(short=5e-3), lag=10.0)
    state, rope = extended.ExtendedState(config.law), 0.0
    for sample in range(150, 400):
        look = ControllerInput(sample, rope, 0.0, config.gait.knee[sample], 0.0)
        outputs, state, _ = extended.step(look, state, config)
        assert abs(outputs.servo_target_m - rope) <= extended.REACH_M + extended.TARGET_CYCLES * 0.3 * PERIOD_S + 1e-9
        rope += max(-0.3 * PERIOD_S, min(0.3 * PERIOD_S, 0.1 * (outputs.servo_target_m - rope)))


def test_nothing_is_learnt_where_a_target_is_held_back() -> None:
    """A servo that stands still for a gait cycle leaves errors of 15 mm; a larger target would move it no farther."""
    config = configured()
    state = extended.ExtendedState(config.law)
    for sample in range(SAMPLES + 1):
        look = ControllerInput(sample, 0.0, 0.0, config.gait.knee[sample % SAMPLES], 0.0)
        _, state, _ = extended.step(look, state, config)
    assert len(state.tracked) == SAMPLES
    assert np.abs(state.tracked).max() < extended.REACH_M


@pytest.mark.parametrize("lag_hz", [15.0, 25.0, 40.0])
@pytest.mark.parametrize("delays", [1, 2])
def test_what_the_drive_makes_of_a_target_is_learnt_and_converges(lag_hz: float, delays: int) -> None:
    """|Q·(1 − γ·z^d·T)| < 1, T the drive with its lead undone at 25 Hz, also at twice the delay."""
    config = configured()
    frequency = np.linspace(0.01, 60.0, 4000)
    s = 2j * np.pi * frequency
    drive = np.exp(-s * delays * config.ahead * PERIOD_S) / (1.0 + s / (2.0 * np.pi * lag_hz))
    turned = np.exp(s * config.tracking.lead * PERIOD_S) * drive
    passed = learning.passes(frequency, learning.TRACKED_HZ)
    assert np.max(passed * np.abs(1.0 - learning.GAIN * turned)) < 1.0


def evidence_of(
    law: inverse.Law, followed: FrictionChange, true: inverse.Law, offset_m: float = 0.0,
    play_m: float = 0.0,
) -> list[friction_following.CycleEvidence]:
    """What one gait cycle tells a controller that believes `law` as followed on a bench that is `true`, with noise.

    `play_m`: half of the play at its knee, m of rope; the leg lies behind the way that the knee moves.
    """
    rng = np.random.default_rng(5)
    believed_law = friction_following.law_at(law, followed)
    knee, desired = gait.sampled(paper_reference(40.0, 2.0), SAMPLES)
    sides = -np.sign(np.roll(knee, -1) - np.roll(knee, 1))
    told, slip, believed = [], tuple(inverse.Slip()), tuple(inverse.Slip())
    for angle, force, side in zip(knee.tolist(), desired.tolist(), sides.tolist(), strict=True):
        leg = angle + side * followed.play / law.rope_per_knee
        position, start, *_, slip = inverse.inverse(true, slip, force, angle + side * play_m / true.rope_per_knee)
        _, would, *exponents, believed = inverse.inverse(believed_law, believed, force, leg)
        drag = would - force * math.exp(exponents[0] + exponents[1])
        if abs(believed[0]) > extended.SLIDING and abs(believed[1]) > extended.SLIDING and force > 12.0:
            noisy = start + float(rng.normal(0.0, 0.15))
            one = friction_following.friction_evidence(
                believed_law, followed, position + offset_m, leg, noisy, drag, tuple(exponents), side, 12.0)
            told += [] if one is None else [one]
    return told


def exponent(law: inverse.Law) -> float:
    """The whole exponent at the loaded knee."""
    return law.cable_exponent + law.fabric_offset + 0.5 * law.fabric_slope


def changed(law: inverse.Law, friction: float, breakaway: float) -> inverse.Law:
    """Return the law with its exponents times `friction`, and `breakaway` more of breakaway in sheath and on knee."""
    return law._replace(
        cable_exponent=friction * law.cable_exponent, fabric_offset=friction * law.fabric_offset,
        fabric_slope=friction * law.fabric_slope, breakaway=law.breakaway + breakaway,
        fabric_breakaway=law.fabric_breakaway + breakaway)


@pytest.mark.parametrize("factor", [0.95, 1.0, 1.05])
@pytest.mark.parametrize("offset_m", [0.0, 5e-5])
def test_a_change_of_friction_is_followed(factor: float, offset_m: float) -> None:
    """As homed in the first gait cycles, then another: a third of the change is gone after ten more, whatever 0.05 mm
    of zero says against it."""
    law = inverse.law(nominal(), PERIOD_S)
    true = changed(law, factor, 0.0)
    followed = FrictionChange()
    for cycle in range(friction_following.SETTLING + 11):
        here = law if cycle <= friction_following.SETTLING else true
        followed = friction_following.follow(followed, evidence_of(law, followed, here, offset_m))
    left = abs(exponent(friction_following.law_at(law, followed)) - exponent(true))
    assert left <= 0.67 * abs(exponent(law) - exponent(true)) + 0.005 * exponent(law)


@pytest.mark.parametrize("wrong", [
    {"quadratic": -2.2e-6}, {"linear": 2.75e-4}, {"constant": 9.8e-3}, {"rope_per_knee": 0.0412}, {"drag": 1.0e4},
    {"rope_travel": 4e-4}, {"share": 0.55}, {"short": 5e-5}, {"load_slope": 0.1}])
def test_an_error_of_the_model_does_not_move_friction(wrong: dict[str, float]) -> None:
    """Friction as homing measured it, the model wrong elsewhere: after ten cycles it is where homing left it, but for
    what the play and the breakaway, which take their part of the error first, change in the evidence."""
    law = inverse.law(nominal(), PERIOD_S)
    true = law._replace(**wrong)
    followed = FrictionChange()
    for _ in range(10):
        followed = friction_following.follow(followed, evidence_of(law, followed, true))
    moved = exponent(friction_following.law_at(law, followed)) / exponent(law) - 1.0
    assert abs(moved) < 0.2 * friction_following.PRIOR[0]


@pytest.mark.parametrize("play_m", [0.0, 1e-4, 2e-4])
def test_play_at_the_knee_is_found_while_friction_is_as_homed(play_m: float) -> None:
    """Within a third after the first gait cycles, less what its doubt draws it towards none."""
    law = inverse.law(nominal(), PERIOD_S)
    followed = FrictionChange()
    for _ in range(friction_following.SETTLING):
        followed = friction_following.follow(followed, evidence_of(law, followed, law, play_m=play_m))
    assert followed.play == pytest.approx((1.0 - 0.5**friction_following.SETTLING) * play_m, rel=0.33, abs=1e-5)


def test_a_bench_that_breaks_away_harder_is_followed() -> None:
    law = inverse.law(nominal(), PERIOD_S)
    harder, followed = changed(law, 1.0, 0.3), FrictionChange()
    for _ in range(8):
        followed = friction_following.follow(followed, evidence_of(law, followed, harder))
    assert 0.05 < followed.breakaway < 0.3


def test_without_evidence_friction_stays() -> None:
    assert friction_following.follow(FrictionChange(), []) == FrictionChange()


def test_rows_at_the_start_of_the_loading_are_no_evidence() -> None:
    config = configured()
    state = extended.ExtendedState(config.law)
    for sample in range(150, 300):
        i = sample % SAMPLES
        _, state, _ = extended.step(
            ControllerInput(sample, 0.012, 0.0, config.gait.knee[i], 1.3 * config.gait.desired[i]), state, config)
    history, told = state.history, []
    while history is not None:
        sample, _, _, one, history = history
        told += [sample] if one is not None else []
    assert all(config.gait.desired[sample] > 0.3 * 40.0 for sample in told)


def test_only_the_products_of_wrap_and_friction_move_the_rope() -> None:
    """κ is not identified, and need not be: another one with the products kept makes the same step."""
    one = nominal()
    other = dataclasses.replace(one, fabric_wrap=2.0 * one.fabric_wrap, phi0=2.0 * one.phi0,
                                mu2=0.5 * one.mu2)
    assert inverse.law(other, PERIOD_S) == inverse.law(one, PERIOD_S)


def test_an_error_within_the_doubt_of_the_discrepancy_is_hardly_fed_back() -> None:
    """Without a discrepancy all of it is; at one standard deviation half of it, at ten 99 %."""
    assert extended.trusted(0.3, 0.0) == 0.3
    assert [extended.trusted(error, 0.1) for error in (0.1, -0.1, 1.0)] == pytest.approx([0.05, -0.05, 0.99], rel=1e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_migrated_zero_is_followed_within_its_ranges_and_a_load_dependent_error_is_not(sign: float) -> None:
    """A correction that is alike under every load moves the zero, by stride and in all at most as much as is stated."""
    config = dataclasses.replace(configured(), migration=(2e-4, 5e-4))
    taut = np.array(config.gait.slack) == 0.0
    load = np.array(config.gait.desired) / 40.0
    shifted = 0.0
    for expected in (2e-4, 4e-4, 5e-4, 5e-4):
        learnt, fed, shifted = extended._migrated(0.0 * taut, sign * 1e-3 * taut, shifted, config)
        assert shifted == pytest.approx(sign * expected)
        assert learnt[taut].mean() == 0.0
        assert fed[~taut & (np.array(config.gait.slack) == max(config.gait.slack))] == pytest.approx(0.0)
    learnt, fed, shifted = extended._migrated(1e-4 * load, 0.0 * load, 0.0, config)
    left = (learnt + fed)[taut] - (1e-4 * load[taut] - shifted)
    assert left == pytest.approx(0.0 * left, abs=1e-12)
    assert shifted == pytest.approx(1e-4 * load[taut].mean())
