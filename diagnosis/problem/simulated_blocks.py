"""Many-segment simulation as a further block of a fit: START and END, N, under the motion of a trial.

The simulation is slow compared with the prediction equations. It is therefore fitted last, from their result.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis import simulation
from diagnosis.data.table import Table
from diagnosis.problem.blocks import REMEMBERED, Block, cycles_of, signals_of
from diagnosis.problem.deviations import deviating
from diagnosis.problem.fit import Problem, solve
from diagnosis.problem.healthy_reference import BAND
from diagnosis.problem.prior import Free
from physics.plant import imposed
from physics.relations.measured import Signals
from physics.relations.recorded_reads import Memory
from physics.relations.relation import Relation

Array = NDArray[np.float64]
Values = Mapping[str, float]

NAME: Final = "simulation"
LOOKED_AT_HZ: Final = 100.0
MOVED: Final = (
    "mu1", "mu2", "fabric_wrap", "load_slope", "viscous", "stribeck_ratio", "presliding", "fabric_presliding_ratio",
    "stiffness_scale", "stiffness_shape", "cable_share", "rope_zero", "rope_per_knee", "timestamp_skew", "end_delay")
"""Parameters fitted by the simulation: those that it needs more accurately than the equations determine them."""
NEAR: Final = 2.0
"""1σ of a constant in the simulation, as a multiple of its posterior 1σ from the equations."""
STEPS: Final = 6


def _none(signals: Signals, values: Values) -> Array:
    raise NotImplementedError("a simulated block predicts both tensions itself")


@dataclass(frozen=True)
class SimulatedBlock(Block):
    """Both tensions of one trial, one after the other, against the simulation of the bench."""

    table: Table
    at: NDArray[np.intp]
    _runs: Memory = field(default_factory=lambda: Memory(REMEMBERED), repr=False, kw_only=True)

    def _residual(self, values: Values) -> Array:
        moved = self._runs.recall("motion", (values["knee_backlash"],),
                                  lambda: simulation.motion(self.table, values["knee_backlash"]))
        plant = simulation.plant_of(values, simulation.length_s(self.table))
        true = self._runs.recall("tensions", (plant, *moved), lambda: imposed.simulate(plant, moved))
        told = simulation.read(self.table["time_s"], true, values)
        return np.concatenate([
            (self.table[n] - getattr(told, n))[self.at] for n in simulation.SIGNALS if n in self.table])


def can(given: Table) -> bool:
    """Whether a trial has the columns to be simulated and compared."""
    return "servo_position_m" in given and "knee_angle_rad" in given and any(n in given for n in simulation.SIGNALS)


def block(given: Table, first: int = 0, seconds: float | None = None) -> SimulatedBlock:
    """Return the block of one trial (of its first `seconds`), its cycles numbered from `first`."""
    if seconds is not None:
        last = int(np.searchsorted(given["time_s"], given["time_s"][0] + seconds))
        given = dataclasses.replace(given, columns={n: v[:last] for n, v in given.columns.items()})
    signals = signals_of(given, 1e9)
    step = float(np.median(np.diff(given["time_s"])))
    known = np.flatnonzero(simulation.counted(given) & np.all([
        np.isfinite(given[n]) for n in simulation.SIGNALS if n in given], axis=0))
    at = known[:: max(1, round(1.0 / (step * LOOKED_AT_HZ)))]
    ends = sum(n in given for n in simulation.SIGNALS)
    cycle = np.tile(cycles_of(signals)[at] + first, ends)
    relation = Relation(NAME, "N", "tension_start_n", ("servo_position_m", "knee_angle_rad"), _none)
    return SimulatedBlock(relation, signals, np.tile(at, ends), cycle, frozenset(simulation.slots()), table=given,
                          at=at)


def fitted(trials: Sequence[Table], values: Values, sigma: Mapping[str, float], own: Sequence[Free],
           seconds: float | None = None) -> dict[str, float]:
    """Return `values` adjusted so that the simulation fits the trials, each with deviations in the parameters `own`.

    `sigma`: posterior 1σ of each parameter from the prediction equations.
    """
    blocks: list[Block] = [block(t, 0, seconds) for t in trials if can(t)]
    if not blocks:
        return dict(values)
    free = [Free(n, values[n] - 4.0 * NEAR * sigma[n], values[n] + 4.0 * NEAR * sigma[n], values[n], NEAR * sigma[n],
                 NEAR * sigma[n]) for n in MOVED if sigma.get(n, 0.0) > 0.0]
    free = [dataclasses.replace(f, low=max(f.low, 0.05 * f.mean)) if f.mean > 0.0 and f.name not in
            ("rope_zero", "timestamp_skew", "end_delay") else f for f in free]
    start = dict(values)
    if len(trials) > 1:
        mine = [f for f in own if f.name in ("rope_zero", "start_offset", "end_offset")]
        blocks = [deviating(b, i, mine) for i, b in enumerate(blocks)]
        free += [Free(f"{f.name}@{i}", -BAND * f.sigma, BAND * f.sigma, 0.0, f.sigma, f.scale)
                 for i in range(len(blocks)) for f in mine]
        start |= {f"{f.name}@{i}": 0.0 for i in range(len(blocks)) for f in mine}
    level = 0.3 * 10.0**0.5
    found = solve(Problem(blocks, {NAME: level}), start, free, STEPS).values
    return {n: found[n] for n in values}
