"""Hidden cases by seed: a bench with one effect, two, none, one outside the catalogue, or a fault of the wire.

The rule of this file: a seed says everything; what is hidden is drawn here and never handed to the finder.
Sizes are within the catalogue's likely ranges, away from healthy by more than the tolerance of like benches.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tests.hidden.bench import Bench, like
from tests.hidden.readings import wired
from tests.hidden.walk import trial

Rng = np.random.Generator
Drawn = tuple[dict[str, float], dict[str, float]]
"""What the bench is given, and the same as the catalogue's parameters would say it."""

NOMINAL = Bench(drive_coulomb=1.0, drive_viscous=10.0, drive_inertia=2.5)
THETA_1 = math.pi / 2.0


def _sign(rng: Rng) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _either(rng: Rng, low: float, high: float) -> float:
    return _sign(rng) * rng.uniform(low, high)


def _log(rng: Rng, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _one(field: str, slot: str, draw: Callable[[Rng], float], scale: float = 1.0) -> Callable[[Rng, Bench], Drawn]:
    def drawn(rng: Rng, bench: Bench) -> Drawn:
        del bench
        value = draw(rng)
        return {field: value}, {slot: value * scale}
    return drawn


def _factor(field: str, slot: str, low: tuple[float, float], high: tuple[float, float], per: float = 1.0
            ) -> Callable[[Rng, Bench], Drawn]:
    def drawn(rng: Rng, bench: Bench) -> Drawn:
        factor = rng.uniform(*low) if rng.random() < 0.5 else rng.uniform(*high)
        value = getattr(bench, field) * factor
        return {field: value}, {slot: value / per}
    return drawn


def _both(first: Callable[[Rng, Bench], Drawn], second: Callable[[Rng, Bench], Drawn]) -> Callable[[Rng, Bench], Drawn]:
    def drawn(rng: Rng, bench: Bench) -> Drawn:
        a, b = first(rng, bench), second(rng, bench)
        return {**a[0], **b[0]}, {**a[1], **b[1]}
    return drawn


def _gain(side: str) -> Callable[[Rng, Bench], Drawn]:
    return _one(f"{side}_gain", f"{side}_gain", lambda r: 1.0 + _either(r, 0.03, 0.08))


EFFECTS: dict[str, Callable[[Rng, Bench], Drawn]] = {
    "cable_friction": _factor("cap", "mu1", (0.4, 0.7), (1.4, 2.2), THETA_1),
    "fabric_friction": _factor("mu2", "mu2", (0.35, 0.6), (1.6, 3.5)),
    "fabric_wrap": _one("kappa", "fabric_wrap", lambda r: 1.0 + _either(r, 0.4, 0.7)),
    "cable_bend": _one("bend", "cable_bend", lambda r: _either(r, 0.3, 0.5)),
    "load_dependent_friction": _one("load", "load_slope", lambda r: _either(r, 0.2, 0.4)),
    "viscous_friction": _one("viscous", "viscous", lambda r: r.uniform(5.0, 20.0)),
    "stribeck": _both(_one("ratio", "stribeck_ratio", lambda r: r.uniform(1.4, 2.5)),
                      _one("speed", "stribeck_speed", lambda r: _log(r, 0.004, 0.03))),
    "presliding": lambda r, b: (lambda d: ({"delta": d, "delta_f": d}, {"presliding": d}))(_log(r, 0.3e-3, 1.0e-3)),
    "friction_drift": _one("drift", "friction_drift", lambda r: _either(r, 0.3, 0.7)),
    "stiffness": _one("stiffness", "stiffness_scale", lambda r: r.uniform(0.75, 0.88) if r.random() < 0.5
                      else r.uniform(1.13, 1.35)),
    "fabric_creep": _both(_one("creep", "creep_compliance", lambda r: r.uniform(1.5e-5, 4.0e-5)),
                          _one("creep_t", "creep_time", lambda r: _log(r, 0.2, 20.0))),
    "slack": _one("slack", "slack", lambda r: r.uniform(0.8e-3, 4.0e-3)),
    "knee_backlash": _one("backlash", "knee_backlash", lambda r: math.radians(r.uniform(0.5, 2.0))),
    "moment_arm": _one("arm2", "rope_per_knee_quadratic", lambda r: _either(r, 0.8e-3, 1.97e-3)),
    "drum_eccentricity": _both(_one("ecc", "eccentricity", lambda r: r.uniform(0.2e-3, 0.5e-3)),
                               _one("ecc_phase", "eccentricity_phase", lambda r: r.uniform(-math.pi, math.pi))),
    "end_mass": _one("end_mass", "end_mass", lambda r: r.uniform(0.05, 0.15)),
    "end_gain": _gain("end"),
    "start_gain": _gain("start"),
    "end_offset": _one("end_offset", "end_offset", lambda r: _either(r, 1.0, 3.0)),
    "start_offset": _one("start_offset", "start_offset", lambda r: _either(r, 1.0, 3.0)),
    "end_drift": _one("end_drift", "end_drift", lambda r: _either(r, 1.0, 3.0)),
    "start_drift": _one("start_drift", "start_drift", lambda r: _either(r, 1.0, 3.0)),
    "end_delay": _one("end_delay", "end_delay", lambda r: r.uniform(5e-3, 20e-3)),
    "end_filter": _one("end_filter", "end_filter", lambda r: r.uniform(5e-3, 20e-3)),
    "timestamp_skew": _one("skew", "timestamp_skew", lambda r: r.uniform(5e-3, 20e-3)),
    "drive_coulomb": _one("drive_coulomb", "drive_coulomb", lambda r: r.uniform(2.5, 10.0)),
    "drive_viscous": _one("drive_viscous", "drive_viscous", lambda r: r.uniform(30.0, 150.0)),
    "drive_inertia": _one("drive_inertia", "drive_inertia", lambda r: r.uniform(3.5, 10.0)),
    "drive_offset": _one("drive_offset", "drive_offset", lambda r: _either(r, 1.5, 5.0)),
    "drive_asymmetry": _both(_one("drive_coulomb", "drive_coulomb", lambda r: 1.0),
                             _one("drive_asymmetry", "drive_asymmetry", lambda r: _either(r, 0.3, 0.5))),
}

OUTSIDE: dict[str, Callable[[Rng], dict[str, float]]] = {
    "temperature": lambda r: {"temperature": r.uniform(0.06, 0.15)},
    "thump": lambda r: {"thump": r.uniform(4.0, 10.0)},
    "resonance": lambda r: {"resonance": r.uniform(1.5, 4.0)},
}
"""Effects that the catalogue does not have: cross-talk with the gait, a knock by the knee, a sensor that rings."""

ALTERED = (
    {}, {"law": "power"}, {"law": "mixed"}, {"stops": "narrow"}, {"stops": "long"}, {"slopes": "two bends"},
    {"before": 0.4, "over": 0.25}, {"before": 0.15, "over": 0.5}, {"warp": 0.15}, {"coloured": 0.12},
    {"law": "power", "slopes": "two bends"}, {"law": "mixed", "stops": "long"},
)
"""Structures of healthy plants: half of the cases have one other than the first."""


WIRE: dict[str, Callable[[Rng], tuple[dict[str, float], dict[str, float]]]] = {
    "lost_pdo": lambda r: (lambda p: ({"lost": p}, {"lost_share": p}))(_log(r, 0.02, 0.2)),
    "late_pdo": lambda r: (lambda d, p: ({"late": d, "late_share": p}, {"late": 1e-3 * d, "late_share": p}))(
        int(r.integers(1, 6)), r.uniform(0.1, 0.6)),
    "quantisation": lambda r: (lambda q: ({"quantum": q}, {"quantum": q}))(_log(r, 0.4, 2.0)),
}
"""Faults of wire and converter: what the bus does to the columns, and the same as the catalogue says it."""


@dataclass(frozen=True)
class Job:
    """What is asked for: a kind, a seed, what is hidden (drawn where empty), and whether the structure is altered."""

    kind: str
    seed: int
    names: tuple[str, ...] = ()
    altered: bool = False


@dataclass(frozen=True)
class Case:
    """One hidden case: columns of the trial, of a holdout at another peak and cadence, of healthy trials.

    `alone`: of a pair, what the trial would have been with each effect by itself.
    """

    job: Job
    hidden: tuple[str, ...]
    sizes: dict[str, float]
    harmed: Bench
    trial: dict[str, np.ndarray]
    holdout: dict[str, np.ndarray]
    healthy: tuple[dict[str, np.ndarray], ...]
    alone: tuple[dict[str, np.ndarray], ...] = ()


class Hidden(NamedTuple):
    """What is hidden: by effect the numbers of the bench that it sets, what the wire does, the catalogue's sizes."""

    parts: dict[str, dict[str, float]]
    wire: dict[str, float]
    sizes: dict[str, float]

    def bench(self, own: Bench, *names: str) -> Bench:
        """Return the bench with the effects `names`, with all where none is given."""
        for name in names or self.parts:
            own = dataclasses.replace(own, **self.parts[name])
        return own


def structure(seed: int, altered: bool) -> Bench:
    """The structure of a seed's bench."""
    rng = np.random.default_rng((seed, 1))
    chosen = ALTERED[1 + int(rng.integers(len(ALTERED) - 1))] if altered else ALTERED[0]
    return dataclasses.replace(NOMINAL, **chosen)


def hide(job: Job, own: Bench, rng: Rng) -> Hidden:
    """Draw what is hidden on a bench."""
    pool = {"one": EFFECTS, "two": EFFECTS, "none": {}, "outside": OUTSIDE, "wire": WIRE}[job.kind]
    count = min(len(pool), 2 if job.kind == "two" else 1)
    names = job.names or tuple(rng.choice(sorted(pool), size=count, replace=False).tolist() if count else ())
    hidden = Hidden({name: {} for name in names}, {}, {})
    for name in names:
        if job.kind == "outside":
            hidden.parts[name].update(OUTSIDE[name](rng))
            continue
        fields, said = WIRE[name](rng) if job.kind == "wire" else EFFECTS[name](rng, own)
        hidden.sizes.update(said)
        (hidden.parts[name] if job.kind != "wire" or "quantum" in fields else hidden.wire).update(fields)
    return hidden


def case(job: Job, healthy: int = 2, cycles: int = 10) -> Case:
    """Draw a case: the same job gives the same case."""
    rng = np.random.default_rng((job.seed, 2))
    base = structure(job.seed, job.altered)
    own = like(base, int(rng.integers(1 << 30)))
    hidden = hide(job, own, rng)
    names, harmed = tuple(hidden.parts), hidden.bench(own)
    seeds = rng.integers(1 << 30, size=3 + healthy).tolist()
    period = float(rng.uniform(1.2, 1.5))
    peak = float(rng.choice([40.0, 50.0]))

    def recorded(bench: Bench, seed: int, peak: float, period: float, count: int, faults: dict[str, float]
                 ) -> dict[str, np.ndarray]:
        walked = trial(bench, seed, peak, period, count)
        # every second wire is one whose recorder says ages, the others show repeats alone
        return wired(walked, rng, **faults, ages=job.seed % 2 == 0) if job.kind == "wire" else walked

    return Case(
        job, names, hidden.sizes, harmed, recorded(harmed, seeds[0], peak, period, cycles, hidden.wire),
        recorded(harmed, seeds[1], 90.0 - peak, period * 1.25, 4, hidden.wire),
        tuple(recorded(like(base, s), s + 1, peak if i % 2 == 0 else 90.0 - peak, period * (1.0 + 0.1 * i), cycles, {})
              for i, s in enumerate(seeds[3:])),
        tuple(recorded(hidden.bench(own, name), seeds[0], peak, period, cycles, {}) for name in names)
        if len(names) > 1 else ())
