"""A gait trial on the bench of `truth`: reference motion, a feed-forward master, drives, sensors, noise.

The rule of this file: what it returns are the canonical columns and nothing of the truth; effects are settings
of `Bench`, each with its own law here, drawn elsewhere.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from tests.hidden import truth

K2 = 0.706e-3 * 180.0 / math.pi
A, B, C = (48.16, 525.2, 540.2), (0.01951, 0.1239, 0.1232), (-3.112, -0.02836, -3.159)
THETA_13 = math.radians(sum(a * math.sin(b * 13.0 + c) for a, b, c in zip(A, B, C, strict=True)))


@dataclass(frozen=True)
class Bench:
    """Every number of one bench, healthy by default; effects change some of them."""

    cap: float = 0.126
    mu2: float = 0.15
    wrap0: float = 0.15
    kappa: float = 1.0
    bend: float = 0.0
    load: float = 0.0
    viscous: float = 0.0
    ratio: float = 1.0
    speed: float = 0.01
    delta: float = 1.0e-4
    delta_f: float = 1.0e-4
    drift: float = 0.0
    lead: float = 3.0e-5
    sheath: float = 1.0e-5
    stiffness: float = 1.0
    shape: float = 0.0
    law: str = "exponential"
    before: float = 0.25
    over: float = 0.35
    creep: float = 0.0
    creep_t: float = 5.0
    warp: float = 0.0
    slopes: str = "even"
    stops: str = "wide"
    slack: float = 0.0
    zero: float = 0.0
    backlash: float = 0.0
    arm2: float = 0.0
    ecc: float = 0.0
    ecc_phase: float = 0.0
    end_mass: float = 0.0
    end_arm: float = 0.25
    end_gain: float = 1.0
    start_gain: float = 1.0
    end_offset: float = 0.0
    start_offset: float = 0.0
    end_drift: float = 0.0
    start_drift: float = 0.0
    end_delay: float = 0.0
    end_filter: float = 0.0
    skew: float = 0.0
    quantum: float = 0.01
    noise: float = 0.15
    coloured: float = 0.05
    drive_hz: float = 25.0
    drive_coulomb: float = 4.0
    drive_viscous: float = 12.0
    drive_offset: float = 0.0
    drive_asymmetry: float = 0.0
    drive_inertia: float = 0.35
    force_limit: float = 1e9
    speed_limit: float = 1e9
    late_start_ms: int = 0
    lost_share: float = 0.0
    temperature: float = 0.0
    thump: float = 0.0
    resonance: float = 0.0


def chain(bench: Bench) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the chain's flat parameters, stop widths, stop weights and bend by node."""
    soft, knee, linear, power = {
        "exponential": (16.3e-3, 45.0, 0.0, 0.0), "power": (7.6e-3, 10.0, 0.0, 0.5),
        "mixed": (10.0e-3, 30.0, 0.07e-3, 0.0)}[bench.law]
    soft, linear = soft / bench.stiffness, linear / bench.stiffness
    knee = knee * (1.0 + bench.shape)
    soft *= (1.0 + bench.shape) * math.exp(20.0 / knee - 20.0 / (knee / (1.0 + bench.shape))) if not power else 1.0
    p = np.zeros(truth.COUNT)
    p[:] = (bench.cap, bench.mu2, bench.wrap0, bench.kappa, bench.bend, bench.load, bench.viscous, bench.ratio,
            bench.speed, bench.delta, bench.delta_f, bench.drift, bench.lead, bench.sheath, soft, knee, linear, power,
            bench.before, bench.over, bench.creep, bench.creep_t, bench.warp)
    widths, weights = {"wide": ((0.4, 1.0, 2.2), (0.3, 0.4, 0.3)), "narrow": ((0.8, 1.0, 1.3), (0.3, 0.4, 0.3)),
                       "long": ((0.3, 1.2, 4.0), (0.4, 0.4, 0.2))}[bench.stops]
    slopes = np.ones(truth.CABLE) / truth.CABLE
    if bench.slopes == "two bends":
        slopes = np.array([0.3, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.2])
    return p, np.array(widths), np.array(weights), slopes


def preloaded(bench: Bench) -> float:
    """Stretch of the chain at 20 N without friction: where homing puts the encoder's zero."""
    p, *_ = chain(bench)
    return float(truth.stretch(20.0, p)) + 20.0 * (bench.lead + bench.sheath)


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


