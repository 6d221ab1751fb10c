"""Writes docs/faults.md from the verdicts of the matrix.

Every figure of the page comes from a verdict; the words around the tables are here.
"""

# ruff: noqa: E501 — the page's own lines

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from tests.faults.argument import ACTIONS, HAZARDS
from tests.faults.judge import (
    END_LIMIT_N,
    LEG_DEG,
    MOMENT_N,
    OVER,
    PULL,
    SLACK_MS,
    SLACK_N,
    SLOW_MS,
    START_LIMIT_N,
    STOP_MS,
    UNSAID_MS,
    UNSAID_N,
    Verdict,
)
from tests.faults.stage import PEAK_N, SEED, WALK

HEAD = f"""# What happens when something breaks

Written by `make faults` (`python -m tests.faults.run --stealth --page docs/faults.md`) from the rows of `tests/faults/rows.py` and
`tests/faults/slow.py`. A run of some rows (`--kind`, `--stealth`) replaces its own part of this page. Unless a row says otherwise it is a gait of
{PEAK_N:g} N and {WALK.period_s:g} s on the virtual bus ({WALK.cycles} cycles, controller `{WALK.controller}`, serial 1, seed {SEED}), broken at the moment named
(ramp 14.5 %, peak 20 %, idle 60 % of the first cycle; start: before bring-up), and compared with its twin, the same trial unbroken.

| column | meaning | bound |
|---|---|---|
| said after | from the fault to the first event that speaks of it, ms | |
| true peak | greatest true START / END afterwards, N | {OVER * START_LIMIT_N:.0f} / {OVER * END_LIMIT_N:.0f} |
| END off | greatest departure of true END from the twin's while nothing was said: for a moment / for {UNSAID_MS} ms, N | {MOMENT_N:g} (slow faults) / {UNSAID_N:g} |
| leg | greatest departure of the true knee angle from the twin's while nothing was said, degrees; slow faults | {LEG_DEG:g} |
| slack | from the stop's decision until both true tensions stay below {SLACK_N:g} N, ms | {SLACK_MS:.0f}; {SLOW_MS:.0f} where the knee stands or falls |
| pull | greatest true tension after the decision by the greatest of: what it was then, {SLACK_N:g} N, and what it becomes with a servo stage that is dead from 0.6 ms later on (momentum and knee: no command acts sooner) | {PULL:g} |
| stop | from the decision until the servo is last seen enabled, ms | {STOP_MS:.0f} |
| log | a row for every cycle up to the end, and the stop's own event | whole |
"""
AT_ONCE, SLOW, UNSAID = PARTS = ("at once", "slow", "unsaid")
"""Parts of the page: faults that begin at once, slow faults, and the search of `tests.faults.stealth`."""
_ENDS = "<!-- end of {} -->"


def write(path: Path, found: Sequence[Verdict], unsaid: Sequence[str] = ()) -> None:
    """Write the page; a part that has no results here is kept as the file at `path` has it."""
    parts = kept(path.read_text(encoding="utf-8")) if path.exists() else {}
    for name, slow in ((AT_ONCE, False), (SLOW, True)):
        mine = [verdict for verdict in found if verdict.gradual == slow]
        if mine:
            parts[name] = "\n".join(_part(mine, slow))
    if unsaid:
        parts[UNSAID] = "\n".join(unsaid).strip()
    path.write_text("\n".join([HEAD, *(f"{parts[name]}\n\n{_ENDS.format(name)}\n" for name in PARTS if name in parts)]),
                    encoding="utf-8")


def kept(page: str) -> dict[str, str]:
    """Return the parts of a page by name, without the marks at their ends."""
    parts, at = {}, page.find("\n## ")
    for name in PARTS:
        end = page.find(_ENDS.format(name), at)
        if end >= 0:
            parts[name] = page[at:end].strip()
            at = end + len(_ENDS.format(name))
    return parts


