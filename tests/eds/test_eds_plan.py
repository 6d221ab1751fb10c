"""A compiled plan gives the bytes that canopen's PdoMap gives, for every mappable variable and any map."""

import struct

import canopen
import pytest
from canopen.objectdictionary import ODVariable
from canopen.pdo import TPDO
from canopen.pdo.base import PdoMap
from hypothesis import given
from hypothesis import strategies as st

from eds import dictionary
from eds.datatype import DataType
from eds.dictionary import Dictionary, Entry, key
from eds.pdo_plan import JOINED_BYTES, JoinedUnpacker, compile_plan, overlay
from parameters import InputError

NODE = 5
FILES = {name: dictionary.read(dictionary.packaged(name), NODE) for name in dictionary.PACKAGED}
PEERS = {name: canopen.RemoteNode(NODE, canopen.import_od(str(dictionary.packaged(name)), NODE)) for name in FILES}
DUMMIES = [DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32, DataType.UNSIGNED8, DataType.UNSIGNED16,
           DataType.UNSIGNED32]


def words(device):
    mappable = [entry.key << 8 | entry.data_type.bits for entry in device.entries.values() if entry.mappable]
    return mappable + [kind << 16 | kind.bits for kind in DUMMIES]


def raw_values(device, word):
    kind = device.entries[word >> 8].data_type
    return st.floats(width=32, allow_nan=False) if kind.real else st.integers(kind.low, kind.high)


@st.composite
def maps(draw):
    name = draw(st.sampled_from(sorted(FILES)))
    chosen, bits = [], 0
    for word in draw(st.lists(st.sampled_from(words(FILES[name])), max_size=12)):
        if bits + (word & 0xFF) <= 64:
            chosen.append(word)
            bits += word & 0xFF
    values = tuple(draw(raw_values(FILES[name], word)) for word in chosen if word >> 16 >= 0x1000)
    return name, chosen, values


def by_canopen(peer, chosen, values):
    pdo = PdoMap(peer.tpdo, None, None)
    rest = iter(values)
    for word in chosen:
        pdo.add_variable(word >> 16, word >> 8 & 0xFF, word & 0xFF)
    for word, variable in zip(chosen, pdo.map, strict=True):
        if word >> 16 >= 0x1000:
            variable.raw = next(rest)
    return bytes(pdo.data), tuple(v.raw for w, v in zip(chosen, pdo.map, strict=True) if w >> 16 >= 0x1000)


@given(st.lists(st.tuples(maps(), st.integers(-2**63, 2**63 - 1)), min_size=1, max_size=4))
def test_frames_decoded_in_one_call_say_what_each_says_alone(cases):
    plans, stamps, buffer = [], [], b""
    for (name, chosen, values), stamp in cases:
        scales = {word >> 8: 0.25 for word in chosen[::2]}
        plans.append(compile_plan(FILES[name], chosen, 0x180, scales))
        stamps.append(stamp)
        buffer += struct.pack("<q8s", stamp, plans[-1].pack(*values))
    assert len(buffer) == JOINED_BYTES * len(plans)
    together = JoinedUnpacker(plans)
    times, found = together.unpack_si(memoryview(buffer))
    frames = [buffer[16 * n + 8:16 * n + 16] for n in range(len(plans))]
    alone = [plan.unpack(frame) if plan.struct else (frame,) for plan, frame in zip(plans, frames, strict=True)]
    assert together.unpack(buffer) == tuple(
        value for stamp, values in zip(stamps, alone, strict=True) for value in (stamp, *values))
    assert times == tuple(stamps)
    assert found == tuple(plan.unpack_si(frame) for plan, frame in zip(plans, frames, strict=True))


@given(maps())
def test_any_map_packs_and_unpacks_as_canopen_does(case):
    name, chosen, values = case
    plan = compile_plan(FILES[name], chosen, 0x181)
    data, read_back = by_canopen(PEERS[name], chosen, values)
    assert plan.pack(*values) == data
    assert plan.unpack(data) == read_back == values
    assert plan.size == len(data)
    assert plan.struct is not None


@pytest.mark.parametrize("name", sorted(FILES))
def test_every_mappable_variable_alone_packs_as_canopen_does(name):
    for word in words(FILES[name])[: -len(DUMMIES)]:
        kind = FILES[name].entries[word >> 8].data_type
        for value in (0, kind.low, kind.high) if kind.integer else (0.0, -1.5, 200.0):
            assert compile_plan(FILES[name], [word], 0x181).pack(value) == by_canopen(PEERS[name], [word], [value])[0]


ODD = {DataType.BOOLEAN: 1, DataType.INTEGER24: 24, DataType.UNSIGNED24: 24, DataType.UNSIGNED8: 8,
       DataType.INTEGER16: 16, DataType.UNSIGNED40: 40, DataType.REAL32: 32}


def odd_dictionary():
    entries = [Entry(0x3000 + kind, 0, kind.name, kind, "rw", 0, None, None, True) for kind in ODD]
    return Dictionary("odd.eds", {e.key: e for e in entries}, {}, frozenset({1, 2, 5}))


@st.composite
def odd_maps(draw):
    chosen, values, bits = [], [], 0
    for kind in draw(st.lists(st.sampled_from([*ODD, None]), max_size=12)):
        width = ODD[kind] if kind else 1
        if bits + width > 64:
            continue
        bits += width
        chosen.append((0x3000 + kind) << 16 | width if kind else 0x0001_00_01)
        if kind:
            values.append(draw(st.floats(width=32, allow_nan=False) if kind.real else st.integers(kind.low, kind.high)))
    return chosen, values


