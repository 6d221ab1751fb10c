"""Verdict of one search: detection threshold, ambiguity set, part of the bench, second effect, lack of fit.

Evidence is not calibrated by itself, since every model is wrong: `python -m tests.hidden.evidence_calibration` prints
the quantiles of the development family that the threshold and the set's share come from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.evidence.hypothesis_search import Searched, search_pairs
from diagnosis.evidence.posterior import PosteriorMode

NAMED_NATS: Final = 12.0
"""Log Bayes factor from which an effect is named: 3 % of the development family's reference trials exceed it.

Too low, reference trials are named; too high, small effects are missed."""
IMITATED: Final = {"stiffness": 2.0, "end_filter": 2.0}
"""Factor of `NAMED_NATS` for effects that model error imitates: reference trials reach 18 and 22 nats."""
SET_SHARE: Final = 0.5
"""Share of the best log Bayes factor from which an effect is in the ambiguity set; the set holds the truth in 95 %."""
FURTHER_NATS: Final = 20.0
FURTHER_SHARE: Final = 0.05
"""Log Bayes factor, and share of the first effect's, that a second effect must reach: a surrogate's own lack of fit."""
MISFIT: Final = 1.6
"""Mean squared residual of an output over its variance from which the fit lacks something.  No reference trial of the
development family exceeds 1.2."""
STRAINED: Final = 2.0
"""Cost of the best model per datum, over that of reference trials, from which the fit lacks something: constants that
no session moves so far fit the data, too."""


@dataclass(frozen=True)
class Decision:
    """What is decided of one trial.

    `verdict`: none, found, ambiguous or unexplained.  `chosen`: the effects that explain the trial, best first;
    `among`: the ambiguity set, the chosen ones first; `part`: part of the bench that the best effect lies in;
    `misfit`: mean squared residual over variance, by output, of the best model, and as `session` its cost, misfit and
    departure of the constants from the bench, over that of a reference trial.
    """

    verdict: str
    chosen: tuple[str, ...]
    among: tuple[str, ...]
    part: str | None
    gains: dict[str, float]
    misfit: dict[str, float]


def decide(found: Searched) -> Decision:
    """Decide what the evidence of one trial supports."""
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
    """Return the ambiguity set of a ranking, `chosen` first."""
    best = max(gains.values())
    return (*chosen, *(n for n, gain in gains.items() if n not in chosen and gain >= SET_SHARE * best))


def misfits(found: Searched, at: PosteriorMode) -> dict[str, float]:
    """Return, by output, the mean squared residual over its variance, outliers bounded at 25, and the `session`'s cost.
    """
    observed, squares = found.observed, at.residual**2 * found.observed.weight
    told = {name: float(np.mean(np.minimum(observed.tau[k] * observed.part(squares, k), 25.0)))
            for k, name in enumerate(observed.outputs)}
    return told | {"session": at.cost / (observed.data.size * observed.cost)}


def lacks(misfit: Mapping[str, float], before: Mapping[str, float] | None = None) -> bool:
    """Return whether a model misses the data, or fits them by constants that no session moves so far.

    `before`: misfit of the null. An effect whose equation differs from the bench's leaves up to `FURTHER_SHARE` of it.
    """
    return any(value > max(STRAINED if name == "session" else MISFIT, FURTHER_SHARE * (before or {}).get(name, 0.0))
               for name, value in misfit.items())


def none(decided: Decision) -> Decision:
    """Return the decision without a cause named."""
    return Decision("none", (), (), None, decided.gains, decided.misfit)


def unexplained(decided: Decision) -> Decision:
    """Return the decision as one that no effect of the catalogue explains."""
    return Decision("unexplained", (), (), decided.part, decided.gains, decided.misfit)
