"""Before and after on a rig of any kind: what its healthy trials need of the catalogue is its healthy state.

The rule of this file: the healthy trials say which laws the rig follows and by which constants; another trial is
compared with that, inside the bands that one day differs from another by, and never with an ideal transmission.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from diagnosis.data.table import Table
from diagnosis.problem import blocks as relations
from diagnosis.problem.blocks import Block, rmse
from diagnosis.problem.candidates import Candidate
from diagnosis.problem.cross_validation import folds_of
from diagnosis.problem.deviations import correlated
from diagnosis.problem.fit import Fit
from diagnosis.problem.floors import LEAST_CORRELATION_LENGTH
from diagnosis.problem.healthy_reference import BAND, HealthyReference
from diagnosis.problem.healthy_trials import HealthyTrials
from diagnosis.problem.prior import Free, Prior
from diagnosis.problem.problem import ProblemSetting, build_problem, offered_on
from physics.parameters import RELATION_PARAMETERS

DAILY: Final = 0.08
"""1σ from one session to another of a rig's whole friction, of it; of a rubber seal recorded in five sessions, 0.08."""
DAILY_PART: Final = 0.25
"""The same of each of its parts (dry, of the load, viscous), which one session tells apart from the others less well:
those of the seal have 0.18."""
FIRM: Final = {"stiffness_scale": 0.03, "stiffness_shape": 0.03, "drive_inertia": 0.02,
               "unbalance": 0.02}
"""The same of what does not rub: temperature moves a spring by per cents, and a mass is what it was."""
DAILY_ANGLE: Final = 0.02
"""The same of the angle of a mass on a turning axis, rad: its encoder's zero."""
DAILY_RATIO: Final = 0.005
"""The same of the ratio of two sensors."""
DAILY_ZERO: Final = 0.002
"""The same of a zero, of the greatest value that its signal has."""
WHOLE: Final = "cable_friction"
PARTS: Final = ("coulomb", "viscous")
STRUCTURE: Final = 0.5
"""Share of what the laws leave on healthy trials that those of another day may leave in another way."""


def against_healthy(trials: Sequence[Table], healthy: Sequence[Table],
                    searched: Callable[[ProblemSetting], Fit]) -> ProblemSetting:
    """Return what `trials` are judged on beside healthy ones of their rig; `searched`: the best fit of a setting.

    All healthy trials are fitted together: one load alone tells a ratio from a friction no more than one speed does.
    """
    first = build_problem(healthy, HealthyTrials(), None)
    found = searched(first)
    checked = tuple(n for n in first.checked if not relations.allowed(trials)[n])
    prior = _sessions(found, first)
    nuisance = tuple(_band(f, found.values[f.name], sigma) for f, sigma in zip(
        found.free, np.sqrt(np.diag(prior.covariance)).tolist(), strict=True))
    reference = HealthyReference("healthy", dict(found.values), nuisance, prior=prior)
    rests = {n: [b.residual(found.values) for b in first.blocks if b.relation.name == n] for n in checked}
    blocks: list[Block] = [b for b in relations.blocks_of(trials, checked, None, first.rate_hz) if b.keep.size]
    # what a law lacks is a share of what it says: of twice the force it is twice as much
    floors = {n: math.hypot(1.0, STRUCTURE) * rmse(r) * max(1.0, _spread(blocks, n) / _spread(first.blocks, n))
              for n, r in rests.items()}
    weights = {n: floors[n] * math.sqrt(max(correlated(rests[n]), LEAST_CORRELATION_LENGTH)) for n in checked}
    folds = folds_of(np.concatenate([b.cycle for b in blocks]))
    offered = [_whole(c, reference) for c in offered_on(blocks, checked, reference)]
    return ProblemSetting(False, relations.allowed(trials), checked, blocks, folds, reference, reference.values,
                          weights,
                          floors, offered, rate_hz=first.rate_hz)


def _whole(effect: Candidate, reference: HealthyReference) -> Candidate:
    """Return cable friction with every part of it that the healthy trials have: dry, of the load, and viscous.

    On a bench the sheath's friction is a share of the load alone; another seal, or a drier one, rubs otherwise in all:
    one change, which no more parameters are counted for than one.
    """
    if effect.name != WHOLE:
        return effect
    own = tuple(Free(f.name, *RELATION_PARAMETERS[f.name].rig_bounds, f.mean, math.inf, f.scale)
                for f in reference.nuisance if f.name in PARTS and f.name not in effect.parameters and f.mean != 0.0)
    return replace(effect, frees=(*effect.frees, *own), counted=len(effect.frees))


def _spread(blocks: Sequence[Block], name: str) -> float:
    """Return the standard deviation of what a relation predicts, within each trial."""
    return rmse(v - v.mean() for b in blocks if b.relation.name == name
                for v in (b.signals[b.relation.output][b.keep],))


def _sessions(found: Fit, setting: ProblemSetting) -> Prior:
    """Return what constants differ by from one session to another: each by itself, and the friction as a whole by less.

    δ = Σ aᵢ·δθᵢ is the relative change of the friction F = Σ θᵢ·∂r/∂θᵢ along itself, aᵢ = ⟨∂r/∂θᵢ, F⟩ / ⟨F, F⟩, by
    relation; its 1σ is `DAILY`.
    """
    names = tuple(f.name for f in found.free)
    apart = np.array([_daily(name, found, setting) for name in names])
    information = np.diag(1.0 / np.maximum(apart, 1e-3 * np.array([f.scale for f in found.free])) ** 2)
    rubs = np.array([_rubs(name) for name in names])
    at = np.array([found.values[name] for name in names])
    for relation in setting.checked:
        rows = [np.zeros((len(names), 0))]
        for i, block in enumerate(setting.blocks):
            if block.relation.name == relation:
                slopes = np.zeros((len(names), found.slopes[i].shape[1]))
                slopes[found.reads[i]] = found.slopes[i]
                rows.append(slopes)
        slopes = np.concatenate(rows, axis=1) * rubs[:, None]
        friction = at @ slopes
        if (size := float(friction @ friction)) > 0.0:
            along = slopes @ friction / size
            information += np.outer(along, along) / DAILY**2
    return Prior(names, np.linalg.inv(information))


def _rubs(name: str) -> bool:
    p = RELATION_PARAMETERS[name]
    return name not in FIRM and not p.turning and not (p.free and (p.neutral is not None or p.nominal == 1.0))


def _daily(name: str, found: Fit, setting: ProblemSetting) -> float:
    """Return 1σ of a constant from one day to another."""
    p, at = RELATION_PARAMETERS[name], found.values[name]
    if p.free and p.neutral is None and p.nominal == 1.0:
        return DAILY_RATIO * abs(at)
    if p.free and p.neutral is not None:
        peak = max(float(np.nanmax(np.abs(b.signals[b.relation.output]))) for b in setting.blocks if name in b.uses)
        return DAILY_ZERO * peak
    if p.unit == "rad" and p.turning:
        return DAILY_ANGLE
    return FIRM.get(name, DAILY_PART) * abs(at)


def _band(f: Free, at: float, sigma: float) -> Free:
    """Return the band of a constant about its healthy value."""
    sigma = max(sigma, 1e-3 * f.scale)
    low, high = RELATION_PARAMETERS[f.name].rig_bounds
    return Free(f.name, max(low, at - BAND * sigma), min(high, at + BAND * sigma), at, sigma, sigma)
