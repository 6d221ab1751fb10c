"""What the watch says of a trial beside its diagnosis, on benches of several methods, and what a cycle costs.

    python -m tests.hidden.watch_calibration [--cases N] [--first SEED] [--kept FILE]

Prints a line for each case: what is hidden, the watch's last suspicion, verdict and ambiguity set of the diagnosis of
the complete trial, and whether they agree (`Compared.agrees`).  Then the share that agrees, the reference trials that
were suspected in any cycle, and the processor time of cycles with and without a diagnosis.  Cases are of the four
implementations of `tests.plants`, of `tests.hidden.bench` and of the packaged plant, in turns.  A run that was broken
off goes on from the answers in `--kept`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
from scipy.stats import binomtest
from threadpoolctl import threadpool_limits

from bowden.cli.app import run
from bowden.watch.file_watch import DRIFT_S, FileWatch, GaitWindows, LatestCycles, WatchedBench
from diagnosis.evidence.decision import threshold
from diagnosis.finder import Finder
from estimation.data.table import Table, table
from estimation.joint_fit import fit_reference
from estimation.likelihood_data import PathRecording
from estimation.path_model import PATH_MODEL
from estimation.running_evidence import Naming, RunningEvidence, WatchVerdict
from tests.hidden import cases
from tests.hidden.family import Job, case
from tests.hidden.family_jobs import KINDS, serials

BENCHES = (*KINDS, "bench", "packaged")
HIDDEN = ("", "start_gain", "stiffness", "cable_friction", "knee_backlash", "end_drift")
""""": a trial in the reference condition."""
FIRST_SEED = 13_000
CYCLES = 7
"""Gait cycles of a trial: diagnoses after 3, 4 and 6 of them, so that the last suspicion lacks the last cycle."""


@dataclass(frozen=True)
class Question:
    """One case: one of `BENCHES`, the effect hidden in it ("": none), and a seed."""

    bench: str
    hidden: str
    seed: int


@dataclass(frozen=True)
class Compared:
    """Watch and diagnosis of one case: the last suspicion, and the verdict and ambiguity set of the diagnosis.

    `nats`: log Bayes factor of the last suspicion; `largest`: that of all cycles; `ever`: a cycle was suspected.
    `cycle_s`: processor time of each cycle, s; `whole_s`: that of the diagnosis of the trial.
    """

    bench: str
    hidden: str
    seed: int
    suspected: tuple[str, ...]
    best: str
    nats: float
    largest: float
    ever: bool
    verdict: str
    among: tuple[str, ...]
    cycle_s: tuple[float, ...]
    whole_s: float

    @property
    def agrees(self) -> bool:
        """True if neither names an effect, or if both do and at least one effect is in both sets."""
        if not self.suspected or not self.among:
            return not self.suspected and self.verdict == "none"
        return bool(set(self.suspected) & set(self.among))

    def line(self) -> str:
        """Return the case as one line."""
        return (f"{self.bench} {self.seed}, {self.hidden or 'reference'}: "
                f"watch {', '.join(self.suspected) or 'nothing'} ({self.best} {self.nats:.0f} nats); diagnosis "
                f"{self.verdict} {', '.join(self.among)}".rstrip() + f"; {'agree' if self.agrees else 'DISAGREE'}")


def questions(count: int, first: int = FIRST_SEED) -> list[Question]:
    """Return cases with a seed each from `first` on: each effect on each bench, then again with other seeds."""
    pairs = [(bench, hidden) for hidden in HIDDEN for bench in BENCHES]
    return [Question(*pairs[k % len(pairs)], first + k) for k in range(count)]


def tables(asked: Question) -> tuple[Table, list[Table]]:
    """Return the trial of a case of the family or of `tests.hidden.bench`, and its reference trials."""
    hidden = (asked.hidden,) if asked.hidden else ()
    if asked.bench == "bench":
        drawn = cases.case(cases.Job("one" if hidden else "none", asked.seed, hidden), cycles=CYCLES)
        return table("trial", drawn.trial), [table(f"reference {k}", columns) for k, columns in
                                             enumerate(drawn.healthy)]
    own = serials(asked.bench, False)
    made = case(Job(own[asked.seed % len(own)], hidden, asked.seed, CYCLES))
    return made.trial, list(made.healthy)


def watched(trial: Table, references: Sequence[Table], finder: Finder) -> Iterator[WatchVerdict]:
    """Return the suspicions after each gait cycle of a trial in memory; `finder`: diagnosis with its reference trials.
    """
    names = tuple(trial.columns)
    latest, windows = LatestCycles(trial.source, names, finder), GaitWindows(names, period_s=2.0)
    running = RunningEvidence(fit_reference(PATH_MODEL, [PathRecording(t) for t in references]), DRIFT_S,
                              Naming(threshold(PATH_MODEL), latest.diagnosed))

    def verdicts() -> Iterator[WatchVerdict]:
        rows = np.stack([trial[name] for name in names], axis=1)
        for window in (*windows.add(rows), *windows.rest()):
            latest.add(window.rows)
            found = running.add(*window[:3])
            if found is not None:
                yield found

    return verdicts()


def recorded(asked: Question, folder: Path) -> FileWatch:
    """Record two reference trials and the trial of a case on the packaged plant; return the watch of its file."""
    rng = np.random.default_rng(asked.seed)
    values = cases.EFFECTS[asked.hidden](rng, cases.NOMINAL)[1] if asked.hidden else {}
    (folder / "plant.toml").write_text("\n".join([
        *([f"[effects.{asked.hidden}]"] if asked.hidden else []),
        *(f"{name} = {value}" for name, value in values.items())]), encoding="utf-8")
    for day, name in enumerate(("good0", "good1", "trial")):
        words = ("trial", "--serial", asked.seed, "--day", day, "--cycles", CYCLES, "--period", 1.3 + 0.1 * (day == 1),
                 *(("--plant-model", folder / "plant.toml") if name == "trial" and values else ()),
                 "-o", folder / f"{name}.mcap", "--json")
        with redirect_stdout(StringIO()):
            assert run([str(word) for word in words]) == 0
    return FileWatch(folder / "trial.mcap", WatchedBench((folder / "good0.mcap", folder / "good1.mcap")))


def compared(asked: Question) -> Compared:
    """Watch a case and diagnose its whole trial."""
    with tempfile.TemporaryDirectory() as folder:
        if asked.bench == "packaged":
            file = recorded(asked, Path(folder))
            verdicts, diagnosis = file.look(last=True), file.diagnosis
        else:
            trial, references = tables(asked)
            finder = Finder().examine(references)
            verdicts, diagnosis = watched(trial, references, finder), partial(finder.diagnose, [trial])
        found, times = [], [time.process_time()]
        for one in verdicts:
            found.append(one)
            times.append(time.process_time())
        last, whole = found[-1], diagnosis()
        whole_s = time.process_time() - times[-1]
    return Compared(asked.bench, asked.hidden, asked.seed, last.suspected, last.best, last.nats,
                    max(one.nats for one in found), any(one.suspected for one in found), whole.verdict,
                    tuple(whole.rivals), tuple(np.diff(times).tolist()), whole_s)


def answered(asked: Sequence[Question], kept: Path | None) -> Iterator[Compared]:
    """Yield the answer of each case, of those in the file `kept` without asking again; new ones are added to it."""
    lines = kept.read_text(encoding="utf-8").splitlines() if kept is not None and kept.exists() else []
    known = {(one.bench, one.hidden, one.seed): one for one in (_from_json(line) for line in lines)}
    for question in asked:
        one = known.get((question.bench, question.hidden, question.seed)) or compared(question)
        if kept is not None and one not in known.values():
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(one)) + "\n")
        yield one


def _from_json(line: str) -> Compared:
    return Compared(**{name: tuple(value) if isinstance(value, list) else value
                       for name, value in json.loads(line).items()})


def summary(found: Sequence[Compared]) -> str:
    """Return the shares of a run over its cases, and the processor time of cycles."""
    same, level = sum(one.agrees for one in found), threshold(PATH_MODEL)
    interval = binomtest(same, len(found)).proportion_ci()
    equal = sum(set(one.suspected) == set(one.among) for one in found)
    reference = [one for one in found if not one.hidden]
    quiet = [s for one in found if one.largest < level for s in one.cycle_s]
    slowest = [max(one.cycle_s) for one in found if one.largest >= level]
    return "\n".join((
        f"watch and diagnosis agree in {same} of {len(found)} ({100.0 * interval.low:.1f} … "
        f"{100.0 * interval.high:.1f} %), with equal sets in {equal}",
        f"reference trials: {sum(one.ever for one in reference)} of {len(reference)} suspected in any cycle, "
        f"{sum(one.verdict != 'none' for one in reference)} by the diagnosis",
        f"processor time of a cycle below {level:g} nats: median {np.median(quiet or 0.0):.2f} s",
        f"of the slowest cycle of a trial beyond it: median {np.median(slowest or 0.0):.1f} s, at most "
        f"{max(slowest, default=0.0):.1f} s; of the diagnosis of a trial: median "
        f"{np.median([one.whole_s for one in found]):.1f} s"))


def main(arguments: list[str]) -> None:
    """Compare the cases and print their lines and the shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=36)
    parser.add_argument("--first", type=int, default=FIRST_SEED, metavar="SEED", help="seed of the first case")
    parser.add_argument("--kept", type=Path, metavar="FILE", help="answers, as JSON lines")
    given, found = parser.parse_args(arguments), []
    with threadpool_limits(1, user_api="blas"):
        for one in answered(questions(given.cases, given.first), given.kept):
            found.append(one)
            print(one.line(), flush=True)
    print(summary(found))


if __name__ == "__main__":
    main(sys.argv[1:])
