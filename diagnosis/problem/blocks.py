"""Blocks of a fit: each prediction equation that the columns allow, on each trial, with its samples and cycles.

An equation that lacks a column is not checked, and is reported as not checked. Each sample belongs to one complete
cycle of one trial. A cycle is never split between fitting and validation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, median_filter
from scipy.signal import butter, sosfiltfilt

from diagnosis.data.table import Table
from diagnosis.problem.zero_phase import thinning
from physics.laws import Array
from physics.parameters import PARAMETERS
from physics.relations import relation as models
from physics.relations.measured import Fine, Signals
from physics.relations.recorded_reads import Memory
from physics.relations.relation import RELATIONS, Relation

Values = Mapping[str, float]

SAMPLE_BUDGET: Final = 10_000
"""Largest number of samples of one equation over all trials in a fit; more are thinned behind a low-pass."""
RATE_RANGE_HZ: Final = (50.0, 125.0)
TAUT_N: Final = 5.0
"""END tension, N, above which rope motion, knee angle and stretch are coupled; below, the rope may be slack."""
REMEMBERED: Final = 4
ROPE_PER_KNEE: Final = PARAMETERS["rope_per_knee"].nominal
FINE_HZ: Final = 100.0
"""Cut-off, Hz, of the rope's motion that the drive's friction is computed from."""
RATE_HZ: Final = 25.0
"""Cut-off, Hz, of END's rate of change. The drives move no faster, and the noise of a rate grows with its cut-off."""
FEWEST_TURNS: Final = 2
"""Cycles of a signal below which the rope's speed counts the cycles instead."""
SETTLE_S: Final = 0.1
"""Time, s, excluded at both ends of a trial: friction's memory is unknown at the start, derivatives are one-sided at
the end."""
JERKED: Final = 0.5
"""Change of the acceleration between samples, as a share of its RMS, above which the sampling rate does not resolve
it."""

SPIKE_SAMPLES: Final = 5
SPIKE_SIGMA: Final = 6.0
SPIKE_SHARE: Final = 0.5
"""Definition of a spike of a motor's force, by its distance from the median of `SPIKE_SAMPLES` samples. The distance
exceeds `SPIKE_SIGMA` robust deviations of all distances and `SPIKE_SHARE` of the force's RMS."""


@dataclass(frozen=True)
class Block:
    """One prediction equation on one trial: its signals, and the samples on which it is compared.

    `keep`: indices of the compared samples; `cycle`: cycle number of each, unique over all trials; `uses`: names of the
    parameters that the equation reads.
    """

    relation: Relation
    signals: Signals
    keep: NDArray[np.intp]
    cycle: NDArray[np.intp]
    uses: frozenset[str]
    _last: Memory = field(default_factory=lambda: Memory(REMEMBERED), repr=False, kw_only=True)

    def residual(self, values: Values) -> Array:
        """Return measured less predicted output, in the equation's unit, on the samples `keep`."""
        if self._read is None:
            return self._residual(values)
        return self._last.recall(self.relation.name, self._read(values), lambda: self._residual(values))

    def like(self, name: str, values: Values) -> str | None:
        """Return another parameter by which the residual has the same slope at `values`; None if no parameter has."""
        del name, values
        return None

    @cached_property
    def _read(self) -> Callable[[Values], tuple[float, ...]] | None:
        """Return a getter of the values that move this block; None if an effect brings a submodel of others."""
        if models.brings_own(self.relation):
            return None
        names = sorted(self.uses)
        return itemgetter(*names) if len(names) > 1 else lambda values: tuple(values[n] for n in names)

    def _residual(self, values: Values) -> Array:
        return (self.signals[self.relation.output] - models.predict(self.relation, self.signals, values))[self.keep]


def working_rate(tables: Sequence[Table]) -> float:
    """Return the sampling rate, Hz, of all trials in a fit: the highest one that keeps the sample budget."""
    seconds = sum(float(t["time_s"][-1] - t["time_s"][0]) for t in tables)
    low, high = RATE_RANGE_HZ
    native = min(1.0 / float(np.median(np.diff(t["time_s"]))) for t in tables)
    return min(native, max(low, min(high, SAMPLE_BUDGET / seconds)))


