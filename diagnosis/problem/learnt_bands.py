"""A bench's constants from its healthy trials of any motion: wide physical priors, several starts, then its own floor.

The rule of this file: nothing is known of the bench but that a rope runs over a knee and stretches; geometry comes in
closed form from rope, knee and tension, the zero from the median of what kinematics leaves, friction from several
starts, coarse and then in full.  What the data do not move stays where it was and is said so.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.table import Table
from diagnosis.problem import discrepancy
from diagnosis.problem.blocks import REMEMBERED, TAUT_N, Block, rmse
from diagnosis.problem.deviations import chances, correlated, deviating, repeated
from diagnosis.problem.fit import Fit, Problem, solve
from diagnosis.problem.floors import LEAST_CORRELATION_LENGTH, LEAST_FLOOR, MOST_CORRELATION_LENGTH
from diagnosis.problem.healthy_reference import BAND, HealthyReference
from diagnosis.problem.healthy_residuals import HealthyResiduals, another, certainties, examine, noise_at
from diagnosis.problem.loops import settled
from diagnosis.problem.prior import NOTHING_TOGETHER, Free, Prior
from physics.parameters import RELATION_PARAMETERS
from physics.plant.leg import KNEE_AT_FIT
from physics.relations.measured import Signals
from physics.relations.recorded_reads import Memory
from physics.relations.transmission import STRETCH_BEND, STRETCH_LINEAR

Array = NDArray[np.float64]
Values = Mapping[str, float]

WIDE: Final[Mapping[str, float]] = {
    "mu1": 0.05, "mu2": 0.15, "fabric_wrap": 1.0, "cable_bend": 0.1, "load_slope": 0.2, "viscous": 10.0,
    "viscous_tension": 10.0, "stribeck_ratio": 0.3, "stribeck_speed": 0.01, "stribeck_memory": 15e-3,
    "presliding": 0.3e-3, "presliding_shape": 0.3, "fabric_presliding_ratio": 1.0,
    "stiffness_scale": 0.4, "stiffness_shape": 0.5, "toe": 1e-3, "cable_share": 0.15, "rope_zero": 50e-3,
    "rope_per_knee_quadratic": 5e-4, "timestamp_skew": 2e-3, "end_delay": 2e-3,
    "drive_coulomb": 3.0, "drive_viscous": 40.0, "drive_inertia": 2.0, "drive_offset": 1.0, "drive_asymmetry": 0.1,
    "drive_presliding": 0.3e-3, "servo_bandwidth": 15.0, "servo_damping": 0.4, "knee_bandwidth": 15.0,
    "knee_damping": 0.4, "knee_backlash": 3.5e-3, "creep_compliance": 5e-6}
"""1σ of what is known beforehand of a bench of this kind."""
KNEE_RATIO: Final = 0.05
"""1σ of the rope per knee angle about what the closed form says, of it."""
KNEE_RATIO_RANGE: Final = (0.5, 2.0)
NARROW: Final = 0.3
"""Slots that stand in for missing physics (`STANDING_IN`): 1σ after learning, of that of like benches."""
STANDING_IN: Final = ("cable_bend", "load_slope", "toe", "rope_per_knee_quadratic", "stribeck_ratio",
                      "stiffness_shape")
RELATIVE: Final = ("mu1", "mu2", "stiffness_scale", "presliding", "drive_coulomb", "drive_viscous", "drive_inertia")
"""Slots whose tolerance among like benches is a share of their value."""
KEPT: Final = ("knee_backlash", "creep_compliance")
KEPT_SHARE: Final = 0.1
"""Slots that are nothing on a nominal bench and stay what they are on a bench that has them: 1σ of their value, beside
how well they were learnt."""
DRAG: Final = ("viscous",)
DRAG_SHARE: Final = 0.05
"""Slots that a nominal bench has not, and 1σ among like benches, of the value that a bench has."""
NOISE_LENGTH: Final = 1.25
"""Samples of white noise behind the low-pass of the working rate that count as one."""
STARTS: Final = ((1.0, 0.1e-3), (0.5, 0.3e-3), (2.0, 0.1e-3))
"""Friction, of the nominal, and pre-sliding, m, that fits start from."""
AGAIN: Final[tuple[Mapping[str, float], ...]] = (
    {"stribeck_ratio": 1.5, "stribeck_memory": 35e-3},
    {"stribeck_ratio": 1.5, "stribeck_speed": 4e-3, "stribeck_memory": 5e-3},
    {"viscous": 10.0, "viscous_tension": 25.0})
"""Where a fit starts again: friction that breaks away late, or at once, is another minimum than friction that hardly
does, and so is a rope that drags only where it is pressed to its sheath."""
COARSE: Final = ("mu1", "mu2", "viscous", "timestamp_skew", "presliding", "stiffness_scale", "stiffness_shape",
                 "rope_zero", "rope_per_knee")
FULL: Final = 2
CLOSE: Final = 1.2
"""Coarse fits that are carried on: so many at most, of at most this share of the best one's cost."""
STRETCH_AT_60_N: Final = (2e-3, 60e-3)
STRAIGHT: Final = 0.9
"""R² of rope over knee and tension from which a rig is one of this kind."""


