"""Identification of a bench from reference trials of any motion: wide priors, several starts, then its reference RMSE.

The only assumption is that a rope runs over a knee and stretches. Geometry has a closed form in rope, knee angle and
tension. The encoder zero follows from the median kinematic residual. Friction is fitted from several starts, first
coarsely, then in full. Constants that the data do not determine keep their prior.
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
"""Prior 1σ of each constant of a bench of this kind, in its unit."""
KNEE_RATIO: Final = 0.05
"""1σ of the rope per knee angle about its closed form, as a share of its value."""
KNEE_RATIO_RANGE: Final = (0.5, 2.0)
NARROW: Final = 0.3
"""1σ after identification of the surrogates of missing physics (`STANDING_IN`), as a share of the population's 1σ."""
STANDING_IN: Final = ("cable_bend", "load_slope", "toe", "rope_per_knee_quadratic", "stribeck_ratio",
                      "stiffness_shape")
RELATIVE: Final = ("mu1", "mu2", "stiffness_scale", "presliding", "drive_coulomb", "drive_viscous", "drive_inertia")
"""Parameters whose tolerance in the bench population is a share of their value."""
KEPT: Final = ("knee_backlash", "creep_compliance")
KEPT_SHARE: Final = 0.1
"""Parameters that are 0 on a nominal bench and constant on a bench that has them, and 1σ as a share of their value. The
uncertainty of the identification is added to this 1σ."""
DRAG: Final = ("viscous",)
DRAG_SHARE: Final = 0.05
"""Parameters that are 0 on a nominal bench, and their 1σ in the population as a share of the identified value."""
NOISE_LENGTH: Final = 1.25
"""Samples of white noise behind the low-pass of the working rate per effective sample."""
STARTS: Final = ((1.0, 0.1e-3), (0.5, 0.3e-3), (2.0, 0.1e-3))
"""Starting points of the fits: friction as a multiple of the reference value, and pre-sliding, m."""
AGAIN: Final[tuple[Mapping[str, float], ...]] = (
    {"stribeck_ratio": 1.5, "stribeck_memory": 35e-3},
    {"stribeck_ratio": 1.5, "stribeck_speed": 4e-3, "stribeck_memory": 5e-3},
    {"viscous": 10.0, "viscous_tension": 25.0})
"""Further starting points of the joint fit. Each can lead to another local minimum: friction that breaks away late,
friction that breaks away at once, and viscous drag only where the rope is pressed to its sheath."""
COARSE: Final = ("mu1", "mu2", "viscous", "timestamp_skew", "presliding", "stiffness_scale", "stiffness_shape",
                 "rope_zero", "rope_per_knee")
FULL: Final = 2
CLOSE: Final = 1.2
"""Coarse fits to continue: at most `FULL`, with a cost below `CLOSE` times the best one."""
STRETCH_AT_60_N: Final = (2e-3, 60e-3)
STRAIGHT: Final = 0.9
"""R² of rope over knee angle and tension above which a rig is of this kind."""


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
        """Whether the stretch under tension is of the size of a rope with a strap."""
        stretch = self.linear * 60.0 + self.bend * 3600.0
        return self.straight > STRAIGHT and STRETCH_AT_60_N[0] < abs(stretch) < STRETCH_AT_60_N[1]