def signals_of(given: Table, rate_hz: float) -> Signals:
    """Resample a trial to one working rate behind an anti-alias low-pass, with the derivatives that the submodels read.

    Derivatives are computed before the thinning: computed afterwards they would be too small in quick motion.
    """
    time = given["time_s"]
    step = float(np.median(np.diff(time)))
    stride = max(1, round(1.0 / (step * rate_hz)))
    gap = np.concatenate(([True], np.diff(time) > 5.0 * step))
    fine = dict(given.columns)
    _derive(fine)
    if given.turning and "rope_m" in fine:
        fine["turned_rad"] = fine["rope_m"]
    columns = {name: _thinned(values, stride, name) for name, values in fine.items()}
    fresh = np.add.reduceat(gap, np.arange(0, len(time), stride)) > 0
    span = columns["time_s"][-1] - columns["time_s"][0]
    rope = None
    if stride > 1 and "rope_m" in fine:
        slow = _low_passed(fine["rope_m"], FINE_HZ * step)
        rope = Fine(slow, np.gradient(slow, time), gap, thinning(stride))
    return Signals(columns, fresh, (columns["time_s"] - columns["time_s"][0]) / span, rope)


def _low_passed(values: Array, cutoff: float) -> Array:
    """Low-pass a signal to remove sensor noise; `cutoff` in cycles per sample."""
    if np.isnan(values).any() or cutoff >= 0.45:
        return values
    return np.asarray(sosfiltfilt(butter(2, 2.0 * cutoff, output="sos"), values))


def _thinned(values: Array, stride: int, name: str) -> Array:
    if stride == 1:
        return values
    if name in ("time_s", "cycle", "gait_percent") or name.endswith("_ns") or np.isnan(values).any():
        return values[::stride]
    return thinning(stride)(values)


def _derive(columns: dict[str, Array]) -> None:
    time = columns["time_s"]
    if "servo_position_m" in columns:
        columns["rope_m"] = columns["servo_position_m"]
        columns["rope_m_s"] = np.gradient(columns["rope_m"], time)
        columns["rope_m_s2"] = np.gradient(columns["rope_m_s"], time)
        columns["strain_m_s"] = columns["rope_m_s"]
    if "knee_angle_rad" in columns:
        speed = np.gradient(columns["knee_angle_rad"], time)
        columns["knee_acceleration"] = np.gradient(speed, time)
        if "rope_m" in columns:
            columns["strain_m_s"] = columns["rope_m_s"] - ROPE_PER_KNEE * speed
    if "tension_end_n" in columns:
        step = float(np.median(np.diff(time)))
        columns["end_rate"] = np.gradient(_low_passed(columns["tension_end_n"], RATE_HZ * step), time)


def cycles_of(given: Signals) -> NDArray[np.intp]:
    """Return each sample's cycle from 0: from the `cycle` column, else gait percent, else repetitions of the slowest
    motion."""
    if given.has("cycle"):
        return np.unique(given["cycle"], return_inverse=True)[1].astype(np.intp)
    if given.has("gait_percent"):
        wrapped = np.concatenate(([False], np.diff(given["gait_percent"]) < -50.0))
        return np.cumsum(wrapped).astype(np.intp)
    return _turns(given)


def _turns(given: Signals) -> NDArray[np.intp]:
    """Return cycle numbers by the first available signal, or by the speed in one-way motion (a run-up)."""
    count = np.zeros(given["time_s"].size, dtype=np.intp)
    for name in ("knee_angle_rad", "rope_m", "tension_start_n", "servo_force_n"):
        if given.has(name):
            count = _rises(given[name])
            break
    if count[-1] < FEWEST_TURNS and given.has("rope_m_s"):
        count = max(count, _rises(given["rope_m_s"]), key=lambda c: int(c[-1]))
    return count


def _rises(signal: Array) -> NDArray[np.intp]:
    """Return, by sample, the number of passages of a signal from below its median to above it."""
    values = signal - np.median(signal)
    band = 0.3 * np.std(values)
    side = np.where(values > band, 1, np.where(values < -band, -1, 0))
    held = side[np.maximum.accumulate(np.where(side != 0, np.arange(side.size), 0))]
    up = np.concatenate(([False], (held[1:] > 0) & (held[:-1] <= 0)))
    return np.cumsum(up).astype(np.intp)


