"""What sensors, drive and wire say of a bench: gains, lags, noise, steps, and what a wire loses or holds up.

The rule of this file: what it returns are the canonical columns and ages, and nothing of the truth.
"""

from __future__ import annotations

import math

import numpy as np

from tests.hidden.bench import Bench


def sensors(bench: Bench, rng: np.random.Generator, time: np.ndarray, leg: np.ndarray, end: np.ndarray,
            start: np.ndarray) -> dict[str, np.ndarray]:
    """What the two tension sensors say."""
    progress = time / time[-1]
    swing = np.gradient(np.gradient(leg, time), time)
    felt = end + bench.end_mass * (9.81 * np.cos(leg) + bench.end_arm * swing)
    said = {}
    for name, signal, gain, offset, drift in (
            ("tension_start_n", start, bench.start_gain, bench.start_offset, bench.start_drift),
            ("tension_end_n", felt, bench.end_gain, bench.end_offset, bench.end_drift)):
        signal = filtered(signal, 0.7e-3)
        if name == "tension_end_n":
            signal = filtered(signal, bench.end_filter) if bench.end_filter > 0.0 else signal
            signal = late(signal, bench.end_delay) if bench.end_delay > 0.0 else signal
        if bench.skew:
            signal = late(signal, bench.skew)
        signal = gain * signal + offset + drift * progress + noise(bench, rng, signal.size)
        said[name] = np.round(signal / bench.quantum) * bench.quantum
    return said


def encoder(angle: np.ndarray) -> np.ndarray:
    """An angle as the knee drive's PDO says it, in whole millidegrees."""
    return np.round(angle * 57295.78) / 57295.78


def columns(bench: Bench, rng: np.random.Generator, time: np.ndarray, x: np.ndarray, leg: np.ndarray, end: np.ndarray,
            start: np.ndarray) -> dict[str, np.ndarray]:
    """What is recorded of rope, leg and tensions, without targets and counters."""
    said = sensors(bench, rng, time, leg, end, start)
    force = drive_force(bench, rng, time, x, start)
    said |= {"time_s": time, "servo_position_m": np.round(x + rng.normal(0.0, 1e-6, x.size), 6),
             "servo_force_n": np.round(force, 1)}
    said["servo_velocity_m_s"] = np.gradient(said["servo_position_m"], 1e-3)
    return said


def drive_force(bench: Bench, rng: np.random.Generator, time: np.ndarray, x: np.ndarray, start: np.ndarray
                ) -> np.ndarray:
    """The servo's force, N: tension on the drum's arm, friction by direction and speed, inertia, ripple."""
    v = np.gradient(x, time)
    a = np.gradient(v, time)
    s = np.tanh(v / 1.5e-3)
    coulomb = bench.drive_coulomb * s * (1.0 + bench.drive_asymmetry * s)
    pull = start * (1.0 + bench.ecc / 0.020 * np.cos(x / 0.020 + bench.ecc_phase))
    return (pull + coulomb + bench.drive_viscous * v + bench.drive_inertia * a + bench.drive_offset
            + rng.normal(0.0, 0.3, x.size))


def noise(bench: Bench, rng: np.random.Generator, n: int) -> np.ndarray:
    """White noise and a slow coloured part (first-order, 30 ms), N."""
    from scipy.signal import lfilter

    slow = lfilter([1.0], [1.0, -math.exp(-1e-3 / 0.03)], rng.normal(size=n + 500))[500:]
    return bench.noise * rng.normal(size=n) + bench.coloured * slow / slow.std()


def filtered(signal: np.ndarray, seconds: float) -> np.ndarray:
    from scipy.signal import lfilter

    a = math.exp(-1e-3 / seconds)
    return lfilter([1.0 - a], [1.0, -a], signal, zi=[a * signal[0]])[0]


def late(signal: np.ndarray, seconds: float) -> np.ndarray:
    t = np.arange(signal.size) * 1e-3
    return np.interp(t - seconds, t, signal)


def rung(signal: np.ndarray, dt: float) -> np.ndarray:
    """A cantilever's ringing at 9 Hz after each change of load, relative to 1 N."""
    from scipy.signal import lfilter

    w, damping = 2.0 * math.pi * 9.0 * dt, 0.05
    kick = np.gradient(signal, dt) / 400.0
    rings = lfilter([w], [1.0, -2.0 * (1.0 - damping * w) * math.cos(w), (1.0 - damping * w) ** 2], kick)
    return rings / np.abs(rings).max()


NODES = {"servo": ("servo_position_m", "servo_force_n"), "knee": ("knee_angle_rad",), "start": ("tension_start_n",),
         "end": ("tension_end_n",)}


def wired(given: dict[str, np.ndarray], rng: np.random.Generator, lost: float = 0.0, late: int = 0,
          late_share: float = 0.0, ages: bool = True) -> dict[str, np.ndarray]:
    """What a master sees of `given` when PDOs get lost, or a share of them comes `late` cycles after its own.

    It keeps the newest value that has come; with `ages` it says, as a recorder would, how old that is.
    """
    seen = dict(given)
    k = np.arange(given["time_s"].size)
    for node, names in NODES.items():
        chance = rng.random(k.size)
        arrival = np.where(chance < lost, k.size, np.where(chance < lost + late_share, k + late, k))
        newest = np.zeros(k.size, dtype=np.intp)
        on = arrival < k.size
        np.maximum.at(newest, arrival[on], k[on])
        newest = np.maximum.accumulate(newest)
        seen |= {name: given[name][newest] for name in names}
        if ages:
            seen[f"{node}_pdo_age_ns"] = (k - newest) * 1e6
    seen["servo_velocity_m_s"] = np.gradient(seen["servo_position_m"], 1e-3)
    return seen
