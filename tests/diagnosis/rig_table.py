"""Rigs of each kind with exact laws: are changes of 15 % named, repeats quiet, and do the intervals of `fit` cover?

The rule of this file: each seed draws sizes of a rig of each row of docs/rigs.md, its reference trials, a repeat, and
a trial for each changed constant.  Motion is steady but for ramps, 0 to 3 % of the rows are lost in gaps of 60 ms, and
constants of friction differ between trials by 2 % (1σ).  No code is shared with `physics`.

    python -m tests.diagnosis.rig_table [--first SEED] [--count N] [--rigs NAME,…] [--references N] [--seeds]

A change counts if it is 5σ of what noise and repeats leave by least squares with the exact law (`counts`).
"""

from __future__ import annotations

import argparse
import hashlib
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from diagnosis.finder import Finder
from estimation import bench_fit
from estimation.data.table import Table, table
from tests.diagnosis.rigs import STEP_S, Array, Columns, Friction, dragged, lossy, sensed

RATE_HZ = 200.0
CHANGE, REPEATS, SECONDS = 1.15, 0.02, 41.0
LOST = (0.0, 0.01, 0.03)
Sizes = Mapping[str, float]


class Motion(NamedTuple):
    """Position, speed and acceleration in steps of `STEP_S`."""

    x: Array
    v: Array
    a: Array


class Rig(NamedTuple):
    """A kind of rig: `drawn`: sizes of one, by a generator; `speeds`: of its motion; `law`: force signals by column.

    `rubs`: sizes that differ between trials.  `effects`: names that a change of a size may have.  `constants`: name
    in `bowden fit` → size.  `noise`: 1σ and step of the force signals.  `grid`: step of the encoder.
    """

    drawn: Callable[[np.random.Generator], dict[str, float]]
    speeds: Sequence[float]
    law: Callable[[Sizes, Sequence[Motion], np.random.Generator], dict[str, Array]]
    position: str
    rubs: Sequence[str]
    effects: Mapping[str, frozenset[str]]
    constants: Mapping[str, str]
    noise: tuple[float, float]
    grid: float
    joint: str | None = None


def steady(speeds: Sequence[float], rng: np.random.Generator) -> Motion:
    """Return a motion at each of `speeds`, either way, in an order drawn, with ramps of 0.5 s."""
    levels = [0.0]
    for speed in rng.permutation(speeds):
        levels += [speed, -speed]
    target = np.repeat([*levels, 0.0], round(SECONDS / (len(levels) + 1) / STEP_S))
    ramp = np.hanning(round(0.5 / STEP_S))
    v = np.convolve(target, ramp / ramp.sum(), "same")
    return Motion(np.cumsum(v) * STEP_S, v, np.gradient(v, STEP_S))


def _rub(p: Sizes, of: Motion) -> Array:
    """Return the friction of an axis: a bristle's, and viscous."""
    return dragged(of.x, of.v, Friction(p["coulomb"], p["viscous"], bristle=p["bristle"]).row())


def _mix(rng: np.random.Generator, force: float, speed: float, bristle: float) -> dict[str, float]:
    """Return friction of `force` at `speed`, of which 20 to 70 % are viscous."""
    share = rng.uniform(0.2, 0.7)
    return {"coulomb": (1.0 - share) * force, "viscous": share * force / speed,
            "bristle": bristle * math.exp(rng.uniform(-1.0, 1.0))}


def _axis(rng: np.random.Generator) -> dict[str, float]:
    force = math.exp(rng.uniform(math.log(20.0), math.log(200.0)))
    return {**_mix(rng, force, 0.2, 5e-5), "inertia": rng.uniform(0.5, 2.0) * force, "zero": 0.1 * force}


def _motor(rng: np.random.Generator) -> dict[str, float]:
    return {**_mix(rng, 0.6, 7.0, 2e-3), "inertia": rng.uniform(0.01, 0.04)}


def _pendulum(rng: np.random.Generator) -> dict[str, float]:
    return {**_mix(rng, 0.12, 1.5, 2e-3), "inertia": rng.uniform(0.01, 0.03), "unbalance": rng.uniform(0.3, 1.2)}


