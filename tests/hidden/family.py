"""Hidden cases on the family of `tests.plants`: any structure and constants, unequal noise and rates, by serial, seed.

The rule of this file: a job says everything; what is hidden is drawn by the family and never handed to the finder; each
trial is of a like bench of its own, within the tolerance of like benches; whether a case counts the oracle says.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from diagnosis.finder import diagnose
from diagnosis.findings import Findings
from estimation.data.table import Table, table
from tests.hidden import family_moves, moves
from tests.hidden.answers import After
from tests.plants import draws, effects, imposed, oracle
from tests.plants.bench import Bench, replaced

PEAKS_N = (40.0, 50.0)
WIRE = ("lost_pdo", "late_pdo", "quantisation")


@dataclass(frozen=True)
class Job:
    """One case: a serial of the family, what is hidden in it, a seed; `columns` that are left out of every trial."""

    serial: int
    hidden: tuple[str, ...]
    seed: int = 0
    cycles: int = 8
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class Case:
    """What the finder is given, and what it is not."""

    trial: Table
    healthy: tuple[Table, ...]
    bench: Bench
    changed: Bench
    values: dict[str, float]
    motion: imposed.Motion
    noise_n: float
    rate_hz: int


@dataclass(frozen=True)
class Answer:
    """What was said, beside what was hidden; `separation`: χ² of the oracle, None where it was not asked.

    `found`: by effect and parameter its `value` and the ends of its interval, `low` and `high`; `values`: the truth;
    `after`: where the class was left open and the bench runs the experiment by itself.  `nats`: log Bayes factors.
    """

    job: Job
    structure: str
    verdict: str
    named: tuple[str, ...]
    rivals: tuple[str, ...]
    found: dict[str, dict[str, dict[str, float]]]
    values: dict[str, float]
    separation: float | None
    warnings: tuple[str, ...] = ()
    after: After | None = None
    part: str | None = None
    nats: dict[str, float] = field(default_factory=dict)

    @property
    def counts(self) -> bool:
        return self.separation is None or self.separation >= oracle.COUNTS_FROM

    @property
    def right(self) -> bool:
        """Whether all that was hidden is in the class; no name where nothing of the catalogue is hidden."""
        expected = [name for name in self.job.hidden if name in effects.EFFECTS]
        if not expected:
            return not self.rivals and (not self.job.hidden or self.verdict == "unexplained")
        return set(expected) <= set(self.rivals)

    @property
    def wrong(self) -> bool:
        """Whether a name was given and none of what was hidden is among them."""
        return bool(self.rivals) and not set(self.job.hidden) & set(self.rivals)

    @property
    def alarm(self) -> bool:
        """Whether anything was said of a bench with nothing wrong."""
        return not self.job.hidden and self.verdict != "none"

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return dataclasses.asdict(self)


def from_json(given: Mapping[str, Any]) -> Answer:
    """Return the answer that `as_json` made."""
    job, after = given["job"], given.get("after")
    return Answer(**{
        **given, "job": Job(**{**job, "hidden": tuple(job["hidden"]), "left_out": tuple(job["left_out"])}),
        "after": None if after is None else After(**{**after, "rivals": tuple(after["rivals"])}),
        **{name: tuple(given[name]) for name in ("named", "rivals", "warnings")}})


def like(bench: Bench, rng: np.random.Generator) -> Bench:
    """A bench like another: each constant of the oracle's tolerances drawn anew within them."""
    changes = {}
    for name, (kind, size) in oracle.TOLERANCE.items():
        value, off = getattr(bench, name), size * float(np.clip(rng.normal(), -2.0, 2.0))
        changes[name] = value * (1.0 + off) if kind == "share" else value + off
    return replaced(bench, **{**changes, "viscous": max(changes["viscous"], 0.0),
                              "wrap_slope": max(changes["wrap_slope"], 0.0)})


@dataclass(frozen=True)
class Session:
    """How a job is recorded: healthy trials, the trial's period, s, its peak and what is never let go of, N, Hz."""

    healthy: int
    period_s: float
    peak_n: float
    preload_n: float
    rate_hz: int


