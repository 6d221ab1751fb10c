"""The one table of the bench's parameters: name, unit, meaning, bounds, nominal value, tolerances, likely faults.

Each quantity is declared here once; simulation, controller, identification, diagnosis, scatter and the catalogue of
effects read its row. All values are SI. A quantity with another name in a plant model has that name in its row
(`plant`); one with another form there has its conversion in `physics.conversions`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from parameters import parameter
from physics import laws

Range = tuple[float, float]
INFINITE: Final = math.inf


class Tolerance(NamedTuple):
    """Tolerance of a parameter about its nominal value; `law` is one of `virtual_bus.machine.scatter.LAWS`."""

    law: str
    size: float
    source: str


class Assumption(NamedTuple):
    """A controller's assumption before anything is measured, and the bounds of a measurement."""

    value: float
    low: float
    high: float
    source: str
    meaning: str = ""


@dataclass(frozen=True)
class Parameter:
    """One quantity of a bench.

    `nominal`, `source`: its value on the nominal bench, and the origin of that value; `low`, `high`: bounds of the
    simulation. `plant`: "table.key" of a plant model; `assumed`: its value in a calibration before
    identification.

    For the diagnosis: `ideal`: value in a rigid, frictionless transmission with true sensors (None: nominal); `search`:
    bounds of a fit on such a bench; `any_rig`: bounds on rigs of any size, given for each parameter of an effect;
    `likely`: range under a fault; `neutral`: the value at which a fault is absent (None: only a calibration gives it).

    For simulated benches: `made`: tolerance of manufacture, `daily`: change from session to session.
    """

    name: str
    unit: str
    meaning: str
    nominal: float
    low: float
    high: float
    source: str
    plant: str = ""
    assumed: Assumption | None = None
    ideal: float | None = None
    search: Range | None = None
    any_rig: Range | None = None
    likely: Range | None = None
    neutral: float | None = None
    made: Tolerance | None = None
    daily: Tolerance | None = None

    @property
    def is_estimated(self) -> bool:
        """True if the diagnosis states a value of this parameter."""
        return self.any_rig is not None

    @property
    def rig_bounds(self) -> Range:
        """Return the bounds of this parameter in a fit to a rig of any size."""
        return self.any_rig or (self.low, self.high)

    @property
    def search_bounds(self) -> Range:
        """Return the bounds of this parameter in a fit to a bench like the nominal one."""
        return self.search or (self.low, self.high)

    @property
    def in_ideal(self) -> float:
        """Return the value in a rigid, frictionless transmission with true sensors."""
        return self.nominal if self.ideal is None else self.ideal


_P = Parameter
_T = Tolerance


def _measured(name: str, unit: str, meaning: str, value: float, low: float, high: float, source: str) -> Parameter:
    """Return a scalar of a calibration that the simulation does not have, so that its value is an assumption."""
    return Parameter(name, unit, meaning, value, low, high, source, assumed=Assumption(value, low, high, source))


