"""Log Bayes factors by the Laplace approximation, checked against an annealed Monte Carlo estimate.

    python -m tests.hidden.evidence_sampling [--cases N] [--particles N] [--workers N]

Takes development cases with one hidden effect, searches them, and prints for each the log Bayes factor of the best
effect by both estimates, nats.  The estimate is annealed from the Laplace approximation, whose log evidence is ln L:

    ln Z = ln L + Σ ln ⟨exp(−(β′ − β) U)⟩,   U(x) = ½ cost(x) − ½ cost(x̂) − ½ (x − x̂)ᵀ Σ⁻¹ (x − x̂)

β rises from 0 to 1 such that half of the particles stay effective, and at each β every particle makes `MOVES`
preconditioned Crank–Nicolson moves, which leave the Gaussian N(x̂, Σ) invariant (Cotter et al. 2013, Statist. Sci. 28).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import brentq
from scipy.special import logsumexp

from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.evidence.hypothesis_search import search
from estimation.path_model import PATH_MODEL
from estimation.posterior import Gaussian, PosteriorMode, SessionData, loss, widened
from physics.effects.hypotheses import Variant
from physics.laws import Array
from tests.hidden.evidence_calibration import hidden_jobs
from tests.hidden.family import Job, case

MOVES = 4
"""Crank–Nicolson moves of a particle at each β."""


def cost_of(observed: SessionData, prior: Gaussian, variants: Sequence[Variant]) -> Callable[[Array], float]:
    """Return the cost of `estimation.posterior` as a function of x, the constants and feature weights."""
    origin, mean, covariance, active = widened(observed.model.constants, prior, variants)
    factor = np.linalg.cholesky(covariance + 1e-14 * np.diag(np.diag(covariance)))
    root = np.sqrt(observed.weight)

    def cost(x: Array) -> float:
        q = origin.copy()
        q[active] += x[:len(active)]
        off = solve_triangular(factor, x - mean, lower=True)
        left = observed.data - observed.predicted(q) - observed.features @ x[len(active):]
        return loss(left, root) + float(off @ off)

    return cost


def sampled(observed: SessionData, prior: Gaussian, variants: Sequence[Variant], at: PosteriorMode, particles: int
            ) -> float:
    """Return the log evidence, nats, by annealing from the Laplace approximation at the mode `at`."""
    cost = cost_of(observed, prior, variants)
    random = np.random.default_rng(1)
    lower = np.tril(at.inner[0]) if at.inner[1] else np.triu(at.inner[0]).T

    def at_point(z: Array) -> tuple[Array, float]:
        """Return a standardised point with its U; Σ = F (I + FᵀHᵀWHF)⁻¹ Fᵀ."""
        x = at.x + at.factor @ solve_triangular(lower.T, z, lower=False)
        value = 0.5 * (cost(x) - cost_at_mode) - 0.5 * float(z @ z)
        return z, value if np.isfinite(value) else np.inf

    cost_at_mode = cost(at.x)
    cloud = [at_point(random.standard_normal(at.x.size)) for _ in range(particles)]
    log_ratio, beta, turn = 0.0, 0.0, 0.5
    while True:
        energy = np.array([u for _, u in cloud])

        def effective(step: float, energy: Array = energy) -> float:
            logs = -step * energy
            return float(np.exp(2.0 * logsumexp(logs) - logsumexp(2.0 * logs))) - 0.5 * particles

        step = 1.0 - beta if effective(1.0 - beta) >= 0.0 else brentq(effective, 0.0, 1.0 - beta)
        log_ratio += float(logsumexp(-step * energy)) - np.log(particles)
        beta += step
        if beta >= 1.0:
            return at.log_evidence - 0.5 * (cost_at_mode - at.cost) + log_ratio
        weights = np.exp(-step * energy - logsumexp(-step * energy))
        cloud = [cloud[k] for k in random.choice(particles, particles, p=weights)]
        accepted = 0
        for _ in range(MOVES):
            for k, (z, u) in enumerate(cloud):
                then = at_point(np.cos(turn) * z + np.sin(turn) * random.standard_normal(z.size))
                if np.log(random.random()) < beta * (u - then[1]):
                    cloud[k], accepted = then, accepted + 1
        turn *= 1.5 if accepted > 0.4 * MOVES * particles else 0.7
        turn = min(turn, 0.5 * np.pi)


def both(job: Job, particles: int) -> tuple[Job, str, float, float]:
    """Return job, best effect, and its log Bayes factor by Laplace's approximation and by sampling."""
    made = case(job)
    finder = EvidenceFinder(list(made.healthy))
    fitted = finder.reference([made.trial])
    observed = fitted.observe(PATH_MODEL.record(made.trial))
    found = search(observed, fitted.prior, fitted)
    best = next(iter(found.gains()))
    laplace = found.single[best].log_evidence - found.null.log_evidence
    with_effect = sampled(observed, fitted.prior, [found.variants[best]], found.single[best], particles)
    return job, best, laplace, with_effect - sampled(observed, fitted.prior, [], found.null, particles)


def main(arguments: list[str]) -> None:
    """Print both log Bayes factors of each case and how far they differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--particles", type=int, default=100)
    parser.add_argument("--workers", type=int)
    given = parser.parse_args(arguments)
    asked = hidden_jobs(given.cases)
    apart = []
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as crew:
        for job, best, laplace, other in crew.map(both, asked, [given.particles] * len(asked)):
            apart.append(other - laplace)
            print(f"serial {job.serial}, {job.hidden[0]}: {best} {laplace:.1f} nats by Laplace's approximation, "
                  f"{other:.1f} by sampling", flush=True)
    print(f"{sum(abs(v) <= 3.0 for v in apart)} of {len(apart)} within 3 nats; "
          f"median {np.median(apart):+.1f}, farthest {max(apart, key=abs):+.1f}")


if __name__ == "__main__":
    main(sys.argv[1:])
