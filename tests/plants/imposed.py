"""A bench of the family under imposed motion: true tensions for given rope and knee, gait motion, recorded columns.

The rule of this file: nothing here is a controller; the rope's motion for a gait comes from inverting the bench itself,
over two cycles, and what the columns hold is the truth through sensors, drive and wire with the trial's own noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.signal import lfilter

from tests.plants import mechanics
from tests.plants.bench import GRAVITY, Bench, replaced
from tests.plants.plant import METHODS

Array = np.ndarray
DT = 1e-3
"""Step of the motions made here, s; recorded columns are every so many of them."""
RATES_HZ = (200, 250, 500, 1000)
LEAD_IN_S = 0.3
IDLE_SLACK_M = 2e-3
KNEE_HZ = 20.0
_A, _B, _C = (48.16, 525.2, 540.2), (0.01951, 0.1239, 0.1232), (-3.112, -0.02836, -3.159)
"""The paper's (1), degrees over % of gait."""


class Motion(NamedTuple):
    """A motion at `DT`: s, m of rope as the encoder says it, rad at the knee drive's encoder, N, %, number from 0."""

    time: Array
    target: Array
    rope: Array
    knee_target: Array
    knee: Array
    desired: Array
    percent: Array
    cycle: Array


class Forces(NamedTuple):
    """True tensions, N, and the leg's angle, rad."""

    start: Array
    middle: Array
    end: Array
    leg: Array


class Trial(NamedTuple):
    """What was recorded, by the project's column names, and what no finder may see."""

    columns: dict[str, Array]
    motion: Motion
    true: Forces
    bench: Bench


def run(bench: Bench, time_s: Array, rope_m: Array, knee_rad: Array) -> tuple[Array, Array]:
    """True START and END tension, N, of a bench whose encoders are led along `rope_m` and `knee_rad` (100–1000 Hz).

    Before the first sample the rope comes tight from slack at the first knee angle, within 0.3 s.
    """
    forces = forced(bench, time_s, rope_m, knee_rad)
    return forces.start, forces.end


def forced(bench: Bench, time_s: Array, rope_m: Array, knee_rad: Array) -> Forces:
    """As `run`, with the tension before the knee and the leg's angle."""
    method = METHODS[bench.structure.implementation]
    k, p, z = mechanics.parameters(bench), method.parameters(bench), method.state(bench)
    anchored = float(mechanics.anchor.py_func(k, knee_rad[0]))
    loose = min(float(rope_m[0]), anchored + float(k[mechanics.K_ZERO]) - 1e-3)
    n = round(LEAD_IN_S / DT)
    time = np.concatenate([time_s[0] + DT * np.arange(-n, 0), time_s])
    rope = np.concatenate([np.linspace(loose, rope_m[0], n), rope_m])
    knee = np.concatenate([np.full(n, knee_rad[0]), knee_rad])
    out = [np.zeros(time.size) for _ in range(4)]
    out[3][0] = knee[0]
    method.settle(z, p, float(mechanics.paid.py_func(k, rope[0])), anchored)
    method.run(k, z, p, time, rope, knee, bench.leg_weight, *out)
    return Forces(*(values[n:] for values in out))


def knee_motion(percent: Array) -> Array:
    """The paper's (1), rad, closed in angle and slope over the last 30 % of the gait."""
    def at(t: Array, order: int = 0) -> Array:
        return sum(a * b**order * np.sin(b * t + c + 0.5 * math.pi * order) for a, b, c in zip(_A, _B, _C, strict=True))

    t = np.mod(percent, 100.0)
    s = np.clip((t - 70.0) / 30.0, 0.0, 1.0)
    jump, kink = at(0.0) - at(100.0), at(0.0, 1) - at(100.0, 1)
    return np.radians(at(t) + jump * s * s * (3.0 - 2.0 * s) + kink * 30.0 * (s**3 - s * s))


def desired_force(percent: Array, peak_n: float, preload_n: float = 0.0) -> Array:
    """The paper's (2), N: two quarter sines between 10, 20 and 30 %; never below a preload."""
    t = np.mod(percent, 100.0)
    rise, fall = np.sin(0.5 * math.pi * (t - 10.0) / 10.0), np.sin(0.5 * math.pi * (30.0 - t) / 10.0)
    shape = np.where((t >= 10.0) & (t < 20.0), rise, np.where((t >= 20.0) & (t < 30.0), fall, 0.0))
    return np.maximum(preload_n, peak_n * shape)


