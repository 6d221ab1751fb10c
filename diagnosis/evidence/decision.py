"""Verdict from the search of one trial: detection threshold, ambiguity set, part of the bench, second effect, lack of
fit.

The thresholds are calibrated on a development population of simulated benches, since the models have systematic
errors.  `python -m tests.hidden.evidence_calibration` prints the quantiles that they come from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.evidence.hypothesis_search import Searched, search_pairs
from diagnosis.evidence.posterior import PosteriorMode

NAMED_NATS: Final = 12.0
"""Least log Bayes factor, nats, of a named effect.

If it is too low, effects are named in reference trials; if it is too high, small effects are missed."""
IMITATED: Final = {"end_filter": 2.0, "drive_presliding": 2.0}
"""Factor on `NAMED_NATS` for effects confounded with model error: what reference trials reach, by effect."""
SET_SHARE: Final = 0.5
"""Least log Bayes factor of the ambiguity set, relative to the best one; the set contains the true effect in 95 %."""
FURTHER_NATS: Final = 20.0
FURTHER_SHARE: Final = 0.05
"""Least log Bayes factor, nats, of a second effect, and its least share of the first effect's.

Below it, a second effect may only absorb the lack of fit of the first effect's equation."""
MISFIT: Final = 1.6
"""Mean squared residual of an output over its variance above which the model has a lack of fit.

No reference trial of the development population exceeds 1.2."""
STRAINED: Final = 2.0
"""Cost per datum of the best model, relative to reference trials, above which the model has a lack of fit.

The cost includes the prior, so that a good fit by constants far outside the session scatter exceeds it, too."""


@dataclass(frozen=True)
class Decision:
    """Verdict on one trial.

    `verdict`: none, found, ambiguous or unexplained.  `chosen`: effects that explain the trial, best first.  `among`:
    ambiguity set, the chosen effects first.  `part`: part of the bench of the best effect.  `gains`: log Bayes factor
    of each effect, nats.  `misfit`: mean squared residual of the best model over its variance, by output; under
    `session`, the model's cost (misfit and prior) relative to that of a reference trial.
    """

    verdict: str
    chosen: tuple[str, ...]
    among: tuple[str, ...]
    part: str | None
    gains: dict[str, float]
    misfit: dict[str, float]


def decide(found: Searched) -> Decision:
    """Return the verdict that the evidence of one trial supports.

    If an effect is named, pairs with the best effect are fitted and added to `found`.
    """
    gains = found.gains()
    factor = found.observed.model.nats_factor
    named = [name for name, gain in gains.items() if gain >= factor * IMITATED.get(name, 1.0) * NAMED_NATS]
    if not named:
        misfit = misfits(found, found.null)
        return Decision("unexplained" if lacks(misfit) else "none", (), (), None, gains, misfit)
    best = named[0]
    part = found.observed.model.hypotheses[best].part
    search_pairs(found, best)
    further = found.further(best)
    second = next(iter(further), None)
    chosen: tuple[str, ...] = (best,)
    at = found.single[best]
    if second is not None and further[second] >= max(FURTHER_NATS, FURTHER_SHARE * gains[best]):
        chosen, at = (best, second), found.pair[(best, second)]
    misfit = misfits(found, at)
    if lacks(misfit, misfits(found, found.null)):
        return Decision("unexplained", (), (), part, gains, misfit)
    among = _set(gains, chosen)
    if len(chosen) == 2:
        among += tuple(n for n in _set(further, (chosen[1],)) if n not in among)
    return Decision("found" if len(among) == len(chosen) else "ambiguous", chosen, among, part, gains,
                    misfit)


def _set(gains: dict[str, float], chosen: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ambiguity set from log Bayes factors by effect, the `chosen` effects first."""
    best = max(gains.values())
    return (*chosen, *(n for n, gain in gains.items() if n not in chosen and gain >= SET_SHARE * best))


def misfits(found: Searched, at: PosteriorMode) -> dict[str, float]:
    """Return the mean squared residual over its variance by output, and the relative cost under `session`.

    Squares are clipped at 25, so that outliers count little.
    """
    observed, squares = found.observed, at.residual**2 * found.observed.weight / found.observed.growth
    told = {name: float(np.mean(np.minimum(observed.tau[k] * observed.part(squares, k), 25.0)))
            for k, name in enumerate(observed.outputs)}
    return told | {"session": at.cost / (observed.data.size * observed.cost * float(observed.growth.mean()))}


def lacks(misfit: Mapping[str, float], before: Mapping[str, float] | None = None) -> bool:
    """Return whether a model has a lack of fit, in an output or by constants far outside the session scatter.

    `before`: misfit of the null.  A misfit of up to `FURTHER_SHARE` of it is accepted, since the equation of an effect
    differs somewhat from the bench's.
    """
    return any(value > max(STRAINED if name == "session" else MISFIT, FURTHER_SHARE * (before or {}).get(name, 0.0))
               for name, value in misfit.items())


def none(decided: Decision) -> Decision:
    """Return the decision with verdict `none` and without effects."""
    return Decision("none", (), (), None, decided.gains, decided.misfit)


def unexplained(decided: Decision) -> Decision:
    """Return the decision with verdict `unexplained` and without effects."""
    return Decision("unexplained", (), (), decided.part, decided.gains, decided.misfit)
