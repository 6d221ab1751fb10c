"""The rope path from the drum to the leg: elements with tension between nodes with friction, one time step.

Compiled, no allocation, no branch on the rope's state. Node 0 is the rope on the drum, node NODES + 1 the anchor on
the leg. Between them the cable's nodes slide in the sheath and the fabric's on the knee, whose surface moves with the
leg. Friction therefore turns with the rope's velocity in (3) and with the fabric's strain rate in (7).
"""

from typing import Any

from numba import njit

from physics.path_laws import capstan_share, load_dependence, presliding_step, stribeck
from physics.plant.components import spring, strap
from physics.plant.state_layout import CABLE_NODES, FABRIC_NODES, NODES, SLOT


@njit(inline="always")
def tensions(m: Any) -> None:
    """Set every element's tension, N, from the nodes' positions and velocities."""
    x, v, t, free, c = SLOT.x, SLOT.v, SLOT.tension, SLOT.free, SLOT.damping
    m[t] = spring(m[x] - m[x + 1] - m[free], m[v] - m[v + 1], m[SLOT.k_lead], m[c])
    k = m[SLOT.k_segment]
    for e in range(1, CABLE_NODES):
        m[t + e] = spring(m[x + e] - m[x + e + 1], m[v + e] - m[v + e + 1], k, m[c + e])
    b, a4, half = m[SLOT.b_fabric], m[SLOT.a4], m[SLOT.half]
    e_tangent, t_tangent, k_tangent = m[SLOT.e_tangent], m[SLOT.t_tangent], m[SLOT.k_tangent]
    for e in range(CABLE_NODES, NODES + 1):
        m[t + e] = strap(
            m[x + e] - m[x + e + 1] - m[free + e], m[v + e] - m[v + e + 1], m[c + e], m[SLOT.per_share + e],
            b, a4, half, e_tangent, t_tangent, k_tangent,
        )


@njit(inline="always")
def slide(m: Any, first: int, last: int, surface: float, dt: float) -> float:
    """Integrate rope nodes first…last−1 over `dt`, s, on a surface at `surface`, m/s; return the force on it, N."""
    x, v, s, t = SLOT.x, SLOT.v, SLOT.s, SLOT.tension
    light = m[SLOT.slack_drag]
    total = 0.0
    for i in range(first, last):
        # (3) and (7) of one node: s·(T1 + T2)·tanh(μ·dθ/2) is T1/T2 = e^(μ·dθ) in full sliding
        normal = m[t + i - 1] + m[t + i]
        drag = m[SLOT.drag + i] + light * max(0.0, 1.0 - normal)
        friction = m[s + i] * m[SLOT.grip + i] * normal + drag * (m[v + i] - surface)
        # semi-implicit Euler: the position moves by the new velocity, which keeps the energy of an oscillation bounded
        m[v + i] += dt * m[SLOT.inverse_mass + i] * (m[t + i - 1] - m[t + i] - friction)
        m[x + i] += dt * m[v + i]
        m[s + i] = presliding_step(m[s + i], dt * m[SLOT.inverse_delta + i] * (m[v + i] - surface))
        total += friction
    return total


@njit(inline="always")
def refresh_grip(m: Any, first: int, last: int, exponent: float, surface: float, dt: float) -> None:
    """Set tanh(μ·dθ/2) of nodes first…last−1 for the exponent μ·dθ of each, with load and recent sliding speed."""
    fade = min(1.0, dt / m[SLOT.stribeck_memory_s])
    ratio, speed, slope = m[SLOT.stribeck_ratio], m[SLOT.stribeck_speed_m_s], m[SLOT.load_slope]
    for i in range(first, last):
        tension = 0.5 * (m[SLOT.tension + i - 1] + m[SLOT.tension + i])
        # Stribeck's curve by a lagged speed: without the memory single segments chatter at kilohertz (docs/physics.md)
        m[SLOT.recent + i] += fade * (m[SLOT.v + i] - surface - m[SLOT.recent + i])
        factor = load_dependence(slope, tension) * stribeck(ratio, speed, m[SLOT.recent + i])
        m[SLOT.grip + i] = capstan_share(exponent * factor)


@njit(inline="always")
def refresh_friction(m: Any, flexion: float, surface: float, drift: float, dt: float) -> None:
    """Refresh every node's grip at the knee flexion |θk|: θ1·(1 + κb·|θk|) in the sheath, φ0 + κ·|θk| on the knee."""
    bend = m[SLOT.theta1_rad] * max(0.0, 1.0 + m[SLOT.cable_bend] * flexion)
    refresh_grip(m, 1, CABLE_NODES + 1, drift * m[SLOT.mu1] * bend / CABLE_NODES, 0.0, dt)
    wrap = m[SLOT.wrap_rad] + m[SLOT.fabric_wrap] * flexion
    refresh_grip(m, CABLE_NODES + 1, NODES + 1, drift * m[SLOT.mu2] * wrap / FABRIC_NODES, surface, dt)


@njit(inline="always")
def creep(m: Any, dt: float) -> None:
    """Let the fabric creep over `dt` under the mean of its end tensions; each element takes its share."""
    tension = 0.5 * (m[SLOT.tension + CABLE_NODES] + m[SLOT.tension + NODES])
    # γ̇ = (J·T − γ)/τ (Kelvin and Voigt)
    m[SLOT.creep] += dt / m[SLOT.creep_s] * (m[SLOT.creep_compliance] * tension - m[SLOT.creep])
    for e in range(CABLE_NODES, NODES + 1):
        m[SLOT.free + e] = m[SLOT.share + e] * m[SLOT.creep]
