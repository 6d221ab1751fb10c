"""Diagnosis of a rig of another kind: its reference model is fitted from its reference trials with catalogue effects.

Reference trials select the submodels and constants of the rig. Another trial is compared with this model inside
session-to-session bands, never with an ideal transmission.
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
"""1σ of a rig's total friction between sessions, as a share of it; measured on a rubber seal over five sessions."""
DAILY_PART: Final = 0.25
"""1σ between sessions of each part of the friction (dry, load-dependent, viscous), as a share of it. A single session
separates the parts less well than the total; 0.18 was measured on the seal."""
FIRM: Final = {"stiffness_scale": 0.03, "stiffness_shape": 0.03, "drive_inertia": 0.02,
               "unbalance": 0.02}
"""1σ between sessions of constants without friction, as a share of each; temperature changes a spring by percents."""
DAILY_ANGLE: Final = 0.02
"""1σ between sessions of the angle of a mass on a turning axis, rad: the zero of its encoder."""
DAILY_RATIO: Final = 0.005
"""1σ between sessions of the ratio of two sensors, as a share of it."""
DAILY_ZERO: Final = 0.002
"""1σ between sessions of a sensor's zero, as a share of its signal's peak."""
WHOLE: Final = "cable_friction"
PARTS: Final = ("coulomb", "viscous")
STRUCTURE: Final = 0.5
"""Systematic error in which two sessions differ, as a share of the residual in the reference condition."""


def against_healthy(trials: Sequence[Table], healthy: Sequence[Table],
                    searched: Callable[[ProblemSetting], Fit]) -> ProblemSetting:
    """Return the setting of `trials` with a reference fitted to `healthy` trials of their rig.

    `searched`: function that returns the best fit of a setting. All reference trials are fitted together, because one
    load cannot separate a ratio from friction, nor can one speed.
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
    # systematic error is a share of the predicted value: at twice the force it is twice as large
    floors = {n: math.hypot(1.0, STRUCTURE) * rmse(r) * max(1.0, _spread(blocks, n) / _spread(first.blocks, n))
              for n, r in rests.items()}
    weights = {n: floors[n] * math.sqrt(max(correlated(rests[n]), LEAST_CORRELATION_LENGTH)) for n in checked}
    folds = folds_of(np.concatenate([b.cycle for b in blocks]))
    offered = [_whole(c, reference) for c in offered_on(blocks, checked, reference)]
    return ProblemSetting(False, relations.allowed(trials), checked, blocks, folds, reference, reference.values,
                          weights,
                          floors, offered, rate_hz=first.rate_hz)


def _whole(effect: Candidate, reference: HealthyReference) -> Candidate:
    """Return cable friction with all friction parts of the reference model: dry, load-dependent and viscous.

    On the bench, sheath friction is proportional to load alone. Another seal, or a drier one, changes all parts at
    once; this is one change and is charged as the parameters of one.
    """
    if effect.name != WHOLE:
        return effect
    own = tuple(Free(f.name, *RELATION_PARAMETERS[f.name].rig_bounds, f.mean, math.inf, f.scale)
                for f in reference.nuisance if f.name in PARTS and f.name not in effect.parameters and f.mean != 0.0)
    return replace(effect, frees=(*effect.frees, *own), counted=len(effect.frees))


def _spread(blocks: Sequence[Block], name: str) -> float:
    """Return the standard deviation of an equation's measured output, pooled within trials."""
    return rmse(v - v.mean() for b in blocks if b.relation.name == name
                for v in (b.signals[b.relation.output][b.keep],))


def _sessions(found: Fit, setting: ProblemSetting) -> Prior:
    """Return the prior of the constants between sessions: 1σ of each, and a smaller 1σ of the total friction.

    δ = Σ aᵢ·δθᵢ is the relative change of the friction F = Σ θᵢ·∂r/∂θᵢ, projected on F: aᵢ = ⟨∂r/∂θᵢ, F⟩ / ⟨F, F⟩, by
    equation. Its 1σ is `DAILY`.
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
    """Return 1σ of a constant between sessions, in its unit."""
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
    """Return the band of a constant about its reference value."""
    sigma = max(sigma, 1e-3 * f.scale)
    low, high = RELATION_PARAMETERS[f.name].rig_bounds
    return Free(f.name, max(low, at - BAND * sigma), min(high, at + BAND * sigma), at, sigma, sigma)
