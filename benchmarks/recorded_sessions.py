"""Recorded sessions of benches over months: four methods of the family and the packaged plant, healthy or changed.

A session is a short gait trial of a bench whose constants are drawn anew within the tolerance of like benches, or, for
the packaged plant, on another `--day`.  A change begins in session `BEGINS`; the sessions before it are the healthy
bench's own, so that they are recorded once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from tests.hidden.family import like
from tests.plants import draws, imposed
from tests.plants.bench import IMPLEMENTATIONS, Bench, replaced

PACKAGED: Final = "packaged"
KINDS: Final = (*IMPLEMENTATIONS, PACKAGED)
BEGINS: Final = 3
"""First changed session, counted from 0: the fourth one."""
WEAR_SESSIONS: Final = 8
"""Sessions over which wear raises the friction of the cable."""
CYCLES, PERIOD_S, PEAK_N, RATE_HZ, NOISE_N = 6, 1.2, 40.0, 500, 0.1


class ChangeCase(NamedTuple):
    """A change of a bench: of one of the family by session since it began, of the packaged plant as effects; names of
    the effects of which one is right, and the part of the bench that the diagnosis should name."""

    family: Callable[[Bench, int], Bench]
    packaged: Callable[[int], Mapping[str, Mapping[str, float]]]
    names: frozenset[str]
    part: str


def _worn(since: int, most: float) -> float:
    return 1.0 + most * min(since + 1, WEAR_SESSIONS) / WEAR_SESSIONS


FRICTION: Final = frozenset({"cable_friction", "fabric_friction", "cable_bend", "load_dependent_friction",
                             "fabric_wrap", "viscous_friction"})
MU1: Final = 0.08
"""Cable friction of the packaged plant at its middle."""
CHANGES: Final[Mapping[str, ChangeCase]] = {
    "START gain +4 %": ChangeCase(
        lambda b, k: replaced(b, start_gain=1.04 * b.start_gain), lambda k: {"start_gain": {"start_gain": 1.04}},
        frozenset({"start_gain"}), "elasticity and gains"),
    "stiffness -12 %": ChangeCase(
        lambda b, k: replaced(b, stiffness=0.88 * b.stiffness), lambda k: {"stiffness": {"stiffness_scale": 0.88}},
        frozenset({"stiffness"}), "elasticity and gains"),
    "friction +30 %": ChangeCase(
        lambda b, k: replaced(b, mu1=1.3 * b.mu1), lambda k: {"cable_friction": {"mu1": 1.3 * MU1}},
        FRICTION, "friction path"),
    "backlash 26 mrad": ChangeCase(
        lambda b, k: replaced(b, play=b.play + 0.026), lambda k: {"knee_backlash": {"knee_backlash": 0.026}},
        frozenset({"knee_backlash"}), "geometry"),
    "wear +30 % over 8": ChangeCase(
        lambda b, k: replaced(b, mu1=_worn(k, 0.3) * b.mu1), lambda k: {"cable_friction": {"mu1": _worn(k, 0.3) * MU1}},
        FRICTION, "friction path"),
}


@cache
def _motion(kind: str, serial: int) -> imposed.Motion:
    return imposed.gait(draws.draw(serial, implementation=kind), PEAK_N, PERIOD_S, CYCLES)


def record(folder: Path, kind: str, serial: int, session: int, change: str | None = None) -> Path:
    """Record one session of a bench and return its file; a file that is there already is not recorded again."""
    changed = change is not None and session >= BEGINS
    name = "healthy" if not changed else "".join(c if c.isalnum() else "_" for c in str(change))
    path = folder / f"{kind}-{serial}-{name}-{session}{'.mcap' if kind == PACKAGED else '.csv'}"
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    case = CHANGES[change] if changed and change is not None else None
    if kind == PACKAGED:
        _run(path, serial, session, {} if case is None else case.packaged(session - BEGINS))
        return path
    rng = np.random.default_rng((serial, session, 17))
    bench = like(draws.draw(serial, implementation=kind), rng)
    bench = bench if case is None else case.family(bench, session - BEGINS)
    columns = imposed.trial(bench, 1000 * serial + session, motion=_motion(kind, serial), noise_n=NOISE_N,
                            rate_hz=RATE_HZ).columns
    np.savetxt(path, np.stack(list(columns.values()), axis=1), fmt="%.8g", delimiter=",", header=",".join(columns),
               comments="")
    return path


def _run(path: Path, serial: int, session: int, effects: Mapping[str, Mapping[str, float]]) -> None:
    """Run the packaged plant's gait on the day of a session, through the wire."""
    from bowden.bench import buses, configuration
    from bowden.trials import session as trials

    sections: dict[str, Any] = configuration.read(None)
    gait = configuration.override(sections["gait"], {
        "peak_n": ("--peak", PEAK_N), "period_s": ("--period", PERIOD_S), "cycles": ("--cycles", CYCLES),
        "settle": ("--settle", 0)})
    reference, sections["gait"], _ = trials.reference(gait, None, None, period_given=True, peak_given=True)
    bus = buses.simulated(serial=serial, day=session, plant_model={"effects": dict(effects)} if effects else None)
    result = trials.perform(trials.prepare(sections, reference, None, bus, dry_run=False), path)
    if result["outcome"] != "completed" or not math.isfinite(result["simulated_s"]):
        raise RuntimeError(f"{path}: {result['stop_reason']}")