_FRICTION: Final = (
    _P("mu1", "", "friction coefficient μ1 of rope and sheath", 0.08, 0.0, 0.5,
       "assumed: lubricated steel in a lined sheath; with theta1 an exponent of 0.126", plant="plant.mu1",
       ideal=0.0, any_rig=(0.0, 2.0), likely=(0.03, 0.25),
       made=_T("factor", 0.25, "assumed: lubrication, sheath"),
       daily=_T("factor", 0.10, "assumed: temperature, humidity")),
    _P("mu2", "", "friction coefficient μ2 of fabric on the knee", 0.15, 0.0, 1.0,
       "assumed: with the wrap an exponent of 0.10 at 13–20 % of gait", plant="plant.mu2",
       assumed=Assumption(0.12, 0.0, 1.0, "assumed: equation (7) gives the law, the paper no number",
                          "friction coefficient of the fabric on the knee, μ2"),
       ideal=0.0, any_rig=(0.0, 2.0), likely=(0.05, 0.6),
       made=_T("factor", 0.25, "assumed: weave, finish of the knee"),
       daily=_T("factor", 0.10, "assumed: temperature, humidity")),
    _P("theta1", "rad", "total bend θ1 of the sheath", math.pi / 2, 0.0, 4 * math.pi, "assumed: a quarter turn",
       plant="plant.theta1_rad", any_rig=(0.0, 20.0)),
    _P("phi0", "rad", "wrap angle φ0 at the upright knee", 0.15, 0.0, 4.0, "assumed: strap held off the knee",
       plant="plant.wrap_rad",
       assumed=Assumption(0.4, 0.0, 6.3, "assumed: φ = φ0 + κ·|θk|", "wrap of the fabric at the upright knee, φ0"),
       any_rig=(0.0, 6.0), made=_T("factor", 0.25, "assumed: fit of the strap")),
    _P("fabric_wrap", "1/rad", "κ: φ = φ0 + κ·|θk|", 1.0, 0.0, 4.0, "assumed: the wrap grows with the flexion",
       plant="plant.fabric_wrap",
       assumed=Assumption(1.0, 0.0, 3.0, "assumed: φ = φ0 + κ·|θk|", "wrap gained per radian of flexion, κ"),
       ideal=0.0, any_rig=(0.0, 4.0), likely=(0.3, 1.7),
       made=_T("factor", 0.10, "assumed: fit of the strap")),
    _P("cable_bend", "1/rad", "κb: θ1 = θ10·(1 + κb·|θk|)", 0.0, -0.7, 2.0, "assumed: the sheath is clamped",
       plant="plant.cable_bend", search=(-0.7, 1.5), any_rig=(-0.7, 1.5), likely=(-0.5, 0.5),
       neutral=0.0),
    _P("load_slope", "", "λ: μ1 and μ2 times 1 + λ·(T/40 N − 1)", 0.0, -0.9, 2.0, "assumed: Amontons' law",
       plant="plant.load_slope",
       assumed=Assumption(0.0, -0.9, 2.0, "assumed: Amontons' law", "λ: both exponents times 1 + λ·(T/40 N − 1)"),
       search=(-0.8, 0.8), any_rig=(-0.8, 0.8), likely=(-0.4, 0.4),
       neutral=0.0),
    _P("viscous", "N·s/m", "viscous friction of rope in sheath, whole length", 0.0, 0.0, 60.0,
       "paper, 3.1: Coulomb friction only", plant="plant.viscous",
       assumed=Assumption(0.0, 0.0, 200.0, "paper, 3.1: Coulomb friction only",
                          "viscous friction of the rope in its sheath"),
       any_rig=(-1e4, 1e4),
       likely=(3.0, 20.0), neutral=0.0),
    _P("stribeck_ratio", "", "static over sliding friction μs/μc, of rope and fabric", 1.0, 0.3, 5.0,
       "paper, 3.1: Coulomb friction only", plant="plant.stribeck_ratio", search=(1.0, 4.0),
       any_rig=(1.0, 4.0), likely=(1.2, 2.5), neutral=1.0,
       daily=_T("excess", 0.3, "assumed: breakaway after a night's rest; paper, Fig. 15")),
    _P("stribeck_speed", "m/s", "Stribeck speed vs", 0.01, 5e-4, 0.2, "assumed: greased steel",
       plant="plant.stribeck_speed_m_s",
       assumed=Assumption(0.01, 5e-4, 0.2, "assumed: greased steel", "sliding speed at which breakaway has gone, vs"),
       search=(1e-3, 0.1), any_rig=(1e-3, 0.1), likely=(2e-3, 30e-3)),
    _P("presliding", "m", "rope travel δ over which friction turns over", 0.1e-3, 0.02e-3, 3e-3,
       "assumed: Dahl model of tendon sheaths (Palli)", plant="plant.presliding_m",
       assumed=Assumption(2e-4, 1e-6, 5e-3, "assumed: 0.05–1 mm",
                          "rope travel over which the sheath's friction turns over"),
       ideal=1e-6, any_rig=(1e-6, 3e-3), likely=(50e-6, 1e-3),
       made=_T("factor", 0.30, "assumed: as friction, and more")),
    _P("fabric_presliding_ratio", "", "the fabric's pre-sliding travel over the rope's", 1.0, 0.1, 5.0,
       "assumed: as the rope's", any_rig=(0.1, 5.0)),
    _P("friction_drift", "", "relative change of μ1 and μ2 over friction_drift_s (wear, heat)", 0.0, -0.95, 5.0,
       "assumed: none", plant="plant.friction_drift", search=(-0.95, 3.0), any_rig=(-0.95, 3.0), likely=(-0.7, 0.7),
       neutral=0.0),
    _P("coulomb", "N", "friction that no load changes, of a rig", 0.0, -1e3, 1e3, "paper, 3.1: capstan friction only",
       any_rig=(-1e3, 1e3)),
    _P("stribeck_memory", "s", "time by which the Stribeck curve lags the sliding speed", 20e-3, 1e-3, 0.1,
       "assumed: frictional memory (Hess and Soom)", plant="plant.stribeck_memory_s",
       assumed=Assumption(0.01, 1e-3, 0.5, "assumed: frictional memory (Hess and Soom)",
                          "time by which friction lags the sliding speed"),
       ideal=0.0, any_rig=(0.0, 0.1), likely=(2e-3, 38e-3)),
    _P("fabric_presliding", "m", "travel on the knee over which friction turns over", 0.1e-3, 0.02e-3, 3e-3,
       "assumed: as the rope's", plant="plant.fabric_presliding_m",
       assumed=Assumption(2e-4, 1e-6, 5e-3, "assumed: as presliding",
                          "fabric travel over which the knee's friction turns over"),
       made=_T("factor", 0.30, "assumed: as friction, and more")),
    _P("friction_drift_time", "s", "time, from the start of the plant, that friction_drift refers to", 20.0, 1.0, 1e6,
       "assumed: ten gait cycles of 2 s", plant="plant.friction_drift_s"),
    _P("slack_drag", "N·s/m", "drag of a slack segment by its own weight", 0.02, 0.0, 1.0,
       "assumed: keeps a slack rope at rest; gone above 0.5 N", plant="plant.slack_drag"),
)
_PATH: Final = (
    _P("stiffness_scale", "", "stiffness of rope and fabric against (10)", 1.0, 0.3, 3.0, "(10)",
       plant="plant.stiffness_scale", ideal=1e3, any_rig=(0.05, 1e3), likely=(0.75, 1.35),
       neutral=1.0, made=_T("factor", 0.10, "assumed: length and weave of the strap"),
       daily=_T("factor", 0.03, "assumed: temperature, humidity, history")),
    _P("stiffness_shape", "", "relative change of the quadratic coefficient", 0.0, -0.9, 1.0, "(10)",
       plant="plant.stiffness_shape", any_rig=(-4.0, 1.0), likely=(-0.5, 0.5), neutral=0.0),
    _P("cable_share", "", "share of (10)'s linear coefficient that is the rope's, on the START side of its friction",
       (0.024e-3 + 0.5 * 0.008e-3) / (laws.STIFFNESS_B_MM_N * 1e-3), 0.0, 1.0,
       "assumed: lead_compliance and half of sheath_compliance", ideal=0.1, any_rig=(0.0, 1.0)),
    _P("home_preload", "N", "START tension at which homing fixes the encoder's zero", 20.0, 0.0, 20.0,
       "equation (10), lower end of its identification",
       assumed=Assumption(20.0, 1.0, 60.0, "equation (10), lower end of its identification",
                          "START tension at which (10) fixes the encoder zero"),
       ideal=0.0, any_rig=(0.0, 20.0)),
    _P("creep_compliance", "m/N", "J: creep γ̇ = (J·T − γ)/τ", 0.0, 0.0, 0.2e-3, "paper, 3.2: elastic fabric",
       plant="plant.creep_compliance", any_rig=(0.0, 2e-4), likely=(0.01e-3, 0.04e-3), neutral=0.0,
       daily=_T("excess", 0.01e-3, "assumed: woven strap under load")),
    _P("creep_time", "s", "τ of the creep", 5.0, 0.01, 1e4, "assumed: woven strap", plant="plant.creep_s",
       search=(0.05, 300.0), any_rig=(0.05, 300.0), likely=(0.2, 100.0)),
    _P("slack", "m", "length to be wound up before the rope is taut", 0.0, -5e-3, 20e-3, "assumed: none",
       plant="plant.slack_m", any_rig=(-5e-3, 2e-2), likely=(0.5e-3, 5e-3), neutral=0.0),
    _P("rope_zero", "m", "servo position of the taut, unloaded rope at the knee angle of 13 % of gait", 9.7e-3,
       -1.0, 1.0, "(10): ck", plant="plant.encoder_zero_m",
       assumed=Assumption(9.7e-3, -1.0, 1.0, "equation (10), ck", "encoder position that (10) gives at no force"),
       ideal=0.0, any_rig=(-1.0, 1.0),
       daily=_T("offset", 0.1e-3, "repeatability of homing to a preload")),
    _P("rope_per_knee", "m/rad", "k2: rope displacement per knee angle", laws.SWING_K_MM_DEG * 1e-3 / laws.DEGREE,
       0.005, 0.2, "(11): k2", plant="plant.rope_per_knee",
       assumed=Assumption(0.706e-3 * 180 / math.pi, 0.0, 0.2, "equation (11), k2",
                          "rope that one radian of the knee takes"),
       search=(0.9 * (laws.SWING_K_MM_DEG * 1e-3 / laws.DEGREE), 1.1 * (laws.SWING_K_MM_DEG * 1e-3 / laws.DEGREE)),
       any_rig=(-10.0, 10.0),
       likely=(0.95 * (laws.SWING_K_MM_DEG * 1e-3 / laws.DEGREE), 1.05 * (laws.SWING_K_MM_DEG * 1e-3 / laws.DEGREE))),
    _P("rope_per_knee_quadratic", "m/rad²", "k3: quadratic part of the rope displacement k2·θ + k3·θ²", 0.0,
       -0.02, 0.02, "(11): linear", plant="plant.rope_per_knee_quadratic", search=(-0.01, 0.01),
       any_rig=(-0.01, 0.01), likely=(-1.97e-3, 1.97e-3), neutral=0.0),
    _P("knee_backlash", "rad", "whole dead band of the reducer", 0.0, 0.0, 0.2, "assumed: none",
       plant="plant.knee_backlash_rad", any_rig=(0.0, 0.2), likely=(math.radians(0.3), math.radians(2.0)), neutral=0.0,
       daily=_T("set", math.radians(0.3), "maker's class of the reducer, worn in")),
    _P("eccentricity", "m", "amplitude A of the drum's eccentricity A·sin(x/R + φ)", 0.0, -2e-3, 2e-3,
       "assumed: none", plant="plant.eccentricity_m", search=(0.0, 2e-3), any_rig=(0.0, 2e-3),
       likely=(0.1e-3, 0.5e-3), neutral=0.0),
    _P("eccentricity_phase", "rad", "phase φ of the drum's eccentricity", 0.0, -6.3, 6.3, "assumed: none",
       plant="plant.eccentricity_rad", search=(-math.pi, math.pi), any_rig=(-math.pi, math.pi),
       likely=(-math.pi, math.pi)),
    _P("drum_radius", "m", "radius of the drum", 0.020, 10e-3, 0.1, "assumed: fits a 40 N·m·10 % bench",
       plant="plant.drum_radius_m", any_rig=(1e-3, 0.5)),
    _P("lead_compliance", "m/N", "compliance of drum, START sensor and rope before the sheath", 0.024e-3,
       0.005e-3, 0.1e-3, "assumed: with pre-sliding, about 27 N/mm at the drum against a stuck rope",
       plant="plant.lead_compliance"),
    _P("sheath_compliance", "m/N", "compliance of the rope inside the sheath", 0.008e-3, 0.002e-3, 0.1e-3,
       "assumed: 1 m of 1.5 mm rope", plant="plant.sheath_compliance"),
    _P("stretch_a", "m/N²", "quadratic coefficient of the whole stretch", laws.STIFFNESS_A_MM_N2 * 1e-3, -1e-5, -1e-8,
       "(10): ak", plant="plant.stretch_a"),
    _P("stretch_b", "m/N", "linear coefficient of the whole stretch", laws.STIFFNESS_B_MM_N * 1e-3, 5e-5, 5e-3,
       "(10): bk", plant="plant.stretch_b"),
    _P("fabric_share_before", "", "share of the fabric between cable and knee", 0.25, 0.05, 0.9, "assumed: geometry",
       plant="plant.share_before"),
    _P("fabric_share_after", "", "share of the fabric between knee and END sensor", 0.40, 0.05, 0.9,
       "assumed: geometry", plant="plant.share_after"),
)


