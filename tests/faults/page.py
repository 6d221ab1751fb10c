"""Writes docs/faults.md from the verdicts of the matrix.

The rule of this file: every figure of the page is a verdict's; the words around the table are here.
"""

# ruff: noqa: E501 — the page's own lines

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

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

Written by `make faults` (`python -m tests.faults.run --stealth --page docs/faults.md`) from the rows of `tests/faults/rows.py`:
{{faults}} faults, {{rows}} rows with their gaits and the moments at which they begin. Unless it says otherwise a row is a gait of {PEAK_N:g} N and {WALK.period_s:g} s
on the virtual bus ({WALK.cycles} cycles, controller `{WALK.controller}`, serial 1, seed {SEED}), broken at the moment named (ramp 14.5 %, peak
20 %, idle 60 % of the first cycle; start: before bring-up), and compared with its twin, the same trial unbroken.

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

{{summary}}

"""


def write(path: Path, found: Sequence[Verdict], unsaid: Sequence[str] = ()) -> None:
    """Write the page."""
    broken = [verdict for verdict in found if verdict.faults]
    summary = "Every row keeps its bounds." if not broken else "Beyond a bound:\n\n" + "\n".join(
        f"- {v.name}, {v.moment}: {'; '.join(v.faults)}" for v in broken)
    lines = [HEAD.format(faults=len({v.name for v in found}), rows=len(found), summary=summary),
             "| fault | at | gait | said after | true peak | END off | leg | slack | pull | stop | log | said |",
             "|---|---|---|---|---|---|---|---|---|---|---|---|"]
    lines += [_row(verdict) for verdict in found]
    lines += unsaid
    quiet = {v.name: v.excuse for v in found if v.excuse and math.isnan(v.detected_ms)}
    over = {v.name: v.beyond for v in found if v.beyond}
    if over:
        lines += ["", "## Bounds that are not kept, and why", ""]
        lines += [f"- {name}: {_worst(name, found)}; {reason}." for name, reason in over.items()]
    if quiet:
        lines += ["", "## What goes unsaid, and why no signal could show it", ""]
        lines += [f"- {name}: {excuse}." for name, excuse in quiet.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _worst(name: str, found: Sequence[Verdict]) -> str:
    """By how much the worst row of a fault moved END and the leg unsaid."""
    mine = [v for v in found if v.name == name]
    return (f"END off by up to {max(v.apart_n for v in mine):.1f} N, {max(v.unsaid_n for v in mine):.1f} N for {UNSAID_MS} "
            f"ms, the leg by {max(v.leg_deg for v in mine):.1f}°, true tension {max(v.peak_end_n for v in mine):.0f} N")


def _row(v: Verdict) -> str:
    said = v.said.replace("|", "/") or "–"
    return (f"| {v.name} | {v.moment} | {v.walk} | {_number(v.detected_ms, 1)} | {v.peak_start_n:.0f} / {v.peak_end_n:.0f} "
            f"| {v.apart_n:.1f} / {v.unsaid_n:.1f} | {v.leg_deg:.1f} | {_number(v.slack_ms)} | {_number(v.pulled, 2)} "
            f"| {_number(v.stop_ms)} | {'whole' if v.whole else 'torn'} | {said} |")


def _number(value: float, digits: int = 0) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}"
