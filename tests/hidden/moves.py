"""The separating experiments on a hidden bench: what the catalogue says in words, done with code of this room.

The rule of this file: an experiment is a table of moves; the rope is led until the tension is there, step by step, and
each lap is numbered.  What needs hands on the bench is not here.  A rig says how its chain follows.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

import numpy as np

from tests.hidden import truth
from tests.hidden.bench import K2, THETA_13, Bench, chain, zero
from tests.hidden.readings import columns, encoder
from tests.hidden.walk import desired, knee_motion, master

DT = 1e-3
SPAN_S = 20.0
"""Time over which what drifts does so."""
SLACK_M = 4e-3
ANGLE = math.radians(-10.0)
"""The knee's angle where an experiment starts."""
KNEE_HZ = 20.0
PEAK_N, PERIOD_S = 40.0, 1.3
Move = tuple[str, *tuple[float, ...]]
Part = tuple[tuple[Move, ...], tuple[Move, ...], int]


def _locked(degrees: float, low: float, high: float, laps: int) -> Part:
    return (("knee", degrees), ("pull", low, 60.0)), (("pull", high, 60.0), ("release", low, 60.0)), laps


EXPERIMENTS: dict[str, tuple[Part, ...]] = {
    "locked_angles": tuple(_locked(angle, 10.0, 50.0, 4) for angle in (-10.0, -30.0, -60.0)),
    "two_peaks": (_locked(-30.0, 5.0, 20.0, 5), ((), (("pull", 60.0, 60.0), ("release", 5.0, 60.0)), 5)),
    "two_speeds": (((("knee", -30.0),), (("pull", 40.0, 10.0), ("release", 5.0, 10.0)), 4),
                   ((), (("pull", 40.0, 80.0), ("release", 5.0, 80.0)), 8)),
    "dither": (((("knee", -30.0), ("pull", 30.0, 60.0), ("hold", 0.5)),
                (("dither", 0.1, 40.0, 1.0), ("wind", -1.0, 10.0), ("wind", 1.0, 10.0)), 5),
               ((), (("hold", 1.0), ("wind", -1.0, 10.0), ("wind", 1.0, 10.0)), 5)),
    "amplitude_sweep": tuple(
        ((("knee", -30.0), ("pull", 30.0, 60.0), ("hold", 0.5)) if mm == 0.1 else (),
         (("wind", -mm, 2.0), ("wind", mm, 2.0)), 3) for mm in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)),
    "rest_repeat": (((), (("walk",),), 10), ((("hold", 60.0),), (("walk",),), 10)),
    "hold_return": (((("knee", -30.0),),
                     (("pull", 40.0, 60.0), ("hold", 20.0), ("release", 5.0, 60.0), ("hold", 20.0)), 3),),
    "unload": (((("knee", -30.0),), (("release", 1.0, 30.0), ("wind", -10.0, 30.0), ("pull", 20.0, 30.0)), 6),),
    "locked_motor": tuple(
        ((("knee", -30.0), ("pull", 20.0, 60.0), ("hold", 0.5)) if deg == 1.0 else (), (("swing", deg, 2.0, 0.0),), 3)
        for deg in (1.0, 2.0, 5.0)),
    "full_turns": (((("knee", -10.0),), (("wind", -157.0, 100.0), ("wind", 157.0, 100.0)), 2),
                   *(_locked(angle, 5.0, 20.0, 3) for angle in (-10.0, -30.0, -60.0))),
    "slack_swing": (((("knee", -37.5),), (("swing", 32.5, 3.0, 1.0),), 5),),
    "step": (((("knee", -30.0), ("pull", 30.0, 60.0), ("hold", 0.5)),
              (("wind", -1.0, 1e3), ("hold", 0.4), ("wind", 1.0, 1e3), ("hold", 0.4)), 8),),
    "three_speeds": tuple(
        ((("knee", -60.0), ("wind", -10.0, 30.0)) if speed == 10.0 else (),
         (("wind", -30.0, speed), ("wind", 30.0, speed)), 3) for speed in (10.0, 30.0, 100.0)),
}
"""By the catalogue's name: first, lap, how often.  N, mm, mm/s, s, degrees."""


def run(name: str, bench: Bench, seed: int) -> dict[str, np.ndarray]:
    """Run an experiment at 1 kHz; return the canonical columns, `cycle` the lap and −1 outside of laps."""
    rig = _TruthRig(bench)
    rig.run(name)
    x, knee, leg, end, start, target, theta, number = np.array(rig.rows).T
    time = np.arange(x.size) * DT
    return columns(bench, np.random.default_rng(seed), time, x, leg, end, start) | {
        "cycle": number, "servo_target_m": target, "knee_target_rad": theta, "knee_angle_rad": encoder(knee)}