def _sensor(
    side: str, any_offset: Range, gain: Mapping[str, Any], offset: Mapping[str, Any],
) -> tuple[Parameter, ...]:
    """Return the rows of one tension sensor that a diagnosis estimates."""
    where = f"{side}_sensor"
    return (
        _P(f"{side}_gain", "", "gain", 1.0, 0.1, 3.0, "assumed: calibrated", plant=f"{where}.gain",
           search=(0.5, 1.5), any_rig=(0.5, 1.5), likely=(0.92, 1.08), neutral=1.0,
           made=_T("offset", 0.005, "maker's class 0.5"), **gain),
        _P(f"{side}_offset", "N", "error of the zero", 0.0, -100.0, 100.0, "assumed: tared", plant=f"{where}.offset_n",
           search=(-20.0, 20.0), any_rig=any_offset, likely=(-3.0, 3.0), neutral=0.0,
           made=_T("offset", 0.1, "assumed: 0.05 % of full scale"), **offset),
        _P(f"{side}_drift", "N", "change of the zero over drift_s", 0.0, -100.0, 100.0, "assumed: warmed up",
           plant=f"{where}.drift_n", search=(-20.0, 20.0), any_rig=(-20.0, 20.0), likely=(-3.0, 3.0), neutral=0.0),
    )