def second_order(target: Array, hz: float) -> Array:
    """What a position loop of damping 0.9 makes of a target at `DT`."""
    w = 2.0 * math.pi * hz * DT
    gains = np.array([w * w])
    poles = np.array([1.0, -(2.0 - 1.8 * w), 1.0 - 1.8 * w + w * w])
    ahead = np.concatenate([np.full(400, target[0]), target])
    return lfilter(gains, poles, ahead - target[0])[400:] + target[0]


def gait(bench: Bench, peak_n: float = 40.0, period_s: float = 1.3, cycles: int = 10, preload_n: float = 0.0,
         rounds: int = 8) -> Motion:
    """The gait motion by which this bench's END follows the desired force, found by inverting the bench itself.

    Iterated over two cycles: the rope's target is corrected by the force that lacked times the compliance; the second
    cycle is what is repeated.  With no preload the rope idles `IDLE_SLACK_M` slack.
    """
    n = round(period_s / DT)
    percent = np.mod(100.0 * np.arange(2 * n) / n, 100.0)
    knee_target = knee_motion(percent)
    knee = second_order(np.tile(knee_target, 2), KNEE_HZ)[2 * n :]
    wanted = desired_force(percent, peak_n, preload_n)
    taut = _unloaded(bench, knee)
    soft = bench.stretch_60 / 60.0 + bench.lead + bench.sheath
    target = taut + soft * wanted - np.where(wanted > 0.0, 0.0, IDLE_SLACK_M)
    lead = round(1.8 / (2.0 * math.pi * bench.loop_hz) / DT)
    time = DT * np.arange(2 * n)
    for _ in range(rounds):
        rope = second_order(np.tile(target, 2), bench.loop_hz)[2 * n :]
        lacks = wanted - forced(bench, time, rope, knee).end
        lacks = np.where((wanted > 0.0) | (lacks < -1.0), lacks, 0.0)
        second = np.roll(lacks[n:], -lead)
        target = target + np.tile(np.clip(0.6 * soft * second, -1.5e-3, 1.5e-3), 2)
    return _repeated(bench, target[:n], knee_target[:n], peak_n, preload_n, cycles)


def _unloaded(bench: Bench, knee: Array) -> Array:
    k = mechanics.parameters(bench)
    on = np.array([mechanics.anchor.py_func(k, angle) for angle in knee.tolist()])
    return on + k[mechanics.K_ZERO]


def _repeated(bench: Bench, target: Array, knee_target: Array, peak_n: float, preload_n: float, cycles: int) -> Motion:
    n = target.size
    percent = np.mod(100.0 * np.arange(cycles * n) / n, 100.0)
    settled = np.tile(target, cycles + 1), np.tile(knee_target, cycles + 1)
    rope, knee = second_order(settled[0], bench.loop_hz)[n:], second_order(settled[1], KNEE_HZ)[n:]
    return Motion(
        DT * np.arange(cycles * n), settled[0][n:], rope, settled[1][n:], knee,
        desired_force(percent, peak_n, preload_n), percent, np.repeat(np.arange(cycles), n).astype(float))


def _compile(sources: int):
    @njit(cache=True)
    def rubbed(k, v):
        _ = sources
        out = np.zeros(v.size)
        s = 0.0
        for i in range(v.size):
            s = mechanics.bristle(s, DT * v[i] / k[mechanics.K_PRESLIDING])
            out[i] = mechanics.servo_friction(k, s, v[i])
        return out

    return rubbed


_rubbed = _compile(mechanics.SOURCES)


def late(signal: Array, seconds: float) -> Array:
    """A signal at `DT` that is `seconds` late."""
    t = DT * np.arange(signal.size)
    return np.interp(t - seconds, t, signal)


def lagged(signal: Array, seconds: float) -> Array:
    """A signal at `DT` behind a first-order lag."""
    if seconds <= 0.0:
        return signal
    a = math.exp(-DT / seconds)
    return lfilter([1.0 - a], [1.0, -a], signal, zi=[a * signal[0]])[0]