class Rig(ABC):
    """Two drives as second-order loops, their targets two cycles late; what is between them follows in `led`.

    `per_knee`: rope per knee angle, m/rad; `taut`: position of the taut rope at `ANGLE`, m.
    """

    def __init__(self, per_knee: float, taut: float, drive_hz: float) -> None:
        self.per_knee, self.drive_hz = per_knee, drive_hz
        self.number, self.rows = -1, list[tuple[float, ...]]()
        self.x, self.v, self.knee, self.w = taut - SLACK_M, 0.0, ANGLE, 0.0
        self.targets = [(self.x, ANGLE)] * 3
        self.start = 0.0

    @abstractmethod
    def led(self, target: float, theta: float) -> None:
        """Let the chain follow rope and knee by one cycle of 1 ms, set `start`, N, and add to `rows`."""

    @abstractmethod
    def gait(self) -> Iterator[tuple[float, float]]:
        """Yield the targets of rope, m, and knee, rad, of one gait cycle at 1 kHz."""

    def run(self, name: str) -> None:
        """Run an experiment."""
        lap = 0
        for first, moves, laps in EXPERIMENTS[name]:
            for number in (-1, *range(lap, lap + laps)):
                for move in first if number < 0 else moves:
                    self.number = number
                    self.do(*move)
            lap += laps

    def go(self, target: float, theta: float) -> None:
        """One cycle of 1 ms."""
        self.targets = [*self.targets[1:], (target, theta)]
        x_wanted, knee_wanted = self.targets[0]
        self.x, self.v = _loop(self.x, self.v, x_wanted, self.drive_hz)
        self.knee, self.w = _loop(self.knee, self.w, knee_wanted, KNEE_HZ)
        self.led(target, theta)

    def do(self, kind: str, *numbers: float) -> None:
        """One move, from the last targets on."""
        motions: dict[str, Callable[..., None]] = {
            "knee": self._knee, "pull": self._pull, "release": self._release, "wind": self._wind, "hold": self._hold,
            "swing": self._swing, "dither": self._dither, "walk": self._walk}
        motions[kind](*numbers)

    def _pull(self, newton: float, speed: float) -> None:
        while self.start <= newton:
            self._on(speed * 1e-3 * DT)

    def _release(self, newton: float, speed: float) -> None:
        while self.start >= newton:
            self._on(-speed * 1e-3 * DT)

    def _on(self, length: float, angle: float = 0.0) -> None:
        target, theta = self.targets[-1]
        self.go(target + length, theta + angle)

    def _wind(self, mm: float, speed: float) -> None:
        steps = math.ceil(abs(mm) / speed / DT)
        for _ in range(steps):
            self._on(mm * 1e-3 / steps)

    def _hold(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self._on(0.0)

    def _knee(self, degrees: float) -> None:
        self._release(1.0, 60.0) if self.start >= 1.0 else None
        self._wind(-1e3 * SLACK_M, 60.0)
        way = math.radians(degrees) - self.targets[-1][1]
        steps = max(1, math.ceil(abs(way) / 0.6 / DT))
        for _ in range(steps):
            self._on(self.per_knee * way / steps, way / steps)

    def _swing(self, degrees: float, seconds: float, led: float) -> None:
        target, theta = self.targets[-1]
        for k in range(1, round(seconds / DT) + 1):
            angle = math.radians(degrees) * math.sin(2.0 * math.pi * k * DT / seconds)
            self.go(target + led * self.per_knee * angle, theta + angle)

    def _dither(self, mm: float, hz: float, seconds: float) -> None:
        target, theta = self.targets[-1]
        for k in range(1, round(seconds / DT) + 1):
            self.go(target + mm * 1e-3 * math.sin(2.0 * math.pi * hz * k * DT), theta)

    def _walk(self) -> None:
        for target, angle in self.gait():
            self.go(target, angle)


class _TruthRig(Rig):
    """The chain of `truth`."""

    def __init__(self, bench: Bench) -> None:
        taut = K2 * (ANGLE - THETA_13)
        super().__init__(K2, taut, bench.drive_hz)
        self.bench, self.leg = bench, ANGLE
        self.p, self.widths, self.weights, self.slopes = chain(bench)
        nodes, stops = truth.NODES, truth.STOPS
        self.old, self.new = np.full(nodes, taut), np.zeros(nodes)
        self.z, self.z_new = np.zeros((nodes, stops)), np.zeros((nodes, stops))
        self.end = self.creep = 0.0

    def led(self, target: float, theta: float) -> None:
        b, half = self.bench, 0.5 * self.bench.backlash
        self.leg = min(max(self.leg, self.knee - half), self.knee + half)
        drum = self.x + b.ecc * math.sin(self.x / 0.020 + b.ecc_phase) + zero(b)
        taken = K2 * (self.leg - THETA_13) + b.arm2 * (self.leg - THETA_13) ** 2
        self.end, self.start, self.creep = truth.advance(
            drum, taken, self.leg, self.v, len(self.rows) * DT, DT, self.p, SPAN_S, self.creep, self.end, self.old,
            self.new, self.z, self.z_new, self.widths, self.weights, self.slopes)
        self.rows.append((self.x, self.knee, self.leg, self.end, self.start, target, theta, float(self.number)))

    def gait(self) -> Iterator[tuple[float, float]]:
        percent = 100.0 * np.arange(round(PERIOD_S / DT)) * DT / PERIOD_S
        theta = knee_motion(percent)
        yield from zip(master(theta, desired(percent, PEAK_N), 2e-3).tolist(), theta.tolist(), strict=True)


def _loop(at: float, speed: float, wanted: float, hz: float) -> tuple[float, float]:
    """One millisecond of a second-order loop of damping 0.9."""
    w = 2.0 * math.pi * hz
    speed += DT * (w * w * (wanted - at) - 1.8 * w * speed)
    return at + DT * speed, speed
