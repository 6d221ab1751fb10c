"""Simulated Bowden cable–fabric rig with rate-and-state friction: rigs by seed, effects, motions and readings.

The force path is in `rate_state_path`.  Its structure shares nothing with the package's models, and a recording needs
no file.  SI units: m, N, s, rad; the rope's pull is positive, knee flexion is negative.
Rule of this file: numpy only, and nothing of the package is imported.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.hidden.rate_state_path import (
    KELVIN_S,
    STEP_S,
    Array,
    Bench,
    Motion,
    elastic_stretch,
    kelvin_shares,
    knee_path,
    march,
)

Columns = dict[str, NDArray[Any]]

KNEE_HARMONICS: Final = ((18.9, -1.73), (16.7, 2.62), (5.3, 1.54), (0.5, 0.0))
"""Amplitude, degrees, and phase, rad, of knee flexion in level walking: four harmonics of the stride.

Fitted to typical flexion: 18° in the loading response, 5° in late stance, 61° in swing.
"""


class Size(NamedTuple):
    """Range of an effect's size in SI units, or relative to the value of `field` of `Bench` if `scales`.

    `signed`: the sign is drawn, too.
    """

    field: str
    smallest: float
    largest: float
    signed: bool = False
    scales: bool = False


SIZES: Final[Mapping[str, Size]] = {
    "mu1": Size("cable_friction", 0.22, 0.45, True, True), "mu2": Size("fabric_friction", 0.35, 0.6, True, True),
    "stiff": Size("stiffness", 0.15, 0.28, True, True), "presl": Size("cable_shear", 2.0, 5.0, scales=True),
    "strib": Size("stribeck", 0.5, 1.2), "vis": Size("viscous", 6.0, 20.0),
    "blash": Size("knee_backlash", math.radians(0.7), math.radians(2.0)), "creep": Size("creep", 1.5e-5, 4e-5),
    "gain_e": Size("gain_end", 0.035, 0.08, True, True), "gain_s": Size("gain_start", 0.035, 0.08, True, True),
    "drift_e": Size("end_drift", 1.0, 3.0, True), "delay": Size("end_delay_s", 0.006, 0.02),
    "lpf": Size("end_filter_s", 0.006, 0.02), "mass": Size("end_mass", 0.05, 0.15),
    "ecc": Size("ovality", 2.5e-4, 5e-4), "k3": Size("moment_arm", 0.985e-3, 2.298e-3, True),
    "kphi": Size("wrap_gain", 0.4, 0.7, True, True), "kbend": Size("bend_gain", 0.2, 0.4, True),
    "fdrift": Size("friction_drift", 0.3, 0.6, True), "kml": Size("load_exponent", 0.2, 0.4, True),
    "X_slip": Size("slip", 0.8e-3, 2e-3, True), "X_vib": Size("vibration", 0.6, 1.5),
    "X_pulse": Size("pulse", 2.0, 5.0, True), "X_gainstep": Size("gain_step", 0.05, 0.12, True)}
"""Sizes of the effects, by their names in `truths.EFFECTS` and `truths.OUTSIDE`."""
NULL_ALT: Final = (("cable_shear", 0.7, 1.4), ("fabric_shear", 0.7, 1.4), ("critical_slip", 0.7, 1.4),
                   ("sheath_lag_n", 0.7, 1.4), ("creep_first", 0.8, 1.2))
"""Constants that `null_alt` changes, with the smallest and largest factor."""


def draw_bench(random: np.random.Generator) -> Bench:
    """Return the constants of a rig, drawn widely."""
    def uniform(field: dataclasses.Field[Any]) -> float:
        low, high = field.metadata["range"]
        if field.metadata["log"]:
            return math.exp(random.uniform(math.log(low), math.log(high)))
        return float(random.uniform(low, high))

    def shares(values: Array) -> tuple[float, ...]:
        return tuple((values / values.sum()).tolist())

    segments, contacts = int(random.choice([8, 10, 12])), int(random.choice([2, 3, 4]))
    at = (np.arange(segments) + 0.5) / segments
    bends = np.full(segments, random.uniform(0.15, 0.5))  # an even curvature with bends at hip, thigh and knee
    for low, high in ((0.05, 0.3), (0.35, 0.6), (0.7, 0.97)):
        centre, width, height = random.uniform((low, 0.06, 0.3), (high, 0.16, 2.0))
        bends += height * np.exp(-(((at - centre) / width) ** 2))
    return Bench(
        rate_hz=int(random.choice([500, 1000])), bends=shares(bends),
        lengths=shares(random.uniform(0.7, 1.3, segments)),
        contacts=shares(random.dirichlet(np.full(contacts, 6.0))),
        strips=shares(0.6 * random.dirichlet(np.full(contacts + 1, 4.0)) + 0.4 / (contacts + 1)),
        **{field.name: uniform(field) for field in dataclasses.fields(Bench) if field.metadata})


def draw_session(bench: Bench, random: np.random.Generator) -> Bench:
    """Return `bench` with the scatter of one session: friction, stiffness, servo zero, and errors of the load cells."""
    n = random.standard_normal(8)
    return replace(
        bench, cable_friction=bench.cable_friction * (1.0 + 0.03 * n[0]), stiffness=1.0 + 0.03 * n[2],
        fabric_friction=bench.fabric_friction * (1.0 + 0.05 * n[1]), servo_zero=bench.servo_zero + 2e-4 * n[3],
        gain_end=1.0 + 0.003 * n[4], gain_start=1.0 + 0.003 * n[5], offset_end=0.1 * n[6], offset_start=0.1 * n[7])


def altered(bench: Bench, hidden: Sequence[str], random: np.random.Generator) -> Bench:
    """Return `bench` with the hidden effects at drawn sizes; raise KeyError at an unknown effect.

    `null` changes nothing; `null_alt` changes the constants of `NULL_ALT`, which are no effect of the catalogue.
    """
    for name in hidden:
        changes: dict[str, Any] = {}
        if name == "null_alt":
            changes = {field: getattr(bench, field) * random.uniform(low, high) for field, low, high in NULL_ALT}
        elif name != "null":
            effect, sign, place = SIZES[name], random.choice([-1.0, 1.0]), float(random.uniform())
            size = float(random.uniform(effect.smallest, effect.largest)) * (float(sign) if effect.signed else 1.0)
            value = getattr(bench, effect.field)
            changes = {effect.field: value * (1.0 + size) if effect.scales else value + size}
            if name.startswith("X_"):
                changes |= {"place": place, "vibration_phase": float(random.uniform(0.0, 2.0 * math.pi))}
            changes |= {"strib": {"stribeck_speed": 0.004 + 0.011 * place}, "creep": {"creep_s": 0.3 * 10.0**place},
                        "ecc": {"ovality_phase": 2.0 * math.pi * place}}.get(name, {})
        bench = replace(bench, **changes)
    return bench


def draw_motion(bench: Bench, random: np.random.Generator, cycles: int) -> Motion:
    """Return the motion of one trial: harmonic knee flexion, and the rope that a feed-forward of the bench imposes."""
    period = random.uniform(1.0, 2.2)
    samples = np.round(1000.0 * period * (1.0 + 0.05 * random.standard_normal(cycles))).astype(np.int64)
    cycle = np.repeat(np.arange(cycles), samples)
    stride = np.concatenate([np.arange(n) / n for n in samples])
    knee = _draw_knee(random, stride, cycle)
    onset, top, end = random.uniform((0.05, 0.17, 0.28), (0.11, 0.22, 0.4))
    rise = np.interp(stride, [0.0, onset, top, end, 1.0], [0.0, 0.0, 0.5, 1.0, 1.0])  # its fall is slower
    peaks = random.uniform(30.0, 55.0, cycles)[cycle]
    desired = np.maximum(4.0, _smooth(5.5 + (peaks - 5.5) * np.sin(np.pi * rise) ** 2, 25.0))
    wander = _smooth(random.standard_normal(stride.size + 1000), 6.0)[500:-500]  # its ends keep the white noise
    elastic = np.array([elastic_stretch(bench, force) for force in desired.tolist()])
    crept = sum((full * _lag(elastic, s) for full, s in zip(kelvin_shares(bench), KELVIN_S, strict=True)), elastic)
    mean = desired * math.exp(0.4 * bench.cable_friction * bench.cable_bend + 0.4 * bench.fabric_friction)
    rope = crept + bench.sheath * mean + knee_path(bench, knee) + 1.2e-4 * wander / wander.std()
    return Motion(knee, rope, desired, cycle)


def _draw_knee(random: np.random.Generator, stride: Array, cycle: NDArray[np.int64]) -> Array:
    """Return knee angles, rad, at places in the stride, 0 to 1: their range of 50° to 70° varies by 2 %."""
    nominal = np.array(KNEE_HARMONICS)
    amplitudes = nominal[:, 0] * (1.0 + 0.1 * random.standard_normal(len(nominal)))
    phases = nominal[:, 1] + 0.1 * random.standard_normal(len(nominal))

    def shape(place: Array) -> Array:
        orders = 2.0 * np.pi * np.arange(1, len(nominal) + 1)
        return np.asarray(np.cos(np.outer(place, orders) - phases) @ amplitudes)

    whole = shape(np.arange(400) / 400.0)
    least, flexion = np.radians(random.uniform((0.0, 50.0), (8.0, 70.0)))
    sizes = 1.0 + 0.02 * random.standard_normal(cycle[-1] + 2)
    size = np.interp(cycle + stride, np.arange(sizes.size), sizes) * flexion / np.ptp(whole)
    return -_smooth(least + size * (shape(stride) - whole.min()), 10.0)


def simulate(bench: Bench, motion: Motion) -> Columns:
    """Return the columns of one recording at `rate_hz`, with errors of the load cells but without noise."""
    time = np.asarray(STEP_S * np.arange(motion.knee.size), np.float64)
    start, end = march(bench, motion)
    end = _end_reading(bench, motion, time, start, end)
    columns: Columns = {
        "time_s": time, "servo_position_m": motion.rope + bench.servo_zero, "knee_angle_rad": motion.knee,
        "tension_start_n": bench.gain_start * start + bench.offset_start,
        "tension_end_n": bench.gain_end * end + bench.offset_end, "desired_force_n": motion.desired,
        "cycle": motion.cycle}
    return {name: values[::round(1.0 / STEP_S / bench.rate_hz)] for name, values in columns.items()}


def measured(columns: Columns, bench: Bench, noise_n: float, random: np.random.Generator) -> Columns:
    """Return columns with quantisation, and with noise of the load cells: white of `noise_n` rms, and 1/f."""
    steps = {"servo_position_m": 2e-6, "knee_angle_rad": math.radians(0.01), "tension_start_n": 0.01,
             "tension_end_n": 0.01}
    noisy = dict(columns)
    for name in ("tension_start_n", "tension_end_n"):
        samples = columns[name].size
        white, spectrum = random.standard_normal(samples), random.standard_normal((2, samples // 2 + 1))
        frequency = np.maximum(np.fft.rfftfreq(samples, 1.0 / bench.rate_hz), 0.1)  # Hz; flat below
        pink = np.fft.irfft((spectrum[0] + 1j * spectrum[1]) / np.sqrt(frequency), samples)
        pink -= pink.mean()
        noisy[name] = columns[name] + noise_n * (white + bench.pink_share * pink / pink.std())
    return noisy | {name: step * np.round(noisy[name] / step) for name, step in steps.items()}


def _end_reading(bench: Bench, motion: Motion, time: Array, start: Array, end: Array) -> Array:
    """Return END, N, with lag and cross-talk of its load cell, and with the effects of sensor and shank."""
    share, span = bench.place, time[-1]
    end = _lag(end + bench.cross_talk * 0.5 * (start + end), bench.end_lag_s)
    end = end + bench.end_drift * (1.0 - np.exp(-1.2 * time / span)) / (1.0 - math.exp(-1.2))
    end = np.interp(time - bench.end_delay_s, time, end)
    end = _lag(_lag(end, 0.85 * bench.end_filter_s), 0.15 * bench.end_filter_s)
    speed = np.gradient(_smooth(motion.knee, 15.0), STEP_S)
    gravity = 9.81 * np.cos(motion.knee + bench.shank_tilt)
    end = end + bench.end_mass * (gravity + 0.3 * np.gradient(speed, STEP_S) + 0.05 * speed**2)
    wave = 2.0 * np.pi * (7.0 + 13.0 * share) * time + bench.vibration_phase + 0.4 * np.sin(2.0 * np.pi * 0.7 * time)
    end = end + bench.vibration * np.sin(wave)
    for stride in range(int(motion.cycle[-1]) + 1 if bench.pulse else 0):
        inside = time[motion.cycle == stride]
        at = inside[int((0.05 + 0.85 * share) * inside.size)]
        end = end + bench.pulse * np.exp(-(((time - at) / 0.02) ** 2))
    return np.asarray(end * np.where(time > (0.3 + 0.4 * share) * span, 1.0 + bench.gain_step, 1.0))


def _smooth(signal: Array, cutoff_hz: float) -> Array:
    """Return a 1 kHz signal through a zero-phase fourth-order low-pass; both ends are continued by odd reflection."""
    pad = min(signal.size - 1, 1500)
    long = np.pad(signal, pad, mode="reflect", reflect_type="odd")
    trend = np.linspace(long[0], long[-1], long.size)
    gain = 1.0 / (1.0 + (np.fft.rfftfreq(long.size, STEP_S) / cutoff_hz) ** 4)
    return np.asarray((np.fft.irfft(gain * np.fft.rfft(long - trend), long.size) + trend)[pad:-pad])


def _lag(signal: Array, time_constant_s: float) -> Array:
    """Return a 1 kHz signal behind a first-order lag, started at rest."""
    if time_constant_s <= 1e-9:
        return signal
    share, state, out = 1.0 - math.exp(-STEP_S / time_constant_s), float(signal[0]), []
    for value in signal.tolist():
        state += share * (value - state)
        out.append(state)
    return np.array(out)
