"""A gait trial on a bench of `truth`: reference motion, a feed-forward master, drives.

The rule of this file: the motion is imposed and the chain follows it; what comes out are the canonical columns.
"""

from __future__ import annotations

import math

import numpy as np

from tests.hidden import truth
from tests.hidden.bench import K2, THETA_13, A, B, Bench, C, chain, zero
from tests.hidden.readings import columns, encoder, rung


def trial(bench: Bench, seed: int, peak: float = 40.0, period: float = 1.3, cycles: int = 10,
          slack_m: float = 2.0e-3) -> dict[str, np.ndarray]:
    """Run one gait trial at 1 kHz; return the canonical columns."""
    rng = np.random.default_rng(seed)
    dt = 1e-3
    time = np.arange(round(cycles * period / dt)) * dt
    percent = 100.0 * time / period
    theta_ref, force_ref = knee_motion(percent), desired(percent, peak)
    knee = second_order(np.roll(theta_ref, 2), dt, 20.0)
    leg = held(knee, bench.backlash) if bench.backlash > 0.0 else knee
    target = master(theta_ref, force_ref, slack_m)
    x = rope(target, dt, bench)
    end, start = outside(bench, *pulled(bench, time, x, leg), percent, force_ref)
    return columns(bench, rng, time, x, leg, end, start) | {
        "gait_percent": np.mod(percent, 100.0), "cycle": np.floor(percent / 100.0 + 1e-9), "servo_target_m": target,
        "knee_target_rad": theta_ref, "knee_angle_rad": encoder(knee), "desired_force_n": force_ref}


def pulled(bench: Bench, time: np.ndarray, x: np.ndarray, leg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the chain answers to rope and leg: END and START tension, N."""
    p, widths, weights, slopes = chain(bench)
    w = K2 * (leg - THETA_13) + bench.arm2 * (leg - THETA_13) ** 2
    drum = x + bench.ecc * np.sin(x / 0.020 + bench.ecc_phase) + zero(bench)
    return truth.run(drum, w, leg, np.gradient(x, time), time, p, time[-1], widths, weights, slopes)


def outside(bench: Bench, end: np.ndarray, start: np.ndarray, percent: np.ndarray, force: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray]:
    """Put on END and START what no catalogue has."""
    q = np.mod(percent, 100.0)
    if bench.temperature != 0.0:
        start = start + bench.temperature * force**2 / force.max() * np.sin(2.0 * np.pi * 3.0 * percent / 100.0)
    if bench.thump != 0.0:
        start = start + bench.thump * np.exp(-(((q - 15.0) / 1.2) ** 2)) * np.sin((q - 15.0) * 1.3)
    if bench.resonance != 0.0:
        end = end + bench.resonance * rung(end, 1e-3)
    return end, start


def knee_motion(percent: np.ndarray) -> np.ndarray:
    """Formula (1), rad, closed by fading into its own continuation over the last 12 % of the gait."""
    def formula(q):
        return np.radians(sum(a * np.sin(b * q + c) for a, b, c in zip(A, B, C, strict=True)))

    q = np.mod(percent, 100.0)
    u = np.clip((q - 88.0) / 12.0, 0.0, 1.0)
    fade = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return (1.0 - fade) * formula(q) + fade * formula(q - 100.0)


def desired(percent: np.ndarray, peak: float) -> np.ndarray:
    """Formula (2), N."""
    q = np.mod(percent, 100.0)
    return peak * np.where((q >= 10.0) & (q < 30.0), np.sin(np.pi * np.clip(q - 10.0, 0.0, 20.0) / 20.0), 0.0)


def second_order(target: np.ndarray, dt: float, hz: float, damping: float = 0.9) -> np.ndarray:
    """The position loop's answer to its target, started at rest on it."""
    from scipy.signal import StateSpace, lsim

    w = 2.0 * math.pi * hz
    system = StateSpace([[0.0, 1.0], [-w * w, -2.0 * damping * w]], [[0.0], [w * w]], [[1.0, 0.0]], [[0.0]])
    t = np.arange(target.size) * dt
    return lsim(system, target, t, X0=[target[0], 0.0])[1]


def held(signal: np.ndarray, width: float) -> np.ndarray:
    """A dead band of total `width`."""
    out = np.empty_like(signal)
    y = signal[0]
    for k, value in enumerate(signal.tolist()):
        y = min(max(y, value - 0.5 * width), value + 0.5 * width)
        out[k] = y
    return out


def master(theta: np.ndarray, force: np.ndarray, slack_m: float) -> np.ndarray:
    """Feed-forward by the nominal calibration: (10) and (11), a slack rope while no force is wanted."""
    stretch = 9.7e-3 + 0.3e-3 * force - 0.0017e-3 * force**2
    idle = np.where(force > 0.0, 0.0, slack_m)
    kernel = np.hanning(81) / np.hanning(81).sum()
    idle = np.convolve(np.pad(idle, 40, mode="wrap"), kernel, "valid")
    return stretch + K2 * (theta - THETA_13) - idle


def rope(target: np.ndarray, dt: float, bench: Bench) -> np.ndarray:
    """The drum's motion: target two cycles late, the position loop."""
    return second_order(np.concatenate([target[:1], target[:1], target[:-2]]), dt, bench.drive_hz)
