"""The catalogue: complete, consistent, read by the plant and by compensation, open to one more at run time."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from parameters import InputError, from_table
from physics.converter import SensorParameters
from physics.effects.catalogue import (
    CATALOGUE,
    Effect,
    EffectParameter,
    Trajectory,
    apply,
    compensate,
    register,
    registered,
    value_of,
)
from physics.effects.separating_experiments import EXPERIMENTS
from physics.plant.state_layout import PlantParameters
from tests.physics.effects_page import page

FIRST_EDITION = (
    "cable_friction fabric_friction fabric_wrap cable_bend load_dependent_friction viscous_friction stribeck "
    "presliding friction_drift stiffness fabric_creep slack knee_backlash moment_arm drum_eccentricity end_mass "
    "end_gain start_gain end_offset start_offset end_drift start_drift end_delay end_filter timestamp_skew late_pdo "
    "lost_pdo quantisation drive_coulomb drive_viscous drive_offset drive_asymmetry drive_inertia saturation "
    "supply_sag drive_viscous_asymmetry drive_presliding drive_stribeck demand_gain unbalance"
)
ABSENT = [e for e in CATALOGUE.values() if any(p.neutral is not None for p in e.parameters)]
NOMINAL = {
    "plant": dataclasses.asdict(PlantParameters()), "start_sensor": dataclasses.asdict(SensorParameters()),
    "end_sensor": dataclasses.asdict(SensorParameters()), "bus": {"late_s": 0.0, "lost_share": 0.0}}
DOCS = Path(__file__).parents[2] / "docs"


def test_first_edition_is_whole() -> None:
    assert sorted(CATALOGUE) == sorted(FIRST_EDITION.split())


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))
def test_declaration_is_consistent(effect: Effect) -> None:
    assert effect.rivals
    assert set(effect.rivals) <= set(CATALOGUE) - {effect.name}
    assert effect.experiment in EXPERIMENTS
    assert all((effect.law, effect.source, effect.signature, effect.words, effect.site))
    for p in effect.parameters:
        assert p.low <= p.likely[0] < p.likely[1] <= p.high
        assert p.neutral is None or p.low <= p.neutral <= p.high


def test_parameters_are_owned_by_one_effect() -> None:
    names = [p.name for effect in CATALOGUE.values() for p in effect.parameters]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))
def test_every_likely_effect_makes_a_valid_plant_model(effect: Effect, end: int) -> None:
    tables = apply({effect.name: {p.name: p.likely[end] for p in effect.parameters}})
    kinds = {"plant": PlantParameters, "start_sensor": SensorParameters, "end_sensor": SensorParameters}
    for name, given in tables.items():
        if name in kinds:
            made = from_table(kinds[name], given, where=name)
            assert {key: getattr(made, key) for key in given} == given


@pytest.mark.parametrize("effect", ABSENT, ids=[e.name for e in ABSENT])
def test_neutral_leaves_the_nominal_plant_model(effect: Effect) -> None:
    neutral = {p.name: p.neutral for p in effect.parameters if p.neutral is not None}
    shaping = {p.name: p.likely[0] for p in effect.parameters if p.neutral is None}
    working = {p.name: p.likely[1] for p in effect.parameters if p.neutral is not None}
    moved = 0
    for target, law in effect.forward.items():
        table, _, key = target.partition(".")
        if law(shaping | working) != law(shaping | neutral):
            assert law(shaping | neutral) == NOMINAL[table][key]
            moved += 1
    assert moved > 0


def test_what_is_not_given_is_completed_and_what_is_wrong_is_refused() -> None:
    assert apply({"stribeck": {"stribeck_ratio": 2.0}})["plant"]["stribeck_speed_m_s"] == pytest.approx(16e-3)
    assert apply({"friction_drift": {"friction_drift": 0.3, "trial_s": 13.0}})["plant"]["friction_drift_s"] == 13.0
    with pytest.raises(InputError, match="gremlins is not in the catalogue"):
        apply({"gremlins": {}})
    with pytest.raises(InputError, match="has no parameter mu2"):
        apply({"cable_friction": {"mu2": 0.1}})
    with pytest.raises(InputError, match=r"outside 0 … 0\.5"):
        apply({"cable_friction": {"mu1": 0.7}})


def _course() -> Trajectory:
    t = np.linspace(0.0, 2.0, 201)
    knee = -0.5 + 0.4 * np.sin(np.pi * t)
    desired = 40.0 * np.maximum(0.0, np.sin(np.pi * t)) ** 2
    rope = 0.04 * knee + 0.2e-3 * desired
    rate = np.gradient(rope, t)
    one = np.ones_like(t)
    return Trajectory(
        progress=t / 2.0, desired_n=desired, tension_n=1.1 * desired, knee_rad=knee, knee_rad_s=np.gradient(knee, t),
        rope_m=rope, rope_m_s=rate, time_s=t, rope_slip=np.sign(rate), fabric_slip=np.sign(np.gradient(desired, t)),
        cable_exponent=0.126 * one, fabric_exponent=0.1 * one, start_extra_n=0.0 * one, stretch_m=0.25e-3 * desired,
        rope_extra_m=0.0 * one, knee_extra_rad=0.0 * one, start_gain=one, start_offset_n=0.0 * one, lead_s=0.0)


def test_compensation_meets_each_effect() -> None:
    course = _course()
    met = compensate(course, {"viscous_friction": {"viscous": 10.0}, "slack": {"slack": 1e-3},
                              "start_gain": {"start_gain": 1.05}, "knee_backlash": {"knee_backlash": 0.02}})
    np.testing.assert_allclose(met.start_extra_n, 10.0 * course.rope_m_s)
    np.testing.assert_allclose(met.rope_extra_m, 1e-3)
    np.testing.assert_allclose(met.start_gain, 1.05)
    assert set(np.unique(met.knee_extra_rad)) <= {-0.01, 0.0, 0.01}


def test_effects_that_share_a_law_are_met_together_in_any_order() -> None:
    course = _course()
    friction, wrap, bend = {"mu2": 0.3}, {"fabric_wrap": 0.5}, {"cable_bend": 0.4}
    one = compensate(course, {"fabric_friction": friction, "fabric_wrap": wrap, "cable_bend": bend,
                              "cable_friction": {"mu1": 0.1}})
    other = compensate(course, {"cable_friction": {"mu1": 0.1}, "cable_bend": bend, "fabric_wrap": wrap,
                                "fabric_friction": friction})
    np.testing.assert_array_equal(one.fabric_exponent, other.fabric_exponent)
    np.testing.assert_allclose(one.fabric_exponent, 0.3 * (0.15 + 0.5 * np.abs(course.knee_rad)))
    np.testing.assert_array_equal(one.cable_exponent, other.cable_exponent)
    np.testing.assert_allclose(one.cable_exponent, 0.1 * math.pi / 2 * (1.0 + 0.4 * np.abs(course.knee_rad)))


def test_eccentricity_is_undone_to_first_order() -> None:
    course = _course()
    values = {"eccentricity": 0.3e-3, "eccentricity_phase": 0.7}
    met = compensate(course, {"drum_eccentricity": values})
    asked = course.rope_m + met.rope_extra_m
    paid = asked + 0.3e-3 * (np.sin(asked / 0.02 + 0.7) - math.sin(0.7))
    # second order: A²/R
    np.testing.assert_allclose(paid, course.rope_m, atol=2 * 0.3e-3**2 / 0.02)


def test_an_effect_is_added_at_run_time() -> None:
    bearing = Effect(
        name="knee_bearing", site="knee", law="τ = b·ω", source="dry bearing",
        parameters=(EffectParameter("bearing", "N·m·s/rad", 0.0, 5.0, (0.1, 1.0), 0.02, "b"),),
        forward={"plant.leg_damping": value_of("bearing")}, signature="the leg lags with speed",
        words="The knee's bearing drags.", rivals=("knee_backlash",), experiment="locked_motor",
    )
    with registered(bearing):
        assert CATALOGUE["knee_bearing"] is bearing
        assert apply({"knee_bearing": {"bearing": 0.5}}) == {"plant": {"leg_damping": 0.5}}
        assert "## `knee_bearing`" in page()
        with pytest.raises(ValueError, match="already has"):
            register(bearing)
    assert "knee_bearing" not in CATALOGUE
    with pytest.raises(ValueError, match=r"forward sets plant\.bering"):
        register(dataclasses.replace(bearing, forward={"plant.bering": value_of("bearing")}))


def test_page_is_up_to_date() -> None:
    assert (DOCS / "effects.md").read_text(encoding="utf-8") == page()
