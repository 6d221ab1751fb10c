"""From declared parameters to the flat array: element stiffness, damping, node masses, the state at power-on.

Coefficients that the step needs and that are not declared are computed here, once. Node masses are chosen, not
measured: the least for which the fastest mode of the chain turns by `TURN` rad a step (the explicit limit is 2), half
a gram to a gram; the paper takes rope and fabric as massless.
"""

import math
from dataclasses import astuple
from typing import Final

import numpy as np

from parameters import InputError
from physics.laws import Array
from physics.path_laws import TANGENT_FROM
from physics.plant.components import anchor
from physics.plant.state_layout import (
    CABLE_NODES,
    ELEMENTS,
    FABRIC_NODES,
    NODES,
    PARAMETER_NAMES,
    SLOT,
    PlantParameters,
)
from physics.plant.step import STEP_S

TURN: Final = 0.5
LEAST_MASS_KG: Final = 0.5e-3
DAMPING_RATIO: Final = 0.15
LEAST_FABRIC: Final = 0.1
"""Least share of (10)'s linear coefficient that is the fabric's and not the rope's."""


def derive(m: Array, p: PlantParameters) -> None:
    """Write parameters and derived coefficients of `p` into the plant's array `m`."""
    m[: len(PARAMETER_NAMES)] = astuple(p)
    m[SLOT.bandwidth] = 2.0 * math.pi * p.current_bandwidth_hz
    cable = p.lead_compliance + p.sheath_compliance
    a = p.stretch_a * (1.0 + p.stiffness_shape)
    b = p.stretch_b - cable
    if b < LEAST_FABRIC * p.stretch_b:
        raise InputError(
            f"plant: lead_compliance + sheath_compliance = {cable:g} m/N leave the fabric nothing of stretch_b = "
            f"{p.stretch_b:g} m/N; make them at most {(1.0 - LEAST_FABRIC) * p.stretch_b:g} m/N."
        )
    # force at which (10) turns over; beyond 90 % of it the stretch goes on along its tangent
    turning = -b / (2.0 * a)
    tangent = TANGENT_FROM * turning
    m[SLOT.b_fabric], m[SLOT.a4], m[SLOT.half] = b, -4.0 * a, -1.0 / (2.0 * a)
    m[SLOT.t_tangent], m[SLOT.e_tangent] = tangent, b * tangent + a * tangent**2
    m[SLOT.k_tangent] = 1.0 / (b + 2.0 * a * tangent)
    shares = _shares(p)
    m[SLOT.share : SLOT.share + ELEMENTS] = shares
    fabric = shares > 0.0
    m[SLOT.per_share : SLOT.per_share + ELEMENTS] = np.where(fabric, p.stiffness_scale / np.where(fabric, shares, 1), 0)
    segment = p.stiffness_scale * (CABLE_NODES - 1) / p.sheath_compliance
    m[SLOT.k_lead], m[SLOT.k_segment] = p.stiffness_scale / p.lead_compliance, segment
    stiffness = m[SLOT.per_share : SLOT.per_share + ELEMENTS] * m[SLOT.k_tangent]
    stiffness[0], stiffness[1:CABLE_NODES] = m[SLOT.k_lead], segment
    _masses(m, stiffness)
    _surfaces(m, p)
    m[SLOT.free] = p.slack_m
    m[SLOT.term_start_gain] = m[SLOT.term_end_gain] = 1.0


def _shares(p: PlantParameters) -> Array:
    """Return each element's share of the fabric: none for the rope's, the knee's spread over its elements."""
    shares = np.zeros(ELEMENTS)
    shares[CABLE_NODES], shares[NODES] = p.share_before, p.share_after
    shares[CABLE_NODES + 1 : NODES] = max(0.05, 1.0 - p.share_before - p.share_after) / (FABRIC_NODES - 1)
    whole: Array = shares / shares.sum()
    return whole


def _masses(m: Array, stiffness: Array) -> None:
    """Choose node masses for the step and dampings for the elements, from the elements' greatest stiffness."""
    # ω² ≤ 2·(k1 + k2)/m of any mode (Gershgorin), and an explicit step is stable for ω·dt < 2: here ω·dt = TURN
    mass = np.maximum(LEAST_MASS_KG, 2.0 * (stiffness[:-1] + stiffness[1:]) * (STEP_S / TURN) ** 2)
    m[SLOT.inverse_mass + 1 : SLOT.inverse_mass + NODES + 1] = 1.0 / mass
    lighter = np.concatenate([mass[:1], np.minimum(mass[:-1], mass[1:]), mass[-1:]])
    m[SLOT.damping : SLOT.damping + ELEMENTS] = DAMPING_RATIO * np.sqrt(stiffness * lighter)


def _surfaces(m: Array, p: PlantParameters) -> None:
    """Give each node its pre-sliding length and its share of the sheath's viscous drag."""
    cable = slice(SLOT.inverse_delta + 1, SLOT.inverse_delta + CABLE_NODES + 1)
    knee = slice(SLOT.inverse_delta + CABLE_NODES + 1, SLOT.inverse_delta + NODES + 1)
    m[cable], m[knee] = 1.0 / p.presliding_m, 1.0 / p.fabric_presliding_m
    m[SLOT.drag + 1 : SLOT.drag + CABLE_NODES + 1] = p.viscous / CABLE_NODES


def settle(m: Array, p: PlantParameters) -> None:
    """Put the state at rest: knee at its start, rope slack, nothing moving, no creep, time zero."""
    m[SLOT.servo_x : SLOT.bus_v] = 0.0
    for name in ("x", "v", "s", "recent", "tension"):
        start = getattr(SLOT, name)
        m[start : start + (ELEMENTS if name == "tension" else NODES + 2)] = 0.0
    m[SLOT.leg_q] = m[SLOT.motor_q] = p.start_knee_rad
    hung = anchor.py_func(  # numba would compile it for this one call, in every process
        p.rope_per_knee, p.rope_per_knee_quadratic, p.start_knee_rad)
    m[SLOT.x : SLOT.x + NODES + 2] = hung
    m[SLOT.servo_x] = hung + p.slack_m - p.start_slack_m
    m[SLOT.bus_v] = p.supply_v