def geometry(columns: Sequence[Mapping[str, Array]], ratio: float | None = None) -> Geometry | None:
    """Return the geometry of trials with rope, knee angle and a tension; None if too few samples are taut.

    `ratio`: rope per knee angle, if it is given.
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
    """Return the trials, rope position oriented to grow with the pull, and the sign of the original (1 or −1)."""
    found = geometry([t.columns for t in tables])
    if found is None or found.linear * 60.0 + found.bend * 3600.0 >= 0.0:
        return list(tables), 1
    turned = ("servo_position_m", "servo_target_m", "servo_velocity_m_s")
    return [dataclasses.replace(t, columns={n: -v if n in turned else v for n, v in t.columns.items()})
            for t in tables], -1


@dataclass(frozen=True, kw_only=True)
class Learnt(HealthyResiduals):
    """Bench identified from reference trials: bands about its constants, their 1σ, and its residuals."""

    reference: HealthyReference
    sigma: Mapping[str, float]
    like: tuple[Free, ...]
    trials: int

    def structure(self, relation: str) -> float:
        """Return the systematic error of an equation in the reference condition without noise, RMS, in its unit.

        The spread between benches of the population is included.
        """
        left, plain = (_less(v[relation], self.noise[relation]) for v in (self.floors, self.plain))
        return min(math.hypot(left, another(self.trials) * plain), max(left, plain))

    def structure_length(self, relation: str) -> float:
        """Return the samples per effective sample of the systematic error: total correlation less that of noise."""
        left, noise = self.floors[relation], self.noise[relation]
        beyond = left**2 * self.correlation_length[relation] - NOISE_LENGTH * noise**2
        return min(max(beyond / _less(left, noise) ** 2, LEAST_CORRELATION_LENGTH), MOST_CORRELATION_LENGTH)

    def corrected(self, blocks: Sequence[Block]) -> list[Block]:
        """Return the blocks of another trial with the discrepancies subtracted."""
        return [discrepancy.corrected(b, self.discrepancies, self.reference.values) for b in blocks]

    def weighed(self, blocks: Sequence[Block]) -> Weighed:
        """Return the blocks of another trial with the discrepancies subtracted and each sample weighted.

        The weight of a sample follows from the local model error and from the local noise of the trial itself.
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
    """Weighted blocks of a trial, and the residual expected of them in the reference condition.

    By equation, in its unit: `floors`, the reference RMSE; `weights`, the residual that costs 1; `noise`, the noise in
    the RMSE. Sample weights of an equation have mean square 1.
    """

    blocks: list[Block]
    floors: Mapping[str, float]
    weights: Mapping[str, float]
    noise: Mapping[str, float]


def _less(whole: float, noise: float) -> float:
    """Return the RMS of a residual without its noise; at least a tenth of the noise."""
    return math.sqrt(max(whole**2 - noise**2, (0.1 * noise) ** 2, 1e-24))


def learn(trials: Sequence[Sequence[Block]], reference: HealthyReference, floors: Mapping[str, float],
          correlation_length: Mapping[str, float], others: Sequence[Values] = ()) -> Learnt:
    """Identify a bench from the blocks of each of its reference trials; `others`: further starting points.

    `reference`: prior means of all constants, and the spread between trials of one bench. `floors`,
    `correlation_length`: reference RMSE and samples per effective sample assumed before the fit.
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
        # few samples that no submodel fits (a slack rope that snaps tight) would dominate the constants, so that each
        # sample is weighted by the local residual; the actual RMSE replaces the assumed one
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
    """Return by equation the residual that costs 1, from the RMSE at `values`; at most `before`."""
    left = {n: rmse(b.residual(values) for b in blocks if b.relation.name == n and b.keep.size) for n in before}
    return {n: min(before[n], max(left[n], LEAST_FLOOR[n]) * math.sqrt(LEAST_CORRELATION_LENGTH))
            if math.isfinite(left[n]) else before[n] for n in before}


def _own(reference: HealthyReference) -> tuple[Free, ...]:
    """Return the parameters in which trials of one bench may differ."""
    return reference.nuisance


def _wide(reference: HealthyReference) -> list[Free]:
    """Return every constant with its prior before identification."""
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
    """Return the bounds of a parameter in the reference condition; a delay between two signals may have either sign."""
    slot = RELATION_PARAMETERS[name]
    return (-slot.high if name in ("timestamp_skew", "end_delay") else slot.low), slot.high


def _step(name: str) -> float:
    """Return the scale on which a parameter's slope is computed."""
    return {"rope_zero": 1e-3, "timestamp_skew": 5e-4, "end_delay": 5e-4, "drive_viscous": 10.0, "viscous": 1.0,
            "viscous_tension": 2.0, "servo_bandwidth": 5.0, "knee_bandwidth": 5.0,
            "knee_backlash": 1e-3, "creep_compliance": 5e-6}.get(name, math.inf)


