"""A plant model: effects by name work with the values stated, the wire loses and delays, other text is refused."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest

from eds.declaration import PathNodes
from parameters import InputError
from physics.plant.bench_plant import Plant, create
from physics.plant.state_layout import PlantParameters
from virtual_bus.build import factory, nominal
from virtual_bus.bus import BowdenBus
from virtual_bus.machine import plant_model
from virtual_bus.machine.scatter import scattered

NODES = PathNodes(1, 2, 3, 4)
"""Node ids of the packaged bench."""

CHANNELS = itertools.count()
GIVEN: list[dict[str, float]] = []


def kept(parameters: dict[str, float], seed: int) -> Plant:
    """A plant factory that keeps what it was given."""
    GIVEN.append(parameters)
    return create(parameters, seed)


def test_an_effect_works_with_its_stated_value_on_any_serial_and_day(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text("[effects.cable_friction]\nmu1 = { value = 0.2, low = 0.18, high = 0.22, unit = '' }\n"
                    "[effects.end_gain]\nend_gain = 1.05\n[plant]\nmu2 = 0.2\n")
    model = plant_model.read(str(path), NODES)
    drawn = scattered(nominal(model.tables, model.where), serial=3, day=2)
    tables = model.at_work(drawn)
    assert tables["plant"]["mu1"] == 0.2
    assert tables["end_sensor"]["gain"] == 1.05
    assert tables["plant"]["mu2"] == drawn["plant"]["mu2"] != 0.2
    assert tables["start_sensor"] == drawn["start_sensor"]


def test_a_plant_by_module_stands_behind_the_nodes() -> None:
    bus = BowdenBus(f"plant-model-{next(CHANNELS)}", plant=f"{__name__}:kept", serial=0,
                    plant_model={"effects": {"slack": {"slack": 2e-3}}})
    bus.shutdown()
    assert GIVEN[-1]["slack_m"] == 2e-3
    assert GIVEN[-1]["mu1"] == PlantParameters().mu1


@pytest.mark.parametrize(("name", "says"), [
    ("no_such_module:create", "cannot be imported"), ("physics.plant.bench_plant:nothing", "cannot be imported"),
    ("physics.plant.bench_plant:__doc__", "no callable"),
])
def test_a_plant_that_is_none_is_one_sentence(name: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        factory(name)


def test_the_wire_delays_and_drops_the_inputs_only() -> None:
    late = plant_model.faults({"late_s": 0.004, "late_share": 0.25}, NODES)
    lost = plant_model.faults({"lost_share": 0.05}, NODES)
    assert [(f.kind, f.cob_id, f.delay_us, f.probability) for f in late] == [
        ("delay", cob_id, 4000.0, 0.25) for cob_id in (0x181, 0x182, 0x183, 0x184)]
    assert [(f.kind, f.cob_id, f.probability) for f in lost] == [
        ("drop", cob_id, 0.05) for cob_id in (0x181, 0x182, 0x183, 0x184)]
    assert plant_model.faults({"late_s": 0.0, "late_share": 1.0}, NODES) == ()


def test_a_bus_table_and_an_effect_of_the_wire_say_the_same() -> None:
    table = plant_model.read({"bus": {"late_s": 0.01, "late_share": 0.1}}, NODES)
    effect = plant_model.read({"effects": {"late_pdo": {"late": 0.01, "late_share": 0.1}}}, NODES)
    assert table.faults == effect.faults != ()
    assert table.effects == effect.effects == {}


@pytest.mark.parametrize(("model", "says"), [
    ({"effects": {"gremlin": {}}}, "plant_model: effects: gremlin is not in the catalogue"),
    ({"effects": {"slack": {"length": 1.0}}}, "slack has no parameter length"),
    ({"effects": {"slack": {"slack": 1.0}}}, "outside"),
    ({"effects": {"slack": {"slack": "long"}}}, "is no number"),
    ({"effects": {"slack": {"slack": True}}}, "is no number"),
    ({"effects": {"slack": 1e-3}}, "is not a table"),
    ({"effects": 3}, "effects is not a table"),
    ({"effects": {"slack": {"slack": 1e-3}}, "found": {"reference": "none"}}, "on a rig that no calibration fits"),
    ({"bus": {"late": 1.0}}, r"\[bus\]: unknown key late"),
    ({"bus": {"late_s": -1.0}}, "no number from 0 to 1"),
    ({"bus": 3}, "bus is not a table"),
])
def test_what_cannot_be_is_one_sentence(model: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        plant_model.read(model, NODES)
