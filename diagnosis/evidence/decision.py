"""Verdict of one search: detection threshold, ambiguity set, part of the bench, second effect, lack of fit.

Evidence is not calibrated by itself, since every model is wrong: `python -m tests.hidden.evidence_calibration` prints
the quantiles of the development family that the threshold and the set's share come from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.evidence.hypothesis_search import Searched, search_pairs
from physics.effects.hypotheses import HYPOTHESES
from physics.laws import Array

NAMED_NATS: Final = 20.0
"""Log Bayes factor from which an effect is named: above what 98 % of the development family's reference trials reach.

Too low, reference trials are named; too high, small effects are missed."""
SET_SHARE: Final = 0.5
"""Share of the best log Bayes factor from which an effect is in the ambiguity set; the set holds the truth in 95 %."""
FURTHER_SHARE: Final = 0.05
"""Share of the first effect's log Bayes factor that a second effect must reach: a surrogate's own lack of fit."""
MISFIT: Final = 2.5
"""Mean squared residual of an output over its variance from which the fit lacks something."""


@dataclass(frozen=True)
class Decision:
    """What is decided of one trial.

    `verdict`: none, found, ambiguous or unexplained.  `chosen`: the effects that explain the trial, best first;
    `among`: the ambiguity set, the chosen ones first; `part`: part of the bench that the best effect lies in;
    `misfit`: mean squared residual over variance, by output, of the best model.
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
    best = next(iter(gains), None)
    if best is None or gains[best] < NAMED_NATS:
        misfit = misfits(found, found.null.residual)
        word = "unexplained" if max(misfit.values()) > MISFIT else "none"
        return Decision(word, (), (), None, gains, misfit)
    search_pairs(found, best)
    further = found.further(best)
    second = next(iter(further), None)
    chosen: tuple[str, ...] = (best,)
    at = found.single[best]
    if second is not None and further[second] >= max(NAMED_NATS, FURTHER_SHARE * gains[best]):
        chosen, at = (best, second), found.pair[(best, second)]
    misfit = misfits(found, at.residual)
    if max(misfit.values()) > MISFIT:
        return Decision("unexplained", (), (), HYPOTHESES[best].part, gains, misfit)
    among = _set(gains, chosen)
    if len(chosen) == 2:
        among += tuple(n for n in _set(further, (chosen[1],)) if n not in among)
    return Decision("found" if len(among) == len(chosen) else "ambiguous", chosen, among, HYPOTHESES[best].part, gains,
                    misfit)


def _set(gains: dict[str, float], chosen: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ambiguity set of a ranking, `chosen` first."""
    best = max(gains.values())
    return (*chosen, *(n for n, gain in gains.items() if n not in chosen and gain >= SET_SHARE * best))


def misfits(found: Searched, residual: Array) -> dict[str, float]:
    """Return, by output, the mean squared residual over its variance, outliers bounded at 25."""
    observed = found.observed
    return {name: float(np.mean(np.minimum(observed.part(residual**2 * observed.weight, k), 25.0)))
            for k, name in enumerate(observed.outputs)}


def none(decided: Decision) -> Decision:
    """Return the decision without a cause named."""
    return Decision("none", (), (), None, decided.gains, decided.misfit)


def unexplained(decided: Decision) -> Decision:
    """Return the decision as one that no effect of the catalogue explains."""
    return Decision("unexplained", (), (), decided.part, decided.gains, decided.misfit)
