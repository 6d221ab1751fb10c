"""Search over hypotheses about one trial: no effect (the null), single effects, and pairs with the best effect.

A linear screen ranks the effects of the catalogue; only the first few are fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from scipy.special import logsumexp

from diagnosis.evidence.session_change import averaged, feature_sd, under
from estimation.posterior import (
    Gaussian,
    PosteriorMode,
    SessionData,
    begun,
    error_factor,
    freed,
    mode,
    response_error,
    screened,
)
from estimation.reference_fit import ReferenceFit
from physics.effects.hypotheses import Variant
from physics.laws import Array

FOREMOST: Final = 7
"""Number of effects that are fitted after a linear screen at the null's mode; half of it after any other ranking.

If it is too small, a screen may miss the true effect; the time of a search grows with it."""


@dataclass
class TrialModes:
    """Modes of one trial: `null`, `single` by effect, and `pair` by best and second effect.

    `reference`: reference condition.
    `prior`: prior of the session at the minimum of the best effect.  `variants`: the variant that each effect of
    `single` was fitted with.  `paired`: that of each second effect.  `refused`: effects that are no candidates, since
    their best value is outside their bounds.  `session_priors`: log probability and prior of each scatter between
    sessions over which evidence is averaged (none: that of `prior` alone).  `each_dispersed`: each effect has its
    mode's overdispersion, not that of the best one.  `other_minimum`: function of these modes that returns the same
    trial at another minimum of the reference condition.
    """

    observed: SessionData
    prior: Gaussian
    reference: ReferenceFit
    null: PosteriorMode
    single: dict[str, PosteriorMode] = field(default_factory=dict)
    variants: dict[str, Variant] = field(default_factory=dict)
    pair: dict[tuple[str, str], PosteriorMode] = field(default_factory=dict)
    paired: dict[str, Variant] = field(default_factory=dict)
    refused: set[str] = field(default_factory=set)
    session_priors: Sequence[tuple[float, Gaussian]] = ()
    each_dispersed: bool = False
    other_minimum: Callable[[TrialModes], OtherMinimum] | None = None
    # `_beside` of each pair of modes that was asked, since every ranking asks all of them again
    _known: list[tuple[PosteriorMode, PosteriorMode, float]] = field(default_factory=list)

    def gains(self) -> dict[str, float]:
        """Return the log Bayes factor, nats, of each candidate against the null, best first."""
        return self._against(self.null, self.single, self.variants)

    def further(self, name: str) -> dict[str, float]:
        """Return the log Bayes factor, nats, of each pair with effect `name` against `name` alone, best first."""
        return self._against(self.single[name], {b: at for (a, b), at in self.pair.items() if a == name}, self.paired)

    def _against(self, base: PosteriorMode, offered: Mapping[str, PosteriorMode], variants: Mapping[str, Variant]
                 ) -> dict[str, float]:
        """Return the log Bayes factor, nats, of each candidate against `base`, over the best mode's overdispersion.

        With `each_dispersed` it is that of the better of candidate and `base`.
        """
        candidates = {name: at for name, at in offered.items() if name not in self.refused}
        found = {name: (at.log_evidence - base.log_evidence + self._beside(base, at, variants[name]))
                 / self.overdispersion(base, *((at,) if self.each_dispersed else candidates.values()))
                 for name, at in candidates.items()}
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def _beside(self, base: PosteriorMode, at: PosteriorMode, variant: Variant) -> float:
        """Return by how much the evidence of `variant` falls, nats, since what else changed is known to `SURROGATE`.

        What else changed in the mode `at` is the session, and a first effect.  Its error is in both modes.
        """
        if self.observed.model.pools_sessions:
            return 0.0
        known = next((nats for first, second, nats in self._known if first is base and second is at), None)
        if known is None:
            others = sorted(set(at.table.free) - set(freed(at.table, [variant])))
            error = response_error(at, self.observed, self.prior, others)
            known = min(0.0, error_factor(at, error) - error_factor(base, error))
            self._known.append((base, at, known))
        return known

    def overdispersion(self, *modes: PosteriorMode) -> float:
        """Return the variance of sessions about the reference condition over the expected one, at least 1.

        It is pooled over the reference trials and the trial, by the directions that each determines.  Constants that
        depart by more than their scatter even in the best of `modes` depart by a model error. A log likelihood is taken
        for one of so many times the variance (quasi-likelihood, Wedderburn 1974).  Pooled sessions have no scatter.
        """
        if self.observed.model.pools_sessions:
            return 1.0
        own, others = max(modes, key=lambda at: at.log_evidence).departure, self.reference.departure
        return max(1.0, (own.squared + others.squared) / (own.directions + others.directions))


class OtherMinimum(NamedTuple):
    """A trial at another minimum of the reference condition, and a start for its null.

    `modes`: without any effect.  `nats`: log evidence of the reference trials there less that at the first minimum.
    """

    modes: TrialModes
    nats: float
    start: Array


def joint_minimum(found: TrialModes) -> OtherMinimum:
    """Return a trial at the best joint minimum of the reference trials and itself."""
    assert found.reference.joint_minimum is not None
    fit, nats, start = found.reference.joint_minimum(found.reference, found.observed.trials[0], found.null.x)
    return OtherMinimum(replace(found, prior=fit.prior_of(found.observed), reference=fit, single={}, variants={},
                                session_priors=fit.session_priors_of(found.observed)), nats, start)


def hypotheses(observed: SessionData, constants: Mapping[str, float]) -> dict[str, tuple[Variant, ...]]:
    """Return the variants, at `constants` of the bench, of each effect whose needed outputs were observed."""
    offered = {name: h.variants(constants) for name, h in observed.model.hypotheses.items()
               if set(h.needs) <= set(observed.outputs)}
    return {name: variants for name, variants in offered.items() if variants}


def search(observed: SessionData, prior: Gaussian, reference: ReferenceFit,
           session_priors: Sequence[tuple[float, Gaussian]] = (), effects: bool = True) -> TrialModes:
    """Fit the null and the effects that the screen ranks first, and restart the fits from each other's modes.

    The null starts at the prior's mean and at the modes of the trials of the `reference` condition.  `effects`: False
    for the null alone.
    """
    starts = (None, *reference.starts()) if effects else (None,)
    null = max((mode(observed, prior, start=at) for at in starts), key=lambda m: m.log_evidence)
    found = TrialModes(observed, prior, reference, null, session_priors=session_priors,
                       other_minimum=None if reference.joint_minimum is None else joint_minimum)
    found.null = _averaged(found, null)
    if not effects:
        return found
    offered = hypotheses(observed, observed.model.constants.named(prior.origin))
    # at the reference constants no constant has taken up an effect
    _screen(found, offered, mode(observed, prior, descends=False), FOREMOST // 2)
    _screen(found, offered, found.null, FOREMOST)
    while _restarted(found):
        _screen(found, offered, found.null, FOREMOST)
    _cross(found)
    return found


def search_other_minimum(found: TrialModes, least: float, clear: float = 10.0) -> None:
    """Fit the null and the best effects at another minimum of the reference condition, too, once.

    The larger evidence counts, that of the reference trials included.  On a bench of another structure minima are
    several, and the reference trials' own one may hold the trial for changed although another one predicts them all.
    Only an effect that is detected, with the log Bayes factor `least`, is so examined, and none with `clear` times
    that: another minimum changes it by some 20 nats.
    """
    best = max(found.gains().values(), default=0.0)
    if found.other_minimum is None or not least <= best < clear * least:
        return
    other, nats, start = found.other_minimum(found)
    fitted = [at for x in (start, found.null.x) if (at := _fit(other, [], x)) is not None]
    if not fitted:
        return
    other.null = max(fitted, key=lambda at: at.log_evidence)
    for name in list(found.gains())[:FOREMOST]:
        variant = found.variants[name]
        for x in (found.single[name].x, begun(other.null, variant)):
            _keep(other, name, variant, _fit(other, [variant], x))
    highest, there = (max(at.log_evidence for at in (modes.null, *modes.single.values())) for modes in (found, other))
    found.other_minimum = None  # asked once
    if there + nats > highest:
        found.observed, found.prior, found.reference = other.observed, other.prior, other.reference
        found.session_priors = other.session_priors
    found.null = max(found.null, _shifted(other.null, nats), key=lambda at: at.log_evidence)
    for name, at in other.single.items():
        _keep(found, name, other.variants[name], _shifted(at, nats))


def _shifted(at: PosteriorMode, nats: float) -> PosteriorMode:
    return replace(at, log_evidence=at.log_evidence + nats)


def search_pairs(found: TrialModes, best: str) -> None:
    """Fit pairs of `best` with the effects that a linear screen at its mode ranks first."""
    offered = hypotheses(found.observed, found.observed.model.constants.named(found.prior.origin))
    at, first = found.single[best], found.variants[best]
    rated = []
    for name, variants in offered.items():
        for variant in variants:
            if name != best and not _same_shape(first, variant):
                gain, sizes = screened(at, found.observed, variant)
                rated.append((gain, name, variant, sizes))
    taken: set[str] = set()
    for _, name, variant, sizes in sorted(rated, key=lambda r: -r[0]):
        if name in taken:
            continue
        taken.add(name)
        fitted = _fit(found, [first, variant], begun(at, variant, sizes, [first]))
        if fitted is not None:
            found.pair[(best, name)], found.paired[name] = fitted, variant
        if len(taken) == FOREMOST // 2:
            return


def _same_shape(first: Variant, second: Variant) -> bool:
    """Return whether two variants set one constant to different values, so that no simulation can have both."""
    return any(second.at.get(name, value) != value for name, value in first.at.items())


def _screen(found: TrialModes, offered: Mapping[str, tuple[Variant, ...]], base: PosteriorMode, most: int) -> None:
    """Fit the `most` effects that a linear screen at `base` ranks first: the null's mode or the reference constants."""
    rated = []
    for name, variants in offered.items():
        gain, sizes, variant = max(((*screened(base, found.observed, v), v) for v in variants),
                                   key=lambda r: float(r[0]))
        rated.append((gain, name, variant, sizes))
    for _, name, variant, sizes in sorted(rated, key=lambda r: -r[0])[:most]:
        fitted = _fit(found, [variant], begun(base, variant, sizes))
        _keep(found, name, variant, fitted)
        if fitted is None or fitted.cost > found.null.cost:
            # an effect contains the null, so that this is no mode; a variant that sets no constant has the null's own
            variant = next((v for v in offered[name] if not v.at), variant)
            _keep(found, name, variant, _fit(found, [variant], begun(found.null, variant)))


