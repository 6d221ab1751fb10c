"""Quantiles of the development family that the threshold and ambiguity set are calibrated on.

    python -m tests.hidden.evidence_calibration [--reference N] [--truths N] [--hidden N] [--scatter N] [--noise N]
                                                [--workers N]

Prints, over reference trials of the family (`--reference`) and of two rigs of other structure (`--truths` of each), the
verdicts by the number of the bench's other ones, how many reach a log Bayes factor, with the rate's 95 % interval, the
threshold that 2 % reach if the largest one of a trial is exponential, and the largest one of each effect; over trials
with one hidden effect that is named, the share of the best log Bayes factor that the truth has; over benches with
several reference trials, the scatter of each constant between sessions, in its session σ; over reference trials, the
log likelihood of a further one by a factor on the variance of the model error, and by a factor on the growth of the
session deviation with motion that the bench's other ones do not have.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
from scipy.stats import binomtest, chi2

from diagnosis.evidence.decision import threshold
from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.finder import diagnose
from estimation.data.table import Table, table
from estimation.path_model import PATH_MODEL
from estimation.posterior import mode
from physics.effects.hypotheses import HYPOTHESES
from physics.forward.path_constants import FREE, NAMES, SESSION_SD
from physics.laws import Array
from tests.hidden import truths, truths_run
from tests.hidden.family import Job, case, session
from tests.hidden.family_jobs import KINDS, jobs, serials
from tests.hidden.truths import Question

FIRST_SEED = 5000
"""Seeds of the reference trials: none of `family_jobs` has them."""
NOISE = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors on the variance of the model error at which a reference trial's likelihood is printed."""
UNSEEN = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
"""Factors on the growth of the session deviation at which it is printed, of trials with 10 % of unseen motion or more.
"""


def reference_jobs(count: int) -> list[Job]:
    """Return reference trials of development serials, the implementations in turns."""
    each = [[Job(s, (), FIRST_SEED + i) for i, s in enumerate(serials(kind, False))] for kind in KINDS]
    return [job for turn in zip(*each, strict=False) for job in turn][:count]


def hidden_jobs(count: int) -> list[Job]:
    """Return development cases with one effect of the forward model, the implementations in turns."""
    each = [[j for j in jobs(kind, False) if len(j.hidden) == 1 and not j.left_out and j.hidden[0] in HYPOTHESES]
            for kind in KINDS]
    return [job for turn in zip(*each, strict=False) for job in turn][:count]


def truth_questions(count: int, first: int = 4100) -> list[Question]:
    """Return reference trials of the rigs of other structure, every second one of another mesh and travel."""
    return [Question(name, ("null_alt" if i % 2 else "null",), first + i)
            for i in range(count) for name in truths.STRUCTURES]


def healthy(job: Job | Question) -> list[Table]:
    """Return the reference trials of a bench; of a rig of other structure that of the trial's motion, too."""
    if isinstance(job, Job):
        return list(case(job).healthy)
    drawn = truths_run.stored(job)
    return [table(f"healthy{k}", c) for k, c in enumerate((*drawn.references, drawn.same_motion))]


def gains(job: Job | Question) -> tuple[str, dict[str, float]]:
    """Return the verdict and the log Bayes factors of a case; none of these where wire or integrity come first."""
    if isinstance(job, Question):
        trial, known = table("trial", truths_run.stored(job).trial), healthy(job)[:2]
    else:
        trial, known = case(job).trial, healthy(job)
    said = diagnose([trial], healthy=known)
    return said.verdict, (said.evidence or {}).get("log_bayes_factors", {})


def scatter(job: Job | Question) -> Array | None:
    """Return the constants of each session of a bench less their mean, in session σ; None for a single session."""
    known = healthy(job)
    if len(known) < 2:
        return None
    fitted, free = EvidenceFinder(known).reference(()), list(FREE)
    q, count = np.array([at for at, _ in fitted.identified]), len(fitted.identified)
    return np.asarray((q - q.mean(axis=0))[:, free] / SESSION_SD[free] * np.sqrt(count / (count - 1)))


def likelihoods(job: Job) -> tuple[Array, Array | None]:
    """Return the log likelihood of a reference trial given the bench's other ones, nats, by `NOISE` and by `UNSEEN`.

    The second one is None for a trial with less than 10 % of unseen motion.
    """
    made = case(job)
    fitted = EvidenceFinder(list(made.healthy)).reference([made.trial])
    trial, told, start = PATH_MODEL.record(made.trial), [], None
    for factor in NOISE:
        observed = replace(fitted, model_error=factor * fitted.model_error).observe(trial)
        at = mode(observed, fitted.prior_of(observed), start=start)
        tau, start = np.repeat(fitted.tau, trial.bins), at.x
        told.append(at.log_evidence + 0.5 * float(np.sum(np.log(observed.weight * tau) / tau)))
    observed = fitted.observe(trial)
    if observed.beyond < 0.1:
        return np.array(told), None
    grown = [fitted.prior_of(replace(observed, beyond=factor * observed.beyond)) for factor in UNSEEN]
    return np.array(told), np.array([mode(observed, prior, start=start).log_evidence for prior in grown])


