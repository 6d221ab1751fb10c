"""The plant's explicit steps against SciPy's integrator on the same equations, and against wild parameters."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from parameters import InputError, declarations
from physics.plant.bench_plant import NOMINAL, BowdenPlant, PlantParameters, create
from physics.plant.components import KNEE_AT_FIT
from physics.plant.state_layout import CABLE_NODES, NODES, SLOT

SERVO_NM, KNEE_NM = 0.8, -1.2
SECONDS = 0.05


class Equations:
    """The bench's differential equations, written out with arrays; element data are the plant's own."""

    def __init__(self, plant: BowdenPlant) -> None:
        m = plant.memory
        self.mass = 1.0 / m[SLOT.inverse_mass + 1 : SLOT.inverse_mass + NODES + 1]
        self.damping = m[SLOT.damping : SLOT.damping + NODES + 1]
        self.share = m[SLOT.share : SLOT.share + NODES + 1]
        self.stiff = np.r_[m[SLOT.k_lead], np.full(CABLE_NODES - 1, m[SLOT.k_segment])]
        self.b, self.a = m[SLOT.b_fabric], -m[SLOT.a4] / 4.0
        self.start = np.r_[
            m[SLOT.servo_x], np.zeros(4), m[SLOT.x + 1 : SLOT.x + NODES + 1], np.zeros(2 * NODES),
            m[SLOT.motor_q], 0.0, 0.0, 0.0, m[SLOT.leg_q], 0.0]

    def tensions(self, path: np.ndarray, speed: np.ndarray) -> np.ndarray:
        stretch, rate = np.maximum(0.0, -np.diff(path)), -np.diff(speed)
        linear = self.stiff * stretch[:CABLE_NODES]
        share = self.share[CABLE_NODES:]
        root = np.sqrt(self.b**2 + 4.0 * self.a * stretch[CABLE_NODES:] / share)
        elastic = np.r_[linear, (root - self.b) / (2.0 * self.a)]
        return elastic + np.clip(self.damping * rate, -elastic, elastic)

    def __call__(self, t: float, y: np.ndarray) -> np.ndarray:
        p = NOMINAL
        x0, v0, current, integral, s0 = y[:5]
        x, v, s = y[5 : 5 + NODES], y[5 + NODES : 5 + 2 * NODES], y[5 + 2 * NODES : 5 + 3 * NODES]
        motor, motor_w, torque, motor_s, leg, leg_w = y[5 + 3 * NODES :]
        surface = p.rope_per_knee * leg_w
        tension = self.tensions(
            np.r_[x0, x, p.rope_per_knee * (leg - KNEE_AT_FIT)], np.r_[v0, v, surface])
        slip = v - np.r_[np.zeros(CABLE_NODES), np.full(NODES - CABLE_NODES, surface)]
        exponent = np.r_[
            np.full(CABLE_NODES, p.mu1 * p.theta1_rad / CABLE_NODES),
            np.full(NODES - CABLE_NODES, p.mu2 * (p.wrap_rad + p.fabric_wrap * abs(leg)) / (NODES - CABLE_NODES))]
        normal = tension[:-1] + tension[1:]
        friction = s * np.tanh(exponent / 2.0) * normal + p.slack_drag * np.maximum(0.0, 1.0 - normal) * slip
        emf = p.torque_constant * v0 / p.drum_radius_m
        error = SERVO_NM / p.torque_constant - current
        band = 2.0 * math.pi * p.current_bandwidth_hz
        volts = band * p.winding_h * error + integral + emf
        pull = current * p.torque_constant / p.drum_radius_m - p.servo_coulomb_n * s0 - p.servo_viscous * v0
        through = p.reducer_stiffness * (motor - leg) + p.reducer_damping * (motor_w - leg_w)
        rope = (tension[-1] + friction[CABLE_NODES:].sum()) * p.rope_per_knee
        weight = p.leg_moment_kg_m * 9.80665 * math.sin(leg)
        return np.r_[
            v0, (pull - tension[0]) / p.servo_inertia_kg,
            (volts - p.winding_ohm * current - emf) / p.winding_h, band * p.winding_ohm * error,
            (v0 - s0 * abs(v0)) / p.servo_presliding_m,
            v, (tension[:-1] - tension[1:] - friction) / self.mass, (slip - s * np.abs(slip)) / p.presliding_m,
            motor_w, (torque - p.knee_coulomb_nm * motor_s - p.knee_viscous * motor_w - through) / p.knee_inertia,
            (KNEE_NM - torque) / p.knee_lag_s, (motor_w - motor_s * abs(motor_w)) / p.knee_presliding_rad,
            leg_w, (through + rope - weight - p.leg_damping * leg_w) / p.leg_inertia]


def test_agrees_with_solve_ivp_on_pulling_and_flexing() -> None:
    plant = create({"start_knee_rad": KNEE_AT_FIT, "start_slack_m": 0.0}, 0)
    plant.reset(0)
    equations = Equations(plant)
    times = np.linspace(0.0, SECONDS, 11)
    solved = solve_ivp(equations, (0.0, SECONDS), equations.start, "LSODA", t_eval=times, rtol=1e-7, atol=1e-9)
    assert solved.success
    for k, t in enumerate(times[1:], start=1):
        seen = plant.advance(round(t * 1e9), SERVO_NM, KNEE_NM)
        y = solved.y[:, k]
        path = np.r_[y[0], y[5 : 5 + NODES], NOMINAL.rope_per_knee * (y[-2] - KNEE_AT_FIT)]
        speed = np.r_[y[1], y[5 + NODES : 5 + 2 * NODES], NOMINAL.rope_per_knee * y[-1]]
        tension = equations.tensions(path, speed)
        # first order: one or two steps of 10 µs at 0.4 m/s and 2 N/ms
        assert seen.servo_position_m - NOMINAL.encoder_zero_m == pytest.approx(y[0], abs=1e-5)
        assert seen.knee_angle_rad == pytest.approx(y[-2], abs=5e-5)
        assert (seen.start_n, seen.end_n) == pytest.approx((tension[0], tension[-1]), abs=0.05)
    assert seen.end_n > 20.0


def _drawn(rng: np.random.Generator) -> dict[str, float]:
    """Return each parameter at its least, greatest, nominal or any value."""
    drawn: dict[str, float] = {}
    for name, default, declared in declarations(PlantParameters):
        any_value = declared.low + (declared.high - declared.low) * rng.random()
        drawn[name] = (declared.low, declared.high, default, any_value)[rng.integers(4)]
    return drawn | {"start_slack_m": 0.0}


def test_stays_finite_over_all_declared_ranges() -> None:
    rng = np.random.default_rng(1)
    tried = 0
    while tried < 60:
        try:
            plant = create(_drawn(rng), 0)
        except InputError:
            continue
        tried += 1
        torque = 40.0 * plant.parameters.drum_radius_m
        for k in range(1, 101):
            plant.advance(k * 1_000_000, torque * (2.0 if k // 20 % 2 == 0 else -2.0), 3.0 * (1 if k // 30 % 2 else -1))
        memory = plant.memory
        assert np.isfinite(memory).all()
        # 40 N on a gram for 0.1 s would be 4 km/s; whatever moves at all like a rope stays far below
        assert np.abs(memory[SLOT.v : SLOT.v + NODES + 2]).max() < 50.0


def test_a_rope_softer_than_the_whole_is_refused() -> None:
    with pytest.raises(InputError, match="leave the fabric nothing"):
        create({"lead_compliance": 0.1e-3, "stretch_b": 0.06e-3}, 0)
