"""What a row's trial is held against: its twin, the bounds, and the name that the fault must be given.

The rule of this file: pure arithmetic on what the processes told.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tests.faults.names import name_of
from tests.faults.stage import WALK, Row, Told, Walk

START_LIMIT_N, END_LIMIT_N = 120.0, 90.0
OVER = 1.10
UNSAID_N, UNSAID_MS, MOMENT_N, LEG_DEG = 5.0, 200, 10.0, 3.0
SLACK_N, SLACK_MS, SLOW_MS = 5.0, 100.0, 400.0
PULL = 1.05
STOP_MS = 500.0


class Verdict(NamedTuple):
    """One row at one moment, times in ms, tensions in N; `faults` lists the bounds that it does not keep."""

    name: str
    moment: str
    detected_ms: float
    named: bool
    said: str
    peak_start_n: float
    peak_end_n: float
    apart_n: float
    unsaid_n: float
    slack_ms: float
    pulled: float
    stop_ms: float
    whole: bool
    excuse: str
    faults: tuple[str, ...]
    walk: str = str(WALK)
    leg_deg: float = 0.0
    beyond: str = ""
    gradual: bool = False
    action: str = ""
    exposed_ms: float = 0.0
    """Time with true END more than `UNSAID_N`, or the leg more than `LEG_DEG`, off the twin's before it was said."""


def judged(row: Row, told: Told, twin: Told, walk: Walk = WALK) -> Verdict:
    """Hold one row against the bounds."""
    detected_ns, said = detection(row, told)
    true = told.true
    after = true[true[:, 0] > told.fault_ns] if len(true) else np.zeros((1, 3))
    if not len(after):
        after = np.zeros((1, 3))
    stop_ns = next((t for t, kind, _s, _x in told.events if kind == "safety" and t >= told.fault_ns), -1)
    peaks = after[:, 1].max(), after[:, 2].max()
    until_ns = detected_ns if detected_ns >= 0 else int(after[-1, 0])
    apart, unsaid, exposed = _unsaid(told, twin, until_ns)
    leg, leg_ms = _leg(told, twin, until_ns)
    slack = pulled = stop = float("nan")
    if stop_ns >= 0:
        later = true[true[:, 0] >= stop_ns]
        taut = later[np.max(later[:, 1:], axis=1) >= SLACK_N] if len(later) else later
        slack = (taut[-1, 0] - stop_ns) * 1e-6 if len(taut) else 0.0
        at = true[true[:, 0] <= stop_ns]
        first = float(at[-1, 1:].max()) if len(at) else 0.0
        most = float(later[:, 1:].max()) if len(later) else 0.0
        floor = max(first, told.floor_n, SLACK_N)
        pulled = most / floor if most > SLACK_N else 1.0
        stop = max(0.0, (told.off_ns - stop_ns) * 1e-6)
    named = name_of(said) in row.named if said else False
    verdict = Verdict(
        row.name, told.moment, (detected_ns - told.fault_ns) * 1e-6 if detected_ns >= 0 else float("nan"), named,
        said, *peaks, apart, unsaid, slack, pulled, stop, told.whole, row.silent, (), str(walk),
        leg, row.beyond, row.gradual, row.action.words, max(exposed, leg_ms))
    return verdict._replace(faults=tuple(_faults(row, verdict, told)))


def detection(row: Row, told: Told) -> tuple[int, str]:
    """When it was first said, and how: a stop's reason, or for rows that need no stop an event's text."""
    if told.crashed:
        return -1, told.crashed
    for time_ns, kind, _source, text in told.events:
        if time_ns < told.fault_ns - 1_000_000 or kind in ("host", "warning"):
            continue
        if kind == "safety" or (row.event and name_of(text) in row.named):
            return time_ns, told.reason if kind == "safety" and told.reason else text
    return (told.last_ns, told.reason) if told.reason else (-1, "")


def _unsaid(told: Told, twin: Told, until_ns: int) -> tuple[float, float, float]:
    """Largest departure of true END from the twin's before it was said: for a moment, and for `UNSAID_MS`, N.

    Third: for how long, ms, it was beyond `UNSAID_N`.
    """
    if not len(told.true) or not len(twin.true) or told.moment == "start":
        return 0.0, 0.0, 0.0
    mine = told.true[(told.true[:, 0] > told.fault_ns) & (told.true[:, 0] <= until_ns)]
    if not len(mine):
        return 0.0, 0.0, 0.0
    apart = np.abs(mine[:, 2] - np.interp(mine[:, 0], twin.true[:, 0], twin.true[:, 2]))
    exposed = float(np.sum(apart > UNSAID_N))  # a row of the truth each ms
    if len(mine) < UNSAID_MS:
        return float(apart.max()), 0.0, exposed
    windows = np.lib.stride_tricks.sliding_window_view(apart, UNSAID_MS)
    return float(apart.max()), float(windows.min(axis=1).max()), exposed


def _leg(told: Told, twin: Told, until_ns: int) -> tuple[float, float]:
    """Largest departure of the leg from the twin's before it was said, degrees; for how long, ms, beyond `LEG_DEG`."""
    if not len(told.true) or told.moment == "start":
        return 0.0, 0.0
    mine = (told.true[:, 0] > told.fault_ns) & (told.true[:, 0] <= until_ns)
    other = np.interp(told.true[mine, 0], twin.true[:, 0], twin.leg)
    apart = np.degrees(np.abs(told.leg[mine] - other))
    return float(apart.max(initial=0.0)), float(np.sum(apart > LEG_DEG))


def _faults(row: Row, verdict: Verdict, told: Told) -> Sequence[str]:
    found = []
    if told.crashed:
        found.append(f"crashed: {told.crashed}")
    said = np.isfinite(verdict.detected_ms)
    if said and not verdict.named and row.named:
        found.append("named otherwise")
    if not said and not row.silent and not row.gradual:
        found.append("not said")
    if verdict.unsaid_n > UNSAID_N and not (row.silent or row.beyond):
        found.append(f"END off by {verdict.unsaid_n:.1f} N for {UNSAID_MS} ms unsaid")
    if row.gradual and verdict.apart_n > MOMENT_N and not row.beyond:
        found.append(f"END off by {verdict.apart_n:.1f} N unsaid")
    if row.gradual and verdict.leg_deg > LEG_DEG and not row.beyond:
        found.append(f"leg off by {verdict.leg_deg:.1f}° unsaid")
    if not row.needs_sto:
        if verdict.peak_start_n > OVER * START_LIMIT_N or verdict.peak_end_n > OVER * END_LIMIT_N:
            found.append(f"true tension {verdict.peak_start_n:.0f}/{verdict.peak_end_n:.0f} N")
        if told.reason and verdict.slack_ms > (SLOW_MS if row.slow else SLACK_MS):
            found.append(f"taut for {verdict.slack_ms:.0f} ms")
        if told.reason and verdict.pulled > PULL:
            found.append(f"the stop pulled: × {verdict.pulled:.2f}")
        if told.reason and verdict.stop_ms > STOP_MS:
            found.append(f"the stop took {verdict.stop_ms:.0f} ms")
    if not verdict.whole:
        found.append("log torn")
    return found