def quantiles(largest: Sequence[float], share: float = 0.02) -> list[str]:
    """Return a line for each threshold: how many reference trials reach it; and the threshold that `share` reach.

    The largest log Bayes factor of a trial is taken as exponential, negative ones as 0.
    """
    count = len(largest)
    found = float(np.mean(np.maximum(largest, 0.0))) * -np.log(share)
    # 2n times the mean of n exponential values over their scale is χ² with 2n degrees of freedom
    low, high = (found * 2.0 * count / chi2.ppf(q, 2 * count) for q in (0.975, 0.025))
    return [f"{nats:g} nats: {_rate(sum(v >= nats for v in largest), count)} of the reference trials reach it"
            for nats in (4.0, 8.0, 10.0, threshold(PATH_MODEL))] + [
        f"{100.0 * share:g} % of {count} would reach {found:.1f} nats (95 %: {low:.1f} … {high:.1f}); largest: "
        + ", ".join(f"{v:.1f}" for v in sorted(largest)[-5:])]


def _rate(count: int, whole: int) -> str:
    """Return a count with the 95 % interval of its rate (Clopper–Pearson)."""
    low, high = binomtest(count, whole).proportion_ci()
    return f"{count} of {whole} ({100 * low:.1f} … {100 * high:.1f} %)"


def main(arguments: list[str]) -> None:
    """Ask the development family and print the quantiles."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=int, default=200)
    parser.add_argument("--truths", type=int, default=0)
    parser.add_argument("--hidden", type=int, default=120)
    parser.add_argument("--scatter", type=int, default=40)
    parser.add_argument("--noise", type=int, default=40)
    parser.add_argument("--workers", type=int)
    given = parser.parse_args(arguments)
    asked: list[Job | Question] = [*reference_jobs(given.reference), *truth_questions(given.truths),
                                   *hidden_jobs(given.hidden)]
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as crew:
        _print_sessions(crew, [*reference_jobs(given.scatter), *truth_questions(given.truths if given.scatter else 0)])
        _print_likelihoods(list(crew.map(likelihoods, reference_jobs(given.noise))))
        _print_gains(dict(zip(asked, crew.map(gains, asked), strict=True)))


def _print_sessions(crew: ProcessPoolExecutor, asked: Sequence[Job | Question]) -> None:
    several: dict[str, list[Array]] = {}
    for job, rows in zip(asked, crew.map(scatter, asked), strict=True):
        if rows is not None:
            several.setdefault(job.structure if isinstance(job, Question) else "family", []).append(rows)
    for name, each in several.items():
        rms = np.sqrt(np.mean(np.concatenate(each) ** 2, axis=0))
        print(f"scatter between sessions, {name}, session σ:", ", ".join(
            f"{NAMES[i]} {v:.2f}" for i, v in zip(FREE, rms, strict=True)))


def _print_likelihoods(rated: Sequence[tuple[Array, Array | None]]) -> None:
    for what, factors, rows in (("model error", NOISE, [told for told, _ in rated]),
                                ("unseen motion", UNSEEN, [told for _, told in rated if told is not None])):
        if rows:
            rises = (np.array(rows) - np.array(rows)[:, [factors.index(1.0)]]).T
            print(f"log likelihood of a reference trial by {what}, nats above factor 1, mean and number above 0:",
                  ", ".join(f"{factor:g}: {np.mean(rise):.1f} ({np.sum(rise > 0.0)} of {rise.size})"
                            for factor, rise in zip(factors, rises, strict=True)))


def _print_gains(told: Mapping[Job | Question, tuple[str, dict[str, float]]]) -> None:
    asked, found = list(told), {job: rated for job, (_, rated) in told.items()}
    verdicts: dict[int, Counter[str]] = {1: Counter(), 2: Counter(), 3: Counter()}
    for job, (verdict, _) in told.items():
        verdicts[2 if isinstance(job, Question) else session(job).healthy].update([] if _effects(job) else [verdict])
    none = [max(found[j].values()) for j in asked if not _effects(j) and found[j]]
    if not asked:
        return
    for healthy, counted in [*verdicts.items(), ("1 to 3", sum(verdicts.values(), Counter()))]:
        print(f"verdict of a trial in the reference condition, {healthy} reference trials:", ", ".join(
            f"{name} {_rate(count, counted.total())}" for name, count in counted.most_common()))
    print("\n".join(quantiles(none)))
    effects = sorted({name for j in asked if not _effects(j) for name in found[j]})
    print("largest of reference trials, nats:", ", ".join(
        f"{name} {max(found[j].get(name, 0.0) for j in asked if not _effects(j)):.1f}" for name in effects))
    shares = sorted(found[j].get(_effects(j)[0], 0.0) / max(found[j].values()) for j in asked
                    if _effects(j) and found[j] and max(found[j].values()) >= threshold(PATH_MODEL))
    at = np.quantile(shares, [0.0, 0.02, 0.05, 0.1]) if shares else []
    print(f"share of the best that the truth has, of {len(shares)} named: least, 2 %, 5 %, 10 %:",
          ", ".join(f"{v:.2f}" for v in at))


def _effects(job: Job | Question) -> tuple[str, ...]:
    return job.effects if isinstance(job, Question) else job.hidden


if __name__ == "__main__":
    main(sys.argv[1:])
