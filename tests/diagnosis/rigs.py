"""Rigs of other kinds, as a lab records them: a drive axis, a series-elastic actuator, a motor's run-up, a seal.

The rule of this file: mechanics integrated in steps of 0.1 ms, sensed and written at the lab's rate with the lab's
noise, filters and grids; no code is shared with `physics`.  Forces in N at the axis, or in N·m about it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter, decimate, lfilter

Array = NDArray[np.float64]
Columns = dict[str, Array]

STEP_S: Final = 1e-4


@dataclass(frozen=True)
class Friction:
    """Bristle friction (LuGre): steady F(v) = g(v)·sgn v + b·(v + β·|v|), g = c·(1 + α·sgn v)·(1 + r·e^(−(v/vs)²)).

    `bristle`: travel over which it turns over, m or rad.
    """

    coulomb: float
    viscous: float = 0.0
    asymmetry: float = 0.0
    viscous_asymmetry: float = 0.0
    rest: float = 0.0
    rest_speed: float = 1.0
    bristle: float = 1e-5

    def row(self) -> Array:
        return np.array([self.coulomb, self.viscous, self.asymmetry, self.viscous_asymmetry, self.rest,
                         self.rest_speed, self.bristle])


@njit(cache=True)
def _rubbed(z: float, v: float, f: Array) -> tuple[float, float]:
    """Return (bristle state −1…1 after one step, friction): the state turns over with travel, exactly."""
    end = 1.0 if v > 0.0 else -1.0
    z = end - (end - z) * math.exp(-abs(v) * STEP_S / f[6])
    level = f[0] * (1.0 + f[2] * end) * (1.0 + f[4] * math.exp(-((v / f[5]) ** 2)))
    return z, level * z + f[1] * (v + f[3] * abs(v))


@njit(cache=True)
def _driven(target: Array, mass: float, f: Array, offset: float, weight: Array, gains: Array, every: int
            ) -> tuple[Array, Array]:
    """Return (position, drive's force) of an axis that follows `target` under a PD loop sampled `every` steps.

    `weight`: greatest torque of a mass on the axis, and its angle from below at position 0.
    """
    position, force = np.empty(target.size), np.empty(target.size)
    x, v, z, drive = target[0], 0.0, 0.0, 0.0
    for k in range(target.size):
        if k % every == 0:
            ahead = (target[min(k + every, target.size - 1)] - target[k]) / (every * STEP_S)
            drive = gains[0] * (target[k] - x) + gains[1] * (ahead - v)
        z, rub = _rubbed(z, v, f)
        v += STEP_S / mass * (drive - rub - offset - weight[0] * math.sin(x + weight[1]))
        x += STEP_S * v
        position[k], force[k] = x, drive
    return position, force


@njit(cache=True)
def _pushed(drive: Array, mass: float, f: Array) -> Array:
    """Return the position of an axis under a given force; it stays where friction holds it."""
    position = np.empty(drive.size)
    x, v, z = 0.0, 0.0, 0.0
    for k in range(drive.size):
        z, rub = _rubbed(z, v, f)
        v += STEP_S / mass * (drive[k] - rub)
        x += STEP_S * v
        position[k] = x
    return position


def sensed(fine: Array, rate_hz: float, rng: np.random.Generator, noise: float = 0.0, grid: float = 0.0,
           cutoff_hz: float = math.inf) -> Array:
    """Return a signal as it is recorded: behind its amplifier's low-pass, every so often, with noise, on a grid."""
    if math.isfinite(cutoff_hz):
        b, a = butter(2, 2.0 * cutoff_hz * STEP_S)
        fine = fine[0] + lfilter(b, a, fine - fine[0])
    kept = fine[:: round(1.0 / (STEP_S * rate_hz))]
    kept = kept + noise * rng.standard_normal(kept.size)
    return np.round(kept / grid) * grid if grid else kept


def strokes(length: float, speeds: list[float], acceleration: float, rest_s: float = 0.2) -> Array:
    """Return the fine positions of strokes to `length` and back at each speed, with ramps and rests between."""
    parts = [np.zeros(round(rest_s / STEP_S))]
    for speed in speeds:
        top = min(speed, math.sqrt(length * acceleration))
        ramp = np.arange(0.0, top, acceleration * STEP_S)
        cruise = np.full(max(0, round((length - top**2 / acceleration) / top / STEP_S)), top)
        there = np.cumsum(np.concatenate([ramp, cruise, ramp[::-1]])) * STEP_S
        there = there * (length / there[-1])
        parts += [there, np.full(round(rest_s / STEP_S), length), length - there, np.zeros(round(rest_s / STEP_S))]
    return np.concatenate(parts)


def _timed(columns: Columns, rate_hz: float) -> Columns:
    count = min(len(values) for values in columns.values())
    return {"time_s": np.arange(count) / rate_hz, **{n: v[:count] for n, v in columns.items()}}


def drive_axis(seed: int, load_kg: float = 0.0, rate_hz: float = 1000.0) -> Columns:
    """A linear axis with a ball screw: mass 60 kg, rubs and drags more one way, a constant force; ~1 minute.

    Force by the drive's current (noise 0.8 N, 100 Hz), encoder of 1 µm.
    """
    rng = np.random.default_rng(seed)
    speeds = list(rng.permutation([0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.12]))
    target = strokes(0.22 + 0.02 * rng.random(), speeds, 2.5)
    rub = Friction(18.0, 180.0, 0.05, 0.15, bristle=2e-5)
    position, force = _driven(target, 60.0 + load_kg, rub.row(), -3.0, np.zeros(2), np.array([6e4, 4e3]), 10)
    return _timed({"servo_position_m": sensed(position, rate_hz, rng, grid=1e-6),
                   "servo_force_n": sensed(force, rate_hz, rng, 0.8, 0.01, min(100.0, 0.4 * rate_hz))}, rate_hz)


def pendulum(seed: int, mass_kg: float = 0.5, rate_hz: float = 200.0) -> Columns:
    """A motor swings a mass at 0.15 m, level at position 0.2 rad: rad and N·m, 20 s of three sines drawn by the seed.

    Torque by the current (noise 4 mN·m, 40 Hz), encoder of 0.1 mrad; armature 2e-3 kg·m².
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 20.0, STEP_S)
    target = sum(a * np.sin(6.2832 * f * (1.0 + 0.1 * rng.random()) * time + 6.28 * rng.random())
                 for a, f in ((0.7, 0.3), (0.3, 0.8), (0.1, 1.7)))
    rub = Friction(0.05, 0.02, bristle=2e-3)
    weight = np.array([mass_kg * 9.81 * 0.15, 0.5 * math.pi - 0.2])
    angle, torque = _driven(np.asarray(target), mass_kg * 0.15**2 + 2e-3, rub.row(), 0.0, weight,
                            np.array([40.0, 1.0]), 10)
    return _timed({"servo_position_rad": sensed(angle, rate_hz, rng, grid=1e-4),
                   "servo_torque_nm": sensed(torque, rate_hz, rng, 4e-3, 1e-4, 40.0)}, rate_hz)


def two_link_arm(seed: int, tip_kg: float = 0.0, elbow_coulomb: float = 0.25, rate_hz: float = 200.0) -> Columns:
    """A shoulder and an elbow move two links in a vertical plane at the same time: rad and N·m, 30 s of sines.

    Upper arm 2 kg of 0.35 m, forearm 1.2 kg of 0.3 m, a mass at the tip; the elbow's angle is against the upper arm.
    Torques by the currents (noise 20 mN·m, 40 Hz), encoders of 0.1 mrad.  The motion is imposed.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 30.0, STEP_S)
    first, second = (np.asarray(sum(
        a * np.sin(6.2832 * f * (1.0 + 0.1 * rng.random()) * time + 6.28 * rng.random()) for a, f in sines))
        for sines in (((0.6, 0.23), (0.25, 0.71), (0.05, 1.6)), ((0.7, 0.31), (0.3, 0.83), (0.06, 1.9))))
    upper, lower = 0.35, 0.3
    centre = (1.2 * 0.5 * lower + tip_kg * lower) / (1.2 + tip_kg)
    own = 1.2 * (lower**2 / 12.0 + (0.5 * lower - centre) ** 2) + tip_kg * (lower - centre) ** 2
    heavy = 1.2 + tip_kg
    w1, w2 = (np.gradient(q, STEP_S) for q in (first, second))
    a1, a2 = np.gradient(w1, STEP_S), np.gradient(w2, STEP_S)
    bend = heavy * upper * centre
    far = own + heavy * centre**2
    near = 2.0 * upper**2 / 3.0 + heavy * upper**2
    weight2 = heavy * 9.81 * centre * np.sin(first + second)
    weight1 = (2.0 * 0.5 + heavy) * 9.81 * upper * np.sin(first) + weight2
    torque1 = ((near + far + 2.0 * bend * np.cos(second)) * a1 + (far + bend * np.cos(second)) * a2
               - bend * np.sin(second) * (2.0 * w1 * w2 + w2**2) + weight1 + 0.02 * a1)
    torque2 = (far + bend * np.cos(second)) * a1 + far * a2 + bend * np.sin(second) * w1**2 + weight2 + 0.01 * a2
    torque1 += dragged(first, w1, Friction(0.5, 0.15, bristle=3e-3).row())
    torque2 += dragged(second, w2, Friction(elbow_coulomb, 0.08, bristle=3e-3).row())
    return _timed({
        "shoulder.servo_position_rad": sensed(first, rate_hz, rng, grid=1e-4),
        "elbow.servo_position_rad": sensed(second, rate_hz, rng, grid=1e-4),
        "shoulder.servo_torque_nm": sensed(torque1, rate_hz, rng, 0.02, 1e-3, 40.0),
        "elbow.servo_torque_nm": sensed(torque2, rate_hz, rng, 0.02, 1e-3, 40.0)}, rate_hz)


