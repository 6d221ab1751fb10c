"""The plant's compiled step (drive, rope path, knee drive and leg, 10 µs at a time), and the row of its true signals.

Semi-implicit Euler (velocities first, then positions), one flat array in and out, nothing else. numba's cache does not
see a change in an imported module, so the sources' digest is a constant of the compiled functions.
"""

import hashlib
import math
from pathlib import Path
from typing import Any, Final

from numba import njit

from physics.path_laws import presliding_step, stribeck
from physics.plant.chain import creep, refresh_friction, slide, tensions
from physics.plant.components import GRAVITY, anchor, current_step, knee_limit, reducer, supply
from physics.plant.modulated import modulate
from physics.plant.state_layout import CABLE_NODES, FABRIC_NODES, NODES, SLOT

STEP_NS: Final = 10_000
STEP_S: Final = STEP_NS * 1e-9
SLOW: Final = 10
"""Steps between updates of the slow states: grip, creep, drift."""


@njit(inline="always")
def servo(m: Any, demand_a: float, arm: float) -> None:
    """Advance motor and drum by one step; `arm` is the rope drawn per metre at the drum (1 without eccentricity)."""
    radius, constant = m[SLOT.drum_radius_m], m[SLOT.torque_constant]
    speed, current = m[SLOT.servo_v], m[SLOT.current]
    back_emf = constant * speed / radius
    bus = supply(m[SLOT.supply_v], m[SLOT.supply_ohm], current * (back_emf + m[SLOT.winding_ohm] * current))
    m[SLOT.bus_v] = bus
    m[SLOT.current], m[SLOT.integral] = current_step(
        current, m[SLOT.integral], demand_a, back_emf, bus,
        m[SLOT.winding_ohm], m[SLOT.winding_h], m[SLOT.bandwidth], STEP_S,
    )
    force = m[SLOT.demand_gain] * m[SLOT.current] * constant / radius
    s = m[SLOT.servo_s]
    coulomb = m[SLOT.servo_coulomb_n] * s * (1.0 + m[SLOT.servo_asymmetry] * s)
    coulomb *= stribeck(m[SLOT.servo_stribeck_ratio], m[SLOT.servo_stribeck_speed_m_s], speed)
    drag = m[SLOT.servo_viscous] * (speed + m[SLOT.servo_viscous_asymmetry] * abs(speed))
    # M·v̇ = K·i/r − friction − rope, all at the rope; Coulomb friction by Dahl's state s in place of a sign
    loss = coulomb + drag + m[SLOT.servo_offset_n] + m[SLOT.tension] * arm
    if m[SLOT.servo_unbalance_n] > 0.0:
        loss += m[SLOT.servo_unbalance_n] * math.sin(m[SLOT.servo_x] / radius + m[SLOT.servo_unbalance_rad])
    m[SLOT.servo_v] += STEP_S / m[SLOT.servo_inertia_kg] * (force - loss)
    m[SLOT.servo_x] += STEP_S * m[SLOT.servo_v]
    m[SLOT.servo_s] = presliding_step(s, STEP_S * m[SLOT.servo_v] / m[SLOT.servo_presliding_m])


@njit(inline="always")
def knee(m: Any, demand_nm: float, rope_nm: float) -> None:
    """Advance knee drive, reducer and leg by one step; `rope_nm`: torque of rope and fabric on the leg, N·m."""
    given = knee_limit(
        demand_nm, m[SLOT.motor_w], m[SLOT.knee_torque_limit_nm], m[SLOT.knee_stall_nm], m[SLOT.knee_no_load_rad_s])
    m[SLOT.motor_t] += STEP_S / m[SLOT.knee_lag_s] * (given - m[SLOT.motor_t])
    through = reducer(
        m[SLOT.motor_q] - m[SLOT.leg_q], m[SLOT.motor_w] - m[SLOT.leg_w],
        0.5 * m[SLOT.knee_backlash_rad], m[SLOT.reducer_stiffness], m[SLOT.reducer_damping])
    loss = m[SLOT.knee_coulomb_nm] * m[SLOT.motor_s] + m[SLOT.knee_viscous] * m[SLOT.motor_w]
    m[SLOT.motor_w] += STEP_S / m[SLOT.knee_inertia] * (m[SLOT.motor_t] - loss - through)
    m[SLOT.motor_q] += STEP_S * m[SLOT.motor_w]
    m[SLOT.motor_s] = presliding_step(m[SLOT.motor_s], STEP_S * m[SLOT.motor_w] / m[SLOT.knee_presliding_rad])
    weight = m[SLOT.leg_moment_kg_m] * GRAVITY * math.sin(m[SLOT.leg_q])
    beyond = max(0.0, m[SLOT.leg_q] - m[SLOT.stop_high_rad]) - max(0.0, m[SLOT.stop_low_rad] - m[SLOT.leg_q])
    weight += m[SLOT.stop_stiffness] * beyond
    # I·θ̈ = reducer + rope·lever − m·g·l·sin θ − stops − damping
    m[SLOT.leg_a] = (through + rope_nm - weight - m[SLOT.leg_damping] * m[SLOT.leg_w]) / m[SLOT.leg_inertia]
    m[SLOT.leg_w] += STEP_S * m[SLOT.leg_a]
    m[SLOT.leg_q] += STEP_S * m[SLOT.leg_w]


@njit(inline="always")
def slow(m: Any, seconds: float) -> None:
    """Update the slow states, `SLOW` steps after the last update."""
    flexion = abs(m[SLOT.leg_q])
    drift = max(0.05, 1.0 + m[SLOT.friction_drift] * seconds / m[SLOT.friction_drift_s])
    modulate(m, seconds, SLOW * STEP_S)
    refresh_friction(m, flexion, m[SLOT.v + NODES + 1], drift, SLOW * STEP_S)
    creep(m, SLOW * STEP_S)


