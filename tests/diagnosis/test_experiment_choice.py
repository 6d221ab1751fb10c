"""The proposed experiment splits the class that it is proposed for, by calculation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.judgement import experiment_choice as choice
from diagnosis.problem.candidates import candidates
from diagnosis.problem.floors import FLOORS
from diagnosis.problem.healthy_reference import of_bench
from physics.relations.relation import RELATIONS, predict

SENSORS = ("friction", "elasticity", "kinematics")
REFERENCE = of_bench(None)
VALUES = REFERENCE.values


def model(name: str, values: Mapping[str, float]) -> Any:
    """A fitted model of one effect, as the search gives it."""
    effect = next(c for c in candidates(SENSORS, VALUES, REFERENCE.nuisance) if c.name == name)
    return SimpleNamespace(effects=[effect], names=(name,), fit=SimpleNamespace(values={**VALUES, **values}), rank=0.0)


def proposed(one: Any, other: Any, *, any_rig: bool = False) -> str | None:
    setting: Any = SimpleNamespace(any_rig=any_rig, learnt=None, reference=REFERENCE, weights={
        name: FLOORS[name] * math.sqrt(5.0) for name in SENSORS})
    found: Any = SimpleNamespace(best=one, models=[one, other])
    return choice.choose([*one.names, *(n for n in other.names if n not in one.names)], found, setting)


GAINS = (("start_gain", {"start_gain": 1.08}), ("end_gain", {"end_gain": 1 / 1.08}))


@pytest.mark.parametrize(("one", "other"), [GAINS, GAINS[::-1]])
def test_two_gains_are_split_by_a_weight_and_not_by_swapping(
    one: tuple[str, dict[str, float]], other: tuple[str, dict[str, float]]
) -> None:
    # swapped: START's place reads g·F(END) before and F(END/g) after, whichever of the two gains is wrong
    assert proposed(model(*one), model(*other)) == "dead_weight"


def test_two_frictions_that_no_calculated_experiment_splits_get_one_that_the_bench_runs_by_itself() -> None:
    rope = model("cable_friction", {"mu1": 1.4 * VALUES["mu1"]})
    fabric = model("fabric_friction", {"mu2": 1.65 * VALUES["mu2"]})
    assert proposed(rope, fabric) == "locked_angles"


def test_without_a_class_there_is_no_experiment_and_on_an_unknown_rig_the_first_named() -> None:
    one, other = (model(*gain) for gain in GAINS)
    assert proposed(one, one) is None
    assert proposed(one, other, any_rig=True) == "swapped_sensors"


@pytest.mark.parametrize("name", [choice.GAIT, *choice.CALCULATED])
@pytest.mark.parametrize("friction", [1.0, 1.5])
def test_the_signals_of_a_motion_are_what_the_bench_model_predicts(name: str, friction: float) -> None:
    values = {**VALUES, "mu1": friction * VALUES["mu1"]}
    signals = choice.predicted_signals(name, tuple(values.items()))
    start = signals["tension_start_n"]
    rms = {relation: float(np.sqrt(np.mean((predict(RELATIONS[relation], signals, values) - measured) ** 2)))
           for relation, measured in (("friction", start), ("elasticity", start),
                                      ("kinematics", signals["knee_angle_rad"]))}
    assert rms["friction"] < 0.1  # N
    assert rms["kinematics"] < 1e-6  # rad
    assert rms["elasticity"] < 0.25 * float(np.sqrt(np.mean(start**2)))  # it starts from another memory of the friction
