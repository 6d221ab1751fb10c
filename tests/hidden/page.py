"""The judging's part of docs/diagnosis_figures.md: bars, what tells against those not met, and the confusion matrix.

The rule of this file: pure text from answers.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from statistics import median

from tests.hidden import cases
from tests.hidden.answers import LEAST_RATIO, Answer
from tests.hidden.bars import FAINT, Bar, bars

SHOWN = 8
"""Kinds of failure that are told of one bar."""
SIZES = (LEAST_RATIO, 1.5, 2.0, 3.0, math.inf)
"""Residuals in healthy floors by which single effects are told apart."""
ALL_THE_GAIN = 0.95
"""From this share on nothing is left to gain: the floor itself is known to some per cent."""


def text(told: Sequence[Answer], said: str) -> str:
    """Return all tables; `said`: by which command, commit and seeds."""
    found = bars(told)
    return "\n".join([said, "", *table(found), "", *failures(found), "", *sizes(told), "", *pairs(told), "",
                      *confusion(told), "", *effects(told)])


def table(found: Sequence[Bar]) -> list[str]:
    """Return the table of bars."""
    return ["| bar | figure | of | bound | met |", "|---|---|---|---|---|",
            *(f"| {b.name} | {b.figure:.3g} | {b.count} | {b.bound or '—'} | {_met(b)} |" for b in found)]


def _met(bar: Bar) -> str:
    return "—" if bar.met is None else "yes" if bar.met else "no"


def failures(found: Sequence[Bar]) -> list[str]:
    """Return a line for each bar that is not met: the cases against it, hidden → said."""
    lines = []
    for bar in found:
        if bar.met is False and bar.against:
            most = "; ".join(f"{case} ×{count}" for case, count in bar.against[:SHOWN])
            more = sum(count for _, count in bar.against[SHOWN:])
            whole = sum(count for _, count in bar.against)
            tail = f"; {more} more" if more else ""
            lines.append(f"- *{bar.name}*: {whole} against it, {bar.faint} of them with a residual below {FAINT} "
                         f"healthy floors, {bar.altered} of altered structure: {most}{tail}.")
    return ["Against the bars that are not met (hidden → said, how often):", "", *lines] if lines else [
        "No case tells against a bar that is not met."]


def sizes(told: Sequence[Answer]) -> list[str]:
    """Return how often the truth was in the class, by how far the residual lies above the healthy floor."""
    counted = [a for a in told if a.job.kind == "one" and a.counts]
    lines = ["How far a single effect's residual lies above the healthy floor, and what that does to the class:", "",
             "| residual, healthy floors | cases | in class (%) | none | unexplained |", "|---|---|---|---|---|"]
    for low, high in itertools.pairwise(SIZES):
        mine = [a for a in counted if low <= a.ratio < high]
        right = 100.0 * sum(a.hidden[0] in a.rivals for a in mine) / len(mine) if mine else math.nan
        upper = f"… {high:g}" if math.isfinite(high) else "and more"
        lines.append(f"| {low:g} {upper} | {len(mine)} | {right:.3g} | {sum(a.verdict == 'none' for a in mine)} "
                     f"| {sum(a.verdict == 'unexplained' for a in mine)} |")
    return lines


def pairs(told: Sequence[Answer]) -> list[str]:
    """Return, of pairs of which one is missing in the class, how much of the achievable gain the other one had."""
    part = [a.share for a in told if a.job.kind == "two" and a.counts and a.share is not None
            and len(set(a.hidden) & set(a.rivals)) == 1]
    if not part:
        return ["Of no pair is one effect alone in the class."]
    whole = sum(share >= ALL_THE_GAIN for share in part)
    return [f"Of {len(part)} pairs one effect alone is in the class. It had the median {100.0 * median(part):.0f} % of "
            f"what both could gain on unseen cycles, and at least {100.0 * ALL_THE_GAIN:.0f} % in {whole} of them: "
            "there what the other one does is not above the floor of a healthy bench."]


def confusion(told: Sequence[Answer]) -> list[str]:
    """Return the matrix hidden × first name, of cases that count; a column's number is its effect's row."""
    counted = [a for a in told if (a.job.kind == "wire" or (a.counts and a.job.kind in ("one", "outside"))) and a.hidden
               ] + [a for a in told if a.job.kind == "none"]
    rows = {name: Counter(a.first for a in counted if (a.hidden or ("nothing",))[0] == name)
            for name in (*sorted(cases.EFFECTS), *sorted(cases.WIRE), *sorted(cases.OUTSIDE), "nothing")}
    number = {name: i for i, name in enumerate(rows, 1)}
    said = {name for row in rows.values() for name in row}
    columns = [*(name for name in rows if name in said), *sorted(said - set(rows))]
    heads = [str(number.get(name, name)) for name in columns]
    return [f"Hidden (row) against the first name said (column: the number of its row), single effects with a residual "
            f"of at least {LEAST_RATIO} healthy floors, wire faults, effects outside the catalogue and healthy plants:",
            "", "| # | hidden | " + " | ".join(heads) + " |", "|---|---|" + "---|" * len(columns),
            *(f"| {number[name]} | `{name}` | " + " | ".join(str(row[c]) if row[c] else "" for c in columns) + " |"
              for name, row in rows.items() if row)]


def effects(told: Sequence[Answer]) -> list[str]:
    """Return one line an effect: how often it was hidden, counted, first, in the class, missed, unexplained."""
    lines = [f"| effect | cases | ratio ≥ {LEAST_RATIO} | first | in class | none | unexplained | refused |",
             "|---|---|---|---|---|---|---|---|"]
    for name in (*sorted(cases.EFFECTS), *sorted(cases.WIRE)):
        mine = [a for a in told if a.job.kind in ("one", "wire") and a.hidden == (name,)]
        counted = [a for a in mine if a.counts or a.job.kind == "wire"]
        words = [sum(a.verdict == word for a in counted) for word in ("none", "unexplained", "refused")]
        if mine:
            lines.append(f"| `{name}` | {len(mine)} | {sum(a.counts for a in mine)} "
                         f"| {sum(a.first == name for a in counted)} | {sum(name in a.rivals for a in counted)} | "
                         + " | ".join(map(str, words)) + " |")
    return lines