@njit(inline="always")
def step(m: Any, demand_a: float, knee_nm: float) -> None:
    """Advance everything by one step under held demands: motor current, A, and knee torque, N·m."""
    turn = (m[SLOT.servo_x] + m[SLOT.encoder_zero_m]) / m[SLOT.drum_radius_m] + m[SLOT.eccentricity_rad]
    arm = 1.0 + m[SLOT.eccentricity_m] / m[SLOT.drum_radius_m] * math.cos(turn)
    m[SLOT.x] = m[SLOT.servo_x] + m[SLOT.eccentricity_m] * (math.sin(turn) - math.sin(m[SLOT.eccentricity_rad]))
    m[SLOT.v] = m[SLOT.servo_v] * arm
    knee_rad = m[SLOT.leg_q]
    k2, k3 = m[SLOT.rope_per_knee], m[SLOT.rope_per_knee_quadratic]
    # moment arm of the rope by virtual work: dx2/dθ of (11)
    lever = k2 + 2.0 * k3 * knee_rad
    m[SLOT.x + NODES + 1] = anchor(k2, k3, knee_rad)
    surface = lever * m[SLOT.leg_w]
    m[SLOT.v + NODES + 1] = surface
    tensions(m)
    slide(m, 1, CABLE_NODES + 1, 0.0, STEP_S)
    m[SLOT.leg_friction] = slide(m, CABLE_NODES + 1, NODES + 1, surface, STEP_S)
    servo(m, demand_a, arm)
    knee(m, knee_nm, (m[SLOT.tension + NODES] + m[SLOT.leg_friction]) * lever)


TRUTH_NAMES: Final = (
    "true_start_n", "true_cable_end_n", "true_end_n", "true_knee_angle_rad", "true_knee_velocity_rad_s",
    "true_knee_motor_rad", "true_servo_position_m", "true_servo_velocity_m_s", "true_current_a", "true_supply_v",
    "true_cable_slip", "true_fabric_slip", "true_creep_m",
)
"""True signals that no device measures, in the order of a row of the truth file."""


def _compile(sources: int) -> tuple[Any, Any]:
    @njit(cache=True, error_model="numpy")
    def advance(m: Any, steps: int, servo_nm: float, knee_nm: float) -> None:
        _ = sources
        limit = m[SLOT.current_limit_a]
        demand = min(limit, max(-limit, servo_nm / m[SLOT.torque_constant]))
        done = int(m[SLOT.steps])
        before = m[SLOT.leg_w]
        for n in range(done, done + steps):
            if n % SLOW == 0:
                slow(m, n * STEP_S)
            step(m, demand, knee_nm)
        m[SLOT.steps] = done + steps
        swing = (m[SLOT.leg_w] - before) / (max(1, steps) * STEP_S)
        # END is on a cantilever, m·(g·cos θ + L·θ̈): the jitter at zero force (paper, Fig. 15)
        carried = GRAVITY * math.cos(m[SLOT.leg_q]) + m[SLOT.end_mass_arm_m] * swing
        m[SLOT.out_servo_x], m[SLOT.out_servo_v] = m[SLOT.servo_x] + m[SLOT.encoder_zero_m], m[SLOT.servo_v]
        m[SLOT.out_motor_q], m[SLOT.out_motor_w] = m[SLOT.motor_q], m[SLOT.motor_w]
        m[SLOT.out_leg_q] = m[SLOT.leg_q]
        m[SLOT.out_start] = m[SLOT.term_start_gain] * m[SLOT.tension] + m[SLOT.term_start_n]
        end = m[SLOT.tension + NODES] + m[SLOT.end_mass_kg] * carried
        m[SLOT.out_end] = m[SLOT.term_end_gain] * end + m[SLOT.term_end_n]

    @njit(cache=True)
    def truth_row(m: Any, row: Any) -> None:
        _ = sources
        cable = fabric = 0.0
        for i in range(CABLE_NODES):
            cable += m[SLOT.s + 1 + i]
        for i in range(FABRIC_NODES):
            fabric += m[SLOT.s + CABLE_NODES + 1 + i]
        row[0], row[1], row[2] = m[SLOT.tension], m[SLOT.tension + CABLE_NODES], m[SLOT.tension + NODES]
        row[3], row[4], row[5] = m[SLOT.leg_q], m[SLOT.leg_w], m[SLOT.motor_q]
        row[6], row[7] = m[SLOT.servo_x] + m[SLOT.encoder_zero_m], m[SLOT.servo_v]
        row[8], row[9] = m[SLOT.current], m[SLOT.bus_v]
        row[10], row[11], row[12] = cable / CABLE_NODES, fabric / FABRIC_NODES, m[SLOT.creep]

    return advance, truth_row


SOURCES: Final = (
    "expressions", "laws", "parameters", "path_laws", "terms", "plant/components", "plant/state_layout", "plant/chain",
    "plant/modulated", "plant/step",
)


def digest() -> int:
    """Return a checksum of the source files of the compiled step, as a whole number of 56 bits."""
    here = Path(__file__).parents[1]
    text = b"".join((here / f"{name}.py").read_bytes() for name in SOURCES)
    return int.from_bytes(hashlib.sha256(text).digest()[:7], "big")


advance, truth_row = _compile(digest())
"""`advance(memory, steps, servo torque in N·m, knee torque in N·m)`: advance the whole bench by `steps` of 10 µs.

`truth_row(memory, row)`: write the values of `TRUTH_NAMES` into `row`."""
