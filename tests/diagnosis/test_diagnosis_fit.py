"""Fits keep their bounds, reach the least cost, and the laws they move keep theirs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from diagnosis.data.table import table
from diagnosis.finder import diagnose
from diagnosis.problem.blocks import blocks_of
from diagnosis.problem.fit import Problem, solve
from diagnosis.problem.prior import Free
from physics.effects.catalogue import Effect, EffectParameter, registered
from physics.parameters import ideal
from physics.relations.tension_chain import along_cable


def pulled(exponent: float, compliance: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rope drawn in and paid out under 20 N: position, tension behind the cable, START."""
    position = 0.01 * np.sin(np.linspace(0.0, 6.0 * np.pi, 1500))
    behind = np.full(position.size, 20.0)
    fresh = np.zeros(position.size, dtype=np.bool_)
    fresh[0] = True
    start, _ = along_cable(behind, position, np.full(position.size, exponent), 1e-3 * np.arange(position.size),
                           fresh, 1e-4, 1.0, compliance, 0.0, 1.0, 0.01, 0.02, 0.3, 1.0)
    return position, behind, start


@pytest.mark.parametrize("compliance", [0.0, 3.5e-5])
def test_a_sliding_rope_keeps_the_capstan_law_both_ways(compliance: float) -> None:
    _, _, start = pulled(0.2, compliance)
    assert start.max() == pytest.approx(20.0 * math.exp(0.2), rel=1e-6)
    assert start[500:].min() == pytest.approx(20.0 * math.exp(-0.2), rel=1e-6)


def test_start_depends_smoothly_on_the_friction_where_the_rope_turns() -> None:
    near = [pulled(0.2 + h, 3.5e-5)[2] for h in (0.0, 1e-6, 2e-6)]
    assert np.abs(near[2] - 2.0 * near[1] + near[0]).max() < 1e-6


def rig(seed: int = 0, end_extra: float = 0.0) -> dict[str, np.ndarray]:
    """A frictionless transmission measured at both ends: ten turns at 100 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(2000) / 100.0
    rope = 0.01 * np.sin(np.pi * time)
    end = 20.0 + 10.0 * np.sin(0.7 * np.pi * time)
    start = 1.2 * end + 3.0 + end_extra * np.sin(2.0 * np.pi * 0.15 * time) + rng.normal(0.0, 0.05, time.size)
    return {"time_s": time, "cycle": np.floor(time / 2.0), "servo_position_m": rope, "tension_end_n": end,
            "tension_start_n": start}


def test_a_bounded_fit_stops_on_the_bound_and_moves_the_rest() -> None:
    problem = Problem(blocks_of([table("rig", rig())], ["friction"]), {"friction": 1.0})
    free = [Free("tension_ratio", 1.0, 1.1, 1.0, math.inf, 0.1), Free("start_offset", -20.0, 20.0, 0.0, math.inf, 1.0)]
    fit = solve(problem, ideal(), free)
    assert fit.values["tension_ratio"] == 1.1
    assert fit.values["start_offset"] == pytest.approx(3.0 + 0.1 * 20.0, abs=0.1)


def test_a_prior_holds_a_parameter_as_far_as_the_data_let_it() -> None:
    problem = Problem(blocks_of([table("rig", rig())], ["friction"]), {"friction": 1e6})
    fit = solve(problem, ideal(), [Free("tension_ratio", 0.5, 2.0, 1.05, 0.01, 0.1)])
    assert fit.values["tension_ratio"] == pytest.approx(1.05, abs=1e-4)


def hum() -> Effect:
    """An effect that no law of the room reads: START hums at 0.15 Hz."""
    return Effect(
        name="hum", site="START sensor", law="T + h·sin(2π·0.15 Hz·t)", source="made for this test",
        parameters=(EffectParameter("hum", "N", -10.0, 10.0, (0.5, 5.0), 0.0, "amplitude"),), forward={},
        relations=("friction",), signature="a slow hum", words="START hums.", rivals=(), experiment="bus_log",
        measured={"friction": lambda columns, predicted, values: predicted + values["hum"] * np.sin(
            2.0 * np.pi * 0.15 * columns["time_s"])})


def test_an_effect_added_at_run_time_is_found_by_name_and_size() -> None:
    with registered(hum()):
        found = diagnose([table("rig", rig(end_extra=2.5))], holdout=[table("other", rig(1, 2.5))])
    assert found.verdict == "found"
    assert [cause["effect"] for cause in found.causes] == ["hum"]
    assert found.causes[0]["parameters"]["hum"]["value"] == pytest.approx(2.5, rel=0.02)
    figures = found.relations["friction"]
    assert figures.holdout_before is not None
    assert figures.holdout_after is not None
    assert figures.holdout_after < 0.1 < 1.0 < figures.holdout_before


def test_trials_held_out_that_are_predicted_worse_are_said() -> None:
    with registered(hum()):
        told = diagnose([table("rig", rig(end_extra=2.5))], holdout=[table("other", rig(1))])
    figures = told.relations["friction"]
    assert figures.holdout_before is not None
    assert figures.holdout_after is not None
    assert figures.holdout_after > figures.holdout_before
    assert any("the trials held out are predicted worse" in sentence for sentence in told.warnings)


def test_nothing_is_found_where_nothing_is_wrong() -> None:
    found = diagnose([table("rig", rig())])
    assert found.verdict == "none"
    assert found.rivals == []
