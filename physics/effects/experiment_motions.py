"""Motions of an experiment as data: motion of a bench's rope and knee, and the expected observation.

A motion starts from the last targets and is led at a stated speed. `master.motion.scripted_experiments` runs motions
on a bench; `diagnosis.evidence.experiment_prediction` simulates the observation from the waypoints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

SLACK_N: Final = 1.0
"""START tension, N, below which the rope counts as slack."""


@dataclass(frozen=True)
class Pull:
    """Wind the rope until START is above `start_n`."""

    start_n: float
    speed_m_s: float = 0.06


@dataclass(frozen=True)
class Release:
    """Pay the rope out until START is below `start_n`, then `beyond_m` more."""

    start_n: float = SLACK_N
    speed_m_s: float = 0.06
    beyond_m: float = 0.0


@dataclass(frozen=True)
class Wind:
    """Wind a length of rope at constant speed, at any tension; a negative length is unwound."""

    length_m: float
    speed_m_s: float


@dataclass(frozen=True)
class Hold:
    """Hold both axes."""

    seconds: float


@dataclass(frozen=True)
class Dither:
    """Hold the rope with a sine of `amplitude_m` on it, in whole sines."""

    amplitude_m: float
    frequency_hz: float
    seconds: float


@dataclass(frozen=True)
class Knee:
    """Slacken the rope, then bring the knee to an angle, the rope led along; it stays locked there."""

    angle_rad: float


@dataclass(frozen=True)
class Swing:
    """Swing the knee once about where it is, a sine; the rope follows, or is held."""

    amplitude_rad: float
    seconds: float
    rope_follows: bool = False


Motion = Pull | Release | Wind | Hold | Dither | Knee | Swing


class ScriptPart(NamedTuple):
    """Motions that are done first, then `laps` times the same ones; each lap is numbered like a gait cycle."""

    first: Sequence[Motion]
    lap: Sequence[Motion]
    laps: int


class ScriptedWalk(NamedTuple):
    """The gait after a rest, s; `cycles` None: the number in the configuration."""

    rest_s: float = 0.0
    cycles: int | None = None


class Waypoint(NamedTuple):
    """Point of a quasi-static motion: time since the last one, s, END tension, N, and knee angle, degrees, there."""

    seconds: float
    end_n: float
    knee_deg: float


def laps(seconds: float, tensions: Sequence[float], knee_deg: float, count: int = 2) -> list[Waypoint]:
    """Return `count` rounds through tensions at a locked knee, each reached in `seconds`."""
    return [Waypoint(seconds, tension, knee_deg) for _ in range(count) for tension in tensions]


def gaits(count: int) -> list[Waypoint]:
    """Return gait cycles of 2 s and 40 N."""
    return [Waypoint(*point) for _ in range(count) for point in (
        (0.5, 5.0, -5.0), (0.3, 40.0, -15.0), (0.4, 6.0, -40.0), (0.4, 5.0, -60.0), (0.4, 5.0, -10.0))]
