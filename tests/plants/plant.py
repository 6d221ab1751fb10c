"""A bench of the family behind the nodes: the plant protocol of docs/plants.md.

The rule of this file: it holds the arrays and cuts time into whole steps; every law is elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import ModuleType

import numpy as np

from physics.plant import Outputs
from tests.plants import mechanics, path_dahl, path_fronts, path_lugre, path_maxwell
from tests.plants.bench import END, GAMMA, START, Bench

METHODS: dict[str, ModuleType] = {
    "maxwell": path_maxwell, "lugre": path_lugre, "dahl": path_dahl, "fronts": path_fronts}
UPRIGHT = 0.0
"""Knee angle at power-on, rad."""


class FamilyPlant:
    """One bench of the family; times in ns, torques in N·m, see `physics.plant.Plant`."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._method = METHODS[bench.structure.implementation]
        self._k, self._p = mechanics.parameters(bench), self._method.parameters(bench)
        self._zero = self._k[mechanics.K_ZERO]
        self._m, self._z = np.zeros(mechanics.STATES), self._method.state(bench)
        self.reset(0)

    def reset(self, time_ns: int) -> Outputs:
        """At rest, upright, the rope loose by `start_slack`."""
        b, m = self.bench, self._m
        self._now_ns = self._done_ns = time_ns
        self._start_ns = time_ns
        m[:] = 0.0
        m[[mechanics.Q, mechanics.LEG, mechanics.OLD_LEG]] = UPRIGHT
        anchored = float(mechanics.anchor.py_func(self._k, UPRIGHT))
        m[mechanics.X] = anchored + b.zero + b.slack - b.start_slack
        self._method.settle(self._z, self._p, float(mechanics.paid.py_func(self._k, m[mechanics.X])), anchored)
        m[[mechanics.FELT_END, mechanics.FELT_LATE]] = b.end_mass * 9.81 * math.cos(UPRIGHT)
        return self._felt()

    def advance(self, until_ns: int, servo_torque_nm: float, knee_torque_nm: float) -> Outputs:
        """Run to the last whole step of 50 µs not after `until_ns` under held torques."""
        if until_ns < self._now_ns:
            raise ValueError(f"the plant is at {self._now_ns} ns and cannot go back to {until_ns} ns")
        if not math.isfinite(servo_torque_nm + knee_torque_nm):
            raise ValueError(f"torque demands {servo_torque_nm} and {knee_torque_nm} N·m are not finite numbers")
        self._now_ns = until_ns
        count = (until_ns - self._done_ns) // mechanics.STEP_NS
        if count:
            self._done_ns += count * mechanics.STEP_NS
            self._k[mechanics.K_ZERO] = self._zero + self.bench.zero_rate * (until_ns - self._start_ns) * 1e-9
            self._method.drive(count, self._m, self._k, self._z, self._p, servo_torque_nm, knee_torque_nm)
        return self._felt()

    def _felt(self) -> Outputs:
        b = self.bench
        m = self._m.tolist()
        share = (self._done_ns - self._start_ns) * 1e-9 / b.drift_s
        return Outputs(
            m[mechanics.X], m[mechanics.V], m[mechanics.Q], m[mechanics.W], m[mechanics.LEG],
            b.start_gain * m[mechanics.FELT_START] + b.start_offset + b.start_drift * share,
            b.end_gain * m[mechanics.FELT_END] + b.end_offset + b.end_drift * share)

    def truth(self) -> Mapping[str, float]:
        """The true tensions and what else no device feels."""
        z, m = self._z, self._m
        return {
            "true_end_n": float(z[END]), "true_start_n": float(z[START]),
            "true_knee_angle_rad": float(m[mechanics.LEG]), "true_creep_m": float(z[GAMMA]),
        }

    def prepare(self) -> None:
        """Compile, or load the compiled step, before time matters."""
        self.advance(self._now_ns + mechanics.STEP_NS, 0.0, 0.0)
        self.reset(0)


__all__ = ["METHODS", "FamilyPlant"]