@given(odd_maps())
def test_bit_packed_maps_lie_least_significant_bit_first(case):
    """The reference is written out from CiA 301, 7.4.7: object after object, each from its least bit."""
    chosen, values = case
    plan, text, rest = compile_plan(odd_dictionary(), chosen, 0x181), "", iter(values)
    for word in chosen:
        bits, value = word & 0xFF, next(rest) if word >> 16 >= 0x1000 else 0
        if isinstance(value, float):
            value = int.from_bytes(struct.pack("<f", value), "little")
        text = format(value & (1 << bits) - 1, f"0{bits}b") + text
    data = int(text or "0", 2).to_bytes((len(text) + 7) // 8, "little")
    assert plan.pack(*values) == data
    assert plan.unpack(data) == tuple(values)


@given(st.integers(0, 255), st.lists(st.integers(0, 1), max_size=8))
def test_bits_after_a_byte_pack_as_canopen_does(byte, flags):
    """canopen writes a bit through the struct of a whole byte: only whole bytes may stand before its bits."""
    od = canopen.ObjectDictionary()
    for kind in (DataType.BOOLEAN, DataType.UNSIGNED8):
        variable = ODVariable(kind.name, 0x3000 + kind)
        variable.data_type = int(kind)
        od.add_object(variable)
    kinds = [DataType.UNSIGNED8] + [DataType.BOOLEAN] * len(flags)
    pdo = PdoMap(TPDO(canopen.RemoteNode(NODE, od)), None, None)
    for kind in kinds:
        pdo.add_variable(0x3000 + kind, 0, ODD[kind])
    for value, variable in zip((byte, *flags), pdo.map, strict=True):
        variable.raw = value
    plan = compile_plan(odd_dictionary(), [(0x3000 + kind) << 16 | ODD[kind] for kind in kinds], 0x181)
    assert plan.pack(byte, *flags) == bytes(pdo.data)


def test_a_frame_too_long_is_read_as_far_as_it_is_mapped_and_a_short_one_is_refused():
    plan = compile_plan(FILES["servo_drive"], [0x60410010, 0x60640020], 0x181)
    assert plan.unpack(plan.pack(7, -9) + b"\xff\xff") == (7, -9)
    with pytest.raises(struct.error):
        plan.unpack(b"\x00" * 5)
    bits = compile_plan(odd_dictionary(), [0x3001_00_01, 0x3010_00_18], 0x181)
    assert bits.unpack(bits.pack(1, -2) + b"\xff") == (1, -2)
    with pytest.raises(struct.error):
        bits.unpack(b"\x00\x00\x00")
    for wrong in ((1,), (1, 1 << 23), (2, 0)):
        with pytest.raises(struct.error):
            bits.pack(*wrong)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_si_values_are_rounded_and_held_at_the_ends_of_the_type(position, torque):
    scales = {key(0x6064): 1e-6, key(0x6077): 0.002}
    plan = compile_plan(FILES["servo_drive"], [0x60640020, 0x60770010], 0x181, scales)
    raw_position, raw_torque = plan.unpack(plan.pack_si(position, torque))
    assert raw_position == min(max(round(position / 1e-6), -2**31), 2**31 - 1)
    assert raw_torque == min(max(round(torque / 0.002), -2**15), 2**15 - 1)
    assert plan.unpack_si(plan.pack(raw_position, raw_torque)) == (raw_position * 1e-6, raw_torque * 0.002)


def test_a_value_that_is_no_number_is_never_packed():
    plan = compile_plan(FILES["servo_drive"], [0x60640020], 0x181)
    with pytest.raises(ValueError, match="NaN"):
        plan.pack_si(float("nan"))
    assert plan.unpack(plan.pack_si(float("-inf"))) == (-2**31,)


def test_a_map_of_dummies_or_reals_or_nothing_converts_too():
    assert compile_plan(FILES["servo_drive"], [], 0x181).pack_si() == b""
    assert compile_plan(FILES["servo_drive"], [0x00060010], 0x181).unpack_si(b"ab") == ()
    real = compile_plan(FILES["tension_sensor"], [0x61300120], 0x181, {key(0x6130, 1): 0.5})
    assert real.unpack_si(real.pack_si(1.25)) == (1.25,)


@pytest.mark.parametrize(("mapping", "said"), [
    ([0x60640020, 0x60640020, 0x60410010], "80 bits"),
    ([0x60640010], "32 bits, not 16"),
    ([0x60840020], "PDOMapping=0"),
    ([0x99990020], "no object 9999:00"),
    ([0x00010001], "no such dummy"),
    ([0x00040010], "no such dummy"),
    ([0x00FF0010], "no such dummy"),
    ([0x10080040], "PDOMapping=0"),
])
def test_a_map_that_the_device_would_refuse_is_refused_with_its_reason(mapping, said):
    with pytest.raises(InputError, match=said):
        compile_plan(FILES["servo_drive"], mapping, 0x181)


def test_frames_shared_by_two_receivers_overlay_their_dummies():
    servo = compile_plan(FILES["servo_drive"], [0x607A0020, 0x00040020], 0x201)
    knee = compile_plan(FILES["knee_drive"], [0x00040020, 0x607A0020], 0x201)
    both = overlay([servo, knee], 0x201)
    data = both.pack(-5, 70_000)
    assert servo.unpack(data) == (-5,)
    assert knee.unpack(data) == (70_000,)
    with pytest.raises(InputError, match="do not line up"):
        overlay([servo, servo], 0x201)


def test_a_plan_knows_its_mapping_words_and_says_them():
    words = [0x60410010, 0x00060010, 0x60640020]
    plan = compile_plan(FILES["servo_drive"], words, 0x181)
    assert [f.word for f in plan.fields] == words
    assert plan.keys == (key(0x6041), key(0x6064))
    assert repr(plan) == "PdoPlan(181h, 6041:00/16 0006:00/16 6064:00/32)"
