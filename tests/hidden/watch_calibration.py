"""How often the watch suspects something of reference trials of the development family, and names what is hidden.

    python -m tests.hidden.watch_calibration [--reference N] [--hidden N]

Prints the share of reference trials of which any gait cycle reaches a log Bayes factor, which the watch states as how
sure it is, and of trials with one hidden effect the share in whose suspicion it is, and the diagnosis of the whole.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

import numpy as np
from threadpoolctl import threadpool_limits

from bowden.watch.gait_windows import GaitWindows
from bowden.watch.running_evidence import RunningEvidence, WatchVerdict
from diagnosis.evidence.decision import IMITATED
from diagnosis.evidence.likelihood_data import SIGNALS, PathRecording
from diagnosis.evidence.path_model import PATH_MODEL
from diagnosis.evidence.reference_fit import fit_reference
from tests.hidden.evidence_calibration import hidden_jobs, reference_jobs
from tests.hidden.family import Case, Job, case

LEVELS = (6.0, 12.0, 20.0, 30.0, 50.0)


def watched(made: Case) -> Iterator[WatchVerdict]:
    """Yield the suspicion after each gait cycle of a case."""
    fit = fit_reference(PATH_MODEL, [PathRecording(t) for t in made.healthy])
    running = RunningEvidence(fit, span_s=20.0)
    names = tuple(made.trial.columns)
    windows = GaitWindows(names, period_s=2.0)
    rows = np.stack([made.trial[name] for name in names], axis=1)
    for window in (*windows.add(rows), *windows.rest()):
        found = running.add(*window)
        if found is not None:
            yield found


def suspicion(job: Job) -> list[WatchVerdict]:
    """Return the suspicions of a case; none where its outputs differ from the reference trials'."""
    made = case(job)
    if any(n not in made.trial for n in SIGNALS):
        return []
    return list(watched(made))


def main(arguments: list[str]) -> None:
    """Watch the development family and print the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=int, default=60)
    parser.add_argument("--hidden", type=int, default=60)
    given = parser.parse_args(arguments)
    with threadpool_limits(1, user_api="blas"):
        largest = []
        for job in reference_jobs(given.reference):
            largest += [max((v.nats / IMITATED.get(v.best, 1.0) for v in suspicion(job)), default=0.0)]
        for level in LEVELS:
            print(f"{level:g} nats: {sum(v >= level for v in largest)} of {len(largest)} reference trials reach it",
                  flush=True)
        last = [(job, found[-1]) for job in hidden_jobs(given.hidden) if (found := suspicion(job))]
    named = [(job, v) for job, v in last if v.suspected]
    right = sum(job.hidden[0] in v.suspected for job, v in named)
    print(f"hidden: {len(named)} of {len(last)} suspected, {right} of them with the truth among the suspected")


if __name__ == "__main__":
    main(sys.argv[1:])
