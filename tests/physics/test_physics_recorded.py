"""What a relation depends on is recorded: warm against fresh, for a change of every parameter."""

from __future__ import annotations

import numpy as np
import pytest

from physics.effects.catalogue import CATALOGUE
from physics.parameters import RELATION_PARAMETERS, healthy, ideal
from physics.relations.measured import Signals
from physics.relations.recorded_reads import Memory, Recorded
from physics.relations.relation import RELATIONS, predict, read_by

STEP_S = 5e-3


def signals() -> Signals:
    """Everything that relations read, of a rope that is wound in and paid out while the knee swings."""
    time = np.arange(0.0, 3.0, STEP_S)
    wave = 1.0 - np.cos(2.0 * np.pi * time)
    knee = -0.35 - 0.3 * np.cos(np.pi * time)
    rope = 0.012 + 0.006 * wave
    speed = np.gradient(rope, time)
    end = 15.0 * wave
    columns = {
        "time_s": time, "servo_position_m": rope, "servo_target_m": rope, "knee_angle_rad": knee,
        "knee_target_rad": knee, "tension_end_n": end, "tension_start_n": 1.2 * end, "servo_force_n": 1.2 * end,
        "rope_m": rope, "rope_m_s": speed, "rope_m_s2": np.gradient(speed, time),
        "strain_m_s": speed - 0.04 * np.gradient(knee, time),
        "knee_acceleration": np.gradient(np.gradient(knee, time), time), "end_rate": np.gradient(end, time)}
    fresh = np.zeros(time.size, dtype=np.bool_)
    fresh[0] = True
    return Signals(columns, fresh, time / time[-1])


def others(name: str, values: dict[str, float]) -> list[float]:
    """Values of a parameter at which a law may take another way."""
    p = RELATION_PARAMETERS[name]
    low, high = (max(min(end, 100.0), -100.0) for end in p.rig_bounds)
    likely = p.likely or (p.nominal, p.nominal + (p.like_benches or 0.05 * (high - low)))
    return [v for v in (p.nominal, p.in_ideal, low + 0.3 * (high - low), *likely) if v != values[name]]


START = {"healthy": healthy(), "ideal": ideal(), "at work": {
    n: p.nominal if p.likely is None else 0.5 * sum(p.likely) for n, p in RELATION_PARAMETERS.items()}}


@pytest.mark.parametrize("base", START)
@pytest.mark.parametrize("name", RELATIONS)
def test_a_warm_relation_says_what_a_fresh_one_says(name: str, base: str) -> None:
    relation, warm, start = RELATIONS[name], signals(), START[base]
    predict(relation, warm, start)
    moves: set[str] = set()
    for parameter in RELATION_PARAMETERS:
        for value in others(parameter, start):
            changed = {**start, parameter: value}
            said = predict(relation, warm, changed)
            np.testing.assert_array_equal(said, predict(relation, signals(), changed), err_msg=f"{parameter} = {value}")
            if not np.array_equal(said, predict(relation, warm, start), equal_nan=True):
                moves.add(parameter)
    assert moves <= read_by(relation)


@pytest.mark.parametrize("name", RELATIONS)
def test_what_was_recorded_covers_every_value(name: str) -> None:
    relation, read = RELATIONS[name], set()
    for start in START.values():
        for parameter in RELATION_PARAMETERS:
            for value in others(parameter, start):
                recorded = Recorded({**start, parameter: value})
                relation.law(signals(), recorded)
                read |= recorded.read
    assert read <= read_by(relation)


def test_skew_and_sign_move_what_they_move() -> None:
    """5 ms of skew moved `friction` by nothing where its rope was remembered, and a rope's sign was in no set."""
    warm, values = signals(), healthy()
    predict(RELATIONS["friction"], warm, values)
    skewed = predict(RELATIONS["friction"], warm, {**values, "timestamp_skew": 5e-3})
    turned = predict(RELATIONS["friction"], warm, {**values, "pull_sign": -1.0})
    plain = predict(RELATIONS["friction"], signals(), values)
    assert np.abs(skewed - plain).max() > 0.1
    assert np.abs(turned - plain).max() > 3.0
    assert {"timestamp_skew", "pull_sign"} <= read_by(RELATIONS["friction"])


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))
def test_an_effect_names_the_relations_that_read_it(effect: object) -> None:
    names = {p.name for p in effect.parameters}  # type: ignore[attr-defined]
    reading = {r.name for r in RELATIONS.values() if names & read_by(r)}
    assert reading == set(effect.relations) & set(RELATIONS)  # type: ignore[attr-defined]


def test_a_result_is_kept_by_what_it_was_made_from() -> None:
    made: list[str] = []

    def law(array: np.ndarray, factor: float) -> np.ndarray:
        made.append("made")
        return factor * array

    memory, one = Memory(2), np.ones(3)
    same = one.copy()
    for array, factor, times in ((one, 1.0, 1), (one, 1.0, 1), (same, 1.0, 2), (one, 1.0, 2), (one, 2.0, 3),
                                 (one, 1.0, 3), (same, 1.0, 4)):
        said = memory.recall("law", (array, factor), lambda array=array, factor=factor: law(array, factor))
        np.testing.assert_array_equal(said, factor * array)
        assert len(made) == times


def test_an_array_that_is_gone_is_taken_for_no_other() -> None:
    memory = Memory(4)
    said = [memory.recall("sum", (np.full(8, float(i)),), lambda i=i: 8.0 * i) for i in range(64)]
    assert said == [8.0 * i for i in range(64)]