def _moved(p: Sizes, motions: Sequence[Motion], rng: np.random.Generator) -> Array:
    at = motions[0]
    return p["inertia"] * at.a + _rub(p, at) + p.get("zero", 0.0) + p.get("unbalance", 0.0) * np.sin(at.x + 1.2)


def _sealed(p: Sizes, motions: Sequence[Motion], rng: np.random.Generator) -> dict[str, Array]:
    at = motions[0]
    law = Friction(p["coulomb"], p["viscous"], rest=p["rest"], rest_speed=0.006, bristle=p["bristle"])
    return {"servo_force_n": dragged(at.x, at.v, law.row())}


def _two_forces(p: Sizes, motions: Sequence[Motion], rng: np.random.Generator) -> dict[str, Array]:
    at = motions[0]
    end = p["load"] * (1.0 + 0.3 * np.sin(6.2832 * (0.07 * STEP_S * np.arange(at.x.size) + rng.random())))
    turned = dragged(at.x, at.v, Friction(1.0, bristle=p["bristle"]).row())
    return {"tension_start_n": end * np.exp(p["wrap"] * turned) + p["viscous"] * at.v, "tension_end_n": end}


def _arm(p: Sizes, motions: Sequence[Motion], rng: np.random.Generator) -> dict[str, Array]:
    """Lagrange's equations of a forearm of which only the mass varies, and of an upper arm that carries it."""
    (q1, w1, a1), (q2, w2, a2) = motions
    upper, centre = 0.35, 0.15
    far, near, bend = 1.3 * p["mass"] * centre**2, 0.1 + p["mass"] * upper**2, p["mass"] * upper * centre
    weight2 = p["mass"] * 9.81 * centre * np.sin(q1 + q2)
    torque1 = ((near + far + 2.0 * bend * np.cos(q2)) * a1 + (far + bend * np.cos(q2)) * a2
               - bend * np.sin(q2) * (2.0 * w1 * w2 + w2**2) + weight2 + 4.0 * np.sin(q1) + 0.5 * np.tanh(w1 / 0.01))
    torque2 = (far + bend * np.cos(q2)) * a1 + (far + 0.01) * a2 + bend * np.sin(q2) * w1**2 + weight2
    return {"shoulder.servo_torque_nm": torque1, "elbow.servo_torque_nm": torque2 + _rub(p, motions[1])}


def _elastic(p: Sizes, motions: Sequence[Motion], rng: np.random.Generator) -> dict[str, Array]:
    at = motions[0]
    lever, middle = 0.2, 0.5 * (at.x.max() + at.x.min())  # a spring that pulls and pushes
    joint = (middle + 0.8 * (at.x - middle) + 0.005 * np.sin(at.x / 0.05)) / lever
    spring = p["stiffness"] * (at.x - lever * joint)
    return {"servo_force_n": spring + p["inertia"] * at.a + _rub(p, at), "tension_start_n": spring,
            "knee_angle_rad": joint}


