"""Share of an effect's visible χ² along its hypothesis, on rigs of another structure.

    python -m tests.hidden.truths_shares [--first SEED] [--singles N] [--structures truth1,truth2]

D: the rig's clean response, C: covariance of the data under the model without an effect, E: slopes of the hypothesis.
Prints D'D in sensor noise, D'C⁻¹D, and the largest D'C⁻¹E(E'C⁻¹E)⁻¹E'C⁻¹D / D'C⁻¹D over the variants.
"""

from __future__ import annotations

import argparse
import sys
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve
from threadpoolctl import threadpool_limits

from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.evidence.hypothesis_search import hypotheses
from estimation.data.table import table
from estimation.path_model import PATH_MODEL
from estimation.posterior import PosteriorMode, mode, response
from physics.laws import Array
from tests.hidden import truths, truths_run
from tests.hidden.truths import Drawn, Question


class Share(NamedTuple):
    """χ² of an effect in sensor noise and as it is visible to the diagnosis, and its share along the hypothesis."""

    in_noise: float
    visible: float
    along: float


def share(asked: Question) -> Share:
    """Return the share of the hidden effect of one case."""
    made = truths_run.stored(asked)
    finder = EvidenceFinder([table(f"healthy{k}", columns) for k, columns in enumerate(made.references)])
    trial = table("trial", made.trial)
    fit = finder.reference([trial])
    observed = fit.observe(finder.model.record(trial))
    null = mode(observed, fit.prior_of(observed), start=fit.starts()[0])
    clean = clean_data(made)
    visible = _product(null, clean[:, None], clean[:, None])[0, 0]
    noise = np.repeat([observed.trials[0].noise_n[name] for name in observed.outputs], observed.trials[0].bins)
    bench = finder.model.constants.named(fit.bench_coordinates())
    slopes = [response(null, observed, variant)[0] for variant in hypotheses(observed, bench)[asked.effects[0]]]
    along = [_along(null, each, clean) for each in slopes]
    return Share(float(np.sum((clean / noise) ** 2)), float(visible), max(along) / visible)


def clean_data(made: Drawn) -> Array:
    """Return the data of the likelihood that correspond to the rig's clean response, shape (data,)."""
    whole, rest = (PATH_MODEL.record(table("trial", columns)) for columns in (made.trial, made.without))
    # the ratio END/START of the trial weighs both, so that the difference is linear in the signals
    signals = {name: whole.measured(name) - rest.measured(name) for name in whole.outputs}
    return np.concatenate([whole.binned(whole.weighed(signals, name)) for name in whole.outputs])


def _product(null: PosteriorMode, first: Array, second: Array) -> Array:
    """Return AᵀC⁻¹B."""
    light = null.weight[:, None] * second
    return np.asarray(first.T @ (light - null.weight[:, None] * (
        null.inward @ cho_solve(null.inner, null.inward.T @ light))))


def _along(null: PosteriorMode, slopes: Array, clean: Array) -> float:
    square, pull = _product(null, slopes, slopes), _product(null, slopes, clean[:, None])[:, 0]
    return float(pull @ np.linalg.lstsq(square + 1e-9 * np.trace(square) * np.eye(pull.size), pull, rcond=None)[0])


def main(arguments: list[str]) -> None:
    """Print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--singles", type=int, default=20)
    parser.add_argument("--structures", default=",".join(truths.STRUCTURES))
    given = parser.parse_args(arguments)
    with threadpool_limits(1, user_api="blas"):
        for structure in given.structures.split(","):
            for asked in truths.questions(structure, given.first, given.singles, 0):
                found = share(asked)
                print(f"{structure} {asked.seed} {asked.effects[0]}: χ² {found.in_noise:.0f} in sensor noise, "
                      f"{found.visible:.0f} visible; along {found.along:.2f}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