def seal(seed: int, coulomb: float = 12.0, viscous: float = 150.0, rest: float = 0.8, rate_hz: float = 200.0
         ) -> Columns:
    """A rod dragged through a seal at 1 … 60 mm/s: force by a load cell (0.08 N, 50 Hz), position by a scale of 0.5 µm.

    Each day the stage's zero and the cell's are others, and the friction by two per cent.
    """
    rng = np.random.default_rng(seed)
    speeds = list(rng.permutation([0.002, 0.004, 0.008, 0.015, 0.03, 0.05, 0.06, 0.02, 0.006]))
    day = 1.0 + 0.02 * rng.standard_normal()
    rub = Friction(day * coulomb, viscous, 0.0, 0.0, rest, 0.006, 1.5e-4)
    target = strokes(0.03, speeds, 0.4, 0.3)
    speed = np.gradient(target, STEP_S)
    force = dragged(target, speed, rub.row()) + 0.1 * rng.standard_normal()
    return _timed({
        "servo_position_m": sensed(target + 0.02 + 2e-3 * rng.random(), rate_hz, rng, 3e-7, 5e-7),
        "servo_force_n": sensed(force, rate_hz, rng, 0.08, 0.005, 50.0)}, rate_hz)


@njit(cache=True)
def dragged(position: Array, speed: Array, f: Array) -> Array:
    """Return the friction of a rod whose motion is imposed."""
    force, z = np.empty(position.size), 0.0
    for k in range(position.size):
        z, force[k] = _rubbed(z, speed[k], f)
    return force


