"""Terms in the simulated plant: parameters that follow a modulation of the plant's own state.

`rows_of` lays terms out once, `modulate` writes the parameters at each slow step.  A step has happened and a decay is
over in a later trial, a trend stays at its end: these three act as constants.  The phase of a gait is unknown to a
plant, and so is any other signal that it does not have.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numba import njit

from parameters import InputError
from physics.laws import Array
from physics.plant.state_layout import CABLE_NODES, ELEMENTS, MODULATIONS_MOST, NODES, SLOT, TERM_WIDTH
from physics.terms import SPEED_M_S, TENSION_N, Term

(CONSTANT, TENSION, TENSION_SQUARED, SATURATION, KNEE, KNEE_SQUARED, KNEE_BUMP, DIRECTION, POSITION_SINE, POSITION_BUMP,
 TIME_SINE, LOAD_MEMORY) = range(12)
CODES: Final = {
    "constant": CONSTANT, "step": CONSTANT, "decay": CONSTANT, "time": CONSTANT, "tension": TENSION,
    "tension_squared": TENSION_SQUARED, "saturation": SATURATION, "knee": KNEE, "knee_squared": KNEE_SQUARED,
    "knee_bump": KNEE_BUMP, "direction": DIRECTION, "position_sine": POSITION_SINE, "position_bump": POSITION_BUMP,
    "time_sine": TIME_SINE, "load_memory": LOAD_MEMORY}
"""Code of each modulation that the plant can follow."""
LATER: Final = {"step": 1.0, "decay": 0.0, "time": 0.5}
"""Value in a later trial of the modulations by time."""
KNEE_RAD: Final = -0.5
"""Knee angle, rad, about which a term's lever arm turns, as in the forward model."""
(FREE, STIFFNESS, DRAG, TRAVEL, START_GAIN, START_OFFSET, END_GAIN, END_OFFSET) = range(-1, -9, -1)
TARGETS: Final = {
    "zero": FREE, "arm": SLOT.rope_per_knee, "stiffness": STIFFNESS, "cable": SLOT.mu1, "fabric": SLOT.mu2,
    "viscous": DRAG, "cable_travel": TRAVEL, "start_gain": START_GAIN, "start_offset": START_OFFSET,
    "end_gain": END_GAIN, "end_offset": END_OFFSET, "drive_coulomb": SLOT.servo_coulomb_n,
    "drive_viscous": SLOT.servo_viscous, "drive_offset": SLOT.servo_offset_n, "demand_gain": SLOT.demand_gain}
"""Place of each carrier in the plant: an index of its array, or a negative code for what has no single place."""
KEYS: Final = {"saturation": ("from_n",), "knee_bump": ("at_rad", "width_rad"), "position_sine": ("radius_m",),
               "position_bump": ("at_m", "width_m"), "time_sine": ("hz",), "load_memory": ("tau_s",)}
"""Parameters of each modulation, in the order of the plant's row."""


def extend(m: Array, terms: Sequence[Term], where: str) -> None:
    """Write `terms` into the plant's array `m`, after its parameters.

    Raises `InputError` for a term that the plant cannot follow, and for more than it has room for.
    """
    rows = [row for term in terms for row in _rows(term, m, where)]
    if len(rows) > MODULATIONS_MOST:
        raise InputError(f"{where}: {len(terms)} terms; the simulated bench has room for {MODULATIONS_MOST}, and one "
                         "of the lever arm needs two places.")
    for number, row in enumerate(rows):
        first = SLOT.terms + TERM_WIDTH * number
        m[first:first + TERM_WIDTH] = row


def _rows(term: Term, m: Array, where: str) -> list[Array]:
    """Return the rows of one term; the lever arm turns about the angle of the loading, so that its zero moves, too."""
    if term.carrier not in TARGETS or term.modulation not in CODES:
        raise InputError(f"{where}: the simulated bench cannot follow a term of {term.carrier} by {term.modulation}; "
                         "remove it, or compare it by bowden simulate.")
    row = np.zeros(TERM_WIDTH)
    target, parameters = TARGETS[term.carrier], [term.parameters[key] for key in KEYS.get(term.modulation, ())]
    row[:4] = 1.0, target, CODES[term.modulation], float(term.unit == "")
    row[4] = m[target] if target >= 0 else m[SLOT.free] if target == FREE else 1.0
    row[5:5 + len(parameters)] = parameters
    row[7:7 + len(term.coefficients)] = [LATER.get(term.modulation, 1.0) * a for a in term.coefficients]
    if term.carrier != "arm":
        return [row]
    zero = row.copy()
    zero[1], zero[4] = FREE, m[SLOT.free]
    zero[7:9] *= -KNEE_RAD
    return [row, zero]


