"""What the finder answers to a hidden case: asked once, and once more with the experiment that it proposed.

The rule of this file: the finder sees the columns of a case and nothing else of it; a job goes to another process or
machine as it is, and an answer comes back as plain values.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tests.hidden import cases, moves
from tests.hidden.cases import Job

LEAST_RATIO = 1.25
"""Residual against the healthy floor from which a case counts: below it the data hold too little."""


@dataclass(frozen=True)
class After:
    """What was said when the trial of the proposed experiment lay beside the first."""

    experiment: str
    verdict: str
    rivals: tuple[str, ...]


@dataclass(frozen=True)
class Answer:
    """What was hidden and what was said; `ratio`: the largest residual in healthy floors, `share`: of its gain.

    `alone`: of a pair, the same ratio of each effect by itself on the same bench and motion.
    """

    job: Job
    hidden: tuple[str, ...]
    sizes: Mapping[str, float]
    verdict: str
    rivals: tuple[str, ...]
    causes: list[dict[str, Any]]
    ratio: float
    share: float | None
    seconds: float
    experiment: str | None = None
    after: After | None = None
    alone: tuple[float, ...] = ()

    @property
    def counts(self) -> bool:
        """Whether the data hold what was hidden; of a pair, each effect by itself."""
        return min((self.ratio, *self.alone)) >= LEAST_RATIO

    @property
    def named(self) -> bool:
        return self.verdict in ("found", "ambiguous")

    @property
    def first(self) -> str:
        return self.rivals[0] if self.rivals else self.verdict

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return dataclasses.asdict(self)


def from_json(given: Mapping[str, Any]) -> Answer:
    """Return the answer that `as_json` made."""
    after, job = given["after"], given["job"]
    return Answer(**{
        **given, "job": Job(**{**job, "names": tuple(job["names"])}), "hidden": tuple(given["hidden"]),
        "rivals": tuple(given["rivals"]), "alone": tuple(given["alone"]),
        "after": None if after is None else After(**{**after, "rivals": tuple(after["rivals"])})})


def answer(job: Job, cycles: int = 10, healthy: int = 2, again: bool = True) -> Answer:
    """Draw one case and diagnose it, with its healthy trials and its holdout; `again`: with the experiment, too.

    `again` asks, of a pair, of each effect by itself as well.
    """
    from diagnosis.finder import Finder
    from estimation.data import table

    case = cases.case(job, healthy, cycles)
    trial, holdout = table.table("trial", case.trial), table.table("holdout", case.holdout)
    taught = [table.table(f"healthy {i}", columns) for i, columns in enumerate(case.healthy)]
    began = time.perf_counter()
    finder = Finder().fit(taught)
    said = finder.diagnose([trial], [holdout])
    seconds = time.perf_counter() - began
    ratio, share = _risen(said)
    after = None
    if again and said.verdict == "ambiguous" and said.experiment in moves.EXPERIMENTS:
        second = table.table("experiment", moves.run(said.experiment, case.harmed, job.seed))
        told = finder.diagnose([trial, second])
        after = After(said.experiment, told.verdict, tuple(told.rivals))
    alone = [_risen(finder.diagnose([table.table("alone", columns)]))[0] for columns in case.alone if again]
    return Answer(job, case.hidden, {k: float(v) for k, v in case.sizes.items()}, said.verdict, tuple(said.rivals),
                  said.causes, ratio, share, seconds, said.experiment, after, tuple(alone))


def _risen(said: Any) -> tuple[float, float | None]:
    """Return the largest residual in healthy floors, and the share of what could be gained on it that was."""
    rises = [(f.rmse_before / f.floor, f) for f in said.relations.values()
             if f.floor and f.rmse_before is not None]
    if not rises:
        return 0.0, None
    ratio, f = max(rises, key=lambda rise: rise[0])
    share = (f.rmse_before - f.rmse_last) / (f.rmse_before - f.floor) if ratio > LEAST_RATIO else None
    return ratio, share
