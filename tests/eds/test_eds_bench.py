"""The bench's wire: identifiers, plans, scales, and set-up lists in the standard's order."""

import math

import pytest

import eds
from eds import cia301, scale_factors
from eds.bench import bench_network
from eds.bench.bench_network import Network
from eds.datatype import DataType
from eds.device_mapping import KneeMapping, ServoMapping
from eds.dictionary import key
from parameters import InputError, checked, template

INVALID = cia301.COB_ID_INVALID


@pytest.fixture(scope="module")
def wire():
    return eds.wire(Network())


def layout(plan):
    return plan.cob_id, plan.size, [f"{k >> 8:04X}" for k in plan.keys]


def test_identifiers_and_plans_are_those_of_the_design(wire):
    assert [layout(plan) for plan in wire.tpdo.values()] == [
        (0x181, 8, ["6041", "6064", "6077"]), (0x182, 6, ["6041", "6064"]), (0x183, 2, ["7130"]),
        (0x184, 2, ["7130"]),
    ]
    assert layout(wire.targets) == (0x201, 8, ["607A", "607A"])
    assert layout(wire.controlwords) == (0x301, 4, ["6040", "6040"])
    assert wire.period_ns == 1_000_000


def test_plans_speak_si(wire):
    servo, knee, start = (wire.tpdo[0x180 + node] for node in (eds.SERVO, eds.KNEE, eds.START))
    assert servo.unpack_si(servo.pack(0x27, 123_456, 50)) == pytest.approx((0x27, 0.123456, 0.1))
    assert knee.unpack_si(knee.pack(0x27, -90_000)) == pytest.approx((0x27, -math.pi / 2))
    assert start.unpack_si(start.pack(4012)) == pytest.approx((40.12,))
    assert wire.targets.unpack(wire.targets.pack_si(0.01, math.radians(-28.44))) == (10_000, -28_440)


def test_units_come_from_the_devices_own_objects(wire):
    servo, knee, start = (wire.nodes[node].dictionary for node in (eds.SERVO, eds.KNEE, eds.START))
    assert scale_factors.position_unit(servo) == 1e-6
    assert scale_factors.position_unit(knee) == pytest.approx(math.radians(1e-3))
    assert scale_factors.velocity_unit(knee) == pytest.approx(math.radians(1e-3))
    assert scale_factors.drum_radius_m(servo) == pytest.approx(0.020, rel=1e-6)
    assert scale_factors.torque_unit(servo) / scale_factors.drum_radius_m(servo) == pytest.approx(0.1, rel=1e-6)
    assert scale_factors.gear_ratio(knee) == 20
    assert scale_factors.increments_per_unit(knee) == pytest.approx(4000 * 20 / 360_000)
    assert scale_factors.increments_per_unit(servo) == pytest.approx(131_072 * 10 / 1_256_637)
    assert scale_factors.process_value_unit(start) == 0.01


def apply(dictionary, writes):
    """Play writes on a dictionary as a strict device would; returns the values it ends with."""
    values = {at: entry.initial for at, entry in dictionary.entries.items()}
    for index, sub, value in writes:
        entry = dictionary.entries[key(index, sub)]
        assert entry.writable, f"{index:04X}:{sub:02X}"
        assert entry.low is None or value >= entry.low
        assert entry.high is None or value <= entry.high
        assert entry.data_type.low <= value <= entry.data_type.high
        base = index & ~0x200
        if index & ~0x3FF in (0x1600 & ~0x3FF, 0x1A00 & ~0x3FF) and index & 0x200:
            assert values[key(base, 1)] & INVALID, "a map changes only while its PDO is invalid"
            assert sub == 0 or values[key(index)] == 0, "entries change only while the map is empty"
        if base == index and 0x1400 <= index < 0x1C00 and sub == 1:
            assert value & INVALID or values[key(index, 1)] & INVALID, "an identifier changes only while it is invalid"
        values[key(index, sub)] = value
    return values


def held(values, base):
    """PDOs that are valid at the end, as (COB-ID, type, timer, words)."""
    found = []
    for index in range(base, base + 4):
        if key(index, 1) in values and not values[key(index, 1)] & INVALID:
            count = values[key(index + 0x200)]
            words = [values[key(index + 0x200, sub)] for sub in range(1, count + 1)]
            found.append((values[key(index, 1)] & 0x7FF, values[key(index, 2)], values[key(index, 5)], words))
    return found


TARGETS_MS = 100


