"""One bench of the family: its structure, its constants, what an effect changes, and the flat array of the path.

The rule of this file: data only.  Lengths in m, forces in N, times in s, angles in rad; rope positive pulling, knee
flexion negative.  Friction exponents are those of the capstan, T_out = T_in·e^(−exponent).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

IMPLEMENTATIONS = ("maxwell", "lugre", "dahl", "fronts")
STRETCHES = ("parabola", "exponential", "power", "toe")
STRIBECKS = ("sheath", "fabric", "both", "none")
KNEES = ("gap", "play", "none")

KNEE_AT_FIT = -0.4964
"""Knee angle at 13 % of gait, rad (paper, (1): −28.44°): where the leg's anchor counts as displaced by nothing."""
LOADED_KNEE = -0.5
"""Knee angle, rad, at which the total exponent is drawn: about that of the loading, 13–20 % of gait."""
GRAVITY = 9.81
EDS_DRUM_M = 0.020
"""Radius by which the servo's unit objects (0x6092, feed constant) turn torque into force at the rope."""


class Structure(NamedTuple):
    """What kind of bench: drawn from the serial apart from every constant."""

    implementation: str
    stretch: str
    stribeck: str
    knee: str
    drive_order: int
    sheath_nodes: int
    fabric_nodes: int
    cells: int


@dataclass(frozen=True)
class Bench:
    """Every number of one bench; healthy as drawn, an effect replaces some of them."""

    structure: Structure
    serial: int = 0
    day: int = 0
    # friction: sheath, fabric on the knee
    theta1: float = 1.6  # bend of the sheath, rad; with mu1 the sheath's exponent
    mu1: float = 0.08
    mu2: float = 0.15
    wrap: float = 0.15  # wrap at the upright knee, rad
    wrap_slope: float = 1.0  # wrap per knee angle, 1/rad
    cable_bend: float = 0.0  # 1/rad
    presliding: float = 1e-4  # of the sheath, m
    fabric_presliding: float = 1e-4
    sheath_ratio: float = 1.0  # static over sliding friction
    fabric_ratio: float = 1.0
    stribeck_speed: float = 0.01  # m/s
    stribeck_memory: float = 0.01  # s
    breakaway_room: float = 1.0  # share of a day's breakaway that this bench takes
    load_slope: float = 0.0  # relative change of the friction for each 40 N
    load_reference: float = 40.0  # tension at which mu1 and mu2 are what they say, N
    viscous: float = 0.0  # N·s/m, whole sheath
    friction_drift: float = 0.0
    drift_s: float = 20.0
    # elasticity
    lead: float = 2.4e-5  # compliance between drum and sheath, m/N
    sheath: float = 0.8e-5  # compliance of the rope in the sheath, m/N
    stretch_60: float = 12e-3  # stretch of the fabric alone at 60 N, m
    curve: float = 0.5  # share of stretch_60 that is not linear (0…1)
    bend_n: float = 30.0  # force that the curved part is scaled with, N
    power: float = 0.5
    before: float = 0.25  # shares of the fabric between sheath and knee, and between knee and END
    after: float = 0.4
    stiffness: float = 1.0
    creep: float = 0.0  # m/N
    creep_s: float = 5.0
    torn: float = 0.0  # outside the catalogue: softer by this share while the load rises
    # rope
    rope_kg: float = 0.02
    loose_drag: float = 0.3  # friction of the loose rope against its own weight, as a coefficient
    loose_viscous: float = 0.3  # drag of the whole path without load, N·s/m
    slack: float = 0.0  # length to be wound up before the rope is taut, m
    # knee
    moment_arm: float = 0.0405  # m/rad
    moment_arm2: float = 0.0  # m/rad²
    play: float = 0.0  # whole gap, rad
    play_s: float = 5e-3
    play_nm: float = 0.3  # torque that closes the gap under load, N·m
    leg_inertia: float = 0.045
    leg_weight: float = 0.9  # mass·g·lever, N·m
    knee_rub: float = 0.3
    knee_viscous: float = 0.1
    knee_lag: float = 1.5e-3
    # servo, at the rope
    drum: float = 0.02  # m: period of an eccentricity; forces go by EDS_DRUM_M
    drive_kg: float = 2.5
    drive_coulomb: float = 1.5
    drive_viscous: float = 12.0
    drive_viscous_asymmetry: float = 0.0
    drive_offset: float = 0.0
    drive_asymmetry: float = 0.0
    drive_presliding: float = 2e-5
    drive_lag: float = 5e-4
    demand_gain: float = 1.0
    force_limit: float = 300.0
    loop_hz: float = 25.0  # position loop: lives in the drive, set by `stack.tables`; used by imposed motion
    eccentricity: float = 0.0
    eccentricity_phase: float = 0.0
    zero: float = 0.0  # encoder's reading of the taut, unloaded rope at KNEE_AT_FIT
    start_slack: float = 8e-3
    zero_rate: float = 0.0  # m/s: a garment that migrates moves the zero
    # sensors, as the bridges feel
    start_lag: float = 1e-3
    end_lag: float = 1e-3
    start_gain: float = 1.0
    end_gain: float = 1.0
    start_offset: float = 0.0
    end_offset: float = 0.0
    start_drift: float = 0.0
    end_drift: float = 0.0
    end_mass: float = 0.0
    end_arm: float = 0.25
    end_filter: float = 0.0
    end_delay: float = 0.0
    skew: float = 0.0
    quantum: float = 0.0
    lost_share: float = 0.0
    late_share: float = 0.0
    late_cycles: int = 0
    resonance: float = 0.0  # outside the catalogue: share of END's rate that a 9 Hz cantilever rings with
    noise: float = 0.0  # of END and START, N rms: drawn for each trial, not for each bench

    @property
    def exponent(self) -> float:
        """Total friction exponent at the loaded knee."""
        return self.mu1 * self.theta1 + self.mu2 * (self.wrap + self.wrap_slope * abs(LOADED_KNEE))

    def loose_drag_n(self, speed_m_s: float) -> float:
        """What it costs to drag the rope without load through its sheath at a speed, N: weight and loose drag."""
        return self.loose_drag * self.rope_kg * GRAVITY + self.loose_viscous * abs(speed_m_s)