def session(job: Job, rng: np.random.Generator | None = None) -> Session:
    """Draw how a job is recorded; `rng`: the job's own stream, which goes on from there."""
    rng = np.random.default_rng((job.serial, job.seed, 3)) if rng is None else rng
    healthy, period, peak = int(rng.integers(1, 4)), float(rng.uniform(1.2, 1.5)), float(rng.choice(PEAKS_N))
    return Session(healthy, period, peak, float(rng.choice([0.0, 0.0, rng.uniform(2.0, 20.0)])),
                   int(rng.choice(imposed.RATES_HZ)))


def case(job: Job) -> Case:
    """Record the trials of a job: one with what is hidden, one to three healthy ones at other peaks and cadences."""
    rng = np.random.default_rng((job.serial, job.seed, 3))
    own = draws.draw(job.serial)
    healthy, period, peak, preload, rate = dataclasses.astuple(session(job, rng))
    bench = like(own, rng)
    changed, values = effects.hide(bench, job.hidden, job.seed)
    motion = imposed.gait(changed, peak, period, job.cycles, preload)
    seeds = [int(s) for s in rng.integers(1 << 30, size=1 + healthy)]
    shown = imposed.trial(changed, seeds[0], motion=motion, rate_hz=rate)
    rest = tuple(
        _table(f"healthy_{i}.csv", imposed.trial(
            like(own, rng), s, PEAKS_N[i % 2], period * (1.0 + 0.1 * i), job.cycles, rate_hz=rate,
            preload_n=preload).columns, job.left_out) for i, s in enumerate(seeds[1:]))
    return Case(_table("trial.csv", shown.columns, job.left_out), rest, bench, changed, values, motion,
                shown.bench.noise, rate)


def _table(name: str, columns: dict[str, np.ndarray], left_out: tuple[str, ...]) -> Table:
    return table(name, {n: v for n, v in columns.items() if n not in left_out})


def answer(job: Job, judged: bool = True) -> Answer:
    """Ask the finder, and once more with the experiment that it proposes; `judged`: the oracle, too.
    """
    made = case(job)
    told = diagnose([made.trial], healthy=list(made.healthy))
    return replace(answered(job, made, told, judged), after=_again(job, made, told))


def _again(job: Job, made: Case, told: Findings) -> After | None:
    """Run the proposed experiment on the changed bench where that needs no hands, and ask with both trials."""
    if told.verdict != "ambiguous" or told.experiment not in moves.EXPERIMENTS:
        return None
    seed = int(np.random.default_rng((job.serial, job.seed, 4)).integers(1 << 30))
    second = _table("experiment.csv", family_moves.run(told.experiment, made.changed, seed, made.rate_hz), job.left_out)
    said = diagnose([made.trial, second], healthy=list(made.healthy))
    return After(told.experiment, said.verdict, tuple(said.rivals))


def answered(job: Job, made: Case, told: Findings, judged: bool) -> Answer:
    """Put what was said beside what was hidden; without END no oracle is asked, since only names are judged there."""
    found = {c["effect"]: {n: {end: float(p[end]) for end in ("value", "low", "high")}
                           for n, p in c["parameters"].items()} for c in told.causes}
    apart = separation(made, job) if judged and job.hidden and not job.left_out else None
    return Answer(job, made.bench.structure.implementation, told.verdict, tuple(found), tuple(told.rivals), found,
                  made.values, apart, tuple(told.warnings), part=told.part,
                  nats=dict((told.evidence or {}).get("log_bayes_factors", {})))


def separation(made: Case, job: Job) -> float:
    """χ² by which the truth is told from every like bench without what is hidden, of two cycles times their number.

    Of two effects the lesser: how far the truth is from the bench that has the other one alone.
    """
    motion = made.motion
    n = int(np.searchsorted(motion.cycle, 2.0))
    short = imposed.Motion(*(values[:n] for values in motion))
    rest = [tuple(h for h in job.hidden if h != name) for name in job.hidden]
    return min(oracle.separation(effects.hide(made.bench, others, job.seed)[0], made.changed, short, made.noise_n,
                                 made.rate_hz) for others in rest) * motion.time.size / n