@pytest.mark.parametrize(("node", "sent", "taken"), [
    (eds.SERVO, [(0x181, 1, 0, [0x60410010, 0x60640020, 0x60770010])], [
        (0x201, 1, TARGETS_MS, [0x607A0020, 0x00040020]), (0x301, 255, 0, [0x60400010, 0x00060010]),
        (0x183, 255, 5, [0x20110010])]),
    (eds.KNEE, [(0x182, 1, 0, [0x60410010, 0x60640020])], [
        (0x201, 1, TARGETS_MS, [0x00040020, 0x607A0020]), (0x301, 255, 0, [0x00060010, 0x60400010])]),
    (eds.START, [(0x183, 1, 0, [0x71300110])], []),
    (eds.END, [(0x184, 1, 0, [0x71300110])], []),
])
def test_set_up_leaves_a_node_with_exactly_its_pdos(wire, node, sent, taken):
    values = apply(wire.nodes[node].dictionary, wire.setup(node))
    assert held(values, bench_network.TPDO) == sent
    assert held(values, bench_network.RPDO) == taken


def test_set_up_starts_the_supervision(wire):
    for node in wire.nodes:
        values = apply(wire.nodes[node].dictionary, wire.setup(node))
        assert values[key(0x1017)] == 100
        assert values[key(0x1016, 1)] == 127 << 16 | 250
        assert values[key(0x1015)] == 1000
        assert values[key(0x1006)] == 1000


def test_the_servo_lets_go_and_the_knee_holds(wire):
    servo, knee = (apply(wire.nodes[n].dictionary, wire.setup(n)) for n in bench_network.DRIVES)
    assert (servo[key(0x605A)], servo[key(0x605E)], servo[key(0x6007)]) == (2, 0, 2)
    assert (knee[key(0x605A)], knee[key(0x605E)], knee[key(0x6007)]) == (2, 0, 3)
    assert servo[key(0x6060)] == knee[key(0x6060)] == 8


@pytest.mark.parametrize(("rate", "expected"), [
    (1000, (1, -3)), (500, (2, -3)), (100, (1, -2)), (400, (25, -4)), (10, (1, -1)),
])
def test_interpolation_period_is_exact(rate, expected):
    wire = eds.wire(Network(rate_hz=rate))
    writes = {(index, sub): value for index, sub, value in wire.setup(eds.SERVO)}
    assert (writes[0x60C2, 1], writes[0x60C2, 2]) == expected
    assert expected[0] * 10 ** (6 + expected[1]) == 1_000_000 // rate


@pytest.mark.parametrize(("network", "said"), [
    (Network(rate_hz=300), "whole number of microseconds"),
    (Network(rate_hz=64), "0x60C2"),
    (Network(bitrate=900_000), "choose one of them"),
])
def test_what_the_objects_cannot_express_is_refused(network, said):
    with pytest.raises(InputError, match=said):
        eds.wire(network)


def test_parameters_keep_their_bounds_and_describe_themselves():
    with pytest.raises(InputError, match="rate_hz = 5000"):
        checked(Network(rate_hz=5000), where="bench.toml [network]")
    assert "heartbeat_timeout_ms = 250" in template(Network, "network")


def test_another_device_may_take_a_nodes_place(tmp_path):
    text = eds.packaged("knee_drive").read_text()
    other = tmp_path / "other.eds"
    other.write_text(text.replace("DefaultValue=0xFD410000", "DefaultValue=0xFE410000"))
    wire = eds.wire(Network(), {eds.KNEE: KneeMapping(file=str(other))})
    assert wire.nodes[eds.KNEE].dictionary.path == str(other)
    assert wire.targets.unpack(wire.targets.pack_si(0.0, math.radians(-20.0))) == (0, -2000)


@pytest.mark.parametrize(("cut", "said"), [("[1402sub5]", "1402:05"), ("[1601sub2]", "1601:02"), ("[607A]", "607A")])
def test_a_device_that_lacks_an_object_is_named(tmp_path, cut, said):
    path = tmp_path / "lacking.eds"
    path.write_text(eds.packaged("servo_drive").read_text().replace(cut, "[Gone]"))
    with pytest.raises(InputError, match=rf"lacking.eds.*{said}"):
        eds.wire(Network(), {eds.SERVO: ServoMapping(file=str(path))}).setup(eds.SERVO)


def test_a_unit_that_nobody_knows_is_refused(tmp_path):
    path = tmp_path / "unit.eds"
    text = eds.packaged("knee_drive").read_text()
    path.write_text(text.replace("DefaultValue=0xFD410000", "DefaultValue=0xFD990000"))
    with pytest.raises(InputError, match="60A8 = FD990000h"):
        eds.wire(Network(), {eds.KNEE: KneeMapping(file=str(path))})


def test_set_up_values_are_whole_numbers(wire):
    for node in wire.nodes:
        for index, sub, value in wire.setup(node):
            assert isinstance(value, int)
            assert wire.nodes[node].dictionary.entries[key(index, sub)].data_type is not DataType.REAL32
