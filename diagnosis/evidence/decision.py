"""Verdict from the search of one trial: detection threshold, ambiguity set, part of the bench, second effect, lack of
fit.

The thresholds are calibrated on a development population of simulated benches, since the models have systematic
errors.  `python -m tests.hidden.evidence_calibration` prints the quantiles that they come from.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Final

import numpy as np
from scipy.linalg import cho_solve

from diagnosis.evidence.hypothesis_search import TrialModes, search_other_minimum, search_pairs
from estimation.forward_model import ForwardModel
from estimation.posterior import PosteriorMode, SessionData, freed, response_error
from physics.effects.hypotheses import Variant
from physics.laws import Array

NAMED_NATS: Final = 12.0
"""Least log Bayes factor, nats, of a named effect.

If it is too low, effects are named in reference trials; if it is too high, small effects are missed."""
DOUBTED: Final = 2.0
"""Factor where constants absorb model error: on `NAMED_NATS` of a second effect and of a name beside a lack of fit.

A model whose cost per datum is above that factor of the reference trials', and whose constants depart by that many
session σ, RMS, has a lack of fit, too."""
SET_SHARE: Final = 0.5
"""Least log Bayes factor of the ambiguity set, relative to the best one; the set contains the true effect in 95 %."""
FURTHER_SHARE: Final = 0.05
"""Share of the null's misfit above which the misfit of an effect is a lack of fit."""
MISFIT: Final = 1.6
"""Mean squared residual of an output over its variance, relative to that of the reference trials, above which the model
has a lack of fit.

No reference trial of the development population exceeds 1.2."""


@dataclass(frozen=True)
class Decision:
    """Verdict on one trial.

    `verdict`: none, found, ambiguous, or unexplained if nothing is chosen and the null has a lack of fit.  `chosen`:
    effects that explain the trial, best first.  `among`: ambiguity set, the chosen effects first.  `part`: part of the
    bench of the best effect.  `gains`: log Bayes factor of each effect, nats.  `misfit`: of the best model, by
    output (`SessionData.misfit`).  Its key `session`: the model's cost (misfit and prior), or the RMS departure of its
    constants and discrepancy, whichever is less; each relative to that of the reference trials.
    `lacking`: outputs (and `session`) in which the best model has a lack of fit; beside chosen effects it means that
    something else changed, too.
    """

    verdict: str
    chosen: tuple[str, ...]
    among: tuple[str, ...]
    part: str | None
    gains: dict[str, float]
    misfit: dict[str, float]
    lacking: tuple[str, ...] = ()


def decide(found: TrialModes) -> Decision:
    """Return the verdict that the evidence of one trial supports.

    If an effect is detected, modes at another minimum of the reference trials are added to `found`, and if one is
    named, pairs with the best effect.
    """
    least = threshold(found.observed.model)
    search_other_minimum(found, least)
    gains = found.gains()
    seen = detected(gains, least)
    if not seen:
        return unnamed(found)
    best = seen[0]
    part = found.observed.model.hypotheses[best].part
    search_pairs(found, best)
    further = found.further(best)
    seconds = detected(further, DOUBTED * least)
    chosen = (best, *seconds[:1])
    at = found.pair[(best, seconds[0])] if seconds else found.single[best]
    misfit = misfits(found, at, chosen_variants(found, chosen))
    among = _set(gains, chosen)
    if len(chosen) == 2:
        among += tuple(n for n in _set(further, (chosen[1],)) if n not in among)
    return Decision("found" if len(among) == len(chosen) else "ambiguous", chosen, among, part, gains,
                    misfit, lacking(misfit, misfits(found, found.null)))


def of_best(decided: Decision) -> Decision:
    """Return a decision for two effects without the second one, which did not change beside the first."""
    chosen = decided.chosen[:1]
    among = tuple(name for name in _set(decided.gains, chosen) if name != decided.chosen[1])
    return replace(decided, verdict="found" if len(among) == 1 else "ambiguous", chosen=chosen, among=among)


def chosen_variants(found: TrialModes, chosen: Sequence[str]) -> list[Variant]:
    """Return the variant of each chosen effect; a second effect has the variant of the fitted pair."""
    return [(found.paired if k else found.variants)[name] for k, name in enumerate(chosen)]


def unnamed(found: TrialModes) -> Decision:
    """Return the decision without an effect: `none`, or `unexplained` if the null has a lack of fit."""
    misfit = misfits(found, found.null)
    lack = lacking(misfit)
    return Decision("unexplained" if lack else "none", (), (), None, found.gains(), misfit, lack)


