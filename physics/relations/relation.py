"""Prediction equations between measured signals (`RELATIONS`), with the names of DESIGN §8.

An equation predicts one measured signal from others, over the parameters of `physics.parameters`; its dependencies
are recorded, not listed. An effect outside these equations supplies one, by relation (`Effect.measured`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from physics.effects.catalogue import CATALOGUE
from physics.laws import Array
from physics.parameters import RELATION_PARAMETERS, healthy, ideal
from physics.relations import drive_relations, transmission
from physics.relations.measured import Fine, Signals, Values
from physics.relations.recorded_reads import Recorded


class Relation(NamedTuple):
    """One relation: its law predicts `output`, in `unit`, from `columns` and the parameters that it reads.

    `bench_only`: it holds where (10) carries the load, not on a rig whose load is another.
    """

    name: str
    unit: str
    output: str
    columns: tuple[str, ...]
    law: Callable[[Signals, Values], Array]
    bench_only: bool = False


RELATIONS: Final[Mapping[str, Relation]] = {
    relation.name: relation for relation in (
        Relation("friction", "N", "tension_start_n", ("tension_end_n", "servo_position_m"), transmission.friction),
        Relation("elasticity", "N", "tension_start_n", ("servo_position_m", "knee_angle_rad"),
                 transmission.elasticity, bench_only=True),
        Relation("kinematics", "rad", "knee_angle_rad", ("servo_position_m",), transmission.kinematics),
        Relation("servo", "m", "servo_position_m", ("servo_target_m",), drive_relations.servo),
        Relation("drive_force", "N", "servo_force_n", ("servo_position_m",), drive_relations.drive_force),
        Relation("knee", "rad", "knee_angle_rad", ("knee_target_rad",), drive_relations.knee),
    )
}


def uses(relation: Relation) -> frozenset[str]:
    """Return the parameters that move `relation`: what its law reads, and those of effects that bring their own."""
    brought = {p.name for effect in CATALOGUE.values() if relation.name in effect.measured for p in effect.parameters}
    return read_by(relation) | brought


@cache
def read_by(relation: Relation) -> frozenset[str]:
    """Return the parameters that the law of `relation` reads, its switches on or off, optional columns there or not."""
    read: set[str] = set()
    for values in (healthy(), ideal(), _switched_on()):
        for signals in (_probe(fine=True), _probe(fine=False), _probe(only={*relation.columns, relation.output})):
            recorded = Recorded(values)
            relation.law(signals, recorded)
            read |= recorded.read
    return frozenset(read)


def read_on(relation: Relation, signals: Signals) -> frozenset[str]:
    """Return the parameters that `relation` reads on `signals`: fewer, where it can do without a column."""
    recorded = Recorded(_switched_on())
    relation.law(signals, recorded)
    brought = {p.name for effect in CATALOGUE.values() if relation.name in effect.measured for p in effect.parameters}
    return frozenset(recorded.read) | brought


def _switched_on() -> dict[str, float]:
    """Return values of which none is where its part of a law is left out."""
    values = {}
    for name, p in RELATION_PARAMETERS.items():
        low, high = (max(end, -1e3) if end < 0.0 else min(end, 1e3) for end in p.rig_bounds)
        off = p.like_benches or p.law or 1e-3 * (high - low)
        values[name] = p.nominal + off if p.nominal + off <= high else p.nominal - off
    return values


def _probe(fine: bool = False, only: set[str] | None = None) -> Signals:
    """Return signals of a few samples that move; `only`: the measured ones, else all are."""
    time = np.arange(12) * 1e-2
    wave = 1.0 - np.cos(2.0 * np.pi * time / 0.12)
    columns = {
        "time_s": time, "servo_position_m": 0.02 * wave, "servo_target_m": 0.02 * wave, "servo_force_n": 10.0 * wave,
        "knee_angle_rad": -0.3 * wave, "knee_target_rad": -0.3 * wave, "tension_start_n": 10.0 * wave,
        "tension_end_n": 8.0 * wave}
    if only is not None:
        columns = {name: column for name, column in columns.items() if name in {"time_s", *only}}
    slope = np.gradient(wave, time)
    columns |= {"rope_m": 0.02 * wave, "rope_m_s": 0.02 * slope, "rope_m_s2": np.gradient(0.02 * slope, time),
                "strain_m_s": 0.02 * slope, "knee_acceleration": slope, "end_rate": 8.0 * slope, "turned_rad": wave}
    fresh = np.zeros(time.size, dtype=np.bool_)
    fresh[0] = True
    rope = Fine(columns["rope_m"], columns["rope_m_s"], fresh, lambda values: values) if fine else None
    return Signals(columns, fresh, time / time[-1], rope)


def brings_own(relation: Relation) -> bool:
    """Whether an effect of the catalogue supplies an equation for `relation`."""
    return any(relation.name in effect.measured for effect in CATALOGUE.values())


def predict(relation: Relation, signals: Signals, values: Values) -> Array:
    """Return the prediction of `relation`, with the laws that effects bring themselves put on top."""
    predicted = relation.law(signals, values)
    for effect in [e for e in CATALOGUE.values() if e.measured]:
        brought = effect.measured.get(relation.name)
        if brought is not None and any(p.name in values and values[p.name] != p.neutral for p in effect.parameters):
            predicted = brought(signals.columns, predicted, values)
    return predicted
