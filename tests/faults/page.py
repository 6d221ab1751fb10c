"""Writes docs/faults.csv, docs/faults.svg and docs/faults.md from the verdicts of the matrix.

The table file has every row; page and picture are made from it, so that a run of some rows replaces those rows alone.
"""

# ruff: noqa: E501 — the page's own lines

from __future__ import annotations

import csv
import math
import string
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.faults import cover
from tests.faults.argument import ACTIONS, HAZARDS
from tests.faults.judge import (
    LEG_DEG,
    MOMENT_N,
    SLACK_MS,
    STOP,
    UNSAID_MS,
    UNSAID_N,
    Verdict,
    beyond_stop,
)
from tests.faults.rows import ROWS
from tests.faults.stage import PEAK_N, SEED

BOUNDS = tuple((name, *of) for name, of in STOP.items())
WORST = 3
UNSAID = "<!-- search -->"
HEAD = f"""# What happens when something breaks

For whoever asks what a broken part does to a wearer. `make faults` breaks a {PEAK_N:g} N trial of the virtual bus (serial 1, seed {SEED}) in every way of `tests/faults/rows.py` and `tests/faults/slow.py`,
compares it with its twin, the same trial unbroken, and goes on until the bench stands still. [faults.csv](faults.csv) has one row for each run: the fault, its
moment (per cent of the first gait cycle; ramp 14.5, peak 20, idle 60; "s": seconds of another motion; start: before bring-up), controller, period and
bench, when it was said and in which words, and what was measured. This page shows the worst of them.

![Every stop of the matrix against its bounds](faults.svg)

| measure of a stop | column | bound | meaning |
|---|---|---|---|
""" + "\n".join(f"| {words} | `{name}` | {bound:g} {unit} | {meaning} |" for name, words, unit, bound, meaning in BOUNDS)


def read(path: Path) -> list[Verdict]:
    """Return the verdicts of a table file; none where there is no file."""
    if not path.exists():
        return []
    kinds = {name: type(Verdict._field_defaults.get(name, "")) for name in Verdict._fields}
    kinds |= dict.fromkeys(("detected_ms", "peak_start_n", "peak_end_n", "apart_n", "unsaid_n"), float)
    kinds |= {"named": bool, "whole": bool, "faults": tuple}
    with path.open(encoding="utf-8", newline="") as file:
        return [Verdict(**{name: _value(kinds[name], text) for name, text in row.items()}) for row in csv.DictReader(file)]


def _value(kind: type[Any], text: str) -> Any:
    if kind is bool:
        return text == "yes"
    if kind is tuple:
        return tuple(text.split("; ")) if text else ()
    return kind(text or "nan") if kind is float else text


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return "; ".join(value)
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.4g}"
    return str(value)


def write(path: Path, found: Sequence[Verdict], unsaid: Sequence[str] = ()) -> None:
    """Write the table file, the picture and the page at `path`; rows and a search that did not run are kept."""
    table = path.with_suffix(".csv")
    rows = {(v.name, v.moment, v.walk): v for v in (*read(table), *found)}
    with table.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(Verdict._fields)
        out.writerows([_text(value) for value in verdict] for verdict in rows.values())
    searched = path.read_text(encoding="utf-8").partition(UNSAID)[2] if path.exists() else ""
    searched = "\n".join(("", "", *unsaid)).replace("\n\n\n", "\n\n") + "\n" if unsaid else searched
    picture(path.with_suffix(".svg"), read(table))
    path.write_text(f"{HEAD}\n\n{chr(10).join(_summary(read(table)))}\n\n{UNSAID}{searched}", encoding="utf-8")