def threshold(model: ForwardModel) -> float:
    """Return the log Bayes factor, nats, from which an effect is named in the trials of one session."""
    return model.nats_factor * NAMED_NATS


def probabilities(gains: Mapping[str, float], least: float) -> dict[str, float]:
    """Return the probability of each effect with a positive log Bayes factor; the rest to 1 is that of no effect.

    Model error makes log Bayes factors too large, in proportion to themselves.  So the odds of an effect are normal in
    its share of the best one: the true effect has at least `SET_SHARE` in 95 %.  The odds of no effect are normal in
    the best one: reference trials reach the threshold `least` in 2 %.
    """
    seen = {name: gain for name, gain in gains.items() if gain > 0.0}
    if not seen:
        return {}
    best = max(seen.values())
    odds = {name: _odds((1.0 - gain / best) / (1.0 - SET_SHARE), 0.95) for name, gain in seen.items()}
    whole = sum(odds.values()) + _odds(best / least, 0.98)
    return {name: each / whole for name, each in odds.items()}


def _odds(departure: float, reached: float) -> float:
    """Return the density of a departure relative to that at 0, for a normal one that is below 1 in the share `reached`.
    """
    return math.exp(-0.5 * (departure * NormalDist().inv_cdf(0.5 + 0.5 * reached)) ** 2)


def detected(gains: Mapping[str, float], least: float) -> list[str]:
    """Return the effects whose log Bayes factor reaches the detection threshold `least`, in the order of `gains`."""
    return [name for name, gain in gains.items() if gain >= least]


def _set(gains: dict[str, float], chosen: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ambiguity set from log Bayes factors by effect, the `chosen` effects first."""
    best = max(gains.values())
    return (*chosen, *(n for n, gain in gains.items() if n not in chosen and gain >= SET_SHARE * best))


def misfits(found: TrialModes, at: PosteriorMode, variants: Sequence[Variant] = ()) -> dict[str, float]:
    """Return the misfit by output, `SessionData.misfit`, and `session` as defined in `Decision`.

    `variants`: effects of the mode, whose equations may be inexact.
    """
    observed = found.observed
    left = _left(at, [response_error(at, observed, found.prior, freed(at.table, [variant])) for variant in variants])
    told = dict(zip(observed.outputs, observed.misfit(left).tolist(), strict=True))
    return told | {"session": departure(observed, at)}


def departure(observed: SessionData, at: PosteriorMode) -> float:
    """Return how far a mode is from a reference trial's: `session` of `Decision.misfit`."""
    return min(at.cost / (observed.count * observed.cost * float(observed.growth.mean())),
               at.departure.rms / observed.own_strain)


def _left(at: PosteriorMode, errors: Sequence[Array]) -> Array:
    """Return the residual of a mode after Gaussian `errors` of the data, columns of 1σ, are fitted, too.

    The mode's own residual is exact; only the change by the errors is linear.
    """
    if not errors:
        return at.residual
    error, off = np.concatenate(errors, axis=1), at.x - at.prior_mean
    # C⁻¹[e, F] by Woodbury's identity, F the columns of `errors`, e the error about the prior's mean
    light = at.weight[:, None] * np.concatenate([(at.residual + at.design @ off)[:, None], error], axis=1)
    applied = light - at.weight[:, None] * (at.inward @ cho_solve(at.inner, at.inward.T @ light))
    # posterior mean of their sizes, (I + FᵀC⁻¹F)⁻¹FᵀC⁻¹e; what they take moves the mode, too
    size = np.linalg.solve(np.eye(error.shape[1]) + error.T @ applied[:, 1:], error.T @ applied[:, 0])
    return np.asarray(at.residual + at.inward @ (at.inward.T @ (applied[:, 1:] @ size)) - error @ size)


def lacking(misfit: Mapping[str, float], before: Mapping[str, float] | None = None) -> tuple[str, ...]:
    """Return the outputs in which a model has a lack of fit, and `session` for constants far outside their scatter.

    `before`: misfit of the null.  A misfit of up to `FURTHER_SHARE` of it is accepted, since the equation of an effect
    differs somewhat from the bench's.
    """
    return tuple(name for name, value in misfit.items() if value > max(
        DOUBTED if name == "session" else MISFIT, FURTHER_SHARE * (before or {}).get(name, 0.0)))