def run_up(seed: int, inertia: float = 3.2e-4, rate_hz: float = 100.0) -> Columns:
    """A motor started from rest again and again at currents that differ little: rad and N·m, turning one way.

    Torque by the current (noise 4 mN·m), encoder of 4096 lines.
    """
    rng = np.random.default_rng(seed)
    rub = Friction(0.02, 4e-4, bristle=0.02).row()
    on, off = round(2.5 / STEP_S), round(2.5 / STEP_S)
    torque = np.concatenate([np.repeat([level, 0.0], [on, off]) for level in 0.10 + 0.02 * rng.random(12)])
    angle = _pushed(torque, inertia, rub)
    return _timed({
        "servo_position_rad": sensed(angle, rate_hz, rng, grid=2.0 * math.pi / 4096),
        "servo_torque_nm": sensed(torque, rate_hz, rng, 4e-3, 1e-4, 40.0)}, rate_hz)


@njit(cache=True)
def _sheathed(drum: Array, wrap: float, travel: float, drag: float, spring: float, damper: float, relaxed_s: float,
              lead: float) -> Array:
    """Return (START, END), N, of a cable in a sheath: exact capstan, START = END·e^(±μθ), with pre-sliding.

    END pulls a viscoelastic load (spring and damper beside a spring that relaxes); the cable stretches by `lead`, m/N,
    before the sheath.  The end's position is found by bisection of the balance of forces.
    """
    out = np.empty((2, drum.size))
    end, state, relaxed = drum[0], 0.0, drum[0]
    for k in range(drum.size):
        low, high = end - 2e-4, end + 2e-4
        start = pull = turned = 0.0
        for _ in range(40):
            there = 0.5 * (low + high)
            moved = there - end
            way = 1.0 if moved > 0.0 else -1.0
            turned = way - (way - state) * math.exp(-abs(moved) / travel)
            pull = spring * there + damper * moved / STEP_S + 0.3 * spring * (there - relaxed)
            start = pull * math.exp(wrap * turned) + drag * moved / STEP_S
            if start > (drum[k] - there) / lead:
                high = there
            else:
                low = there
        state, end = turned, there
        relaxed += STEP_S / relaxed_s * (end - relaxed)
        out[0, k], out[1, k] = start, pull
    return out