_START: Final = _sensor(
    "start", (-1e3, 1e3),
    {"assumed": Assumption(1.0, 0.8, 1.25, "assumed: both true", "START's reading by END's, without friction between")},
    {"assumed": Assumption(0.0, -10.0, 10.0, "assumed", "START reading with a slack rope"),
     "daily": _T("offset", 0.2, "assumed: temperature of the bridge")})
_END: Final = _sensor("end", (-20.0, 20.0), {}, {})
_SENSORS: Final = (
    _P("end_mass", "kg", "mass that the END sensor carries on its cantilever", 0.0, 0.0, 0.5,
       "paper, 5.2: named, not given", plant="plant.end_mass_kg", any_rig=(0.0, 0.5), likely=(0.05, 0.15), neutral=0.0),
    _P("end_mass_arm", "m", "lever of the END sensor from the knee", 0.25, 0.0, 1.0, "assumed: geometry",
       plant="plant.end_mass_arm_m", search=(0.05, 0.6), any_rig=(0.05, 0.6), likely=(0.15, 0.35)),
    *(row for pair in zip(_END, _START, strict=True) for row in pair),
    _P("end_delay", "s", "dead time of the signal", 0.0, 0.0, 0.1, "assumed: none", plant="end_sensor.delay_s",
       any_rig=(0.0, 0.1), likely=(5e-3, 20e-3), neutral=0.0),
    _P("end_filter", "s", "time constant of a further low-pass", 0.0, 0.0, 1.0, "assumed: none",
       plant="end_sensor.lag_s", search=(0.0, 0.1), any_rig=(0.0, 0.1), likely=(5e-3, 20e-3), neutral=0.0),
    _P("timestamp_skew", "s", "what its time stamps are early by, with those of the other sensor", 0.0, 0.0, 0.1,
       "assumed: none", plant="start_sensor.skew_s end_sensor.skew_s", any_rig=(0.0, 0.1),
       likely=(5e-3, 20e-3), neutral=0.0),
    _P("full_scale", "N", "force at full scale, either way", 200.0, 1.0, 1e4, "assumed: maker's range",
       plant="start_sensor.full_scale_n end_sensor.full_scale_n"),
    _P("sensor_cutoff", "Hz", "converter's low-pass, first order", 200.0, 1.0, 1e4, "assumed: sinc filter at 1 kHz",
       plant="start_sensor.cutoff_hz end_sensor.cutoff_hz"),
    _P("start_noise", "N", "noise of a sample, rms", 0.15, 0.0, 20.0, "assumed: 0.075 % of full scale",
       plant="start_sensor.noise_n",
       assumed=Assumption(0.15, 0.0, 5.0, "assumed", "standard deviation of START at rest")),
    _P("drift_time", "s", "time, from the start, that drift_n refers to", 20.0, 0.1, 1e6,
       "assumed: ten gait cycles of 2 s", plant="start_sensor.drift_s end_sensor.drift_s"),
    _P("quantum", "N", "step to which the signal is rounded; 0: the converter's own", 0.0, 0.0, 20.0,
       "assumed: 24 bits", plant="start_sensor.quantum_n end_sensor.quantum_n", likely=(0.1, 2.0), neutral=0.0),
)
_DRIVES: Final = (
    _P("drive_coulomb", "N", "Coulomb friction of motor and reducer at the rope", 1.0, 0.0, 50.0,
       "assumed: 1 % of rated torque", plant="plant.servo_coulomb_n", ideal=0.0,
       any_rig=(0.0, 1e4), likely=(2.0, 10.0), made=_T("factor", 0.25, "assumed: bearings, seals")),
    _P("drive_viscous", "N·s/m", "viscous friction of motor and reducer at the rope", 10.0, 0.0, 500.0,
       "assumed: maker's class", plant="plant.servo_viscous", ideal=0.0, any_rig=(0.0, 1e5),
       likely=(30.0, 150.0)),
    _P("drive_inertia", "kg", "rotor, reducer and drum as a mass at the rope (J/R²)", 2.5, 0.5, 30.0,
       "assumed: J = 1.0e-3 kg·m² at the output", plant="plant.servo_inertia_kg", ideal=0.0,
       any_rig=(0.0, 1e4), likely=(3.5, 10.0)),
    _P("drive_offset", "N", "constant force against pulling", 0.0, -50.0, 50.0, "assumed: none",
       plant="plant.servo_offset_n", ideal=0.0, any_rig=(-1e4, 1e4), likely=(-5.0, 5.0),
       neutral=0.0),
    _P("unbalance", "N", "force against pulling by a mass off the drum's axis, where it is greatest: m·g·r/R", 0.0,
       0.0, 50.0, "assumed: balanced", plant="plant.servo_unbalance_n", any_rig=(0.0, 1e4), likely=(0.5, 5.0),
       neutral=0.0),
    _P("unbalance_phase", "rad", "angle φ of the mass from below the axis at position 0", 0.0, -6.3, 6.3,
       "assumed: below", plant="plant.servo_unbalance_rad", search=(-math.pi, math.pi), any_rig=(-math.pi, math.pi),
       likely=(-math.pi, math.pi)),
    _P("drive_asymmetry", "", "Coulomb friction greater pulling (> 0) than releasing, relative", 0.0, -0.95, 0.95,
       "assumed: none", plant="plant.servo_asymmetry", ideal=0.0, any_rig=(-0.95, 0.95),
       likely=(-0.5, 0.5), neutral=0.0),
    _P("drive_viscous_asymmetry", "", "β in b·(v + β·|v|): drag greater pulling (> 0) than releasing, relative", 0.0,
       -0.95, 0.95, "assumed: none", plant="plant.servo_viscous_asymmetry", ideal=0.0,
       any_rig=(-0.95, 0.95), likely=(-0.8, 0.8), neutral=0.0),
    _P("demand_gain", "", "force that the drive gives over the force that it says", 1.0, 0.1, 3.0,
       "assumed: torque constant as the maker says", plant="plant.demand_gain", search=(0.5, 1.5),
       any_rig=(0.3, 3.0), likely=(0.85, 1.15), neutral=1.0),
    _P("drive_presliding", "m", "rope travel over which motor friction turns over", 20e-6, 2e-6, 2e-3,
       "assumed: 1 mrad of the drum", plant="plant.servo_presliding_m", any_rig=(1e-6, 2e-3),
       likely=(0.1e-3, 1.5e-3)),
    _P("drive_stribeck_ratio", "", "static over sliding friction of the drive", 1.0, 0.3, 5.0, "assumed: none",
       plant="plant.servo_stribeck_ratio", ideal=1.0, search=(1.0, 4.0), any_rig=(1.0, 5.0),
       likely=(1.2, 2.5), neutral=1.0),
    _P("drive_stribeck_speed", "m/s", "Stribeck speed of the drive's friction", 0.01, 5e-4, 0.2,
       "assumed: greased steel", plant="plant.servo_stribeck_speed_m_s", search=(1e-3, 0.1), any_rig=(1e-5, 100.0),
       likely=(2e-3, 30e-3)),
    _P("current_limit", "A", "limit of the motor current", 7.5, 0.0, 30.0, "assumed: 6.75 N·m peak at the output",
       plant="plant.current_limit_a", ideal=INFINITE, search=(0.1, 30.0), any_rig=(0.1, INFINITE), likely=(0.8, 3.0)),
    _P("supply_ohm", "Ω", "internal resistance of the supply (sag)", 0.0, 0.0, 5.0, "assumed: a stiff supply",
       plant="plant.supply_ohm", any_rig=(0.0, 5.0), likely=(1.0, 5.0), neutral=0.0),
    _P("servo_bandwidth", "Hz", "bandwidth of the servo's position loop", 25.0, 1.0, 500.0, "assumed",
       assumed=Assumption(25.0, 1.0, 500.0, "assumed"),
       any_rig=(1.0, 500.0)),
    _P("servo_delay", "s", "from a target sent to its first sight in the inputs", 2e-3, -0.01, 0.1,
       "control timing: two SYNC periods at 1 kHz",
       assumed=Assumption(2e-3, 0.0, 0.1, "control timing: two SYNC periods at 1 kHz"),
       any_rig=(-0.01, 0.1)),
    _P("supply", "V", "supply voltage", 48.0, 0.0, 60.0, "paper, 5.2", plant="plant.supply_v"),
    _P("torque_constant", "N·m/A", "torque and back-EMF constant at the output", 0.9, 0.05, 2.0,
       "assumed: maker's class of a 1:6 48 V actuator", plant="plant.torque_constant"),
    _P("winding_resistance", "Ω", "winding resistance", 0.6, 0.05, 5.0, "assumed: maker's class",
       plant="plant.winding_ohm"),
    _P("winding_inductance", "H", "winding inductance", 0.4e-3, 0.1e-3, 10e-3, "assumed: maker's class",
       plant="plant.winding_h"),
    _P("current_bandwidth", "Hz", "bandwidth of the current loop", 800.0, 50.0, 3000.0,
       "assumed: field-oriented drives", plant="plant.current_bandwidth_hz"),
    _P("servo_position_gain", "1/s", "position loop, proportional", 125.0, 0.0, 2000.0,
       "assumed: 25 Hz on the nominal bench", plant="servo_drive.position_gain",
       made=_T("factor", 0.25, "bandwidth of the position loop, 25 Hz ± 25 %")),
)
_LEG: Final = (
    _P("knee_inertia", "kg·m²", "rotor of the knee motor behind the reducer", 0.01, 1e-3, 0.5,
       "assumed: 2.3e-5 kg·m² by 20²", plant="plant.knee_inertia"),
    _P("knee_coulomb", "N·m", "Coulomb friction of knee motor and reducer", 0.3, 0.0, 10.0, "assumed: maker's class",
       plant="plant.knee_coulomb_nm", made=_T("factor", 0.25, "assumed: bearings, seals")),
    _P("knee_viscous", "N·m·s/rad", "viscous friction of knee motor and reducer", 0.05, 0.0, 10.0,
       "assumed: maker's class", plant="plant.knee_viscous"),
    _P("knee_presliding", "rad", "travel over which the knee drive's friction turns over", 5e-4, 1e-5, 0.05,
       "assumed: tooth compliance", plant="plant.knee_presliding_rad"),
    _P("knee_lag", "s", "lag of the knee motor's current loop", 1e-3, 1e-4, 0.05, "assumed: block commutation",
       plant="plant.knee_lag_s"),
    _P("knee_torque_limit", "N·m", "peak torque of the knee drive at the knee", 17.0, 0.5, 200.0,
       "assumed: maker's class", plant="plant.knee_torque_limit_nm"),
    _P("knee_stall", "N·m", "torque at which the supply's voltage would stall it", 60.0, 1.0, 1000.0,
       "assumed: maker's class", plant="plant.knee_stall_nm"),
    _P("knee_no_load", "rad/s", "no-load speed at the knee", 15.7, 1.0, 100.0, "assumed: 3000 1/min behind 1:20",
       plant="plant.knee_no_load_rad_s"),
    _P("reducer_stiffness", "N·m/rad", "torsional stiffness of reducer and shaft", 2000.0, 200.0, 1e4,
       "assumed: maker's class", plant="plant.reducer_stiffness"),
    _P("reducer_damping", "N·m·s/rad", "damping of reducer and shaft", 1.5, 0.0, 10.0, "assumed: 15 % of critical",
       plant="plant.reducer_damping"),
    _P("leg_inertia", "kg·m²", "lower-leg model about the knee", 0.03, 5e-3, 1.0, "assumed: 0.6 kg at 0.2 m",
       plant="plant.leg_inertia"),
    _P("leg_moment", "kg·m", "mass times lever of the lower-leg model", 0.09, 0.0, 5.0, "assumed: 0.6 kg at 0.15 m",
       plant="plant.leg_moment_kg_m"),
    _P("leg_damping", "N·m·s/rad", "damping of the knee bearing", 0.02, 0.0, 5.0, "assumed: ball bearings",
       plant="plant.leg_damping"),
    _P("stop_low", "rad", "mechanical stop in flexion", -1.75, -3.0, -1.0, "assumed: beyond the travel of 90°",
       plant="plant.stop_low_rad"),
    _P("stop_high", "rad", "mechanical stop in extension", 0.35, 0.0, 1.0, "assumed: beyond upright",
       plant="plant.stop_high_rad"),
    _P("stop_stiffness", "N·m/rad", "stiffness of the stops", 500.0, 10.0, 2000.0, "assumed: rubber",
       plant="plant.stop_stiffness"),
    _P("start_knee", "rad", "knee angle at power-on", 0.0, -1.6, 0.2, "assumed: upright", plant="plant.start_knee_rad"),
    _P("start_slack", "m", "slack of the rope at power-on", 5e-3, 0.0, 1.0, "assumed: the rope hangs",
       plant="plant.start_slack_m"),
)
_WIRE: Final = (
    _P("late", "s", "by how much PDOs are late", 0.0, 0.0, 0.1, "assumed: none", plant="bus.late_s",
       likely=(1e-3, 20e-3), neutral=0.0),
    _P("late_share", "", "share of the PDOs that is late", 1.0, 0.0, 1.0, "assumed: all", plant="bus.late_share",
       likely=(0.01, 1.0)),
    _P("lost_share", "", "share of the PDOs that is lost", 0.0, 0.0, 1.0, "assumed: none", plant="bus.lost_share",
       likely=(0.005, 0.2), neutral=0.0),
)
_MEASURED: Final = (
    _measured("stiffness_a", "m/N²", "quadratic term of the stretch", -1.7e-6, -1e-4, 0.0, "equation (10), ak"),
    _measured("stiffness_b", "m/N", "linear term of the stretch", 3e-4, 1e-6, 1e-2, "equation (10), bk"),
    _measured("stretch_short", "m/N", "departure of the stretch from (10) that fades over 8 N, s1", 0.0, -1e-2, 1e-2,
              "(10): none"),
    _measured("stretch_wide", "m/N", "departure of the stretch from (10) that fades over 30 N, s2", 0.0, -1e-2, 1e-2,
              "(10): none"),
    _measured("identified_to", "N", "START tension up to which the bench was identified", 300.0, 1.0, 300.0,
              "neutral: no bound"),
    _measured("swing_p", "m", "encoder position at the upright knee under 20 N", 22.17e-3, -1.0, 1.0,
              "equation (11), p2"),
    _P("cable_exponent", "", "capstan exponent of the cable, μ1·θ", 0.08 * math.pi / 2, 0.0, 1.0, "mu1, theta1",
       assumed=Assumption(0.13, 0.0, 1.0, "assumed: equation (3) gives the law, the paper no number")),
    _P("cable_compliance", "m/N", "stretch of the rope on the START side of the friction", 0.024e-3 + 0.5 * 0.008e-3,
       0.0, 1e-3, "lead_compliance and half of sheath_compliance",
       assumed=Assumption(3.7e-5, 0.0, 1e-3, "assumed: 27 N/mm against a stuck rope")),
    _P("breakaway", "", "friction that rest adds to sliding friction, relative, β", 0.0, 0.0, 4.0, "stribeck_ratio",
       assumed=Assumption(0.0, 0.0, 4.0, "assumed: none on the day of identification")),
    _P("fabric_breakaway", "", "friction that rest adds to sliding friction of the fabric on the knee, relative", 0.0,
       0.0, 4.0, "stribeck_ratio",
       assumed=Assumption(0.0, 0.0, 4.0, "assumed: none on the day of identification")),
    _P("viscous_tension", "N", "tension from which the rope's viscous friction acts in full, in proportion below", 10.0,
       1.0, 100.0, "assumed: a slack rope does not press on its sheath",
       assumed=Assumption(10.0, 0.1, 100.0, "assumed: a slack rope does not press on its sheath"),
       ideal=0.0, any_rig=(0.0, 100.0)),
    _P("fabric_share", "", "share of the fabric's stretch on the rope's side of the knee", 0.425, 0.0, 1.0,
       "fabric_share_before and half of what lies on the knee",
       assumed=Assumption(0.4, 0.0, 1.0, "assumed: geometry")),
    _measured("start_lag", "s", "time by which START's reading lags its force", 1e-3, 0.0, 0.1,
              "assumed: a low-pass of 200 Hz and half a sampling interval"),
    _measured("homed_friction", "", "friction that homing finds where it is what was identified", 1.0, 0.5, 2.0,
              "assumed: the model is the bench"),
    _measured("homed_softness", "", "stretch that homing finds where it is what was identified", 1.0, 0.5, 2.0,
              "assumed: the model is the bench"),
)