@njit(inline="always")
def factor(m: Any, first: int, seconds: float, dt: float) -> float:
    """Return a·m of the term whose row begins at `first`, in the unit of its coefficient."""
    code, p0, p1, a, b = m[first + 2], m[first + 5], m[first + 6], m[first + 7], m[first + 8]
    at_end = m[first + 1] == END_GAIN or m[first + 1] == END_OFFSET
    tension = m[SLOT.tension + NODES] if at_end else m[SLOT.tension]
    knee, position = m[SLOT.leg_q], m[SLOT.servo_x] + m[SLOT.encoder_zero_m]
    value = float(a)
    if code == TENSION:
        value = a * (tension / TENSION_N - 1.0)
    elif code == TENSION_SQUARED:
        value = a * ((tension / TENSION_N) ** 2 - 1.0)
    elif code == SATURATION:
        value = a * max(tension - p0, 0.0) / TENSION_N
    elif code == KNEE:
        value = a * (knee - KNEE_RAD)
    elif code == KNEE_SQUARED:
        value = a * (knee * knee - KNEE_RAD * KNEE_RAD)
    elif code == KNEE_BUMP:
        value = a * math.exp(-0.5 * ((knee - p0) / p1) ** 2)
    elif code == DIRECTION:
        value = a * math.tanh(m[SLOT.servo_v] / SPEED_M_S)
    elif code == POSITION_SINE:
        value = a * math.sin(position / p0) + b * math.cos(position / p0)
    elif code == POSITION_BUMP:
        value = a * math.exp(-0.5 * ((position - p0) / p1) ** 2)
    elif code == TIME_SINE:
        angle = 2.0 * math.pi * p0 * seconds
        value = a * math.sin(angle) + b * math.cos(angle)
    elif code == LOAD_MEMORY:
        m[first + 9] += -math.expm1(-dt / p0) * (tension - m[first + 9])
        value = a * m[first + 9] / TENSION_N
    return float(value)


@njit(inline="always")
def _since_last(m: Any, first: int, whole: float) -> float:
    """Return the ratio of the modulation factor `whole`, at least 0.05, to the last step's, and store it."""
    now, before = max(whole, 0.05), m[first + 10]
    m[first + 10] = now
    return float(now / before if before > 0.0 else now)


@njit(inline="always")
def modulate(m: Any, seconds: float, dt: float) -> None:
    """Set the modulated parameters for the present state; sensor terms go to `term_start_…` and `term_end_…`."""
    if m[SLOT.terms] == 0.0:
        return
    m[SLOT.term_start_gain], m[SLOT.term_end_gain] = 1.0, 1.0
    m[SLOT.term_start_n], m[SLOT.term_end_n] = 0.0, 0.0
    for number in range(MODULATIONS_MOST):  # several terms may act on one parameter
        first = SLOT.terms + TERM_WIDTH * number
        place = SLOT.free if m[first + 1] == FREE else int(m[first + 1])
        if m[first] != 0.0 and place >= 0:
            m[place] = m[first + 4]
    for number in range(MODULATIONS_MOST):
        first = SLOT.terms + TERM_WIDTH * number
        if m[first] == 0.0:
            break
        target, base = int(m[first + 1]), m[first + 4]
        added = factor(m, first, seconds, dt)
        change = base * added if m[first + 3] != 0.0 else added
        whole = base + change
        if target >= 0:
            m[target] += change
        elif target == FREE:
            m[SLOT.free] += change
        elif target == STIFFNESS:
            share = _since_last(m, first, whole)
            m[SLOT.k_lead] *= share
            m[SLOT.k_segment] *= share
            for e in range(ELEMENTS):
                m[SLOT.per_share + e] *= share
        elif target == DRAG:
            change = (added - m[first + 10]) / CABLE_NODES
            m[first + 10] = added
            for i in range(1, CABLE_NODES + 1):
                m[SLOT.drag + i] = max(m[SLOT.drag + i] + change, 0.0)
        elif target == TRAVEL:
            share = _since_last(m, first, whole)
            for i in range(1, CABLE_NODES + 1):
                m[SLOT.inverse_delta + i] /= share
        elif target == START_GAIN:
            m[SLOT.term_start_gain] *= whole
        elif target == START_OFFSET:
            m[SLOT.term_start_n] += added
        elif target == END_GAIN:
            m[SLOT.term_end_gain] *= whole
        elif target == END_OFFSET:
            m[SLOT.term_end_n] += added