def cable(seed: int, wrap: float = 0.35, start_gain: float = 1.0, travel: float = 2e-4, drag: float = 30.0,
          session: float = 0.01, rate_hz: float = 200.0) -> Columns:
    """A plain Bowden cable with a load cell at each end, 20 s of sines: no knee, no drive force.

    Load cells of 0.15 N noise, 50 Hz; each session has its own friction (`session`, relative) and zeros (0.1 N).
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 20.0, STEP_S)
    drum = 0.03 + np.asarray(sum(a * np.sin(6.2832 * f * (1.0 + 0.1 * rng.random()) * time + 6.28 * rng.random())
                                 for a, f in ((0.008, 0.23), (0.004, 0.71), (0.002, 1.3))))
    day = 1.0 + session * rng.standard_normal()
    start, end = _sheathed(drum, wrap * day, travel, drag, 1200.0, 25.0, 0.8, 3e-5)
    zeros = 0.1 * rng.standard_normal(2)
    return _timed({"servo_position_m": sensed(drum, rate_hz, rng, grid=2e-6),
                   "tension_start_n": start_gain * sensed(start + zeros[0], rate_hz, rng, 0.15, 0.01, 50.0),
                   "tension_end_n": sensed(end + zeros[1], rate_hz, rng, 0.15, 0.01, 50.0)}, rate_hz)


def motor(seed: int, coulomb: float = 0.5, viscous: float = 0.02, inertia: float = 0.0205, session: float = 0.02,
          rate_hz: float = 200.0) -> Columns:
    """A motor at twelve steady speeds, either way, with ramps between: rad and N·m, 41 s, an exact law.

    Torque noise 0.03 N·m, encoder of 4096 counts; friction differs between sessions by `session`, relative.
    """
    rng = np.random.default_rng(seed)
    levels = [0.0]
    for speed in rng.permutation([1.0, 2.0, 4.0, 6.0, 9.0, 12.0]):
        levels += [speed, -speed]
    target = np.repeat([*levels, 0.0], round(41.0 / 14.0 / STEP_S))
    ramp = np.hanning(round(0.5 / STEP_S))
    speed = np.convolve(target, ramp / ramp.sum(), "same")
    angle = np.cumsum(speed) * STEP_S
    day = 1.0 + session * rng.standard_normal(2)
    torque = inertia * np.gradient(speed, STEP_S) + dragged(angle, speed, Friction(
        day[0] * coulomb, day[1] * viscous, bristle=1e-3).row())
    return _timed({"servo_position_rad": sensed(angle, rate_hz, rng, grid=2.0 * math.pi / 4096),
                   "servo_torque_nm": sensed(torque, rate_hz, rng, 0.03, 1e-4)}, rate_hz)


def lossy(columns: Columns, share: float, seed: int = 0, burst: int = 12) -> Columns:
    """Return a trial that has lost a share of its rows, in gaps of `burst` rows, as a log of a bus does."""
    rng, count = np.random.default_rng(seed), columns["time_s"].size
    kept = np.ones(count, bool)
    for first in rng.integers(burst, count - 2 * burst, round(share * count / burst)):
        kept[first:first + burst] = False
    return {name: values[kept] for name, values in columns.items()}


@njit(cache=True)
def _sprung(target: Array, motor: Array, spring: Array, load: Array, f: Array, rub: Array) -> Array:
    """Return (motor position, drive's force, spring's force, load angle): motor – spring – lever with a pendulum.

    `motor`: mass, position gain, speed gain; `spring`: N/m, N/m³, damping; `load`: lever m, inertia, weight N·m,
    damping; `f`: torque from outside.
    """
    out = np.empty((4, target.size))
    x, v, z, angle, rate, drive = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(target.size):
        if k % 10 == 0:
            drive = motor[1] * (target[k] - x) - motor[2] * v
        stretch, quick = x - load[0] * angle, v - load[0] * rate
        pull = spring[0] * stretch + spring[1] * stretch**3 + spring[2] * quick
        z, loss = _rubbed(z, v, rub)
        v += STEP_S / motor[0] * (drive - loss - pull)
        x += STEP_S * v
        if load[1] > 0.0:
            rate += STEP_S / load[1] * (load[0] * pull - load[2] * math.sin(angle) - load[3] * rate + f[k])
            angle += STEP_S * rate
        out[0, k], out[1, k], out[2, k], out[3, k] = x, drive, pull, angle
    return out


def series_elastic(seed: int, stiffness: float = 9e3, locked: bool = False, lever_m: float = 0.08,
                   rate_hz: float = 500.0) -> Columns:
    """A series-elastic actuator: motor (4 kg at the spring), spring, pendulum on a lever, pushed from outside.

    Force of the spring by a load cell (0.3 N), of the motor by its current (0.5 N); encoders of 5 µm and 0.1 mrad.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 40.0, STEP_S)
    phase = 6.28 * rng.random(4)
    target = sum(a * (np.sin(6.2832 * f * time + p) - math.sin(p)) for a, f, p in zip(
        (0.012, 0.008, 0.004), (0.25, 0.7, 1.9), phase, strict=False))
    outside = 3.0 * np.sin(6.2832 * 0.4 * time + phase[3])
    load = np.array([lever_m, 0.0 if locked else 0.05, 2.0, 0.3])
    told = _sprung(np.asarray(target), np.array([4.0, 4e4, 900.0]), np.array([stiffness, 0.0, 15.0]), load, outside,
                   Friction(6.0, 40.0, bristle=3e-5).row())
    return _timed({
        "servo_position_m": sensed(told[0], rate_hz, rng, grid=5e-6),
        "servo_force_n": sensed(told[1], rate_hz, rng, 0.5, 0.02, 100.0),
        "tension_start_n": sensed(told[2], rate_hz, rng, 0.3, 0.01, 100.0),
        "knee_angle_rad": sensed(told[3], rate_hz, rng, grid=1e-4)}, rate_hz)


def decimated(columns: Columns, factor: int) -> Columns:
    """Return a trial at a lower rate, every signal behind the same low-pass without phase."""
    return {n: v[::factor] if n == "time_s" else decimate(v, factor, zero_phase=True)[: len(v[::factor])]
            for n, v in columns.items()}


def write(path: Path, columns: Columns, names: tuple[str, ...] = ()) -> Path:
    """Write a trial as CSV, of the columns `names` (none: all)."""
    kept = [n for n in columns if not names or n in ("time_s", *names)]
    rows = np.column_stack([columns[n] for n in kept])
    np.savetxt(path, rows, "%.9g", ",", header=",".join(kept), comments="")
    return path
