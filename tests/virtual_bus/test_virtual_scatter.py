"""Serial numbers and days: within their tolerance, reproducible, and independent parameter by parameter."""

from __future__ import annotations

import math

import pytest

from parameters import InputError, declarations
from physics.converter import SensorParameters
from physics.plant.bench_plant import PlantParameters
from virtual_bus.build import GROUPS, factory, nominal, steady
from virtual_bus.machine import scatter
from virtual_bus.machine.scatter import DAY, LAWS, SERIAL, draw, scattered

NOMINAL = nominal(None)


def test_serial_0_on_day_0_is_nominal() -> None:
    assert scattered(NOMINAL, 0, 0) == NOMINAL


def test_the_same_numbers_give_the_same_bench_and_others_another() -> None:
    assert scattered(NOMINAL, 7, 3) == scattered(NOMINAL, 7, 3)
    benches = [scattered(NOMINAL, serial, day)["plant"]["mu1"] for serial in range(1, 20) for day in range(4)]
    assert len(set(benches)) == len(benches)


@pytest.mark.parametrize("spread", SERIAL, ids=lambda spread: f"{spread.group}.{spread.name}")
def test_a_serial_number_stays_within_its_tolerance_and_uses_it(spread: scatter.Spread) -> None:
    value = NOMINAL[spread.group][spread.name]
    drawn = [scattered(NOMINAL, serial, 0)[spread.group][spread.name] for serial in range(1, 101)]
    reach = spread.size * value if spread.law == "factor" else spread.size
    assert max(abs(d - value) for d in drawn) <= reach
    assert max(drawn) > value + 0.8 * reach
    assert min(drawn) < value - 0.8 * reach
    assert abs(math.fsum(drawn) / len(drawn) - value) < 0.2 * reach


@pytest.mark.parametrize("spread", DAY, ids=lambda spread: f"{spread.group}.{spread.name}")
def test_a_day_departs_from_the_bench_that_was_identified(spread: scatter.Spread) -> None:
    bench = scattered(NOMINAL, 5, 0)[spread.group][spread.name]
    drawn = [scattered(NOMINAL, 5, day)[spread.group][spread.name] for day in range(1, 101)]
    least, most = {
        "factor": (bench * (1 - spread.size), bench * (1 + spread.size)),
        "offset": (bench - spread.size, bench + spread.size),
        "excess": (bench, bench + spread.size),
        "set": (spread.size, spread.size),
    }[spread.law]
    assert least <= min(drawn) <= max(drawn) <= most
    assert spread.law == "set" or len(set(drawn)) == 100


def test_a_row_more_changes_no_other_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    before = scattered(NOMINAL, 5, 2)["plant"]
    added = scatter.Spread("plant", "leg_inertia", "factor", 0.1, "test")
    monkeypatch.setattr(scatter, "SERIAL", (added, *SERIAL))
    after = scattered(NOMINAL, 5, 2)["plant"]
    assert {name for name in after if after[name] != before[name]} == {"leg_inertia"}


def test_serial_and_day_draw_apart() -> None:
    mu1 = next(spread for spread in DAY if spread.name == "mu1")
    assert draw("serial", mu1, 5) != draw("day", mu1, 5, 1) != draw("day", mu1, 6, 1)


def test_every_row_names_a_parameter_and_a_law_and_stays_within_the_declared_bounds() -> None:
    for spread in (*SERIAL, *DAY):
        assert spread.name in NOMINAL[spread.group]
        assert spread.law in LAWS
    for serial in range(1, 50):
        tables = scattered(NOMINAL, serial, serial)
        for group, cls in GROUPS.items():
            for name, _, declared in declarations(cls):
                assert declared.low <= tables[group][name] <= declared.high


def test_a_plant_model_takes_the_place_of_nominal_values() -> None:
    tables = nominal({"plant": {"mu1": 0.1}, "end_sensor": {"offset_n": 0.5}})
    assert (tables["plant"]["mu1"], tables["end_sensor"]["offset_n"]) == (0.1, 0.5)
    assert tables["start_sensor"] == NOMINAL["start_sensor"]
    assert set(tables["plant"]) == {name for name, _, _ in declarations(PlantParameters)}
    assert set(tables["end_sensor"]) == {name for name, _, _ in declarations(SensorParameters)}


@pytest.mark.parametrize(("model", "says"), [
    ({"cable": {}}, "unknown table cable"), ({"plant": {"mu": 1.0}}, "mu"), ({"plant": {"mu1": 9.0}}, "mu1"),
])
def test_an_unusable_plant_model_is_one_sentence(model: dict[str, dict[str, float]], says: str) -> None:
    with pytest.raises(InputError, match=says):
        nominal(model)


def test_an_unknown_plant_is_named() -> None:
    with pytest.raises(InputError, match="'steam'"):
        factory("steam")


@pytest.mark.parametrize("spread", DAY, ids=lambda spread: spread.label)
def test_what_is_steady_keeps_its_value_over_the_day_and_nothing_else_does(spread: scatter.Spread) -> None:
    made, changed = scattered(NOMINAL, 5, 0), scattered(NOMINAL, 5, 2)
    kept = scattered(NOMINAL, 5, 2, {spread.label})
    assert kept[spread.group][spread.name] == made[spread.group][spread.name]
    kept[spread.group][spread.name] = changed[spread.group][spread.name]
    assert kept == changed


def test_what_no_day_changes_cannot_be_steady() -> None:
    assert steady("plant.mu1, plant.mu2,") == {"plant.mu1", "plant.mu2"}
    with pytest.raises(InputError, match=r"plant\.theta1_rad is nothing that a day changes"):
        steady(["plant.mu1", "plant.theta1_rad"])
