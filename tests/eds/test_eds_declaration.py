"""Declared benches: the packaged ones give a wire that holds, and a declaration that does not add up is refused."""

import copy
import tomllib

import pytest

import eds
from eds.bench import bench_network, bus_load
from eds.bench.bench_network import Network
from eds.declaration import as_json, declared, from_json, packaged, text_of
from parameters import InputError

SHAPES = {"bench": (1000, 4), "bench_start_only": (1000, 3), "bench_no_knee_drive": (1000, 4),
          "bench_antagonists": (500, 7), "bench_two_legs": (500, 8)}


def wire_of(name: str, rate_hz: int) -> eds.WireLayout:
    return eds.wire(Network(rate_hz=rate_hz, bench=packaged(name)))


@pytest.mark.parametrize("name", SHAPES)
def test_a_packaged_bench_keeps_its_deadline_at_its_rate(name: str) -> None:
    rate, nodes = SHAPES[name]
    wire = wire_of(name, rate)
    found = bus_load.refuse(wire)
    assert len(wire.nodes) == len(wire.tpdo) == nodes
    assert found.load_percent <= bus_load.LOAD_GOAL_PERCENT
    assert [list(wire.missing(node)) for node in wire.nodes] == [[]] * nodes
    assert len({stream.can_id for stream, _ in found.responses}) == len(found.responses)


@pytest.mark.parametrize("name", SHAPES)
def test_a_bench_is_read_back_from_its_one_text(name: str) -> None:
    assert from_json(as_json(packaged(name)), where="a row") == packaged(name)


@pytest.mark.parametrize("name", ["bench_antagonists", "bench_two_legs"])
def test_a_bench_that_does_not_fit_1_khz_is_refused_with_the_rate_that_fits(name: str) -> None:
    wire = wire_of(name, 1000)
    assert bus_load.rate_that_fits(wire) == 500
    with pytest.raises(InputError, match=r"rate_hz = 1000 .*lower rate_hz to 500,"):
        bus_load.refuse(wire)


def test_eight_bytes_of_targets_go_into_a_frame_and_the_rest_into_the_next() -> None:
    wire = wire_of("bench_two_legs", 500)
    assert [(plan.cob_id, plan.size) for plan in wire.target_frames] == [(0x201, 8), (0x205, 8)]
    assert [(plan.cob_id, plan.size) for plan in wire.controlword_frames] == [(0x301, 8)]
    assert [[f"{word:08X}" for word in pdo.mapping] for pdo in wire.pdos(6) if pdo.base == bench_network.RPDO] == [
        ["00040020", "607A0020"], ["00060010", "00060010", "00060010", "60400010"]]


def test_a_joint_without_a_drive_is_asked_in_the_frame_of_targets() -> None:
    wire, driven = wire_of("bench_no_knee_drive", 1000), wire_of("bench", 1000)
    assert wire.targets.pack_si(0.01, -0.5) == driven.targets.pack_si(0.01, -0.5)
    assert [[f"{word:08X}" for word in pdo.mapping] for pdo in wire.pdos(1) if pdo.base == bench_network.RPDO][:2] == [
        ["607A0020", "00040020"], ["60400010"]]
    assert [pdo.base for pdo in wire.pdos(2)] == [bench_network.TPDO]


def test_asked_angles_that_do_not_fit_go_into_a_frame_of_their_own() -> None:
    tables = tomllib.loads(text_of("bench_antagonists"))
    next(row for row in tables["device"] if row["name"] == "knee")["type"] = "joint_encoder"
    tables["joint"] = [{"name": "knee", "measured_by": "knee"}]
    wire = eds.wire(Network(rate_hz=500, bench=declared(tables, where="bench.toml")))
    assert [(plan.cob_id, plan.size) for plan in wire.target_frames] == [(0x201, 8), (0x202, 4)]


def test_each_rope_drive_watches_the_start_of_its_own_path() -> None:
    wire = wire_of("bench_antagonists", 500)
    assert {node: pdo.cob_id for node in (1, 5) for pdo in wire.pdos(node) if pdo.number == 3} == {1: 0x183, 5: 0x186}


def test_a_path_without_start_is_not_watched_by_its_drive() -> None:
    tables = tomllib.loads(text_of("bench"))
    del tables["force_path"][0]["start"]
    tables["device"] = [row for row in tables["device"] if row["name"] != "start"]
    wire = eds.wire(Network(bench=declared(tables, where="bench.toml")))
    assert [pdo.cob_id for pdo in wire.pdos(1) if pdo.base == bench_network.RPDO] == [0x201, 0x301]


WRONG = {
    "a second node 1": ({"device": {"node_id": 1}}, "node_id 1 is given twice"),
    "the master's id": ({"device": {"node_id": 127}}, "node_id = 127 is no whole number from 1 to 126"),
    "a boolean id": ({"device": {"node_id": True}}, "node_id = True"),
    "a type": ({"device": {"type": "camera"}}, "type = 'camera' is unknown; expected one of rope_drive"),
    "a key": ({"device": {"colour": "red"}}, "unknown key colour"),
    "a name": ({"device": {"name": "left knee"}}, "name = 'left knee' is no name"),
    "the master's name": ({"device": {"name": "master"}}, "master is taken"),
    "a joint without a device": ({"joint": {"driven_by": ""}}, "neither driven_by nor measured_by"),
    "a joint with two devices": ({"joint": {"measured_by": "knee"}}, "both driven_by and measured_by"),
    "a joint's encoder": ({"joint": {"driven_by": "", "measured_by": "knee"}}, "which is no joint_encoder"),
    "a joint's drive": ({"joint": {"driven_by": "servo"}}, "driven_by = 'servo', which is no joint_drive"),
    "a path's joint": ({"force_path": {"joint": "hip"}}, "joint = 'hip', which no"),
    "a load cell": ({"force_path": {"start": "knee"}}, "start = 'knee', which is no load_cell"),
    "one load cell twice": ({"force_path": {"start": "end"}}, "place of the device end is given twice"),
    "no load cell": ({"force_path": {"start": "", "end": ""}}, "neither start nor end"),
    "a number": ({"force_path": {"start": 3}}, "start = 3 is not a text"),
    "a device without a place": ({"force_path": {"end": ""}}, "names the device end"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_declaration_that_does_not_add_up_is_refused(wrong: str) -> None:
    tables = copy.deepcopy(tomllib.loads(text_of("bench")))
    changed, said = WRONG[wrong]
    for table, row in changed.items():
        tables[table][-1] |= row
    with pytest.raises(InputError, match=said) as raised:
        declared(tables, where="mine.toml")
    assert str(raised.value).startswith("mine.toml")


@pytest.mark.parametrize("table", ["device", "joint", "force_path"])
def test_a_declaration_is_whole_or_absent(table: str) -> None:
    tables = tomllib.loads(text_of("bench"))
    with pytest.raises(InputError, match=rf"no \[\[{table}\]\]"):
        declared({**tables, table: []}, where="mine.toml")
    with pytest.raises(InputError, match="no array of tables"):
        declared({**tables, table: {"name": "one"}}, where="mine.toml")
