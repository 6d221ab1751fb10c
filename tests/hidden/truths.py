"""Trials of simulated rigs whose structure shares nothing with the product's model, and an oracle of their effects.

Two rigs, `STRUCTURES`, are not part of the project: `TRUTHS` is their folder, and what needs it is skipped where it is
absent.  The rig `rate_state` is in this folder.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np

from physics.effects.hypotheses import HYPOTHESES
from physics.laws import Array
from tests.hidden import rate_state

TRUTHS: Final = Path(__file__).resolve().parents[3] / "shared" / "truths"
STRUCTURES: Final = ("truth1", "truth2")
EFFECTS: Final[Mapping[str, str]] = {
    "mu1": "cable_friction", "mu2": "fabric_friction", "stiff": "stiffness", "presl": "presliding", "strib": "stribeck",
    "vis": "viscous_friction", "blash": "knee_backlash", "creep": "fabric_creep", "gain_e": "end_gain",
    "gain_s": "start_gain", "drift_e": "end_drift", "delay": "end_delay", "lpf": "end_filter", "mass": "end_mass",
    "ecc": "drum_eccentricity", "k3": "moment_arm", "kphi": "fabric_wrap", "kbend": "cable_bend",
    "fdrift": "friction_drift", "kml": "load_dependent_friction"}
"""Effect of a rig → effect of the catalogue."""
OUTSIDE: Final = ("X_slip", "X_vib", "X_pulse", "X_gainstep")
ALIKE: Final = (
    ("fabric_wrap", "fabric_friction"), ("end_gain", "start_gain", "stiffness"), ("moment_arm", "drum_eccentricity"),
    ("end_delay", "end_filter", "timestamp_skew"))
"""Effects that no gait separates in principle: each is right for the others."""
SEPARABLE: Final = 132.0
"""χ² of the effect in the trial's sensor noise, session constants adapted, from which a case counts."""
FURTHER: Final = 20_000
"""Seed of the motion of a further trial, less that of the case."""


@dataclass(frozen=True, order=True)
class Question:
    """One case: structure of the rig, its names of the hidden effects, and the seed of bench and trial."""

    structure: str
    hidden: tuple[str, ...]
    seed: int

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the catalogue that are hidden."""
        return tuple(EFFECTS[name] for name in self.hidden if name in EFFECTS)


@dataclass(frozen=True)
class Drawn:
    """Columns of one case: two reference trials, one of the trial's own motion, the trial, and two further trials.

    `repeat`, `further`: of the trial's own session and effect, of its motion and of another one; nothing is fitted to
    them.  `separation`: χ² of the oracle.  `clean`: START and END of the effect alone, N, shape (2, samples).
    """

    references: tuple[dict[str, Array], ...]
    same_motion: dict[str, Array]
    trial: dict[str, Array]
    repeat: dict[str, Array]
    further: dict[str, Array]
    separation: float
    clean: Array

    @property
    def without(self) -> dict[str, Array]:
        """The trial less the effect's own response, as after an exact model of the effect."""
        return _moved(self.trial, -self.clean)


