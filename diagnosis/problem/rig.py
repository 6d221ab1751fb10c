"""Before and after on a rig of any kind: what its healthy trials need of the catalogue is its healthy state.

The rule of this file: the healthy trials say which laws the rig follows and how far its trials differ from each other;
another trial is compared with that, inside those bands, and never with an ideal transmission.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from diagnosis.data.table import Table
from diagnosis.problem import blocks as relations
from diagnosis.problem.blocks import Block, rmse
from diagnosis.problem.candidates import candidates
from diagnosis.problem.cross_validation import folds_of
from diagnosis.problem.deviations import correlated
from diagnosis.problem.fit import Fit, Free, Problem, solve
from diagnosis.problem.floors import LEAST_CORRELATION_LENGTH
from diagnosis.problem.healthy_trials import HealthyTrials
from diagnosis.problem.problem import Setting, build_problem
from diagnosis.problem.reference import BAND, Reference
from physics.parameters import RELATION_PARAMETERS

LEAST_SPREAD: Final = 0.05
"""1σ between trials of one rig, of a value, where few trials say less."""


def against_healthy(trials: Sequence[Table], healthy: Sequence[Table], searched: Callable[[Setting], Fit]) -> Setting:
    """Return what `trials` are judged on beside healthy ones of their rig; `searched`: the best fit of a setting."""
    first = build_problem(healthy, HealthyTrials(), None)
    found = searched(first)
    checked = tuple(n for n in first.checked if not relations.allowed(trials)[n])
    rate = min(relations.working_rate(group) for group in (trials, healthy))
    by_trial = [relations.blocks_of([t], checked, None, rate) for t in healthy]
    alone = [solve(Problem(b, first.weights), found.values, found.free).values for b in by_trial]
    nuisance = tuple(_band(f, [a[f.name] for a in alone]) for f in found.free)
    reference = Reference("healthy", {**found.values, **{f.name: f.mean for f in nuisance}}, nuisance)
    rests: dict[str, list[np.ndarray]] = {n: [] for n in checked}
    for part in by_trial:
        values = solve(Problem(part, first.weights), reference.values, nuisance).values
        for block in part:
            rests[block.relation.name].append(block.residual(values))
    floors = {n: rmse(r) for n, r in rests.items()}
    weights = {n: floors[n] * math.sqrt(max(correlated(rests[n]), LEAST_CORRELATION_LENGTH)) for n in checked}
    blocks: list[Block] = [b for b in relations.blocks_of(trials, checked, None, rate) if b.keep.size]
    folds = folds_of(np.concatenate([b.cycle for b in blocks]))
    offered = candidates(checked, reference.values, nuisance, True)
    return Setting(False, relations.allowed(trials), checked, blocks, folds, reference, reference.values, weights,
                   floors, offered, rate_hz=rate)


def _band(f: Free, values: Sequence[float]) -> Free:
    """Return the band that the trials' own values of a parameter give."""
    mean, n = float(np.mean(values)), len(values)
    spread = float(np.std(values, ddof=1)) if n > 1 else 0.0
    sigma = max(spread, LEAST_SPREAD * abs(mean), 1e-3 * f.scale) * math.sqrt(1.0 + 1.0 / n)
    low, high = RELATION_PARAMETERS[f.name].rig_bounds
    return Free(f.name, max(low, mean - BAND * sigma), min(high, mean + BAND * sigma), mean, sigma, sigma)