_FRICTION = {"coulomb": frozenset({"drive_coulomb"}), "viscous": frozenset({"drive_viscous"})}
_INERTIA = {**_FRICTION, "inertia": frozenset({"drive_inertia"})}
_RUBS = ("coulomb", "viscous")
_FITTED = {"drive_coulomb": "coulomb", "drive_viscous": "viscous", "drive_inertia": "inertia"}
RIGS: dict[str, Rig] = {
    "seal": Rig(lambda r: {**_mix(r, 15.0, 0.03, 1e-4), "rest": r.uniform(0.0, 0.6)},
                (0.002, 0.005, 0.01, 0.02, 0.04, 0.06), _sealed, "servo_position_m", _RUBS, _FRICTION, {},
                (0.08, 0.005), 5e-7),
    "cable": Rig(lambda r: {"load": r.uniform(30.0, 120.0), "wrap": r.uniform(0.1, 0.5), "bristle": 1e-4,
                            "viscous": r.uniform(20.0, 200.0)},
                 (0.005, 0.01, 0.02, 0.04, 0.06), _two_forces, "servo_position_m", ("wrap", "viscous"),
                 {"wrap": frozenset({"cable_friction", "load_dependent_friction"}),
                  "viscous": frozenset({"viscous_friction"})}, {"viscous": "viscous"}, (0.1, 0.01), 1e-6),
    "axis": Rig(_axis, (0.02, 0.05, 0.1, 0.2, 0.3, 0.4),
                lambda p, m, r: {"servo_force_n": _moved(p, m, r)}, "servo_position_m", _RUBS, _INERTIA, _FITTED,
                (0.8, 0.01), 1e-6),
    "motor": Rig(_motor, (1.0, 2.0, 4.0, 6.0, 9.0, 12.0), lambda p, m, r: {"servo_torque_nm": _moved(p, m, r)},
                 "servo_position_rad", _RUBS, _INERTIA, _FITTED, (0.03, 1e-4), 2.0 * math.pi / 4096),
    "voltage": Rig(_motor, (1.0, 2.0, 4.0, 6.0, 9.0, 12.0),
                   lambda p, m, r: {"motor_voltage_v": 10.0 * _moved(p, m, r) + 0.4 * m[0].v}, "servo_position_rad",
                   _RUBS, {k: v for k, v in _INERTIA.items() if k != "viscous"}, {}, (0.1, 1e-3),
                   2.0 * math.pi / 4096),
    "pendulum": Rig(_pendulum, (0.3, 0.6, 1.0, 2.0, 3.0), lambda p, m, r: {"servo_torque_nm": _moved(p, m, r)},
                    "servo_position_rad", _RUBS, {**_INERTIA, "unbalance": frozenset({"unbalance"})},
                    {**_FITTED, "unbalance": "unbalance"}, (0.01, 1e-4), 1e-4),
    "arm": Rig(lambda r: {**_mix(r, 0.4, 0.8, 3e-3), "mass": r.uniform(0.8, 2.0)}, (0.3, 0.5, 1.0, 1.5), _arm,
               "servo_position_rad", _RUBS, {**_FRICTION, "mass": frozenset({"unbalance"})},
               {"drive_coulomb": "coulomb", "drive_viscous": "viscous"}, (0.02, 1e-3), 1e-4, "elbow"),
    "elastic": Rig(lambda r: {**_mix(r, 10.0, 0.03, 5e-5), "inertia": r.uniform(10.0, 40.0),
                              "stiffness": r.uniform(4e3, 2e4)}, (0.005, 0.01, 0.02, 0.06), _elastic,
                   "servo_position_m", _RUBS, {**_INERTIA, "stiffness": frozenset({"stiffness"})}, _FITTED,
                   (0.5, 0.01), 5e-6),
}


class Case:
    """A rig of one seed: recordings of its reference trials, and further ones with a size times a factor."""

    def __init__(self, name: str, seed: int, references: int = 2) -> None:
        self.rig, self.lost = RIGS[name], LOST[seed % len(LOST)]
        self.rng = np.random.default_rng([seed, sorted(RIGS).index(name)])
        self.sizes = self.rig.drawn(self.rng)
        self.reference = [self.trial(f"reference_{k}.csv") for k in range(references)]

    def trial(self, source: str, changed: str | None = None) -> Table:
        """Return a recording of another session, in which the size `changed` is times `CHANGE`."""
        own = {k: v * (1.0 + REPEATS * self.rng.standard_normal() * (k in self.rig.rubs)) * (
            CHANGE if k == changed else 1.0) for k, v in self.sizes.items()}
        columns = lossy(self._recorded(own), self.lost, int(self.rng.integers(1 << 31))) if self.lost \
            else self._recorded(own)
        return table(source, columns, **({"joint": self.rig.joint} if self.rig.joint else {}))

    def _motions(self) -> list[Motion]:
        return [steady(self.rig.speeds, self.rng) for _ in range(2 if self.rig.joint else 1)]

    def _recorded(self, sizes: Sizes) -> Columns:
        motions = self._motions()
        columns = {}
        for prefix, motion in zip(("shoulder.", "elbow.") if self.rig.joint else ("",), motions, strict=True):
            columns[prefix + self.rig.position] = sensed(motion.x, RATE_HZ, self.rng, grid=self.rig.grid)
        for column, force in self.rig.law(sizes, motions, self.rng).items():
            noise, grid = (0.0, self.rig.grid) if column == "knee_angle_rad" else self.rig.noise
            columns[column] = sensed(force, RATE_HZ, self.rng, noise, grid)
        return {"time_s": np.arange(next(iter(columns.values())).size) / RATE_HZ, **columns}

    def counts(self, changed: str, least: float = 5.0) -> bool:
        """Return whether a change is `least` σ of repeats and noise, by least squares with the exact law."""
        motions, names = self._motions(), sorted({*self.rig.effects})
        fixed = self.rng.bit_generator.state

        def force(p: Sizes) -> Array:
            self.rng.bit_generator.state = fixed  # a load is the same in each
            every = self.rig.law(p, motions, self.rng)
            return np.concatenate([v[::round(1.0 / (STEP_S * RATE_HZ))] for k, v in every.items()
                                   if k not in ("tension_end_n", "knee_angle_rad", "shoulder.servo_torque_nm")])

        base = force(self.sizes)
        slopes = np.stack([(force({**self.sizes, n: 1.01 * self.sizes[n]}) - base) / 0.01 for n in names], axis=1)
        own = self.rig.noise[0] ** 2 * np.linalg.inv(slopes.T @ slopes + 1e-9 * np.eye(len(names)))[
            names.index(changed), names.index(changed)]
        # the mean of two reference trials has half the variance of one trial
        return bool(least * math.sqrt(1.5 * (own + REPEATS**2 * (changed in self.rig.rubs))) <= CHANGE - 1.0)


