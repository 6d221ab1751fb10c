"""A walk of recorded strides: played in random order, varied, and joined without a step in angle or speed.

A walk is drawn once, by its seed, into the knee angle of every control cycle.  The end of a stride and the beginning
of the next are cross-faded over `BLEND` of the mean period about their seam, by the quintic 10u³ − 15u⁴ + 6u⁵; a
stride is continued beyond its ends by its tangent, which fades within `BLEND`.  Angle and speed have no step.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from parameters import InputError
from physics.laws import Array

WALK, STUMBLE, STOP, SIT = "walk", "stumble", "stop", "sit"
BLEND: Final = 0.1
"""Length of a join between two strides, in parts of the mean period: half before and half after the seam."""
STILL_S, STAND_S, SEAT_S = 2.0, 0.3, 1.0
"""Time that a wearer stands or sits, s, and the time in which they come to rest, or sit down, and start again, s."""
STANDING_RAD, SITTING_RAD = math.radians(-5.0), math.radians(-80.0)
"""Knee angle of a wearer who stands, and who sits, rad."""
TRIPPED_S, TRIPPED_RAD = 0.3, math.radians(-15.0)
"""A stumble: time for which the stride does not go on, s, and by how much the knee flexes meanwhile, rad: the elevating
strategy, Schillings, van Wezel, Mulder & Duysens (2000), J. Neurophysiol. 83, 2093."""
EARLY, LATE = 0.05, 0.95
"""Range of phases in which a stumble begins."""
APART: Final = 3
"""Least number of strides between two interruptions, and before the first one."""


class Stride(NamedTuple):
    """A recorded stride: angle, rad, at rising percents of the gait; duration, s, NaN if it was not recorded."""

    percent: Array
    angle_rad: Array
    period_s: float


class Variation(NamedTuple):
    """Drawn variation of a walk of `strides`: period and amplitude each even within ± their share; interruptions."""

    strides: int
    seed: int
    period: float
    amplitude: float
    stumbles: int = 0
    stops: int = 0
    sits: int = 0


class PlayedStride(NamedTuple):
    """A stride, or a rest, of a walk: its kind, its first sample and its length in samples."""

    kind: str
    begin: int
    samples: int


@dataclass(frozen=True)
class StrideWalk:
    """Knee angle, rad, and true phase, % (NaN while a wearer stumbles or rests), by sample from −`before` on.

    `played` lists strides and rests in their order; sample 0 is the beginning of the first one.
    """

    before: int
    knee_rad: Array
    percent: Array
    number: Array
    played: tuple[PlayedStride, ...]

    @property
    def samples(self) -> int:
        """Return the number of samples of all strides and rests."""
        return self.played[-1].begin + self.played[-1].samples

    def at(self, sample: int) -> tuple[float, float, float]:
        """Return knee angle, rad, true phase, %, and the stride's number at a sample; the last one beyond the end."""
        i = min(sample + self.before, len(self.knee_rad) - 1)
        return float(self.knee_rad[i]), float(self.percent[i]), float(self.number[i])


class _Part(NamedTuple):
    """A part of a walk: its angle by sample from its begin, its length, and half of its blend at either end."""

    kind: str
    samples: int
    angle: Callable[[Array], Array]
    phase: Callable[[Array], Array]
    half: int


def mean(strides: Sequence[Stride]) -> tuple[Array, Array]:
    """Return percents 0 … 99 and the mean angle of strides there, rad: what a wearer's template is."""
    percent = np.arange(100.0)
    return percent, np.mean([curve(stride)(percent / 100.0) for stride in strides], axis=0)


def walk(strides: Sequence[Stride], variation: Variation, lap: Array, period_s: float, first: int, rest: int,
         laps: int = 2) -> StrideWalk:
    """Draw a walk; `lap`: the mean stride's knee angle by sample of `period_s`, closed, as the controller expects it.

    The knee is led through the mean stride from its sample `first` − `laps` laps up to sample 0, and for `rest` samples
    after the walk.  Raises `InputError` for more interruptions than the strides have room for.
    """
    random = np.random.Generator(np.random.Philox(variation.seed))
    parts = _parts(strides, variation, lap.size, period_s, random)
    before = laps * lap.size - first
    lead = _Part(WALK, before, lambda t: lap[(t.astype(np.int64) + first) % lap.size],
                 lambda t: ((t + first) / lap.size) % 1.0, _half(lap.size))
    out = _Part(WALK, rest, lambda t: lap[t.astype(np.int64) % lap.size], lambda t: t / lap.size, _half(lap.size))
    return _joined(before, [lead, *parts, out])


def _half(samples: int) -> int:
    return max(1, round(0.5 * BLEND * samples))


