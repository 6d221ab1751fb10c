"""The impedance law in its loop: step responses and gain margins against a rope of a given stiffness.

The rule of this file: linear and small, with everything that turns the phase: the law is `physics.laws`' own; a target
is taken over at the next SYNC and led to in a straight line until the one after; the drive is a position loop around
a velocity loop; START's converter has its low-pass; the rope is a spring.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from physics import laws
from physics.converter import SensorParameters
from physics.drive_loops import SERVO_GAINS

PERIOD_S = 1e-3
SUBSTEPS = 20
VELOCITY_RAD_S = 2.0 * math.pi * 100.0
"""Bandwidth of the drive's velocity loop on the nominal inertia."""
POSITION_RAD_S = SERVO_GAINS.position_gain
SENSOR_RAD_S = 2.0 * math.pi * SensorParameters().cutoff_hz
OLD_SUBSTEPS = 5
"""Age of the converter's sample at SYNC: half a sampling interval of 500 µs, in substeps."""
SECONDS = 2.0
AT_40_N = 1.0 / laws.stiffness_slope(40.0)
"""N/m: rope and fabric at 40 N."""
STUCK = 27e3
"""N/m: the rope alone, while friction holds it."""


class Response(NamedTuple):
    """A step of 1 N in the desired force: what is left of the error, time to 63 % of the way (s), overshoot."""

    stable: bool
    left: float
    rise_s: float
    overshoot: float


def response(spring_n_m: float, damping: float, stiffness: float) -> Response:
    """Return the closed loop's answer; `damping` and `stiffness` are B and K in SI."""
    dt = PERIOD_S / SUBSTEPS
    target = before = ordered = position = velocity = felt = sampled = 0.0
    course: list[float] = []
    for _ in range(round(SECONDS / PERIOD_S)):
        before, ordered = ordered, target
        target = laws.impedance_step(target, 1.0 - sampled, PERIOD_S, damping, stiffness)
        for part in range(SUBSTEPS):
            wanted = before + (ordered - before) * (part + 1) / SUBSTEPS
            velocity += (POSITION_RAD_S * (wanted - position) - velocity) * VELOCITY_RAD_S * dt
            position += velocity * dt
            felt += (spring_n_m * position - felt) * SENSOR_RAD_S * dt
            sampled = felt if part < SUBSTEPS - OLD_SUBSTEPS else sampled
        course.append(spring_n_m * position)
        if abs(course[-1]) > 100.0:
            return Response(False, math.nan, math.nan, math.nan)
    final = spring_n_m / (spring_n_m + stiffness)
    late, early = (max(abs(value - final) for value in part) for part in (course[-200:], course[-400:-200]))
    if late > early and late > 1e-6:
        return Response(False, math.nan, math.nan, math.nan)
    rise = next(i for i, value in enumerate(course) if value >= 0.632 * final) * PERIOD_S
    return Response(True, 1.0 - final, rise, max(course) / final - 1.0)


def passed(s: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the answer of everything but law and spring, at s = jω: delay, hold, drive and START's converter."""
    age = PERIOD_S * (1.0 + OLD_SUBSTEPS / SUBSTEPS)
    held = np.exp(-s * age) * ((1.0 - np.exp(-s * PERIOD_S)) / (s * PERIOD_S)) ** 2
    drive = POSITION_RAD_S / (s * (1.0 + s / VELOCITY_RAD_S) + POSITION_RAD_S)
    return np.asarray(held * drive / (1.0 + s / SENSOR_RAD_S))


def sampled_law(s: NDArray[np.complex128], damping: float, stiffness: float) -> NDArray[np.complex128]:
    """Return the admittance 1/(B·s + K) as the law has it by control cycle, m/N, at s = jω."""
    decay = math.exp(-stiffness / damping * PERIOD_S)
    return np.asarray((1.0 - decay) / stiffness / (1.0 - decay * np.exp(-s * PERIOD_S)))


def margin(spring_n_m: float, damping: float, stiffness: float) -> float:
    """Return by how much the loop's gain may grow before it is unstable; below 1 it is."""
    s = 1j * np.geomspace(1.0, 2e3, 4000)
    loop = spring_n_m * sampled_law(s, damping, stiffness) * passed(s)
    turned = np.unwrap(np.angle(loop))
    crossing = int(np.argmax(turned < -math.pi))
    return float(1.0 / np.abs(loop[crossing]))


def least_damping(spring_n_m: float, stiffness: float) -> float:
    """Return the B, N·s/m, below which the loop is unstable."""
    low, high = 1e-3, 1e5
    for _ in range(80):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if margin(spring_n_m, middle, stiffness) < 1.0 else (low, middle)
    return high


def noise_gain(damping: float, stiffness: float) -> float:
    """Return Δx's standard deviation by START's, m/N, for noise that is new in every cycle: jitter of the output."""
    decay = math.exp(-stiffness / damping * PERIOD_S)
    return (1.0 - decay) / stiffness / math.sqrt(1.0 - decay * decay)
