"""One bench of `truth`: its numbers, the chain they make, and how like benches differ.

The rule of this file: effects are settings of `Bench`, each with its own law in this room, drawn elsewhere.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from tests.hidden import truth

K2 = 0.706e-3 * 180.0 / math.pi
A, B, C = (48.16, 525.2, 540.2), (0.01951, 0.1239, 0.1232), (-3.112, -0.02836, -3.159)
THETA_13 = math.radians(sum(a * math.sin(b * 13.0 + c) for a, b, c in zip(A, B, C, strict=True)))


@dataclass(frozen=True)
class Bench:
    """Every number of one bench, healthy by default; effects change some of them."""

    cap: float = 0.126
    mu2: float = 0.15
    wrap0: float = 0.15
    kappa: float = 1.0
    bend: float = 0.0
    load: float = 0.0
    viscous: float = 0.0
    ratio: float = 1.0
    speed: float = 0.01
    delta: float = 1.0e-4
    delta_f: float = 1.0e-4
    drift: float = 0.0
    lead: float = 3.0e-5
    sheath: float = 1.0e-5
    stiffness: float = 1.0
    shape: float = 0.0
    law: str = "exponential"
    before: float = 0.25
    over: float = 0.35
    creep: float = 0.0
    creep_t: float = 5.0
    warp: float = 0.0
    slopes: str = "even"
    stops: str = "wide"
    slack: float = 0.0
    zero: float = 0.0
    backlash: float = 0.0
    arm2: float = 0.0
    ecc: float = 0.0
    ecc_phase: float = 0.0
    end_mass: float = 0.0
    end_arm: float = 0.25
    end_gain: float = 1.0
    start_gain: float = 1.0
    end_offset: float = 0.0
    start_offset: float = 0.0
    end_drift: float = 0.0
    start_drift: float = 0.0
    end_delay: float = 0.0
    end_filter: float = 0.0
    skew: float = 0.0
    quantum: float = 0.01
    noise: float = 0.15
    coloured: float = 0.05
    drive_hz: float = 25.0
    drive_coulomb: float = 4.0
    drive_viscous: float = 12.0
    drive_offset: float = 0.0
    drive_asymmetry: float = 0.0
    drive_inertia: float = 0.35
    temperature: float = 0.0
    thump: float = 0.0
    resonance: float = 0.0


def chain(bench: Bench) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the chain's flat parameters, stop widths, stop weights and bend by node."""
    soft, knee, linear, power = {
        "exponential": (16.3e-3, 45.0, 0.0, 0.0), "power": (7.6e-3, 10.0, 0.0, 0.5),
        "mixed": (10.0e-3, 30.0, 0.07e-3, 0.0)}[bench.law]
    soft, linear = soft / bench.stiffness, linear / bench.stiffness
    knee = knee * (1.0 + bench.shape)
    soft *= (1.0 + bench.shape) * math.exp(20.0 / knee - 20.0 / (knee / (1.0 + bench.shape))) if not power else 1.0
    p = np.zeros(truth.COUNT)
    p[:] = (bench.cap, bench.mu2, bench.wrap0, bench.kappa, bench.bend, bench.load, bench.viscous, bench.ratio,
            bench.speed, bench.delta, bench.delta_f, bench.drift, bench.lead, bench.sheath, soft, knee, linear, power,
            bench.before, bench.over, bench.creep, bench.creep_t, bench.warp)
    widths, weights = {"wide": ((0.4, 1.0, 2.2), (0.3, 0.4, 0.3)), "narrow": ((0.8, 1.0, 1.3), (0.3, 0.4, 0.3)),
                       "long": ((0.3, 1.2, 4.0), (0.4, 0.4, 0.2))}[bench.stops]
    slopes = np.ones(truth.CABLE) / truth.CABLE
    if bench.slopes == "two bends":
        slopes = np.array([0.3, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.2])
    return p, np.array(widths), np.array(weights), slopes


def preloaded(bench: Bench) -> float:
    """Stretch of the chain at 20 N without friction: where homing puts the encoder's zero."""
    p, *_ = chain(bench)
    return float(truth.stretch(20.0, p)) + 20.0 * (bench.lead + bench.sheath)


def zero(bench: Bench) -> float:
    """Rope of the chain at the drum's zero, m: homed at 20 N by the nominal stretch (10), less slack."""
    return preloaded(bench) - (9.7e-3 + 0.3e-3 * 20.0 - 0.0017e-3 * 400.0) + bench.zero - bench.slack


def like(bench: Bench, seed: int, tolerance: float = 1.0) -> Bench:
    """A like bench: the manufacturing tolerances of healthy benches, 1σ times `tolerance`."""
    rng = np.random.default_rng(seed)
    r = tolerance * rng.normal(size=9)
    r = np.clip(r, -2.5, 2.5)
    return dataclasses.replace(
        bench, cap=bench.cap * (1.0 + 0.03 * r[0]), mu2=bench.mu2 * (1.0 + 0.05 * r[1]),
        stiffness=bench.stiffness * (1.0 + 0.03 * r[2]), zero=bench.zero + 2e-4 * r[3],
        start_gain=bench.start_gain * (1.0 + 0.003 * r[4]), end_gain=bench.end_gain * (1.0 + 0.003 * r[5]),
        start_offset=bench.start_offset + 0.1 * r[6], end_offset=bench.end_offset + 0.1 * r[7],
        delta=bench.delta * (1.0 + 0.1 * r[8]), drive_hz=bench.drive_hz * (1.0 + 0.02 * r[8]))
