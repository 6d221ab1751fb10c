"""How often the watch suspects something of reference trials of the development family, and names what is hidden.

    python -m tests.hidden.watch_calibration [--reference N] [--hidden N] [--kept FILE]

Prints the share of reference trials of which any gait cycle reaches a log Bayes factor, which the watch states as how
sure it is.  Of trials with one hidden effect it prints the share in whose suspicion the effect is, and how many last
suspicions agree with the diagnosis of the same trial (`Watched.agrees`).  A run that was broken off goes on from the
answers in `--kept`.
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

from bowden.watch.file_watch import DRIFT_S, NAMING, GaitWindows
from diagnosis.finder import diagnose
from estimation.joint_fit import fit_reference
from estimation.likelihood_data import SIGNALS, PathRecording
from estimation.path_model import PATH_MODEL
from estimation.running_evidence import RunningEvidence, WatchVerdict
from tests.hidden.evidence_calibration import hidden_jobs, reference_jobs
from tests.hidden.family import Case, Job, case

LEVELS = (6.0, 12.0, 20.0, 30.0, 50.0)


@dataclass(frozen=True)
class Watched:
    """One case: the effect hidden in it, the last suspicion of the watch, verdict and ambiguity set of the diagnosis.

    `nats`: log Bayes factor of the last suspicion.
    """

    serial: int
    seed: int
    hidden: str
    suspected: tuple[str, ...]
    best: str
    nats: float
    verdict: str
    among: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        """True if neither names an effect, or if both do and at least one effect is in both sets."""
        if not self.suspected or not self.among:
            return not self.suspected and self.verdict == "none"
        return bool(set(self.suspected) & set(self.among))


def watched(made: Case) -> Iterator[WatchVerdict]:
    """Yield the suspicion after each gait cycle of a case."""
    fit = fit_reference(PATH_MODEL, [PathRecording(t) for t in made.healthy])
    running = RunningEvidence(fit, DRIFT_S, NAMING)
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


def compared(job: Job) -> Watched:
    """Watch a case with one hidden effect and diagnose its whole trial."""
    made = case(job)
    last = list(watched(made))[-1]
    whole = diagnose([made.trial], healthy=list(made.healthy))
    return Watched(job.serial, job.seed, job.hidden[0], last.suspected, last.best, last.nats, whole.verdict,
                   tuple(whole.rivals))


def answered(asked: Sequence[Job], kept: Path | None) -> Iterator[Watched]:
    """Yield the answer of each case, of those in the file `kept` without asking again; new ones are added to it."""
    lines = kept.read_text(encoding="utf-8").splitlines() if kept is not None and kept.exists() else []
    known = {(one.serial, one.seed, one.hidden): one for one in (_from_json(line) for line in lines)}
    for job in asked:
        one = known.get((job.serial, job.seed, job.hidden[0]))
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
    """Return the shares of a run over cases with one hidden effect, and each case that disagrees."""
    named = [one for one in told if one.suspected]
    right = sum(one.hidden in one.suspected for one in named)
    same = sum(one.agrees for one in told)
    interval = binomtest(same, len(told)).proportion_ci()
    return "\n".join((
        f"hidden: {len(named)} of {len(told)} suspected, {right} of them with the truth among the suspected",
        f"last suspicion agrees with the diagnosis of the trial in {same} of {len(told)} "
        f"({100.0 * interval.low:.1f} … {100.0 * interval.high:.1f} %)",
        *(f"- serial {one.serial}, {one.hidden}: suspected {', '.join(one.suspected) or 'nothing'} ({one.best} "
          f"{one.nats:.0f} nats); diagnosis {one.verdict} {', '.join(one.among)}".rstrip()
          for one in told if not one.agrees)))


def main(arguments: list[str]) -> None:
    """Watch the development family and print the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=int, default=60)
    parser.add_argument("--hidden", type=int, default=100)
    parser.add_argument("--kept", type=Path, metavar="FILE", help="answers of the hidden cases, as JSON lines")
    given = parser.parse_args(arguments)
    with threadpool_limits(1, user_api="blas"):
        largest = []
        for job in reference_jobs(given.reference):
            largest += [max((v.nats for v in suspicion(job)), default=0.0)]
        for level in LEVELS if largest else ():
            print(f"{level:g} nats: {sum(v >= level for v in largest)} of {len(largest)} reference trials reach it",
                  flush=True)
        if given.hidden:
            print(comparison(list(answered(hidden_jobs(given.hidden), given.kept))))


if __name__ == "__main__":
    main(sys.argv[1:])
