"""Errors on held-out cycles: a cycle that is left out is predicted as by a fit without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.evidence.held_out import blocks_of, left_out, rest
from estimation.path_model import PATH_MODEL
from estimation.posterior import mode
from tests.hidden.family import Job, case

BENCH = Job(39, (), 9, cycles=3)


def test_a_cycle_that_is_left_out_is_predicted_as_by_a_fit_without_it() -> None:
    made = case(BENCH)
    fit = EvidenceFinder(made.healthy[:1]).reference([made.trial])
    observed = fit.observe(PATH_MODEL.record(made.trial))
    prior = fit.prior_of(observed)
    at = mode(observed, prior)
    cycles = np.tile(blocks_of([made.trial], observed.trials)[0], len(observed.outputs))
    own = cycles == 0
    without = mode(replace(observed, weight=np.where(own, 1e-12, observed.weight)), prior, start=at.x)
    predicted, fitted = left_out(observed, at, cycles)[own], at.residual[own]
    exact = rest(observed, without)[own]
    # one step from a mode that is reached to 0.15 nats, with constants that are not linear
    assert np.sqrt(np.mean((predicted - exact) ** 2)) < 0.1 * np.sqrt(np.mean((exact - fitted) ** 2))
