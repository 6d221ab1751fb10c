"""Errors on held-out cycles: a cycle that is left out is predicted as by a fit without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.evidence.held_out import blocks_of, cycles_of, left_out, rest
from estimation.data.table import table
from estimation.path_model import PATH_MODEL
from estimation.posterior import mode
from physics.laws import Array
from tests.hidden.family import Job, case

BENCH = Job(39, (), 9, cycles=5)


@pytest.mark.parametrize(("length_s", "blocks"), [
    (2.9, [1.0, 1.9]), (3.3, [1.1, 1.1, 1.1]), (5.0, [1.67, 1.67, 1.66]), (7.9, [2.0, 2.0, 3.9])])
def test_a_trial_without_cycle_numbers_has_three_blocks_from_3_s_on(length_s: float, blocks: list[float]) -> None:
    time_s = np.arange(0.0, length_s, 1e-3)
    _, rows = np.unique(cycles_of(table("a.csv", {"time_s": time_s, "tension_start_n": time_s})), return_counts=True)
    np.testing.assert_allclose(1e-3 * rows, blocks, atol=0.01)


def test_a_cycle_that_is_left_out_is_predicted_as_by_a_fit_without_it() -> None:
    made = case(BENCH)
    fit = EvidenceFinder(made.healthy[:1]).reference([made.trial])
    observed = fit.observe(PATH_MODEL.record(made.trial))
    prior = fit.prior_of(observed)
    at = mode(observed, prior)
    cycles = np.tile(blocks_of([made.trial], observed.trials)[0], len(observed.outputs))
    whole, exact = left_out(observed, prior, [], at, cycles), np.zeros(cycles.size)
    for cycle in np.unique(cycles):
        others = replace(observed, weight=np.where(cycles == cycle, 1e-9, observed.weight))
        exact = np.where(cycles == cycle, rest(observed, mode(others, prior, start=at.x)), exact)

    def rms(values: Array) -> float:
        return float(np.sqrt(np.mean(values[observed.weight > 0.0] ** 2)))

    # the residual of the fit itself would miss the whole of what the deletion changes
    assert abs(rms(whole) - rms(exact)) < 0.1 * (rms(exact) - rms(at.residual))