@functools.cache
def rig(structure: str) -> ModuleType:
    """Return the module of one rig."""
    if str(TRUTHS) not in sys.path:
        sys.path.insert(0, str(TRUTHS))
    spec = importlib.util.spec_from_file_location(structure, TRUTHS / f"{structure}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@functools.cache
def version(structure: str) -> str:
    """Return eight digits of the SHA-256 of what draws the trials of a rig."""
    here = Path(__file__)
    own = [TRUTHS / f"{structure}.py"] if structure in STRUCTURES else sorted(here.parent.glob(f"{structure}*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in (here, *own))).hexdigest()[:8]


def draw(asked: Question) -> Drawn:
    """Return the trials of one case; those of `TRUTHS` are drawn as the rig's own command draws them."""
    return {"truth1": _first, "truth2": _second, "rate_state": _rate_state}[asked.structure](asked)


def alike(name: str) -> tuple[str, ...]:
    """Return the effects that are right where `name` is hidden, itself first."""
    return (name, *(other for group in ALIKE if name in group for other in group if other != name))


def part(name: str) -> str:
    """Return the part of the bench in which an effect is."""
    return HYPOTHESES[name].part


def questions(structure: str, first: int, singles: int, healthy: int, pairs: int = 0, outside: int = 0
              ) -> list[Question]:
    """Return cases of one structure with the seeds from `first` on: effects in turns, nothing, pairs, no catalogue's.
    """
    names = list(EFFECTS)
    nothing = "null_alt"
    random = np.random.default_rng(first)
    order = [names[int(i)] for i in random.permutation(len(names))]
    hidden: list[tuple[str, ...]] = [(order[i % len(order)],) for i in range(singles)]
    hidden += [(nothing if i % 2 else "null",) for i in range(healthy)]
    hidden += [tuple(str(n) for n in random.choice(names, 2, replace=False)) for _ in range(pairs)]
    hidden += [(OUTSIDE[i % len(OUTSIDE)],) for i in range(outside)]
    return [Question(structure, one, first + i) for i, one in enumerate(hidden)]


def _second(asked: Question) -> Drawn:
    module, seed = rig("truth2"), asked.seed
    random = np.random.default_rng(770000 + seed)
    bench = module.bench(random)
    bench["rate"] = int(random.choice([500, 1000]))
    references = tuple(module.make(["null"], bench, np.random.default_rng(90000 + 7 * seed + k), 12,
                                   random.uniform(.06, .3))[0] for k in range(2))
    noise, held, drawn = (random.uniform(.06, .3), random.uniform(.06, .3)), [], module.motion

    def made(effects: Sequence[str], number: int, sd: float, values: Mapping[str, Any] = bench,
             shift_mm: float = 0.0, draws: bool = True, other: bool = False) -> dict[str, Array]:
        def motion(*given: Any) -> Any:
            own = drawn(*given) if draws else None
            if other:
                return drawn(np.random.default_rng(FURTHER + seed), *given[1:])
            held[:] = held or [own]
            return (held[0][0], held[0][1] + shift_mm, *held[0][2:])
        return _with(module, "motion", motion, lambda: module.make(
            list(effects), values, np.random.default_rng(number), 10, sd)[0])

    trial, further = made(asked.hidden, seed, noise[0]), made(asked.hidden, seed, noise[0], other=True)
    same = made(["null"], 50000 + seed, noise[1], draws=False)
    exact = made(asked.hidden, seed, 0.0)
    # a gain in per cent depends on the sensors' noise, so the repeat has the trial's
    other_noise = _difference(same, made(["null"], 50000 + seed, 0.0, draws=False))
    repeat = _moved(exact, noise[0] / noise[1] * other_noise)
    if asked.hidden == ("null",):
        return Drawn(references, same, trial, repeat, further, 0.0, np.zeros_like(_tensions(trial)))
    base = made(["null"], seed, 0.0)
    clean = _difference(exact, base)
    steps = [_difference(made(["null"], seed, 0.0, {**bench, name: bench[name] * (1.0 + sd)}), base)
             for name, sd in (("mu1", 0.03), ("mu2", 0.05), ("kf0", 0.03))]
    steps.append(_difference(made(["null"], seed, 0.0, bench, 0.2), base))
    return Drawn(references, same, trial, repeat, further, _separation(clean, steps, base, noise[0]), clean)


def _first(asked: Question) -> Drawn:
    module, seed = rig("truth1"), asked.seed
    references = tuple(module.make(["null"], np.random.default_rng(90000 + 7 * seed + k), ncyc=12)[0]
                       for k in range(2))
    nominal, held, drawn = dict(module.P0), [], module.trajectory

    def made(effects: Sequence[str], number: int, values: Mapping[str, Any] = nominal, sd: float = 0.0,
             draws: bool = True, other: bool = False) -> dict[str, Array]:
        def trajectory(*given: Any) -> Any:
            own = drawn(*given) if draws else None
            if other:
                return drawn(np.random.default_rng(FURTHER + seed), *given[1:])
            held[:] = held or [own]
            return held[0]
        module.P0.update(values)
        try:
            return _with(module, "trajectory", trajectory, lambda: module.make(
                list(effects), np.random.default_rng(number), noise=sd)[0])
        finally:
            module.P0.update(nominal)

    trial, further = made(asked.hidden, seed, sd=0.2), made(asked.hidden, seed, sd=0.2, other=True)
    same = made(["null"], 50000 + seed, sd=0.2, draws=False)
    exact = made(asked.hidden, seed)
    repeat = _moved(exact, _difference(same, made(["null"], 50000 + seed, draws=False)))
    if not asked.effects:
        return Drawn(references, same, trial, repeat, further, 0.0, np.zeros_like(_tensions(trial)))
    base = made(["null"], seed)
    clean = _difference(exact, base)
    steps = [_difference(made(["null"], seed, {**nominal, name: value}), base) for name, value in (
        ("mu1", 1.03 * nominal["mu1"]), ("mu2", 1.05 * nominal["mu2"]), ("kf0", 1.03 * nominal["kf0"]), ("x0", 0.2))]
    return Drawn(references, same, trial, repeat, further, _separation(clean, steps, base, 0.2), clean)


def _rate_state(asked: Question) -> Drawn:
    def random(*stream: int) -> np.random.Generator:
        return np.random.default_rng([asked.seed, *stream])

    bench = rate_state.draw_bench(random(0))
    noise = random(1).uniform(0.06, 0.3, 4)  # N, of two references, the trial, and a reference of its motion
    sessions = [rate_state.draw_session(bench, random(2, k)) for k in range(4)]
    motions = [rate_state.draw_motion(bench, random(3, k), cycles) for k, cycles in enumerate((12, 12, 10, 10))]
    own, motion, other_motion, simulate = sessions[2], *motions[2:], rate_state.simulate
    with_effect = rate_state.altered(own, asked.hidden, random(4))

    def read(columns: rate_state.Columns, session: int, recording: int) -> dict[str, Array]:
        return rate_state.measured(columns, bench, float(noise[session]), random(5, recording))

    exact = simulate(with_effect, motion)
    recorded = (tuple(read(simulate(sessions[k], motions[k]), k, k) for k in range(2)),
                read(simulate(sessions[3], motion), 3, 3), read(exact, 2, 2), read(exact, 2, 4),
                read(simulate(with_effect, other_motion), 2, 5))
    if asked.hidden == ("null",):
        return Drawn(*recorded, 0.0, np.zeros_like(_tensions(exact)))
    base = simulate(own, motion)
    clean = _difference(exact, base)
    stepped = [replace(own, **{name: getattr(own, name) * (1.0 + sd)}) for name, sd in (
        ("cable_friction", 0.03), ("fabric_friction", 0.05), ("stiffness", 0.03))]
    steps = [_difference(simulate(constants, motion), base) for constants in stepped]
    steps.append(_difference(simulate(own, motion._replace(rope=motion.rope + 2e-4)), base))
    return Drawn(*recorded, _separation(clean, steps, base, float(noise[2])), clean)


def _with(module: ModuleType, name: str, other: Any, run: Callable[[], dict[str, Array]]) -> dict[str, Array]:
    """Return the result of `run` while the function `name` of a rig is `other`."""
    own = getattr(module, name)
    setattr(module, name, other)
    try:
        return run()
    finally:
        setattr(module, name, own)


def _tensions(columns: Mapping[str, Array]) -> Array:
    return np.stack([columns["tension_start_n"], columns["tension_end_n"]])


def _moved(columns: Mapping[str, Array], by: Array) -> dict[str, Array]:
    """Return columns with START and END greater `by` so much, N, shape (2, samples)."""
    return {**columns, "tension_start_n": columns["tension_start_n"] + by[0],
            "tension_end_n": columns["tension_end_n"] + by[1]}


def _difference(first: Mapping[str, Array], second: Mapping[str, Array]) -> Array:
    return np.asarray(_tensions(first) - _tensions(second))


def _separation(clean: Array, steps: Sequence[Array], base: Mapping[str, Array], noise_n: float) -> float:
    """Return χ² of `clean` in white noise, with the session's constants adapted.

    Gains and offsets of like benches are adapted, too.  `steps`: change of the tensions by 1σ of each constant between
    sessions.
    """
    still = np.zeros(clean.shape[1])
    start, end = _tensions(base)
    columns = [*steps, np.stack([0.003 * start, still]), np.stack([still, 0.003 * end]),
               np.stack([still + 0.1, still]), np.stack([still, still + 0.1])]
    spread = np.stack([c.ravel() for c in columns], axis=1) / noise_n
    effect = clean.ravel() / noise_n
    along = spread.T @ effect
    moved = np.linalg.solve(np.eye(along.size) + spread.T @ spread, along)
    return float(effect @ effect - along @ moved)