def asked(name: str, seed: int, references: int = 2) -> Iterator[dict[str, Any]]:
    """Yield what is said of a repeat and of each change, and of the constants that `bowden fit` states."""
    case = Case(name, seed, references)
    finder = Finder().fit(case.reference)
    for changed in (None, *case.rig.effects):
        said = finder.diagnose([case.trial("trial.csv", changed)])
        right = said.verdict == "none" if changed is None else bool(case.rig.effects[changed] & set(said.rivals))
        nats = max(((said.evidence or {}).get("log_bayes_factors") or {}).values(), default=0.0)
        yield {"rig": name, "seed": seed, "lost": case.lost, "changed": changed or "nothing",
               "counts": changed is None or case.counts(changed), "right": right,
               "wrong": bool(said.rivals) and not right, "verdict": said.verdict, "named": list(said.rivals),
               "nats": round(nats, 1)}
    fitted = bench_fit.fit(case.reference).constants
    for constant, size in case.rig.constants.items():
        if constant in fitted:
            at, truth = fitted[constant], case.sizes[size]
            yield {"rig": name, "seed": seed, "lost": case.lost, "changed": f"[{constant}]", "counts": True,
                   "right": at.low <= truth <= at.high, "wrong": False, "value": at.value, "low": at.low,
                   "high": at.high, "truth": truth}


def main() -> None:
    """Print every answer and, by rig and change, how many that count are right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=6)
    parser.add_argument("--rigs", default=",".join(RIGS))
    parser.add_argument("--references", type=int, default=2, help="reference trials of each rig")
    parser.add_argument("--seeds", action="store_true", help="print the hash of what would be asked, and end")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.count)
    names = options.rigs.split(",")
    if options.seeds:
        made = hashlib.sha256()
        for case in (Case(name, seed, options.references) for name in names for seed in seeds):
            for column in (case.reference[0].columns[c] for c in sorted(case.reference[0].columns)):
                made.update(column.tobytes())
        print(made.hexdigest())
        return
    counted, right, wrong = Counter[tuple[str, str]](), Counter[tuple[str, str]](), Counter[tuple[str, str]]()
    for name in names:
        for row in (row for seed in seeds for row in asked(name, seed, options.references)):
            print(row, flush=True)
            key = (name, row["changed"])
            counted[key] += row["counts"]
            right[key] += row["counts"] and row["right"]
            wrong[key] += row["wrong"]
    for key, total in counted.items():
        print(f"{key[0]:9} {key[1]:16} {right[key]:3} of {total:3}" + (f", {wrong[key]} wrong" if wrong[key] else ""))
    sys.stdout.flush()


if __name__ == "__main__":
    main()
