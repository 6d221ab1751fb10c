"""How often the watch suspects something of reference trials of the development family, and names what is hidden.

    python -m tests.hidden.watch_calibration [--reference N] [--hidden N] [--kept FILE]

Prints of how many reference trials any gait cycle reaches a log Bayes factor or is suspected.  Of trials with one
hidden effect it prints the share in whose suspicion the effect is.  Of both it prints how many last suspicions agree
with the diagnosis of the same trial (`Watched.agrees`).  A run that was broken off goes on from the answers in
`--kept`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binomtest
from threadpoolctl import threadpool_limits

from bowden.watch.file_watch import DRIFT_S, GaitWindows, LatestCycles
from diagnosis.evidence.decision import threshold
from diagnosis.finder import Finder
from estimation.joint_fit import fit_reference
from estimation.likelihood_data import PathRecording
from estimation.path_model import PATH_MODEL
from estimation.running_evidence import Naming, RunningEvidence, WatchVerdict
from tests.hidden.evidence_calibration import hidden_jobs, reference_jobs
from tests.hidden.family import Case, Job, case

LEVELS = (6.0, 12.0, 20.0, 30.0, 50.0)


@dataclass(frozen=True)
class Watched:
    """One case: the effect hidden in it ("": a reference trial), the last suspicion of the watch, verdict and ambiguity
    set of the diagnosis.

    `nats`: log Bayes factor of the last suspicion; `largest`: that of all cycles; `ever`: a cycle was suspected.
    """

    serial: int
    seed: int
    hidden: str
    suspected: tuple[str, ...]
    best: str
    nats: float
    largest: float
    ever: bool
    verdict: str
    among: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        """True if neither names an effect, or if both do and at least one effect is in both sets."""
        if not self.suspected or not self.among:
            return not self.suspected and self.verdict == "none"
        return bool(set(self.suspected) & set(self.among))


def watched(made: Case, finder: Finder) -> Iterator[WatchVerdict]:
    """Yield the suspicion after each gait cycle of a case; `finder`: diagnosis with its reference trials."""
    fit = fit_reference(PATH_MODEL, [PathRecording(t) for t in made.healthy])
    names = tuple(made.trial.columns)
    latest, windows = LatestCycles(made.trial.source, names, finder), GaitWindows(names, period_s=2.0)
    running = RunningEvidence(fit, DRIFT_S, Naming(threshold(PATH_MODEL), latest.diagnosed))
    rows = np.stack([made.trial[name] for name in names], axis=1)
    for window in (*windows.add(rows), *windows.rest()):
        latest.add(window.rows)
        found = running.add(*window[:3])
        if found is not None:
            yield found


def compared(job: Job) -> Watched:
    """Watch a case with at most one hidden effect and diagnose its whole trial."""
    made = case(job)
    finder = Finder().examine(made.healthy)
    found = list(watched(made, finder))
    last, whole = found[-1], finder.diagnose([made.trial])
    return Watched(job.serial, job.seed, "".join(job.hidden), last.suspected, last.best, last.nats,
                   max(one.nats for one in found), any(one.suspected for one in found), whole.verdict,
                   tuple(whole.rivals))


def answered(asked: Sequence[Job], kept: Path | None) -> Iterator[Watched]:
    """Yield the answer of each case, of those in the file `kept` without asking again; new ones are added to it."""
    lines = kept.read_text(encoding="utf-8").splitlines() if kept is not None and kept.exists() else []
    known = {(one.serial, one.seed, one.hidden): one for one in (_from_json(line) for line in lines)}
    for job in asked:
        one = known.get((job.serial, job.seed, "".join(job.hidden)))
        if one is None:
            one = compared(job)
            if kept is not None:
                with kept.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(one)) + "\n")
        yield one


def _from_json(line: str) -> Watched:
    given = json.loads(line)
    return Watched(**{**given, "suspected": tuple(given["suspected"]), "among": tuple(given["among"])})


def comparison(told: Sequence[Watched]) -> str:
    """Return the shares of a run over its cases, and each case that disagrees."""
    hidden = [one for one in told if one.hidden]
    healthy = [one for one in told if not one.hidden]
    named = [one for one in hidden if one.suspected]
    right = sum(one.hidden in one.suspected for one in named)
    same = sum(one.agrees for one in told)
    interval = binomtest(same, len(told)).proportion_ci()
    return "\n".join((
        *(f"{level:g} nats: {sum(one.largest >= level for one in healthy)} of {len(healthy)} reference trials reach it"
          for level in LEVELS),
        f"reference trials: {sum(one.ever for one in healthy)} of {len(healthy)} suspected in any cycle",
        f"hidden: {len(named)} of {len(hidden)} suspected, {right} of them with the truth among the suspected",
        f"last suspicion agrees with the diagnosis of the trial in {same} of {len(told)} "
        f"({100.0 * interval.low:.1f} … {100.0 * interval.high:.1f} %)",
        *(f"- serial {one.serial}, {one.hidden or 'reference'}: suspected {', '.join(one.suspected) or 'nothing'} "
          f"({one.best} {one.nats:.0f} nats); diagnosis {one.verdict} {', '.join(one.among)}".rstrip()
          for one in told if not one.agrees)))


def main(arguments: list[str]) -> None:
    """Watch the development family and print the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=int, default=60)
    parser.add_argument("--hidden", type=int, default=100)
    parser.add_argument("--kept", type=Path, metavar="FILE", help="answers, as JSON lines")
    given = parser.parse_args(arguments)
    with threadpool_limits(1, user_api="blas"):
        print(comparison(list(answered([*reference_jobs(given.reference), *hidden_jobs(given.hidden)], given.kept))))


if __name__ == "__main__":
    main(sys.argv[1:])
