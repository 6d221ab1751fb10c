"""Compensation of terms by the extended controller: the corrections that undo modulated constants over a gait cycle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from physics.effects.effect import Trajectory
from physics.laws import Array
from physics.plant.modulated import KNEE_RAD, LATER
from physics.terms import Course, Term

Undo = Callable[[Trajectory, Array], Trajectory]


def _scaled(name: str) -> Undo:
    return lambda met, added: met._replace(**{name: getattr(met, name) * (1.0 + added)})


def _raised(name: str, of: Callable[[Trajectory, Array], Array]) -> Undo:
    return lambda met, added: met._replace(**{name: getattr(met, name) + of(met, added)})


UNDONE: Final[Mapping[str, Undo]] = {
    "cable": _scaled("cable_exponent"),
    "fabric": _scaled("fabric_exponent"),
    "stiffness": lambda met, added: met._replace(stretch_m=met.stretch_m / np.maximum(1.0 + added, 0.05)),
    "zero": _raised("rope_extra_m", lambda met, added: added),
    "arm": _raised("rope_extra_m", lambda met, added: added * (met.knee_rad - KNEE_RAD)),
    "dry": _raised("start_extra_n", lambda met, added: added * met.rope_slip),
    "viscous": _raised("start_extra_n", lambda met, added: added * met.rope_m_s),
    "start_gain": _scaled("start_gain"),
    "start_offset": _raised("start_offset_n", lambda met, added: added),
}
"""Correction that each carrier needs: what a controller can do by START, rope and knee.  END is no input of it."""


def undone(met: Trajectory, terms: Sequence[Term], samples: int) -> Trajectory:
    """Return the corrections with `terms`; `samples`: of a gait cycle, for the gait's phase.

    Terms of END and of the drive need none; modulations by time have their value in a later trial.
    """
    phase = np.asarray(np.arange(met.time_s.size) % samples / samples)
    course = Course(met.time_s, met.rope_m, met.rope_m_s, met.tension_n, met.knee_rad, phase)
    for term in terms:
        if term.carrier not in UNDONE or term.modulation == "time_sine":
            continue
        later = LATER.get(term.modulation)
        added = term.course(course) if later is None else np.full(met.time_s.size, later * term.size)
        met = UNDONE[term.carrier](met, added)
    return met
