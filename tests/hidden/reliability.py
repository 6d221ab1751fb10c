"""Probabilities of names against how often they are right: a reliability diagram as a table.

    python -m tests.hidden.reliability ANSWERS… [--page]

ANSWERS: files of answers of `truths_run` and `family_run`.  `--page` writes the table into docs/diagnosis_figures.md.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.frame import put
from diagnosis.evidence.decision import NAMED_NATS, probabilities
from physics.effects.hypotheses import HYPOTHESES
from tests.hidden import family, truths, truths_run
from tests.hidden.family_run import DOCS

BINS = (0.0, 0.5, 0.8, 0.95, 1.0)


class Judged(NamedTuple):
    """One case with at most one hidden effect: its structure, log Bayes factors, and the effects that are right."""

    structure: str
    nats: Mapping[str, float]
    right: tuple[str, ...]
    named: bool


def read(paths: Sequence[Path]) -> list[Judged]:
    """Return the cases of files of answers that have log Bayes factors, pairs and foreign changes left out."""
    cases: dict[tuple[object, ...], Judged] = {}
    for path in paths:
        for line in path.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            if "answer" in row:
                b = family.from_json(row["answer"])
                names, foreign = b.job.hidden, any(n in family.WIRE or n not in HYPOTHESES for n in b.job.hidden)
                if foreign or len(names) > 1:
                    continue
                case = Judged(b.structure, b.nats, truths.alike(names[0]) if names else (), bool(b.rivals))
                cases[b.structure, names, b.job.serial, b.job.seed] = case
            else:
                a = truths_run.Answer(**{**row, "hidden": tuple(row["hidden"])})
                names, foreign = a.effects, a.hidden[0] in truths.OUTSIDE
                if foreign or len(names) > 1:
                    continue
                case = Judged(a.structure, a.nats, truths.alike(names[0]) if names else (), bool(a.among))
                cases[a.structure, a.hidden, a.seed, a.motion] = case
    return [case for case in cases.values() if case.nats]


def table(cases: Sequence[Judged]) -> str:
    """Return how often first names are right by the probability said; effects that no gait separates count together."""
    told = []
    for case in cases:
        said = probabilities(case.nats, NAMED_NATS)
        if case.named and said:
            among = truths.alike(max(said, key=lambda name: said[name]))
            told.append((sum(said.get(name, 0.0) for name in among), bool({*among} & {*case.right})))
    counts = Counter(case.structure for case in cases)
    lines = [f"{len(cases)} cases ({', '.join(f'{name} {count}' for name, count in sorted(counts.items()))}), "
             f"{len(told)} names.", "", "| probability said | names | mean said | right |", "|---|---|---|---|"]
    for low, high in itertools.pairwise(BINS):
        inside = [(p, right) for p, right in told if low <= p < high or p == high == 1.0]
        mean = f"{np.mean([p for p, _ in inside]):.2f}" if inside else "–"
        lines.append(f"| {low:g} … {high:g} | {len(inside)} | {mean} | {sum(right for _, right in inside)} |")
    return "\n".join(lines)


def main(arguments: list[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("answers", nargs="+", type=Path)
    parser.add_argument("--page", action="store_true")
    given = parser.parse_args(arguments)
    text = "Printed by `python -m tests.hidden.reliability ANSWERS…`: " + table(read(given.answers))
    print(text)
    if given.page:
        put(DOCS, "reliability", text)


if __name__ == "__main__":
    main(sys.argv[1:])
