"""One table of parameters: every table of a file is in it, and its forms turn into one another and back."""

from __future__ import annotations

import dataclasses
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eds.declaration import PathNodes
from parameters import Remark, declarations
from physics import calibration
from physics.calibration import Calibration
from physics.conversions import MEASURED, RELATED, SIMULATED, UNRELATED, converted, from_scalars, to_scalars
from physics.converter import SensorParameters
from physics.effects.catalogue import CATALOGUE, stated
from physics.forward.path_constants import TABLE
from physics.older_files import FORCE_PATH, RENAMED
from physics.parameters import BY_PLANT, CALIBRATED, ESTIMATED, PARAMETERS
from physics.plant.state_layout import PlantParameters
from virtual_bus.machine import plant_model
from virtual_bus.machine.scatter import LAWS

NODES = PathNodes(1, 2, 3, 4)
"""Node ids of the packaged bench."""

BASE = (PARAMETERS[name] for name in (
    "mu1", "mu2", "phi0", "fabric_wrap", "presliding", "fabric_presliding", "stribeck_speed", "rope_per_knee",
    "rope_zero"))
DRAWN = {p.name: st.floats(p.low, p.high) for p in BASE} | {
    "stiffness_scale": st.floats(0.3, 3.0), "stiffness_shape": st.floats(-0.9, 1.0),
    "lead_compliance": st.floats(5e-6, 1e-4), "stribeck_ratio": st.floats(1.0, 5.0)}


def test_every_field_of_the_simulation_is_a_row() -> None:
    for cls, tables in ((PlantParameters, ("plant",)), (SensorParameters, ("start_sensor", "end_sensor"))):
        for name, default, declared in declarations(cls):
            rows = [PARAMETERS[BY_PLANT[key]] for table in tables if (key := f"{table}.{name}") in BY_PLANT]
            assert rows, name
            for row in rows:
                assert (default, declared.unit) == (row.nominal, row.unit)
                assert (declared.low, declared.high) == (row.low, row.high)


def test_every_scalar_of_a_calibration_is_a_row() -> None:
    for name, default, declared in declarations(Calibration):
        row = PARAMETERS[name]
        assert row.assumed is not None
        assert (default, declared.low, declared.high) == row.assumed[:3]
    assert set(calibration.scalars()) == CALIBRATED


def test_every_parameter_of_an_effect_is_a_row() -> None:
    for effect in CATALOGUE.values():
        for p in effect.parameters:
            row = PARAMETERS[p.name]
            assert (p.unit, p.low, p.high, p.likely, p.neutral) == (
                row.unit, *row.search_bounds, row.likely, row.neutral)
        assert set(effect.forward) <= set(BY_PLANT)


@pytest.mark.parametrize("p", PARAMETERS.values(), ids=list(PARAMETERS))
def test_a_row_agrees_with_itself(p: object) -> None:
    row = PARAMETERS[p.name]  # type: ignore[attr-defined]
    assert row.low <= row.nominal <= row.high
    low, high = row.rig_bounds
    assert low <= row.nominal <= high
    assert low <= row.in_ideal <= high
    if row.likely is not None:
        low, high = row.search_bounds
        assert low <= row.likely[0] < row.likely[1] <= high
    if row.assumed is not None:
        assert row.assumed.low <= row.assumed.value <= row.assumed.high
    for tolerance in (row.made, row.daily):
        assert tolerance is None or tolerance.law in LAWS
    assert re.fullmatch(r"[a-z][a-z0-9_]*", row.name)


@given(st.fixed_dictionaries(DRAWN))
def test_scalars_of_a_calibration_come_back_from_the_simulations_form(values: dict[str, float]) -> None:
    told = to_scalars(values)
    again = to_scalars(from_scalars(told))
    for name, value in told.items():
        assert again[name] == pytest.approx(value, rel=1e-12, abs=1e-15), name


@given(st.fixed_dictionaries(DRAWN))
def test_the_simulations_form_comes_back_from_a_calibrations(values: dict[str, float]) -> None:
    back = converted(SIMULATED, converted(MEASURED, values))
    for name, value in values.items():
        assert back[name] == pytest.approx(value, rel=1e-12, abs=1e-15), name
    related = converted(RELATED, values)
    lost = ("lead_compliance", "fabric_presliding")
    there = converted(UNRELATED, {name: value for name, value in related.items() if name not in lost})
    for name in lost:
        assert there[name] == pytest.approx(values[name], rel=1e-12, abs=1e-15)


@given(st.floats(0.15, 0.8))
def test_the_fabrics_share_comes_back(share: float) -> None:
    there = converted(SIMULATED, {"fabric_share": share})
    assert converted(MEASURED, there)["fabric_share"] == pytest.approx(share, rel=1e-12)


def test_a_whole_calibration_comes_back() -> None:
    nominal = {name: getattr(calibration.nominal(), name) for name in calibration.scalars()}
    back = to_scalars(from_scalars(nominal))
    assert set(back) == set(nominal)
    for name, value in nominal.items():
        assert back[name] == pytest.approx(value, rel=1e-12, abs=1e-15), name


def test_older_names_are_read_with_a_remark() -> None:
    with pytest.warns(Remark, match="moment_arm_m is called rope_per_knee today"):
        model = plant_model.read({"plant": {"moment_arm_m": 0.05, "moment_arm": 1e-3}}, NODES)
    assert model.tables["plant"] == {"rope_per_knee": 0.05, "rope_per_knee_quadratic": 1e-3}
    with pytest.warns(Remark, match="knee_ratio is called rope_per_knee today"):
        found = stated({"effects": {"moment_arm": {"moment_arm": 1e-3, "knee_ratio": {"value": 0.04}}}}, "m.toml")
    assert found == {"moment_arm": {"rope_per_knee_quadratic": 1e-3, "rope_per_knee": 0.04}}
    assert set(RENAMED.values()) <= set(PARAMETERS)


def test_a_name_that_the_force_path_shares_with_the_table_is_of_one_unit() -> None:
    shared = {row.name for row in TABLE} & set(PARAMETERS)
    assert {name: PARAMETERS[name].unit for name in shared} == {
        row.name: row.unit for row in TABLE if row.name in shared}
    assert not {row.name for row in TABLE} & set(FORCE_PATH)


def test_relations_read_names_of_the_table() -> None:
    assert set(ESTIMATED) <= set(PARAMETERS)
    assert not {f.name for f in dataclasses.fields(PlantParameters)} & set(RENAMED)
