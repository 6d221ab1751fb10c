"""What a row's trial is held against: its twin, the bounds, and the name that the fault must be given.

The rule of this file: pure arithmetic on what the processes told.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tests.faults.names import name_of
from tests.faults.stage import WALK, Row, Told, Walk

START_LIMIT_N, END_LIMIT_N = 120.0, 90.0
OVER = 1.10
UNSAID_N, UNSAID_MS, MOMENT_N, LEG_DEG = 5.0, 200, 10.0, 3.0
SLACK_N, SLACK_MS = 10.0, 200.0
"""Tension up to which a rope is slack: a leg at 400 degrees/s drags a drum without torque by so much (2 N of Coulomb
friction, 15 N·s/m at 0.3 m/s, the rotor's inertia).  Time until it is."""
OFF_DEG, OVER_DEG_S, STOP_END_N, TORQUE_MS = 20.0, 150.0, 50.0, 250.0
"""Bounds through a stop to standstill: leg off its course, leg above its own speed, true END, time with torque."""
HANGING_RAD = 0.0
"""Angle at which a leg without torque comes to rest: its way there is a fall, which no stop without torque prevents."""
NO_TORQUE_NM = 1e-3
SPEED_MS = 5
"""Time over which a speed of the leg is taken, ms."""


class Measure(NamedTuple):
    """Measure of a stop to standstill: in words, its unit and its bound."""

    words: str
    unit: str
    bound: float
    meaning: str


STOP = {
    "off_deg": Measure(
        "leg off its course", "degrees", OFF_DEG, "distance of the leg from the angles that the twin passes from the "
        f"fault to {TORQUE_MS:.0f} ms after the stop, and those from there to a leg that hangs"),
    "over_deg_s": Measure("leg above its own speed", "degrees/s", OVER_DEG_S,
                          "greatest speed of the leg beyond the twin's greatest in that time"),
    "stop_end_n": Measure("END in the stop", "N", STOP_END_N, "greatest true END tension from the stop to standstill; "
                          "what END had when the stop began is no breach"),
    "slack_ms": Measure("rope taut", "ms", SLACK_MS,
                        f"from the stop until both true tensions stay below {SLACK_N:g} N"),
    "torque_ms": Measure("torque", "ms", TORQUE_MS, "from the stop until neither drive gives torque"),
}
"""Measures of a stop by the column of a `Verdict`."""


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
    unstoppable: str = ""
    off_deg: float = float("nan")
    """Greatest distance of the leg from its course: the angles that the twin passes from the fault to `TORQUE_MS` after
    the stop, and those between them and a leg that hangs."""
    over_deg_s: float = float("nan")
    """Greatest speed of the leg above the twin's greatest in that time."""
    low_deg: float = float("nan")
    high_deg: float = float("nan")
    stop_start_n: float = float("nan")
    stop_end_n: float = float("nan")
    """Greatest true tension from the stop to standstill."""
    said_end_n: float = float("nan")
    """True END when the stop began: what was there before anything was said."""
    slack_ms: float = float("nan")
    torque_ms: float = float("nan")


def judged(row: Row, told: Told, twin: Told, walk: Walk = WALK) -> Verdict:
    """Hold one row against the bounds."""
    detected_ns, said = detection(row, told)
    after = [true[true[:, 0] > told.fault_ns] for true in told.paths if len(true)]
    stop_ns = next((t for t, kind, _s, _x in told.events if kind == "safety" and t >= told.fault_ns), -1)
    peaks = [max((float(true[:, at].max(initial=0.0)) for true in after), default=0.0) for at in (1, 2)]
    until_ns = detected_ns if detected_ns >= 0 else told.last_ns
    # homing and its kin pull until a tension is reached, whenever that is: the twin's END at that time is no bound
    apart, unsaid, exposed = _unsaid(told, twin, until_ns) if walk.motion == "gait" else (0.0, 0.0, 0.0)
    leg, leg_ms = _leg(told, twin, until_ns)
    named = name_of(said) in row.named if said else False
    verdict = Verdict(
        row.name, told.moment, (detected_ns - told.fault_ns) * 1e-6 if detected_ns >= 0 else float("nan"), named,
        said, peaks[0], peaks[1], apart, unsaid, told.whole, row.silent, (), str(walk),
        leg, row.beyond, row.gradual, row.action.words, max(exposed, leg_ms), row.unstoppable)
    if stop_ns >= 0:
        verdict = verdict._replace(**stopped(told, twin, stop_ns))
    return verdict._replace(faults=tuple(_faults(row, verdict, told)))


def stopped(told: Told, twin: Told, stop_ns: int) -> dict[str, float]:
    """Return what a stop did until standstill, the worst of all force paths, as fields of a `Verdict`."""
    found: dict[str, list[float]] = {}
    for true, own in zip(told.paths, twin.paths, strict=True):
        later = true[true[:, 0] >= stop_ns]
        course = own[(own[:, 0] >= told.fault_ns) & (own[:, 0] <= stop_ns + TORQUE_MS * 1e6)]
        leg = np.degrees(later[:, 3])
        least, most = np.degrees([course[:, 3].min(initial=HANGING_RAD), course[:, 3].max(initial=HANGING_RAD)])
        one = {
            "off_deg": float(np.maximum(least - leg, leg - most).max(initial=0.0)),
            "over_deg_s": max(0.0, _fastest(later) - _fastest(course)),
            "low_deg": -float(leg.min()), "high_deg": float(leg.max()),
            "stop_start_n": float(later[:, 1].max()), "stop_end_n": float(later[:, 2].max()),
            "said_end_n": float(later[0, 2]),
            "slack_ms": _last_ms(later, np.max(later[:, 1:3], axis=1) >= SLACK_N, stop_ns),
            "torque_ms": _last_ms(later, np.max(np.abs(later[:, 4:6]), axis=1) > NO_TORQUE_NM, stop_ns)}
        for name, value in one.items():
            found.setdefault(name, []).append(value)
    worst = {name: max(values) for name, values in found.items()}
    return worst | {"low_deg": -worst["low_deg"]}


def _fastest(true: Any) -> float:
    """Return the greatest speed of the leg, degrees per second, as a mean over `SPEED_MS`."""
    if len(true) <= SPEED_MS:
        return 0.0
    return float(np.degrees(np.abs(true[SPEED_MS:, 3] - true[:-SPEED_MS, 3]).max()) * 1e3 / SPEED_MS)


def _last_ms(true: Any, there: Any, since_ns: int) -> float:
    """Return the time, ms, from `since_ns` to the last row at which something is there; 0 where it never is."""
    return float(true[there][-1, 0] - since_ns) * 1e-6 if there.any() else 0.0


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
    other = np.interp(told.true[mine, 0], twin.true[:, 0], twin.true[:, 3])
    apart = np.degrees(np.abs(told.true[mine, 3] - other))
    return float(apart.max(initial=0.0)), float(np.sum(apart > LEG_DEG))


def beyond_stop(verdict: Verdict, excused: Sequence[str] = ()) -> list[str]:
    """Return the bounds of a stop that a row does not keep, but for the excused ones, with what it did."""
    bounds = {**STOP, "stop_end_n": STOP["stop_end_n"]._replace(bound=max(STOP_END_N, verdict.said_end_n))}
    return [f"{of.words} {getattr(verdict, name):.0f} {of.unit}" for name, of in bounds.items()
            if name not in excused and getattr(verdict, name) > of.bound]


def _faults(row: Row, verdict: Verdict, told: Told) -> Sequence[str]:
    found = []
    if told.crashed:
        found.append(f"crashed: {told.crashed}")
    said = np.isfinite(verdict.detected_ms)
    if said and not verdict.named and (row.named or verdict.said.startswith("program failed")):
        found.append("named otherwise")
    if not said and not (row.silent or row.gradual or row.quiet):
        found.append("not said")
    if verdict.unsaid_n > UNSAID_N and not (row.silent or row.beyond):
        found.append(f"END off by {verdict.unsaid_n:.1f} N for {UNSAID_MS} ms unsaid")
    if row.gradual and verdict.apart_n > MOMENT_N and not row.beyond:
        found.append(f"END off by {verdict.apart_n:.1f} N unsaid")
    if row.gradual and verdict.leg_deg > LEG_DEG and not row.beyond:
        found.append(f"leg off by {verdict.leg_deg:.1f}° unsaid")
    excused = row.excused or STOP if row.unstoppable else ()
    found += beyond_stop(verdict, excused)
    high = verdict.peak_start_n > OVER * START_LIMIT_N or verdict.peak_end_n > OVER * END_LIMIT_N
    if high and (row.excused or not row.unstoppable):
        found.append(f"true tension {verdict.peak_start_n:.0f}/{verdict.peak_end_n:.0f} N")
    if not verdict.whole:
        found.append("log torn")
    return found