def trial(bench: Bench, seed: int, peak: float = 40.0, period: float = 1.3, cycles: int = 10,
          slack_m: float = 2.0e-3) -> dict[str, np.ndarray]:
    """Run one gait trial at 1 kHz; return the canonical columns."""
    rng = np.random.default_rng(seed)
    dt = 1e-3
    time = np.arange(round(cycles * period / dt)) * dt
    percent = 100.0 * time / period
    theta_ref, force_ref = knee_motion(percent), desired(percent, peak)
    theta_drive = second_order(np.roll(theta_ref, 2), dt, 20.0)
    leg = held(theta_drive, bench.backlash) if bench.backlash > 0.0 else theta_drive
    target = master(theta_ref, force_ref, slack_m)
    x, force_limit = rope(target, dt, bench)
    p, widths, weights, slopes = chain(bench)
    base = preloaded(bench) - (9.7e-3 + 0.3e-3 * 20.0 - 0.0017e-3 * 400.0) + bench.zero
    w = K2 * (leg - THETA_13) + bench.arm2 * (leg - THETA_13) ** 2
    drum = x + bench.ecc * np.sin(x / 0.020 + bench.ecc_phase) + base - bench.slack
    speed = np.gradient(x, dt)
    scaled = p.copy()
    end, start = truth.run(drum, w, leg, speed, time, scaled, time[-1], widths, weights, slopes)
    if bench.temperature != 0.0:
        start = start + bench.temperature * force_ref**2 / peak * np.sin(2.0 * np.pi * 3.0 * percent / 100.0)
    if bench.thump != 0.0:
        q = np.mod(percent, 100.0)
        start = start + bench.thump * np.exp(-(((q - 15.0) / 1.2) ** 2)) * np.sin((q - 15.0) * 1.3)
    if bench.resonance != 0.0:
        end = end + bench.resonance * rung(end, dt)
    columns = sensors(bench, rng, time, leg, end, start)
    force = drive_force(bench, rng, time, x, start)
    columns |= {
        "time_s": time, "gait_percent": np.mod(percent, 100.0), "cycle": np.floor(percent / 100.0 + 1e-9),
        "servo_target_m": target, "servo_position_m": np.round(x + rng.normal(0.0, 1e-6, x.size), 6),
        "servo_force_n": np.round(force, 1), "knee_target_rad": theta_ref,
        "knee_angle_rad": np.round(theta_drive * 57295.78) / 57295.78, "desired_force_n": force_ref}
    columns["servo_velocity_m_s"] = np.gradient(columns["servo_position_m"], dt)
    del force_limit
    return columns


def master(theta: np.ndarray, force: np.ndarray, slack_m: float) -> np.ndarray:
    """Feed-forward by the nominal calibration: (10) and (11), a slack rope while no force is wanted."""
    stretch = 9.7e-3 + 0.3e-3 * force - 0.0017e-3 * force**2
    idle = np.where(force > 0.0, 0.0, slack_m)
    kernel = np.hanning(81) / np.hanning(81).sum()
    idle = np.convolve(np.pad(idle, 40, mode="wrap"), kernel, "valid")
    return stretch + K2 * (theta - THETA_13) - idle


def rope(target: np.ndarray, dt: float, bench: Bench) -> tuple[np.ndarray, float]:
    """The drum's motion: target two cycles late, the position loop, limits of speed."""
    x = second_order(np.concatenate([target[:1], target[:1], target[:-2]]), dt, bench.drive_hz)
    if bench.speed_limit < 1e8:
        step = bench.speed_limit * dt
        out = np.empty_like(x)
        y = x[0]
        for k, value in enumerate(x.tolist()):
            y += min(max(value - y, -step), step)
            out[k] = y
        x = out
    return x, bench.force_limit


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
    if bench.late_start_ms:
        said["tension_start_n"] = repeated(said["tension_start_n"], bench.late_start_ms)
    if bench.lost_share > 0.0:
        gone = np.flatnonzero(rng.random(time.size) < bench.lost_share)
        for k in gone[gone > 0]:
            said["tension_end_n"][k] = said["tension_end_n"][k - 1]
    return said


def repeated(signal: np.ndarray, every: int) -> np.ndarray:
    """A PDO that comes only each `every` ms: the values between are the last one's."""
    return signal[(np.arange(signal.size) // every) * every]


def drive_force(bench: Bench, rng: np.random.Generator, time: np.ndarray, x: np.ndarray, start: np.ndarray
                ) -> np.ndarray:
    """The servo's force, N: tension, friction by direction and speed, inertia, ripple."""
    v = np.gradient(x, time)
    a = np.gradient(v, time)
    s = np.tanh(v / 1.5e-3)
    coulomb = bench.drive_coulomb * s * (1.0 + bench.drive_asymmetry * s)
    return (start + coulomb + bench.drive_viscous * v + bench.drive_inertia * a + bench.drive_offset
            + rng.normal(0.0, 0.3, x.size))


def like(bench: Bench, seed: int, tolerance: float = 1.0) -> Bench:
    """A like bench: the manufacturing tolerances of healthy benches, 1σ times `tolerance`."""
    rng = np.random.default_rng(seed)
    r = tolerance * rng.normal(size=9)
    r = np.clip(r, -2.5, 2.5)
    return dataclasses.replace(
        bench, cap=bench.cap * (1.0 + 0.03 * r[0]), mu2=bench.mu2 * (1.0 + 0.05 * r[1]),
        stiffness=bench.stiffness * (1.0 + 0.03 * r[2]), zero=bench.zero + 2e-4 * r[3],
        start_gain=bench.start_gain * (1.0 + 0.003 * r[4]), end_gain=bench.end_gain * (1.0 + 0.003 * r[5]),
        start_offset=bench.start_offset + 0.1 * r[6], end_offset=bench.end_offset + 0.1 * r[7],
        delta=bench.delta * (1.0 + 0.1 * r[8]), drive_hz=bench.drive_hz * (1.0 + 0.02 * r[8]))
