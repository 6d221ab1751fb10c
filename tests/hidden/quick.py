"""The short set that runs with every change: fixed seeds, shorter trials, no second question.

The rule of this file: a file of tests asks its part of the set once; what it asserts are rates with their reason, and
a failure shows what was hidden and what was said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from tests.hidden import cases
from tests.hidden.answers import Answer, answer
from tests.hidden.cases import Job

FIRST = 50_000
CYCLES, HEALTHY = 8, 2
PATH = (
    "cable_bend", "cable_friction", "drum_eccentricity", "fabric_creep", "fabric_friction", "fabric_wrap",
    "friction_drift", "knee_backlash", "load_dependent_friction", "moment_arm", "presliding", "slack", "stiffness",
    "stribeck", "viscous_friction")
SENSED = tuple(sorted(set(cases.EFFECTS) - set(PATH)))


def jobs(kind: str, first: int, names: Iterable[str]) -> list[Job]:
    """Return one case of each of `names` (drawn by seed where ""), every second one of an altered structure."""
    return [Job(kind, FIRST + first + i, (name,) if name else (), i % 2 == 1) for i, name in enumerate(names)]


def ask(asked: Sequence[Job]) -> list[Answer]:
    """Return the answers, in order."""
    return [answer(job, CYCLES, HEALTHY, again=False) for job in asked]


def of(told: Sequence[Answer], holds: Callable[[Answer], bool]) -> list[str]:
    """Return, as text, the answers of which something holds."""
    return [f"{a.job.seed}: {' + '.join(a.hidden) or 'nothing'} → {a.verdict} {', '.join(a.rivals)} ({a.ratio:.2f})"
            for a in told if holds(a)]
