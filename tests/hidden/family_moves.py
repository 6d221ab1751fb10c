"""The separating experiments on a bench of the family: the moves of `moves`, a path of `tests.plants` that follows.

The rule of this file: what drifts does so over the experiment; what is recorded is what a trial records, but for what
only a gait has.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property

import numpy as np

from tests.hidden.moves import ANGLE, DT, PEAK_N, PERIOD_S, Rig
from tests.plants import imposed, mechanics
from tests.plants.bench import END, MIDDLE, START, Bench, replaced
from tests.plants.plant import METHODS

OF_A_GAIT = ("gait_percent", "desired_force_n")


def run(name: str, bench: Bench, seed: int, rate_hz: int) -> dict[str, np.ndarray]:
    """Run an experiment; return the project's columns at a rate, `cycle` the lap and −1 outside of laps.

    `seed`: of the trial's noise, as in `imposed.trial`.
    """
    if bench.friction_drift:
        steady = _FamilyRig(replaced(bench, friction_drift=0.0))
        steady.run(name)
        bench = replaced(bench, drift_s=len(steady.rows) * DT)
    rig = _FamilyRig(bench)
    rig.run(name)
    x, knee, target, theta, number, start, middle, end, leg = np.array(rig.rows).T
    nothing = np.zeros(x.size)
    motion = imposed.Motion(np.arange(x.size) * DT, target, x, theta, knee, nothing, nothing, number)
    noisy = replaced(bench, noise=imposed.sized(seed)[0])
    said = imposed.recorded(noisy, motion, imposed.Forces(start, middle, end, leg), np.random.default_rng((seed, 2)),
                            rate_hz)
    return {column: values for column, values in said.items() if column not in OF_A_GAIT}


class _FamilyRig(Rig):
    """The path of a bench of the family, the leg behind its gear."""

    def __init__(self, bench: Bench) -> None:
        self.k = mechanics.parameters(bench)
        anchored = float(mechanics.anchor(self.k, ANGLE))
        super().__init__(bench.moment_arm, anchored + float(self.k[mechanics.K_ZERO]), bench.loop_hz)
        self.bench, self.method, self.leg = bench, METHODS[bench.structure.implementation], ANGLE
        self.p, self.z = self.method.parameters(bench), self.method.state(bench)
        self.method.settle(self.z, self.p, float(mechanics.paid(self.k, self.x)), anchored)

    def led(self, target: float, theta: float) -> None:
        load = self.bench.moment_arm * self.z[MIDDLE] - self.bench.leg_weight * math.sin(self.leg)
        self.leg = mechanics.follow(self.k, self.leg, self.knee, load, DT)
        self.method.step(self.z, self.p, mechanics.paid(self.k, self.x), mechanics.anchor(self.k, self.leg), self.leg,
                         DT)
        self.start = float(self.z[START])
        self.rows.append((self.x, self.knee, target, theta, float(self.number), self.start, float(self.z[MIDDLE]),
                          float(self.z[END]), self.leg))

    @cached_property
    def _motion(self) -> imposed.Motion:
        """One cycle by the bench's own inverse."""
        return imposed.gait(self.bench, PEAK_N, PERIOD_S, 1)

    def gait(self) -> Iterator[tuple[float, float]]:
        yield from zip(self._motion.target.tolist(), self._motion.knee_target.tolist(), strict=True)
