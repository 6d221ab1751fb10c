"""A bought device takes a node's place: other file, other objects, other units."""

import math
from pathlib import Path

import pytest

import eds
from eds.bench import bench_network
from eds.device_mapping import KneeMapping, SensorMapping, ServoMapping
from eds.dictionary import key
from eds.files import check
from parameters import InputError, from_table

VENDOR = str(Path(__file__).with_name("vendor_drive.eds"))
COUNT = 2.0 * math.pi / 524_288
"""The vendor's drive counts increments of a 19-bit encoder at the knee."""


def knee(**changes):
    return {eds.KNEE: KneeMapping(**{"file": VENDOR, "position": "3010", "position_scale": COUNT, **changes})}


def test_a_bought_drive_is_read_mapped_and_scaled():
    wire = eds.wire(eds.Network(), knee())
    assert wire.nodes[eds.KNEE].dictionary.entries[key(0x60C2, 2)].initial == -3
    plan = wire.tpdo[0x182]
    assert plan.keys == (key(0x6041), key(0x3010))
    assert plan.unpack_si(plan.pack(0x27, -131_072)) == pytest.approx((0x27, -math.pi / 2))
    assert wire.targets.unpack(wire.targets.pack_si(0.001, math.pi)) == (1000, 262_144)


def test_its_set_up_leaves_out_only_what_is_optional():
    writes = eds.wire(eds.Network(), knee()).setup(eds.KNEE)
    assert not {0x1006, 0x1015} & {index for index, *_ in writes}
    assert (0x1016, 1, 127 << 16 | 250) in writes
    assert [value for index, sub, value in writes if (index, sub) == (0x1A00, 2)] == [0x30100020]


def test_nothing_is_lacking_in_a_device_that_fits():
    assert bench_network.lacks(eds.Network(), {}) == []
    assert bench_network.lacks(eds.Network(), knee()) == []


def test_every_lack_is_said_at_once(tmp_path):
    path = tmp_path / "poor.eds"
    text = Path(VENDOR).read_text(encoding="cp1252")
    path.write_text(text.replace("[605E]", "[Gone]").replace("[1400Sub5]", "[Gone too]"))
    device_mappings = knee(file=str(path))
    assert [sentence.split(",")[0] for sentence in bench_network.lacks(eds.Network(), device_mappings)] == [
        f"{path}: no object 1400:05", f"{path}: no object 605E:00"]
    with pytest.raises(InputError, match="1400:05"):
        eds.wire(eds.Network(), device_mappings).setup(eds.KNEE)
    unready, unknown = bench_network.lacks(eds.Network(), knee(position="6060", target="9999"))
    assert "6060 Mode" in unready
    assert "no object 9999" in unknown


@pytest.mark.parametrize(("fitting", "said"), [
    (KneeMapping(file=VENDOR), "unit of 6064 .position. is not declared; give position_scale"),
    (KneeMapping(file=VENDOR, position="9999"), "no object 9999, which should be the position"),
    (KneeMapping(file=VENDOR, position="here", position_scale=COUNT), "no object here"),
    (KneeMapping(file=VENDOR, statusword="6060"), "6060 Mode, which should be the statusword, has PDOMapping=0"),
    (KneeMapping(file=VENDOR, target="6064", position_scale=COUNT), "should be the target.*AccessType=ro"),
])
def test_a_part_that_nobody_can_play_is_refused(fitting, said):
    with pytest.raises(InputError, match=said):
        eds.wire(eds.Network(), {eds.KNEE: fitting})


def test_a_servo_that_cannot_watch_the_tension_takes_none():
    wire = eds.wire(eds.Network(), {eds.SERVO: ServoMapping(tension="")})
    assert len(wire.pdos(eds.SERVO)) == 3


@pytest.mark.parametrize("device_mappings", [
    {eds.START: SensorMapping(value="9130:01")},
    {eds.START: SensorMapping(value_scale=0.001)},
    {eds.SERVO: ServoMapping(tension_scale=0.1)},
])
def test_a_servo_never_reads_the_tension_in_another_unit(device_mappings):
    wire = eds.wire(eds.Network(), device_mappings)
    with pytest.raises(InputError, match=r"tension. counts .* START sends .* make them agree"):
        wire.setup(eds.SERVO)


def test_device_mappings_are_configuration():
    fitting = from_table(KneeMapping, {"file": VENDOR, "position": "3010"}, where="bench.toml [knee]")
    assert fitting.position == "3010"
    with pytest.raises(InputError, match="did you mean position"):
        from_table(KneeMapping, {"positon": "3010"}, where="bench.toml [knee]")


def test_the_check_reads_a_vendors_manner_without_complaint():
    assert check.findings(VENDOR) == []