@dataclass(frozen=True)
class Geometry:
    """Rope over knee and tension in closed form: rope = zero + ratio·(θ − θ13) + linear·T + bend·T²."""

    ratio: float
    zero: float
    linear: float
    bend: float
    straight: float

    @property
    def stretches(self) -> bool:
        """Whether a tension stretches what is there like a rope and a strap."""
        stretch = self.linear * 60.0 + self.bend * 3600.0
        return self.straight > STRAIGHT and STRETCH_AT_60_N[0] < abs(stretch) < STRETCH_AT_60_N[1]


def geometry(columns: Sequence[Mapping[str, Array]], ratio: float | None = None) -> Geometry | None:
    """Return the geometry of trials with rope, knee and a tension; None where too little of it is taut.

    `ratio`: rope per knee angle where it is known.
    """
    rows, rope = [], []
    for held in columns:
        tensions = [held[n] for n in ("tension_start_n", "tension_end_n") if n in held]
        if not tensions or "knee_angle_rad" not in held or "servo_position_m" not in held:
            continue
        tension, least = np.mean(tensions, axis=0), np.min(tensions, axis=0)
        at = np.flatnonzero(np.isfinite(tension + held["knee_angle_rad"] + held["servo_position_m"]) & (least > TAUT_N))
        at = at[:: max(1, at.size // 4000)]
        rows.append(np.column_stack([np.ones(at.size), held["knee_angle_rad"][at] - KNEE_AT_FIT, tension[at],
                                     tension[at] ** 2]))
        rope.append(held["servo_position_m"][at])
    if not rows or sum(map(len, rope)) < 50:
        return None
    x, y = np.concatenate(rows), np.concatenate(rope)
    scale = np.maximum(np.abs(x).max(axis=0), 1e-12)
    free = [0, 1, 2, 3] if ratio is None else [0, 2, 3]
    c = np.array([0.0, ratio or 0.0, 0.0, 0.0])
    c[free] = np.linalg.lstsq((x / scale)[:, free], y - x @ c, rcond=1e-9)[0] / scale[free]
    left, spread = float(np.var(y - x @ c)), float(np.var(y))
    return Geometry(float(c[1]), float(c[0]), float(c[2]), float(c[3]), 1.0 - left / spread if spread else 0.0)


def oriented(tables: Sequence[Table]) -> tuple[list[Table], int]:
    """Return the trials with a rope position that grows where it pulls, and the sign that theirs has (1 or −1)."""
    found = geometry([t.columns for t in tables])
    if found is None or found.linear * 60.0 + found.bend * 3600.0 >= 0.0:
        return list(tables), 1
    turned = ("servo_position_m", "servo_target_m", "servo_velocity_m_s")
    return [dataclasses.replace(t, columns={n: -v if n in turned else v for n, v in t.columns.items()})
            for t in tables], -1


@dataclass(frozen=True, kw_only=True)
class Learnt(HealthyResiduals):
    """What healthy trials say of a bench: bands about the learnt values, 1σ by slot, and what the laws leave."""

    reference: HealthyReference
    sigma: Mapping[str, float]
    like: tuple[Free, ...]
    trials: int

    def structure(self, relation: str) -> float:
        """Return how far a relation may be from holding on a healthy trial without noise, RMS.

        Like benches differ in structure, too.
        """
        left, plain = (_less(v[relation], self.noise[relation]) for v in (self.floors, self.plain))
        return min(math.hypot(left, another(self.trials) * plain), max(left, plain))

    def structure_length(self, relation: str) -> float:
        """Return how many samples of the structure count as one: what the correlation of all has beyond the noise's."""
        left, noise = self.floors[relation], self.noise[relation]
        beyond = left**2 * self.correlation_length[relation] - NOISE_LENGTH * noise**2
        return min(max(beyond / _less(left, noise) ** 2, LEAST_CORRELATION_LENGTH), MOST_CORRELATION_LENGTH)

    def corrected(self, blocks: Sequence[Block]) -> list[Block]:
        """Return blocks of another trial with the discrepancies taken off."""
        return [discrepancy.corrected(b, self.discrepancies, self.reference.values) for b in blocks]

    def weighed(self, blocks: Sequence[Block]) -> Weighed:
        """Return blocks of another trial with the discrepancies taken off, each sample with what it counts.

        A sample counts by how well the laws hold about there, and by the noise that the trial itself has there.
        """
        values, found = self.reference.values, self.corrected(blocks)
        floors, weights, noises = dict[str, float](), dict[str, float](), dict[str, float]()
        for name in self.floors:
            mine = [i for i, b in enumerate(found) if b.relation.name == name and b.keep.size]
            if not mine:
                continue
            at = [discrepancy.features(blocks[i].signals, values)[blocks[i].keep] for i in mine]
            rests = [found[i].residual(values) for i in mine]
            noise = np.concatenate(noise_at(at, rests))
            known = self.scatters.get(name)
            structure = np.concatenate([np.full(len(x), self.structure(name) ** 2) if known is None else known.of(x)
                                        for x in at])
            cost = structure * self.structure_length(name) + NOISE_LENGTH * noise
            weights[name] = 1.0 / math.sqrt(float(np.mean(1.0 / cost)))
            certain = weights[name] / np.sqrt(cost)
            noises[name] = math.sqrt(float(np.mean(np.concatenate([chances(r) for r in rests]) * certain**2)))
            floors[name] = math.hypot(noises[name], math.sqrt(float(np.mean(structure * certain**2))))
            for i, part in zip(mine, np.split(certain, np.cumsum([len(x) for x in at])[:-1]), strict=True):
                found[i] = discrepancy.corrected(blocks[i], self.discrepancies, values, part)
        return Weighed(found, floors, weights, noises)


class Weighed(NamedTuple):
    """Blocks of which each sample counts by how well its law holds about there; what a healthy trial leaves of them.

    By relation, in its unit: the RMSE `floors`, the residual that costs one, and what of the RMSE is noise.  The mean
    square of what the samples of a relation count is 1.
    """

    blocks: list[Block]
    floors: Mapping[str, float]
    weights: Mapping[str, float]
    noise: Mapping[str, float]


def _less(whole: float, noise: float) -> float:
    """Return what of a whole RMS is not noise; a tenth of the noise at least, below which nothing is known of it."""
    return math.sqrt(max(whole**2 - noise**2, (0.1 * noise) ** 2, 1e-24))


def learn(trials: Sequence[Sequence[Block]], reference: HealthyReference, floors: Mapping[str, float],
          correlation_length: Mapping[str, float], others: Sequence[Values] = ()) -> Learnt:
    """Learn a bench from the blocks of each of its healthy trials; `others`: further values to start from.

    `reference`: where nothing is learnt, and how far like trials of one bench differ; `floors`, `correlation_length`:
    what is assumed before they are seen.
    """
    weights = {n: 2.0 * floors[n] * math.sqrt(correlation_length[n]) for n in floors}
    blocks = [deviating(b, i, _own(reference)) for i, trial in enumerate(trials) for b in trial]
    rest = {f"{f.name}@{i}": 0.0 for i in range(len(trials)) for f in _own(reference)}
    wide = _wide(reference)
    short = _short(trials)
    coarse = sorted((solve(Problem(short, weights), start, [f for f in wide if f.name in COARSE], 20)
                     for shape in (reference.values, *others) for start in _starts(shape, trials)),
                    key=lambda f: f.cost)
    carried = [fit for fit in coarse[:FULL] if fit.cost < CLOSE * coarse[0].cost]
    free = (*wide, *_deviations({f.name: f.sigma for f in _own(reference)}, len(trials)))
    loops = settled(Problem([b for trial in trials for b in trial], weights), coarse[0].values, wide)
    together = min((solve(Problem(blocks, weights), {**fit.values, **loops, **rest}, free)
                    for fit in carried), key=lambda f: f.cost)
    for other in AGAIN:
        together = min(together, solve(Problem(blocks, weights), {**together.values, **other}, free, known=together,
                                       thorough=True), key=lambda f: f.cost)
    for last in (False, True):
        # few samples that no law meets (a loose rope that snaps tight) would lead the constants: each counts as its
        # place; and how much data count beside what is known beforehand, what the laws do leave says, not what they may
        certain = certainties(blocks, [b.residual(together.values) for b in blocks], reference.values)
        counted = [discrepancy.corrected(b, {}, {}, c) for b, c in zip(blocks, certain, strict=True)]
        weights = _costing_one(counted, together.values, weights)
        free = (*wide, *_deviations(_like(reference, together.values), len(trials)))
        together = solve(Problem(counted, weights), together.values, free, thorough=last)
    values = {n: together.values[n] for n in reference.values}
    unknown = learnt_covariance(counted, together)
    moved = HealthyReference(reference.kind, {**values, **{discrepancy.slot(n): 1.0 for n in floors}},
                             _bands(reference, values, len(trials), floors, sigmas(unknown)), prior=unknown)
    near = [{f.name: values[f.name] + (together.values[f"{f.name}@{i}"] if rest and len(trials) > 1 else 0.0)
             for f in _own(reference)} for i in range(len(trials))]
    parts = iter(certain)
    left = examine(trials, moved, near, weights, [[next(parts) for _ in trial] for trial in trials])
    return Learnt(reference=moved, sigma=sigmas(unknown), like=reference.nuisance, trials=len(trials), **vars(left))


def _costing_one(blocks: Sequence[Block], values: Values, before: Mapping[str, float]) -> dict[str, float]:
    """Return by relation the residual that costs one, from what is left at `values`; never more than `before`."""
    left = {n: rmse(b.residual(values) for b in blocks if b.relation.name == n and b.keep.size) for n in before}
    return {n: min(before[n], max(left[n], LEAST_FLOOR[n]) * math.sqrt(LEAST_CORRELATION_LENGTH))
            if math.isfinite(left[n]) else before[n] for n in before}


def _own(reference: HealthyReference) -> tuple[Free, ...]:
    """Return in what one trial may differ from another of the same bench."""
    return reference.nuisance


def _wide(reference: HealthyReference) -> list[Free]:
    """Return every constant with what is known of it beforehand."""
    found = {f.name: f for f in reference.nuisance}
    for name, sigma in WIDE.items():
        low, high = bounds(name)
        sigma = min(sigma, reference.measured.get(name, sigma))
        at, half = reference.values[name], 4.0 * sigma
        found[name] = Free(name, max(low, at - half), min(high, at + half), at, sigma, min(sigma, _step(name)))
    ratio, low, high = reference.values["rope_per_knee"], *KNEE_RATIO_RANGE
    sigma = min(KNEE_RATIO * abs(ratio), reference.measured.get("rope_per_knee", math.inf))
    found["rope_per_knee"] = Free(
        "rope_per_knee", min(low * ratio, high * ratio), max(low * ratio, high * ratio), ratio,
        sigma, min(sigma, 0.2 * KNEE_RATIO * abs(ratio)))
    return list(found.values())


def bounds(name: str) -> tuple[float, float]:
    """Return the bounds of a slot on a healthy bench: of two signals either may be the later one."""
    slot = RELATION_PARAMETERS[name]
    return (-slot.high if name in ("timestamp_skew", "end_delay") else slot.low), slot.high


def _step(name: str) -> float:
    """Return the scale on which a slot's slopes are taken."""
    return {"rope_zero": 1e-3, "timestamp_skew": 5e-4, "end_delay": 5e-4, "drive_viscous": 10.0, "viscous": 1.0,
            "viscous_tension": 2.0, "servo_bandwidth": 5.0, "knee_bandwidth": 5.0,
            "knee_backlash": 1e-3, "creep_compliance": 5e-6}.get(name, math.inf)


def _short(trials: Sequence[Sequence[Block]], cycles: int = 3) -> list[Block]:
    """Return the first cycles of each trial, for fits that only look where to go."""
    short = []
    for trial in trials:
        for block in trial:
            inside = block.cycle < block.cycle[0] + cycles
            last = int(block.keep[inside][-1]) + 1 if inside.any() else 0
            whole = block.signals.progress.size
            columns = {n: v[:last] for n, v in block.signals.columns.items()}
            fine = block.signals.fine
            short.append(dataclasses.replace(
                block, keep=block.keep[inside], cycle=block.cycle[inside],
                signals=Signals(columns, block.signals.fresh[:last], block.signals.progress[:last],
                                None if last < whole else fine), _last=Memory(REMEMBERED)))
    return short


def _starts(values: Values, trials: Sequence[Sequence[Block]]) -> Iterator[dict[str, float]]:
    for friction, slide in STARTS:
        start = {**values, "mu1": friction * values["mu1"], "mu2": friction * values["mu2"], "presliding": slide}
        yield _zeroed(start, trials)


def _zeroed(values: dict[str, float], trials: Sequence[Sequence[Block]]) -> dict[str, float]:
    """Put the zero where the median of what kinematics leaves is none."""
    left = [b.residual(values) for trial in trials for b in trial if b.relation.name == "kinematics" and b.keep.size]
    if not left:
        return values
    shift = float(np.median(np.concatenate(left)))
    return {**values, "rope_zero": values["rope_zero"] - values["rope_per_knee"] * shift}


def of_geometry(values: Values, found: Geometry) -> dict[str, float]:
    """Return values with rope per knee angle, zero and stretch as the closed form has them."""
    scale = min(max(STRETCH_LINEAR / found.linear, 0.3), 3.0) if found.linear > 0.0 else 1.0
    shape = min(max(found.bend * scale / STRETCH_BEND - 1.0, -0.95), 0.9)
    return {**values, "rope_per_knee": found.ratio, "rope_zero": found.zero, "stiffness_scale": scale,
            "stiffness_shape": shape if found.linear > 0.0 else 0.0, "home_preload": 0.0}


def _like(reference: HealthyReference, values: Values) -> dict[str, float]:
    """Return 1σ by slot of like benches about what was learnt."""
    found = {}
    zero = next((f.sigma for f in reference.nuisance if f.name == "rope_zero"), math.inf)
    for f in reference.nuisance:
        sigma, slot = f.sigma, RELATION_PARAMETERS[f.name]
        if f.name in RELATIVE and slot.nominal:
            sigma *= max(abs(values[f.name] / slot.nominal), 0.2)
        if f.name in STANDING_IN:
            sigma *= NARROW
        if slot.daily is None:
            sigma = min(sigma, reference.measured.get(f.name, sigma))
        if f.name in DRAG:
            sigma = max(sigma, DRAG_SHARE * abs(values[f.name]))
        if f.name == "home_preload":
            sigma = min(sigma, zero / max(_homed(values), 1e-12))
        found[f.name] = sigma
    return found


def _deviations(like: Values, trials: int) -> list[Free]:
    """Return each trial's own deviation from what is common; of a single one it is part of what is learnt."""
    return [Free(f"{name}@{i}", -BAND * sigma, BAND * sigma, 0.0, sigma, sigma)
            for i in range(trials) for name, sigma in like.items()] if trials > 1 else []


def _bands(reference: HealthyReference, values: Values, trials: int, relations: Mapping[str, float],
           learnt: Values) -> tuple[Free, ...]:
    """Return the bands of like benches about what was learnt, each amplitude of a discrepancy beside them.

    `learnt`: 1σ by slot of what was not learnt.  Slots that no like bench differs in (the wrap of the fabric) are open
    as far as the healthy trials left them so: beside them stand those that trade with them.
    """
    alone = math.sqrt(2.0) if trials == 1 else 1.0
    like = {**dict.fromkeys(learnt, 0.0), **_like(reference, values), **{n: KEPT_SHARE * values[n] for n in KEPT}}
    found = [_band(name, values[name], alone * sigma, learnt.get(name, 0.0)) for name, sigma in like.items()]
    found += [Free(discrepancy.slot(n), 0.0, 2.0, 1.0, discrepancy.AMPLITUDE, discrepancy.AMPLITUDE) for n in relations]
    return tuple(found)


def _band(name: str, value: float, like: float, learnt: float) -> Free:
    """Return the band of a slot from 1σ among like benches and of what was not learnt."""
    sigma, (low, high) = math.hypot(like, learnt), bounds(name)
    return Free(name, max(low, value - BAND * sigma), min(high, value + BAND * sigma), value, sigma, like or sigma)


def _homed(values: Values) -> float:
    """Return by how much a newton of homing's preload moves the zero, m: by what the bench's stretch is not (10)'s.

    It stands for a bench homed before its stretch changed; what is learnt has the zero that it was recorded with.
    """
    linear = STRETCH_LINEAR * (1.0 / values["stiffness_scale"] - 1.0)
    return abs(linear)


def covariance(fit: Fit) -> Prior:
    """Return what a fit leaves open of every slot, from its curvature, what was known beforehand included."""
    return _open(fit, fit.curvature, 1e-10)


def learnt_covariance(blocks: Sequence[Block], fit: Fit) -> Prior:
    """Return what a fit leaves open, its residuals counted as what they are: one after another, cycle after cycle.

    What the laws lack is left again in each cycle of a trial, and does not say more for being seen more often.
    """
    information = NOTHING_TOGETHER.precision(fit.free)
    for name in dict.fromkeys(b.relation.name for b in blocks):
        mine = [i for i, b in enumerate(blocks) if b.relation.name == name and b.keep.size]
        rests = [fit.residuals[i] for i in mine]
        length = max(correlated(rests), LEAST_CORRELATION_LENGTH) * repeated(rests, [blocks[i].cycle for i in mine])
        for i in mine:
            reads, rows = fit.reads[i], fit.slopes[i].astype(float)
            information[np.ix_(reads, reads)] += LEAST_CORRELATION_LENGTH / length * (rows @ rows.T)
    return _open(fit, information, 0.0)


def _open(fit: Fit, information: Array, singular: float) -> Prior:
    """Return the covariance of all but each trial's own; what is less than `singular` of the most is not inverted."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    whole = np.linalg.pinv(information / np.outer(scale, scale), rcond=singular, hermitian=True)
    common = [j for j, f in enumerate(fit.free) if "@" not in f.name]
    found = (whole / np.outer(scale, scale))[np.ix_(common, common)]
    return Prior(tuple(fit.free[j].name for j in common), found)


def sigmas(unknown: Prior) -> dict[str, float]:
    """Return 1σ of every slot."""
    return {n: math.sqrt(max(float(v), 0.0)) for n, v in zip(unknown.names, np.diag(unknown.covariance), strict=True)}
