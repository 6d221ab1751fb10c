"""Lag and low-pass of the END reading, and the servo force ahead of START's lag, against exact responses."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from physics.forward.path_constants import CONSTANTS, INDEX, SESSION_SD, WANDER, values
from physics.forward.path_outputs import PathMotion, drive_force, end_reading, start_reading, zero_courses
from physics.laws import Array

STEP_S = 4e-3
TIME_S: Array = STEP_S * np.arange(400, dtype=np.float64)
INNER = slice(120, -50)
"""Samples that no lag of these tests reads from beyond the ends, and at which a low-pass has settled."""
STILL: dict[str, Any] = dict.fromkeys(PathMotion.__annotations__, np.zeros(TIME_S.size)) | {
    "zero_courses": zero_courses(np.zeros(TIME_S.size))}
"""Motion of a bench at rest."""
lags = st.floats(-0.05, 0.1)
short = st.just(0.0) | st.floats(1e-6, 0.02)


def read(tension: Array, lag_s: float, filter_s: float) -> Array:
    """Return the reading of END of a bench at rest that has no gain error, no zero and no mass."""
    constants = values(np.zeros((len(CONSTANTS), 1)))
    constants[INDEX["end_lag"]], constants[INDEX["end_filter"]] = lag_s, filter_s
    return np.asarray(end_reading(constants, tension[None].copy(), SimpleNamespace(**STILL), STEP_S)[0])


@given(lags, short)
def test_a_ramp_arrives_later_by_lag_and_time_constant(lag_s: float, filter_s: float) -> None:
    told = read(200.0 * TIME_S, lag_s, filter_s)
    np.testing.assert_allclose(told[INNER], 200.0 * (TIME_S - lag_s - filter_s)[INNER], atol=1e-3)


@given(lags)
@example(STEP_S)
@example(-STEP_S)
@example(0.0)
def test_the_reading_is_continuous_in_the_lag(lag_s: float) -> None:
    tension = 30.0 * np.sin(2.0 * np.pi * 5.0 * TIME_S)
    apart = read(tension, lag_s + 1e-7, 0.0) - read(tension, lag_s - 1e-7, 0.0)
    assert np.abs(apart[INNER]).max() < 2.0 * 2e-7 * 30.0 * 2.0 * np.pi * 5.0  # twice the signal's largest slope


def test_a_vanishing_low_pass_changes_nothing() -> None:
    tension = 30.0 * np.sin(2.0 * np.pi * 5.0 * TIME_S)
    np.testing.assert_allclose(read(tension, 0.0, 1e-6), tension, atol=0.01)
    np.testing.assert_array_equal(read(tension, 0.0, 0.0), tension)


@given(lags, st.floats(1.0, 10.0))
def test_a_sine_keeps_its_amplitude(lag_s: float, hz: float) -> None:
    told = read(np.sin(2.0 * np.pi * hz * TIME_S), lag_s, 0.0)
    exact = np.sin(2.0 * np.pi * hz * (TIME_S - lag_s))
    # the error of a cubic interpolation is of the third order in the step: (2π·hz·step)³/16 at most
    np.testing.assert_allclose(told[INNER], exact[INNER], atol=(2.0 * np.pi * hz * STEP_S) ** 3 / 16.0 + 1e-12)


@given(st.floats(-0.03, 0.03), st.floats(1.0, 8.0))
def test_the_servo_force_has_start_as_it_was_before_its_lag(lag_s: float, hz: float) -> None:
    constants = values(np.zeros((len(CONSTANTS), 1)))
    constants[INDEX["start_lag"]] = lag_s
    motion: Any = SimpleNamespace(**STILL | {"start_n": np.sin(2.0 * np.pi * hz * (TIME_S - lag_s))})
    told = drive_force(constants, motion, STEP_S)[0]
    exact = np.sin(2.0 * np.pi * hz * TIME_S)
    np.testing.assert_allclose(told[INNER], exact[INNER], atol=(2.0 * np.pi * hz * STEP_S) ** 3 / 16.0 + 1e-12)


def test_a_zero_wanders_as_a_wiener_process_does_and_the_servo_force_is_without_it() -> None:
    constants = values(np.zeros((len(CONSTANTS), 1 + WANDER)))
    waves = [INDEX[f"start_wander{k}"] for k in range(1, WANDER + 1)]
    constants[waves, 1 + np.arange(WANDER)] = SESSION_SD[waves]
    constants[INDEX["start_lag"]] = 0.0
    progress = TIME_S / TIME_S[-1]
    still = STILL | {"zero_courses": zero_courses(progress)}
    read = start_reading(constants, np.full((1 + WANDER, TIME_S.size), 30.0), SimpleNamespace(**still), STEP_S)
    apart = read[1:] - read[0]
    # a Brownian bridge has the variance sd²·p·(1 − p), its first sines at most that, and most of it
    bridge = SESSION_SD[INDEX["start_drift"]] ** 2 * progress * (1.0 - progress)
    assert np.all((apart**2).sum(axis=0) <= bridge + 1e-12)
    assert (apart**2).sum() > 0.85 * bridge.sum()  # Σ 1/k² up to 4 over π²/6
    for row in range(1 + WANDER):
        motion: Any = SimpleNamespace(**still | {"start_n": read[row]})
        force = drive_force(constants[:, [row]], motion, STEP_S)[0]
        np.testing.assert_allclose(force[INNER], drive_force(constants[:, [0]], SimpleNamespace(
            **still | {"start_n": read[0]}), STEP_S)[0][INNER], atol=1e-9)