PARAMETERS: Final[Mapping[str, Parameter]] = {
    row.name: row for row in (*_FRICTION, *_PATH, *_SENSORS, *_DRIVES, *_LEG, *_WIRE, *_MEASURED)}
"""Every quantity of a bench, by name."""
ESTIMATED: Final[Mapping[str, Parameter]] = {n: p for n, p in PARAMETERS.items() if p.is_estimated}
"""Parameters that a fit estimates, of the simulation or of a rig."""
BY_PLANT: Final[Mapping[str, str]] = {key: p.name for p in PARAMETERS.values() for key in p.plant.split()}
"""Names by "table.key" of a plant model."""
CALIBRATED: Final = frozenset(name for name, p in PARAMETERS.items() if p.assumed is not None)
"""Names of a calibration's scalars."""

def declared(name: str) -> Any:
    """Declare a field of a table of the simulation: nominal value, unit, meaning, bounds and source of `name`."""
    p = PARAMETERS[name]
    return parameter(p.nominal, p.unit, p.meaning, low=p.low, high=p.high, source=p.source)


def assumed(name: str) -> Any:
    """Declare a calibration's field `name`; its default is the value assumed until the bench is measured."""
    p = PARAMETERS[name]
    if p.assumed is None:
        raise ValueError(f"{name} is no scalar of a calibration")
    return parameter(p.assumed.value, p.unit, p.assumed.meaning or p.meaning, low=p.assumed.low, high=p.assumed.high,
                     source=p.assumed.source)


def nominal() -> dict[str, float]:
    """Return every value on the nominal bench."""
    return {name: p.nominal for name, p in PARAMETERS.items()}


def healthy() -> dict[str, float]:
    """Return the estimated parameters' values on the nominal bench."""
    return {name: p.nominal for name, p in ESTIMATED.items()}


