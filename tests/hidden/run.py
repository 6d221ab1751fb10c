"""Hide effects by seed, ask the finder, and print every bar with its figure, its count and whether it is met.

The rule of this file: the finder sees the columns of a case and nothing else of it; a bar is computed from what
it answered, and cases that no figure can be had of are counted, never left out silently.

    python -m tests.hidden.run [--quick] [--jobs 2] [--first SEED] [--json FILE]
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import dataclasses
import json
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

from tests.hidden import cases

FIRST = 100_000
"""Seeds from here on were not looked at while the finder was built."""
LEAST_RATIO = 1.25
"""Residual against the healthy floor from which a case counts: below it the data hold too little."""
FULL = {"one": 14 * 30, "two": 60, "none": 90, "outside": 45}
QUICK = {"one": 30, "two": 8, "none": 14, "outside": 8}

IDENTIFIABLE = (
    "viscous_friction", "friction_drift", "presliding", "knee_backlash", "end_mass", "end_gain", "start_gain",
    "end_offset", "start_offset", "end_drift", "start_drift", "end_delay", "end_filter", "timestamp_skew",
    "drive_coulomb", "drive_viscous", "drive_inertia", "drive_offset")
"""Effects whose parameter one gait trial determines: listed in docs/diagnosis.md before the run."""


@dataclass(frozen=True)
class Answer:
    """What was hidden and what was said."""

    kind: str
    seed: int
    hidden: tuple[str, ...]
    sizes: dict[str, float]
    verdict: str
    rivals: tuple[str, ...]
    causes: list[dict[str, Any]]
    ratio: float
    share: float | None
    seconds: float

    @property
    def counts(self) -> bool:
        return self.ratio >= LEAST_RATIO

    @property
    def named(self) -> bool:
        return self.verdict in ("found", "ambiguous")

    @property
    def first(self) -> str:
        return self.rivals[0] if self.rivals else self.verdict


def jobs(quick: bool, first: int) -> list[tuple[str, int, tuple[str, ...]]]:
    """Return the cases: every effect equally often, the other kinds by seed."""
    wanted, names = (QUICK if quick else FULL), sorted(cases.EFFECTS)
    made = []
    for kind, count in wanted.items():
        for i in range(count):
            made.append((kind, first + len(made), (names[i % len(names)],) if kind == "one" else ()))
    return made


def answer(job: tuple[str, int, tuple[str, ...]]) -> Answer:
    """Draw one case and diagnose it, with its healthy trials and its holdout."""
    from diagnosis import data
    from diagnosis.finder import diagnose

    kind, seed, names = job
    case = cases.case(seed, kind, names)
    said = diagnose(
        [data.table("trial", case.trial)], healthy=[data.table(f"healthy {i}", h) for i, h in enumerate(case.healthy)],
        holdout=[data.table("holdout", case.holdout)])
    rises = [(f.rmse_before / f.floor, (f.rmse_before, f.rmse_after, f.floor)) for f in said.relations.values()
             if f.checked and f.floor and f.rmse_before is not None]
    ratio, (before, after, floor) = max(rises, key=lambda r: r[0])
    share = (before - after) / (before - floor) if before > LEAST_RATIO * floor else None
    return Answer(kind, seed, case.hidden, {k: float(v) for k, v in case.sizes.items()}, said.verdict,
                  tuple(said.rivals), said.causes, ratio, share, said.seconds)


def answers(todo: Sequence[tuple[str, int, tuple[str, ...]]], workers: int) -> list[Answer]:
    """Diagnose every case, spread over processes; the order is that of `todo`."""
    if workers <= 1:
        return [answer(job) for job in todo]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(answer, todo, chunksize=2))


@dataclass(frozen=True)
class Bar:
    """One bar: the figure, what it is out of, the bound and whether it is met (None: nothing to say)."""

    name: str
    figure: float
    count: int
    bound: str
    met: bool | None


def _share(name: str, hits: Iterable[bool], bound: float, at_least: bool = True) -> Bar:
    held = list(hits)
    figure = 100.0 * sum(held) / len(held) if held else math.nan
    met = None if not held else figure >= bound if at_least else figure <= bound
    return Bar(name, figure, len(held), f"{'≥' if at_least else '≤'} {bound:g} %", met)


def _value(name: str, values: Iterable[float], reduce: Callable[[Sequence[float]], float], bound: float,
           unit: str) -> Bar:
    held = list(values)
    figure = reduce(held) if held else math.nan
    return Bar(name, figure, len(held), f"≤ {bound:g}{unit}", figure <= bound if held else None)


def _errors(told: Iterable[Answer]) -> Iterable[tuple[float, bool]]:
    """Yield (relative error, covered) of each hidden parameter that was told for the right effect."""
    for a in told:
        for cause in a.causes:
            if cause["effect"] in a.hidden and cause["effect"] in IDENTIFIABLE:
                for name, p in cause["parameters"].items():
                    if a.sizes.get(name):
                        true = a.sizes[name]
                        healthy = 1.0 if name.endswith("_gain") else 0.0
                        yield abs(p["value"] - true) / abs(true - healthy), p["low"] <= true <= p["high"]


def bars(told: Sequence[Answer]) -> list[Bar]:
    """Return every bar in the order of the list they were set in."""
    one = [a for a in told if a.kind == "one" and a.counts]
    two = [a for a in told if a.kind == "two" and a.counts]
    outside = [a for a in told if a.kind == "outside" and a.counts]
    healthy = [a for a in told if a.kind == "none"]
    errors = list(_errors(one))
    return [
        _share("right class", (a.hidden[0] in a.rivals for a in one), 95),
        _share("first name right", (a.first == a.hidden[0] for a in one), 90),
        _share("wrong name", (a.named and a.hidden[0] not in a.rivals for a in one), 1, False),
        _value("mean class size", (float(len(a.rivals)) for a in one if a.named), _mean, 1.6, ""),
        _share("false alarms", (a.verdict != "none" for a in healthy), 2, False),
        _share("outside: named", (a.named for a in outside), 2, False),
        _share("outside: unexplained", (a.verdict == "unexplained" for a in outside), 95),
        _value("parameter error, median", (100.0 * e for e, _ in errors), median, 10, " %"),
        _share("interval covers", (covered for _, covered in errors), 90),
        _share("0.9 of the achievable gain", (a.share >= 0.9 for a in one if a.share is not None), 90),
        _share("two: class", (set(a.hidden) <= set(a.rivals) for a in two), 85),
        _share("two: one right", (bool(set(a.hidden) & set(a.rivals)) for a in two), 95),
        _value("single: seconds, median", (a.seconds for a in one), median, 10, " s"),
        _value("pair: seconds, most", (a.seconds for a in two), max, 60, " s"),
    ]


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def confusion(told: Sequence[Answer]) -> list[str]:
    """Return one line an effect: how often it was first, in the class, missed, unexplained, and what stood instead."""
    lines = []
    for name in sorted(cases.EFFECTS):
        mine = [a for a in told if a.kind == "one" and a.hidden == (name,)]
        if not mine:
            continue
        counted = [a for a in mine if a.counts]
        wrong = sorted({a.first for a in counted if a.named and a.first != name})
        lines.append(f"| `{name}` | {len(mine)} | {len(counted)} | {sum(a.first == name for a in counted)} "
                     f"| {sum(name in a.rivals for a in counted)} | {sum(a.verdict == 'none' for a in counted)} "
                     f"| {sum(a.verdict == 'unexplained' for a in counted)} | {', '.join(wrong)} |")
    return lines


def page(told: Sequence[Answer]) -> str:
    """Return both tables as text."""
    lines = ["| bar | figure | of | bound | met |", "|---|---|---|---|---|"]
    lines += [f"| {b.name} | {b.figure:.3g} | {b.count} | {b.bound} | "
              f"{'—' if b.met is None else 'yes' if b.met else 'no'} |" for b in bars(told)]
    lines += ["", f"| effect | cases | ratio ≥ {LEAST_RATIO} | first | in class | none | unexplained | first instead |",
              "|---|---|---|---|---|---|---|---|", *confusion(told)]
    return "\n".join(lines)


def main(arguments: Sequence[str]) -> int:
    """Run the set that was asked for; status 0 whatever the bars say: they are a measurement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="60 cases in place of 615")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--first", type=int, default=FIRST, help="first seed")
    parser.add_argument("--json", type=Path, help="write every answer there")
    asked = parser.parse_args(arguments)
    told = answers(jobs(asked.quick, asked.first), asked.jobs)
    if asked.json is not None:
        asked.json.write_text(json.dumps([dataclasses.asdict(a) for a in told], indent=1), encoding="utf-8")
    print(page(told))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
