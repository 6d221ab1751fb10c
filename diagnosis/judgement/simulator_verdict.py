"""Top line of a diagnosis: RMS error of the simulation of this bench in START and END, before and after.

The figures are of a holdout or of held-out cycles. The simulated bench has the constants that fit the reference trials,
plus the changes found by the trial's own fit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis import simulation
from diagnosis.data.table import Table
from diagnosis.judgement.judge import Judge
from diagnosis.problem import simulated_blocks
from diagnosis.problem.blocks import cycles_of, signals_of
from diagnosis.problem.healthy_trials import HealthyTrials
from diagnosis.search.search import FittedEffects

Values = Mapping[str, float]
TAUGHT = 3
"""Most reference trials simulated for comparison: enough for a figure, in about the time of the trial itself."""


def judged(judge: Judge, trials: Sequence[Table], holdout: Sequence[Table], healthy: HealthyTrials
           ) -> dict[str, Any] | None:
    """Return `before_rms_n` and `after_rms_n`, N, their `signals` and data (`on`); None without simulation.

    `healthy_rms_n`: RMS error of the same simulation on the reference trials of its fit; None without reference trials.
    """
    setting = judge.setting
    able = [t for t in (holdout or trials) if simulated_blocks.can(t)]
    if setting.any_rig or setting.elsewhere or not able:
        return None
    signals = [n for n in simulation.SIGNALS if any(n in t for t in able)]
    base = healthy.simulated(setting.learnt) if setting.learnt is not None else dict(setting.reference.values)
    before, after = judge.found.baseline, judge.found.best
    taught = [t for t in healthy if simulated_blocks.can(t)][:TAUGHT]
    known = {"signals": signals, "healthy_rms_n": simulation.rms(taught, base) if taught else None}
    if holdout:
        told = [simulation.rms(able, _moved(base, setting.reference.values, m.fit.values)) for m in (before, after)]
        return {"before_rms_n": told[0], "after_rms_n": told[1], **known, "on": "holdout"}
    told = [_unseen(judge, m, trials, base) for m in (before, after if after.effects else before)]
    return {"before_rms_n": told[0], "after_rms_n": told[1], **known, "on": "cycles that the fit has not seen"}


def _moved(base: Values, learnt: Values, fitted: Values) -> dict[str, float]:
    return {**fitted, **{n: base[n] + fitted[n] - learnt[n] for n in base if n in learnt}}


def _unseen(judge: Judge, model: FittedEffects, trials: Sequence[Table], base: Values) -> float | None:
    """Return the RMS over the first fold's cycles, N, with values fitted to the other cycles; None without samples."""
    values = _moved(base, judge.setting.reference.values, model.unseen.fitted[0])
    total, count, first = 0.0, 0, 0
    for given in trials:
        if not simulated_blocks.can(given):
            continue
        cycle = cycles_of(signals_of(given, 1e9))
        cycle = cycle - cycle[0] + first
        first = int(cycle[-1]) + 1
        inside = np.isin(cycle, list(judge.setting.folds[0])) & simulation.counted(given)
        for rest in _rests(given, values, inside):
            total, count = total + float(rest @ rest), count + rest.size
    return math.sqrt(total / count) if count else None


def _rests(given: Table, values: Values, inside: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
    told = simulation.simulate(given, values)
    return [(given[n] - getattr(told, n))[inside & np.isfinite(given[n])] for n in simulation.SIGNALS if n in given]