def picture(path: Path, found: Iterable[Verdict]) -> None:
    """Draw every stop as a point against the bounds of its measures."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    stops = [v for v in found if not math.isnan(v.torque_ms)]
    with rc_context({"svg.hashsalt": "faults", "svg.fonttype": "none"}):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        for axes, (x, y) in ((left, (BOUNDS[0], BOUNDS[1])), (right, (BOUNDS[4], BOUNDS[2]))):
            for listed, colour, label in ((False, "tab:blue", "master's stop"), (True, "tab:orange", "listed with a reason")):
                mine = [v for v in stops if bool(v.unstoppable) is listed]
                axes.scatter([getattr(v, x[0]) for v in mine], [getattr(v, y[0]) for v in mine], s=5, color=colour, label=label,
                             rasterized=True)
            axes.axvline(x[3], color="0.4", lw=0.8, ls="--")
            axes.axhline(y[3], color="0.4", lw=0.8, ls="--")
            axes.set_xlabel(f"{x[1]} ({x[2]})")
            axes.set_ylabel(f"{y[1]} ({y[2]})")
        right.legend(loc="upper right", fontsize=7)
        figure.savefig(path, metadata={"Date": None})


def _summary(found: Sequence[Verdict]) -> list[str]:
    """Return the lines of the page between its head and the search."""
    stops = [v for v in found if not math.isnan(v.torque_ms)]
    broken = [v for v in found if v.faults]
    lines = [f"{len({v.name for v in found})} faults, {len(found)} rows over {len({v.walk for v in found})} motions; {len(stops)} stops, {len(broken)} rows "
             f"beyond a bound. {_coverage(found)}", "", "## Worst rows of each measure", "", "| measure | worst, bound | fault | at | motion | said |", "|---|---|---|---|---|---|"]
    for name, words, unit, bound, _ in BOUNDS:
        mine = sorted((v for v in stops if not v.unstoppable), key=lambda v: -getattr(v, name))[:WORST]
        lines += [f"| {words} | {getattr(v, name):.0f} of {bound:g} {unit} | {v.name} | {v.moment} | {v.walk} | {_said(v)} |" for v in mine]
    if broken:
        lines += ["", "## Rows beyond a bound", "", "| fault | at | motion | what |", "|---|---|---|---|"]
        lines += [f"| {v.name} | {v.moment} | {v.walk} | {'; '.join(v.faults)} |" for v in broken]
    reasons = {v.name: v.unstoppable for v in stops if v.unstoppable and beyond_stop(v)}
    if reasons:
        lines += ["", "## Stops that cannot keep the bounds, and why", ""]
        lines += ["Worst of each measure, in its unit above; below, the reasons by letter.", ""]
        lines += _with_reasons([*(words for _, words, *_ in BOUNDS)], {name: (_stop_of(name, found), reason) for name, reason in reasons.items()})
    over = {v.name: v.beyond for v in found if v.beyond and (
        v.apart_n > MOMENT_N or v.unsaid_n > UNSAID_N or v.leg_deg > LEG_DEG)}
    if over:
        lines += ["", "## Slow faults that depart further before they are said, and why", ""]
        lines += _with_reasons(["END off, N", f"for {UNSAID_MS} ms, N", "leg off, degrees", "true END, N"],
                               {name: (_unsaid_of(name, found), reason) for name, reason in over.items()})
    quiet = {v.name: v.excuse for v in found if v.excuse and math.isnan(v.detected_ms)}
    if quiet:
        lines += ["", "## What goes unsaid, and why no signal could show it", ""]
        lines += [f"- {', '.join(name for name in quiet if quiet[name] == excuse)}: {excuse}." for excuse in dict.fromkeys(quiet.values())]
    return [*lines, "", "## By unsafe control action", "", *_by_action(found), "", "## Time by hazard", "", *_by_hazard(found)]


def _coverage(found: Sequence[Verdict]) -> str:
    """Return how many of the runs that `make faults` makes the table has."""
    there = {(v.name, v.walk, v.moment) for v in found}
    sampled = [(row.name, str(walk), moment) for walk, rows in cover.sample(ROWS).items() for row in rows for moment in row.moments]
    slow = [(row.name, str(walk), moment) for row in ROWS if row.gradual for walk in row.walks for moment in walk.moments or row.moments
            if moment in row.moments]
    return (f"Among them are {len(there.intersection(sampled)):,} of the {len(sampled):,} runs of the covering sample (each sudden fault at every 5 % of the "
            f"gait and every 0.6 s of home, jog and identify) and {len(there.intersection(slow))} of the {len(slow)} runs of slow faults.")


def _said(v: Verdict) -> str:
    return (v.said.replace("|", "/") or "–")[:90]


def _with_reasons(columns: Sequence[str], faults: Mapping[str, tuple[Sequence[str], str]]) -> list[str]:
    """Return a table of faults with their figures and the letter of a reason, and the reasons behind it."""
    letters = dict(zip(dict.fromkeys(reason for _, reason in faults.values()), string.ascii_lowercase, strict=False))
    return [f"| fault | {' | '.join(columns)} | why |", "|---" * (len(columns) + 2) + "|",
            *(f"| {name} | {' | '.join(figures)} | {letters[reason]} |" for name, (figures, reason) in faults.items()), "",
            *(f"- {letter}: {reason}." for reason, letter in letters.items())]


def _stop_of(name: str, found: Sequence[Verdict]) -> list[str]:
    """Return the worst of each measure over a fault's rows."""
    mine = [v for v in found if v.name == name and not math.isnan(v.torque_ms)]
    return [f"{max(getattr(v, column) for v in mine):.0f}" for column, *_ in BOUNDS]