def felt(bench: Bench, motion: Motion, true: Forces) -> tuple[Array, Array, Array]:
    """START, END and servo force as recorded but for noise, repeats and rounding, N at `DT`."""
    progress = motion.time / motion.time[-1]
    swing = np.gradient(np.gradient(true.leg, DT), DT)
    end = true.end + bench.end_mass * (GRAVITY * np.cos(true.leg) + bench.end_arm * swing)
    end = end + rung(true.end, bench.resonance)
    start = lagged(true.start, bench.start_lag)
    end = late(lagged(lagged(end, bench.end_lag), bench.end_filter), bench.end_delay)
    if bench.skew:
        start, end = late(start, bench.skew), late(end, bench.skew)
    k = mechanics.parameters(bench)
    v = np.gradient(motion.rope, DT)
    pull = true.start * (1.0 + bench.eccentricity / bench.drum * np.cos(
        motion.rope / bench.drum + bench.eccentricity_phase))
    force = (pull + _rubbed(k, v) + bench.drive_kg * np.gradient(v, DT)) / bench.demand_gain
    return (bench.start_gain * start + bench.start_offset + bench.start_drift * progress,
            bench.end_gain * end + bench.end_offset + bench.end_drift * progress, force)


def rung(end: Array, share: float) -> Array:
    """What a cantilever of 9 Hz adds when END changes, N."""
    w = 2.0 * math.pi * mechanics.RING_HZ
    loss = 2.0 * mechanics.RING_DAMPING * w * DT
    poles = [1.0, loss + (w * DT) ** 2 - 2.0, 1.0 - loss]
    return lfilter([share * w * DT], poles, np.diff(end, prepend=end[0]))


def sized(seed: int) -> tuple[float, int]:
    """Noise of the bridges, N rms, 0.05 … 0.4, and sampling rate, Hz, of the trial of a seed."""
    rng = np.random.default_rng((seed, 1))
    return 0.05 * 8.0 ** float(rng.random()), int(rng.choice(RATES_HZ))


def trial(bench: Bench, seed: int, peak_n: float = 40.0, period_s: float = 1.3, cycles: int = 10,
          motion: Motion | None = None, noise_n: float | None = None, rate_hz: int | None = None,
          preload_n: float = 0.0) -> Trial:
    """Record a trial: a gait by this bench's own inverse unless `motion` is given; noise and rate by the seed.

    `rate_hz` divides 1000.  What drifts does so over the trial.
    """
    own_noise, own_rate = sized(seed)
    motion = motion or gait(bench, peak_n, period_s, cycles, preload_n)
    bench = replaced(bench, drift_s=float(motion.time[-1]), noise=own_noise if noise_n is None else noise_n)
    true = forced(bench, motion.time, motion.rope, motion.knee)
    columns = recorded(bench, motion, true, np.random.default_rng((seed, 2)), rate_hz or own_rate)
    return Trial(columns, motion, true, bench)


def recorded(bench: Bench, motion: Motion, true: Forces, rng: np.random.Generator, rate_hz: int) -> dict[str, Array]:
    """The project's columns of a motion on a bench, every so many milliseconds."""
    every = slice(None, None, round(1.0 / (DT * rate_hz)))
    start, end, force = (signal[every] for signal in felt(bench, motion, true))
    n = start.size
    quantum = bench.quantum or 0.01
    said = {
        "time_s": motion.time[every], "gait_percent": motion.percent[every], "cycle": motion.cycle[every],
        "servo_target_m": motion.target[every], "knee_target_rad": motion.knee_target[every],
        "desired_force_n": motion.desired[every],
        "servo_position_m": np.round(motion.rope[every] + rng.normal(0.0, 1e-6, n), 6),
        "knee_angle_rad": np.round(motion.knee[every] * 57295.78) / 57295.78,
        "servo_force_n": np.round(force + rng.normal(0.0, 0.3, n), 1),
        "tension_start_n": quantum * np.round((start + bench.noise * rng.normal(size=n)) / quantum),
        "tension_end_n": quantum * np.round((end + bench.noise * rng.normal(size=n)) / quantum)}
    said = repeated(bench, said, rng)
    said["servo_velocity_m_s"] = np.gradient(said["servo_position_m"], said["time_s"])
    return said


FRAMES = (("servo_position_m", "servo_force_n"), ("knee_angle_rad",), ("tension_start_n",), ("tension_end_n",))


def repeated(bench: Bench, given: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    """What a master keeps when values get lost or come some samples late: the newest that has come."""
    if not bench.lost_share and not bench.late_share:
        return given
    k = np.arange(given["time_s"].size)
    seen = dict(given)
    for names in FRAMES:
        chance = rng.random(k.size)
        arrival = np.where(chance < bench.lost_share, k.size,
                           np.where(chance < bench.lost_share + bench.late_share, k + bench.late_cycles, k))
        newest = np.zeros(k.size, dtype=np.intp)
        came = arrival < k.size
        np.maximum.at(newest, arrival[came], k[came])
        newest = np.maximum.accumulate(newest)
        seen |= {name: given[name][newest] for name in names}
    return seen