def allowed(tables: Iterable[Table]) -> dict[str, tuple[str, ...]]:
    """Return, for each equation of the catalogue, the columns that some trial lacks (empty: the equation can be
    checked)."""
    held = [set(t.columns) for t in tables]
    return {name: tuple(c for c in (*relation.columns, relation.output) if not all(c in h for h in held))
            for name, relation in RELATIONS.items()}


def blocks_of(tables: Sequence[Table], names: Iterable[str], taut_n: float | None = None, rate_hz: float | None = None
              ) -> list[Block]:
    """Return the blocks of the equations `names` on all trials; `taut_n`: angle equations only if END pulls more, N.

    `rate_hz`: sampling rate of all trials that are compared (None: `working_rate` of these trials). The predicted
    friction right after a reversal depends on this rate, through the noise of the motion.
    """
    rate = working_rate(tables) if rate_hz is None else rate_hz
    names = tuple(names)
    made: list[Block] = []
    first = 0
    for given in tables:
        signals = signals_of(given, rate)
        cycle = cycles_of(signals)
        cycle = cycle - cycle[0] + first
        first = int(cycle[-1]) + 1
        for name in names:
            relation = RELATIONS[name]
            keep = _kept(signals, relation, taut_n)
            made.append(Block(relation, signals, keep, cycle[keep], models.uses(relation)))
    return made


def _kept(signals: Signals, relation: Relation, taut_n: float | None) -> NDArray[np.intp]:
    time = signals["time_s"]
    keep = (time >= time[0] + SETTLE_S) & (time <= time[-1] - SETTLE_S)
    for name in (*relation.columns, relation.output):
        keep &= np.isfinite(signals[name])
    if taut_n is None and signals.has("rope_m"):
        # friction's memory of the motion before the trial is erased once the rope has travelled half its range
        gone = np.cumsum(np.abs(np.diff(signals["rope_m"], prepend=signals["rope_m"][0])))
        keep &= gone >= 0.5 * float(np.ptp(signals["rope_m"]))
    if relation.name == "drive_force" and taut_n is not None:
        pulls = signals["tension_start_n"] if signals.has("tension_start_n") else 0.0
        keep &= _resolved(signals["rope_m_s2"]) & ~_spiked(signals["servo_force_n"] - pulls)
    if relation.unit == "rad" and taut_n is not None:
        for name in ("tension_end_n", "tension_start_n"):
            if signals.has(name):
                keep &= signals[name] > taut_n
                break
    return np.flatnonzero(keep)


def _resolved(acceleration: Array) -> NDArray[np.bool_]:
    """Return a mask of the samples whose acceleration the sampling rate resolves.

    A jerked motor pushes and brakes within one sample of a slow recording. The force of that instant carries no
    information about the mass, yet a few such samples outweigh all others. The acceleration is a difference over
    neighbouring samples, so that those are masked, too.
    """
    whole = float(np.sqrt(np.nanmean(acceleration**2)))
    jump = np.pad(np.abs(np.diff(acceleration)) > JERKED * whole, 2)
    return np.asarray(~(jump[:-3] | jump[1:-2] | jump[2:-1] | jump[3:]))


def _spiked(force: Array) -> NDArray[np.bool_]:
    """Return a mask of one-sample or two-sample spikes of a motor's own force, and of their neighbours.

    A jerk too short for the recorded position shows in the force alone: no submodel of that position can reproduce it.
    """
    apart = np.abs(force - median_filter(force, SPIKE_SAMPLES))
    least = SPIKE_SHARE * float(np.sqrt(np.nanmean(force**2)))
    return np.asarray(binary_dilation(apart > max(SPIKE_SIGMA * 1.4826 * float(np.nanmedian(apart)), least)))


def rmse(residuals: Iterable[Array]) -> float:
    """Return the root mean square of all residuals together; NaN without residuals."""
    parts = list(residuals)
    count = sum(r.size for r in parts)
    return math.sqrt(sum(float(r @ r) for r in parts) / count) if count else math.nan