def _part(found: Sequence[Verdict], slow: bool) -> list[str]:
    """Return the lines of one table with its bounds, and the reasons under it."""
    broken = [verdict for verdict in found if verdict.faults]
    count = f"{len({v.name for v in found})} faults, {len(found)} rows"
    lines = (["## Slow faults", "", f"{count} with their gaits of six cycles and their moments."] if slow else
             ["## Faults that begin at once", "", f"{count} with their moments."])
    lines[-1] += " Every row keeps its bounds or has a reason below." if not broken else " Beyond a bound:"
    if slow:
        lines[-1] += f" Gaits (controller, period): {'; '.join(sorted({v.walk for v in found}))}."
    lines += ["", *(f"- {v.name}, {v.moment}, {v.walk}: {'; '.join(v.faults)}" for v in broken), *([""] if broken else [])]
    gait, leg = ("gait | ", "leg | ") if slow else ("", "")
    lines += [f"| fault | at | {gait}said after | true peak | END off | {leg}slack | pull | stop | log | said |",
              "|---|---|---|---|---|---|---|---|---|---|" + "---|---|" * slow]
    lines += [_row(verdict, slow) for verdict in found]
    lines += ["", "### By unsafe control action", "", *_by_action(found)]
    lines += ["", "### Time by hazard", "", *_by_hazard(found)]
    quiet = {v.name: v.excuse for v in found if v.excuse and math.isnan(v.detected_ms)}
    over = {v.name: v.beyond for v in found if v.beyond and (
        v.apart_n > MOMENT_N or v.unsaid_n > UNSAID_N or v.leg_deg > LEG_DEG)}
    if over:
        lines += ["", "### Bounds that are not kept, and why", ""]
        lines += [f"- {name}: {_worst(name, found)}; {reason}." for name, reason in over.items()]
    if quiet:
        lines += ["", "### What goes unsaid, and why no signal could show it", ""]
        lines += [f"- {name}: {excuse}." for name, excuse in quiet.items()]
    return lines


def _by_action(found: Sequence[Verdict]) -> list[str]:
    """Return the table of unsafe control actions (STPA) with what their rows did."""
    lines = ["| unsafe control action | leads to | required | faults, rows | said | unsaid | "
             "END off | true peak START / END, N |", "|---|---|---|---|---|---|---|---|"]
    for action in ACTIONS:
        mine = [v for v in found if v.action == action.words]
        if not mine:
            continue
        unsaid = sum(math.isnan(v.detected_ms) for v in mine)
        lines.append(
            f"| {action.words} | {action.hazard} | {action.required} | {len({v.name for v in mine})}, {len(mine)} | "
            f"{len(mine) - unsaid} | {unsaid} | {max(v.apart_n for v in mine):.1f} / {max(v.unsaid_n for v in mine):.1f} | "
            f"{max(v.peak_start_n for v in mine):.0f} / {max(v.peak_end_n for v in mine):.0f} |")
    return lines


def _by_hazard(found: Sequence[Verdict]) -> list[str]:
    """Return the table of time until a fault is said and until the rope is slack, against what is tolerated."""
    lines = [f"Unsafe time is the time with true END more than {UNSAID_N:g} N, or the leg more than {LEG_DEG:g}°, off before it is "
             f"said; tolerated are {UNSAID_MS} ms of it, and then {SLACK_MS:.0f} ms until the rope is slack ({SLOW_MS:.0f} ms "
             "where the knee stands or falls).", "", "| hazard | faults | unsafe time, most, ms | until slack, most, ms | together, most, ms |",
             "|---|---|---|---|---|"]
    for hazard in HAZARDS:
        words = {action.words for action in ACTIONS if action.hazard == hazard}
        mine = [v for v in found if v.action in words and not v.excuse]
        if not mine:
            continue
        slack = [0.0 if math.isnan(v.slack_ms) else v.slack_ms for v in mine]
        both = [v.exposed_ms + after for v, after in zip(mine, slack, strict=True)]
        lines.append(f"| {hazard} | {len({v.name for v in mine})} | {max(v.exposed_ms for v in mine):.0f} "
                     f"| {max(slack):.0f} | {max(both):.0f} |")
    return lines


def _worst(name: str, found: Sequence[Verdict]) -> str:
    """By how much the worst row of a fault moved END and the leg unsaid."""
    mine = [v for v in found if v.name == name]
    return (f"END off by up to {max(v.apart_n for v in mine):.1f} N, {max(v.unsaid_n for v in mine):.1f} N for {UNSAID_MS} "
            f"ms, the leg by {max(v.leg_deg for v in mine):.1f}°, true tension {max(v.peak_end_n for v in mine):.0f} N")


def _row(v: Verdict, slow: bool) -> str:
    said = v.said.replace("|", "/") or "–"
    gait, leg = (f"{v.walk} | ", f"{v.leg_deg:.1f} | ") if slow else ("", "")
    return (f"| {v.name} | {v.moment} | {gait}{_number(v.detected_ms, 1)} | {v.peak_start_n:.0f} / {v.peak_end_n:.0f} "
            f"| {v.apart_n:.1f} / {v.unsaid_n:.1f} | {leg}{_number(v.slack_ms)} | {_number(v.pulled, 2)} "
            f"| {_number(v.stop_ms)} | {'whole' if v.whole else 'torn'} | {said} |")


def _number(value: float, digits: int = 0) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}"
