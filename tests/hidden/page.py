"""The judging's part of docs/diagnosis.md: bars, what tells against those not met, and the confusion matrix.

The rule of this file: pure text from answers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from tests.hidden import cases
from tests.hidden.answers import LEAST_RATIO, Answer
from tests.hidden.bars import FAINT, Bar, bars

SHOWN = 8
"""Kinds of failure that are told of one bar."""


def text(told: Sequence[Answer], said: str) -> str:
    """Return all tables; `said`: by which command, commit and seeds."""
    found = bars(told)
    return "\n".join([said, "", *table(found), "", *failures(found), "", *confusion(told), "", *effects(told)])


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