def _parts(strides: Sequence[Stride], variation: Variation, samples: int, period_s: float, random: np.random.Generator
           ) -> list[_Part]:
    kinds = [STUMBLE] * variation.stumbles + [STOP] * variation.stops + [SIT] * variation.sits
    room = variation.strides // (APART + 1)
    if len(kinds) > room:
        raise InputError(f"{len(kinds)} stumbles and rests in {variation.strides} strides; at most one in {APART + 1}, "
                         f"so {room}: ask for more strides, or fewer interruptions.")
    # an interruption is in every one of evenly spaced places or in none: which, is drawn
    places = (np.sort(random.permutation(room)[:len(kinds)]) + 1) * (APART + 1) - 1
    at = dict(zip(places.tolist(), random.permutation(kinds).tolist(), strict=True)) if kinds else {}
    parts = []
    for i in range(variation.strides):
        chosen = strides[int(random.integers(len(strides)))]
        share, size = (1.0 + each * random.uniform(-1.0, 1.0) for each in (variation.period, variation.amplitude))
        begins = random.uniform(EARLY, LATE)
        nominal = samples if math.isnan(chosen.period_s) else chosen.period_s / period_s
        length = max(20, round(share * nominal))
        kind = at.get(i, WALK)
        parts.append(_stride(chosen, length, size, samples, round(TRIPPED_S / period_s), begins)
                     if kind == STUMBLE else _stride(chosen, length, size, samples))
        if kind in (STOP, SIT):
            parts.append(_resting(kind, period_s))
    return parts


def _stride(stride: Stride, length: int, size: float, samples: int, tripped: int = 0, begins: float = 1.0) -> _Part:
    """Return a stride of `length` samples whose amplitude about its mean is scaled by `size`.

    A stumble of `tripped` samples, 0 for none, begins at the phase `begins`.
    """
    angle_at, at = curve(stride, size), begins * length
    if not tripped:
        return _Part(WALK, length, lambda t: angle_at(t / length), lambda t: t / length, _half(samples))

    def angle(t: Array) -> Array:
        u = np.clip((t - at) / tripped, 0.0, 1.0)
        # the stride leaves and is joined again at full speed, and gains nothing between
        halted = at + tripped * (u * (1.0 - u) * (1.0 - 2.0 * u))
        progress = np.where(t < at, t, np.where(t < at + tripped, halted, t - tripped))
        return angle_at(progress / length) + TRIPPED_RAD * np.sin(np.pi * u) ** 2

    def phase(t: Array) -> Array:
        inside = (t >= at) & (t < at + tripped)
        return np.where(inside, np.nan, np.where(t < at, t, t - tripped) / length)

    return _Part(STUMBLE, length + tripped, angle, phase, _half(samples))


def _resting(kind: str, period_s: float) -> _Part:
    still = STANDING_RAD if kind == STOP else SITTING_RAD
    half = round(0.5 * (STAND_S if kind == STOP else SEAT_S) / period_s)
    return _Part(kind, round(STILL_S / period_s), lambda t: np.full(t.size, still),
                 lambda t: np.full(t.size, np.nan), half)


def curve(stride: Stride, size: float = 1.0) -> Callable[[Array], Array]:
    """Return the angle, rad, of a stride by its phase 0 … 1, continued by a tangent that fades."""
    from scipy.interpolate import CubicSpline

    middle = float(np.mean(stride.angle_rad))
    spline = CubicSpline(stride.percent / 100.0, middle + size * (stride.angle_rad - middle))
    low, high = stride.percent[0] / 100.0, stride.percent[-1] / 100.0

    def angle(u: Array) -> Array:
        inside = np.clip(u, low, high)
        beyond = BLEND * np.tanh((u - inside) / BLEND)
        return np.asarray(spline(inside) + beyond * spline(inside, 1), dtype=np.float64)

    return angle


def _joined(before: int, parts: Sequence[_Part]) -> StrideWalk:
    """Return the walk of parts one after the other, cross-faded about their seams."""
    begins = np.cumsum([0, *(part.samples for part in parts)])
    knee, percent, number = (np.full(begins[-1], np.nan) for _ in range(3))
    for i, (part, begin) in enumerate(zip(parts, begins[:-1], strict=True)):
        t = np.arange(part.samples, dtype=np.float64)
        knee[begin:begin + part.samples] = part.angle(t)
        percent[begin:begin + part.samples] = 100.0 * part.phase(t)
        number[begin:begin + part.samples] = i - 1.0 if 0 < i < len(parts) - 1 else -1.0
    for older, newer, seam in zip(parts[:-1], parts[1:], begins[1:-1], strict=True):
        half = min(max(older.half, newer.half), older.samples // 2, newer.samples // 2)
        t = np.arange(-half, half, dtype=np.float64)
        u = (t + half) / (2.0 * half)
        share = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
        knee[seam - half:seam + half] = (
            (1.0 - share) * older.angle(t + older.samples) + share * newer.angle(t))
    played = tuple(PlayedStride(part.kind, int(begin) - before, part.samples)
                   for part, begin in zip(parts[1:-1], begins[1:-2], strict=True))
    return StrideWalk(before, knee, percent, number, played)