(E1, BEND, MU2, WRAP, WRAP_SLOPE, DELTA1, DELTA2, RATIO1, RATIO2, SPEED, MEMORY, LOAD, LOAD_N, VISCOUS, DRIFT,
 DRIFT_S, LEAD, SHEATH, KIND, CURVE, LINEAR, BEND_N, POWER, SOFT, BEFORE, OVER, AFTER, CREEP, CREEP_S, TORN,
 MASS, LOOSE, LIGHT, N1, N2, CELLS, FIRST) = range(37)
"""Places in the path's flat parameter array; an implementation's own numbers begin at FIRST."""

START, MIDDLE, END, OLD_X, OLD_W, GAMMA, RISING, TIME, OWN = range(9)
"""Places in the path's flat state: tensions at START, before the knee and at END, then memory; OWN: the method's."""


def pack(bench: Bench) -> np.ndarray:
    """Return the path's common parameters, without the `FIRST` places that an implementation adds."""
    s = bench.structure
    curve, linear = _stretch(bench)
    return np.array([
        bench.mu1 * bench.theta1, bench.cable_bend, bench.mu2, bench.wrap, bench.wrap_slope, bench.presliding,
        bench.fabric_presliding, bench.sheath_ratio, bench.fabric_ratio, bench.stribeck_speed,
        bench.stribeck_memory, bench.load_slope, bench.load_reference, bench.viscous, bench.friction_drift,
        bench.drift_s, bench.lead / bench.stiffness, bench.sheath / bench.stiffness, STRETCHES.index(s.stretch),
        curve, linear, bench.bend_n, bench.power, 1.0 / bench.stiffness, bench.before,
        1.0 - bench.before - bench.after, bench.after, bench.creep, bench.creep_s, bench.torn, bench.rope_kg,
        bench.loose_drag, bench.loose_viscous, s.sheath_nodes, s.fabric_nodes, s.cells])


def _stretch(bench: Bench) -> tuple[float, float]:
    """Coefficients of the curved and the linear part, such that their sum at 60 N is `stretch_60`."""
    from tests.plants.stretch import curved

    kind = STRETCHES.index(bench.structure.stretch)
    at_60 = float(curved.py_func(60.0, kind, bench.bend_n, bench.power))
    return bench.curve * bench.stretch_60 / at_60, (1.0 - bench.curve) * bench.stretch_60 / 60.0


def replaced(bench: Bench, **changes: float) -> Bench:
    """Return the bench with some of its numbers replaced."""
    return dataclasses.replace(bench, **changes)  # type: ignore[arg-type]