def _unsaid_of(name: str, found: Sequence[Verdict]) -> list[str]:
    """By how much the worst row of a fault moved END and the leg unsaid."""
    mine = [v for v in found if v.name == name]
    return [f"{max(getattr(v, column) for v in mine):.{digits}f}"
            for column, digits in (("apart_n", 1), ("unsaid_n", 1), ("leg_deg", 1), ("peak_end_n", 0))]


def _by_action(found: Sequence[Verdict]) -> list[str]:
    """Return the table of unsafe control actions (STPA) with what their rows did."""
    lines = ["| unsafe control action | leads to | required | faults, rows | said | unsaid | "
             "END off, N | leg off in the stop, degrees | END in the stop, N |", "|---|---|---|---|---|---|---|---|---|"]
    for action in ACTIONS:
        mine = [v for v in found if v.action == action.words]
        if mine:
            unsaid = sum(math.isnan(v.detected_ms) for v in mine)
            lines.append(
                f"| {action.words} | {action.hazard} | {action.required} | {len({v.name for v in mine})}, {len(mine)} | "
                f"{len(mine) - unsaid} | {unsaid} | {max(v.apart_n for v in mine):.1f} | "
                f"{_most(mine, 'off_deg'):.0f} | {_most(mine, 'stop_end_n'):.0f} |")
    return lines


def _most(found: Sequence[Verdict], name: str) -> float:
    """Return the greatest value of a measure over the rows that were stopped."""
    return max((getattr(v, name) for v in found if not math.isnan(getattr(v, name))), default=0.0)


def _by_hazard(found: Sequence[Verdict]) -> list[str]:
    """Return the table of time until a fault is said and until the rope is slack, against what is tolerated."""
    lines = [f"Unsafe time is the time with true END more than {UNSAID_N:g} N, or the leg more than {LEG_DEG:g}°, off before it is "
             f"said; tolerated are {UNSAID_MS} ms of it, and then {SLACK_MS:.0f} ms until the rope is slack.", "",
             "| hazard | faults | unsafe time, most, ms | until slack, most, ms | until no torque, most, ms |", "|---|---|---|---|---|"]
    for hazard in HAZARDS:
        words = {action.words for action in ACTIONS if action.hazard == hazard}
        mine = [v for v in found if v.action in words and not v.excuse and not v.unstoppable]
        if mine:
            lines.append(f"| {hazard} | {len({v.name for v in mine})} | {max(v.exposed_ms for v in mine):.0f} "
                         f"| {_most(mine, 'slack_ms'):.0f} | {_most(mine, 'torque_ms'):.0f} |")
    return lines