def _short(trials: Sequence[Sequence[Block]], cycles: int = 3) -> list[Block]:
    """Return the first cycles of each trial, for coarse fits that only select starting points."""
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
    """Shift the encoder zero so that the median kinematic residual is 0."""
    left = [b.residual(values) for trial in trials for b in trial if b.relation.name == "kinematics" and b.keep.size]
    if not left:
        return values
    shift = float(np.median(np.concatenate(left)))
    return {**values, "rope_zero": values["rope_zero"] - values["rope_per_knee"] * shift}


def of_geometry(values: Values, found: Geometry) -> dict[str, float]:
    """Return values with rope per knee angle, zero and stretch replaced by those of the closed form."""
    scale = min(max(STRETCH_LINEAR / found.linear, 0.3), 3.0) if found.linear > 0.0 else 1.0
    shape = min(max(found.bend * scale / STRETCH_BEND - 1.0, -0.95), 0.9)
    return {**values, "rope_per_knee": found.ratio, "rope_zero": found.zero, "stiffness_scale": scale,
            "stiffness_shape": shape if found.linear > 0.0 else 0.0, "home_preload": 0.0}


def _like(reference: HealthyReference, values: Values) -> dict[str, float]:
    """Return the bench population's 1σ of each parameter about the identified value."""
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
    """Return each trial's deviation parameters; empty for a single trial, whose deviation is part of the constants."""
    return [Free(f"{name}@{i}", -BAND * sigma, BAND * sigma, 0.0, sigma, sigma)
            for i in range(trials) for name, sigma in like.items()] if trials > 1 else []


def _bands(reference: HealthyReference, values: Values, trials: int, relations: Mapping[str, float],
           learnt: Values) -> tuple[Free, ...]:
    """Return the bands of the population about the identified values, and those of the discrepancies' amplitudes.

    `learnt`: 1σ of the identification by parameter. Parameters without spread in the population (the wrap of the
    fabric) keep the uncertainty of the identification, because others are confounded with them.
    """
    alone = math.sqrt(2.0) if trials == 1 else 1.0
    like = {**dict.fromkeys(learnt, 0.0), **_like(reference, values), **{n: KEPT_SHARE * values[n] for n in KEPT}}
    found = [_band(name, values[name], alone * sigma, learnt.get(name, 0.0)) for name, sigma in like.items()]
    found += [Free(discrepancy.slot(n), 0.0, 2.0, 1.0, discrepancy.AMPLITUDE, discrepancy.AMPLITUDE) for n in relations]
    return tuple(found)


def _band(name: str, value: float, like: float, learnt: float) -> Free:
    """Return the band of a parameter from its population 1σ and its identification 1σ."""
    sigma, (low, high) = math.hypot(like, learnt), bounds(name)
    return Free(name, max(low, value - BAND * sigma), min(high, value + BAND * sigma), value, sigma, like or sigma)


def _homed(values: Values) -> float:
    """Return |∂zero/∂preload| of homing, m/N: linear compliance of the bench less that of equation (10).

    This covers a bench that was homed before its stretch changed; the identified zero is that of the recording.
    """
    linear = STRETCH_LINEAR * (1.0 / values["stiffness_scale"] - 1.0)
    return abs(linear)


def covariance(fit: Fit) -> Prior:
    """Return the posterior covariance of the common parameters, from the fit's curvature including the prior."""
    return _open(fit, fit.curvature, 1e-10)


def learnt_covariance(blocks: Sequence[Block], fit: Fit) -> Prior:
    """Return the covariance of the common parameters, with correlated residuals counted by their effective samples.

    Systematic error repeats in each cycle of a trial; a repeated error adds no information.
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
    """Return the covariance of the common parameters; directions below `singular` of the largest are not inverted."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    whole = np.linalg.pinv(information / np.outer(scale, scale), rcond=singular, hermitian=True)
    common = [j for j, f in enumerate(fit.free) if "@" not in f.name]
    found = (whole / np.outer(scale, scale))[np.ix_(common, common)]
    return Prior(tuple(fit.free[j].name for j in common), found)


def sigmas(unknown: Prior) -> dict[str, float]:
    """Return 1σ of every parameter of `unknown`."""
    return {n: math.sqrt(max(float(v), 0.0)) for n, v in zip(unknown.names, np.diag(unknown.covariance), strict=True)}