def _fit(found: TrialModes, variants: list[Variant], start: Array) -> PosteriorMode | None:
    """Return the mode with the effects `variants`, with its averaged evidence; None if it is singular."""
    try:
        fitted = _averaged(found, mode(found.observed, found.prior, variants, start), variants)
    except (np.linalg.LinAlgError, ValueError):
        return None
    return fitted if np.isfinite(fitted.log_evidence) else None


def _averaged(found: TrialModes, at: PosteriorMode, variants: Sequence[Variant] = ()) -> PosteriorMode:
    """Return a mode with its evidence averaged over how far constants and discrepancy scatter between sessions."""
    amplitude, shares = feature_sd(found.reference), found.observed.model.session_shares
    nats = [weight + averaged(under(at, prior, variants), amplitude, shares) for weight, prior in found.session_priors]
    return replace(at, log_evidence=float(logsumexp(nats)) if nats else averaged(at, amplitude, shares))


def _keep(found: TrialModes, name: str, variant: Variant, fitted: PosteriorMode | None) -> bool:
    """Store a mode if its evidence is the largest of the effect so far; return whether it was stored."""
    old = found.single.get(name)
    if fitted is None or (old is not None and old.log_evidence >= fitted.log_evidence):
        return False
    found.single[name], found.variants[name] = fitted, variant
    return True


def _restarted(found: TrialModes, least: float = 2.0) -> bool:
    """Refit the null from the modes of better effects; return whether its log evidence rose by `least` nats or more."""
    before = found.null.log_evidence
    for name in [name for name, gain in found.gains().items() if gain >= least][:FOREMOST // 2]:
        again = _fit(found, [], begun(found.single[name], None))
        if again is not None and again.log_evidence > found.null.log_evidence:
            found.null = again
    return found.null.log_evidence >= before + least


def _cross(found: TrialModes) -> None:
    """Refit the best effects from the best mode of all, if that is not the null's, and the null once more."""
    if not found.single:
        return
    order = list(found.gains())[:FOREMOST // 2]
    best = max([found.null, *found.single.values()], key=lambda at: at.log_evidence)
    for name in order:
        if found.single[name] is not best and best is not found.null:
            variant = found.variants[name]
            _keep(found, name, variant, _fit(found, [variant], begun(best, variant)))
    _restarted(found)
