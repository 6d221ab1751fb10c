"""The four devices themselves, profiles and all: any write to any object, any order of services, while they run."""

from __future__ import annotations

import random
import struct

import pytest

from eds.bench.bench_network import Network, wire
from eds.cia301 import Abort, Frame, NmtCommand
from eds.cia402 import state_of
from nodes import Drive, TensionSensor, build

WIRE = wire(Network())
STEP_NS = 100_000
FOR_NS = 3_000_000_000
WORDS = [n.to_bytes(4, "little") for n in (0, 1, 2, 6, 7, 15, 128, 255, 0x7FFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)]
WORDS += [struct.pack("<f", n) for n in (-1.0, 1e-38, 1e-45, 1e38, -3e38)] + [b"save", b"load", b"zero"]
COMMANDS = [NmtCommand.START] * 4 + [NmtCommand.ENTER_PRE_OPERATIONAL, NmtCommand.STOP, NmtCommand.RESET_NODE,
                                     NmtCommand.RESET_COMMUNICATION]


def any_frame(chance: random.Random, node_id: int, entries: list[int], heard: list[int]) -> Frame:
    """Mostly writes of the right length, so that they reach the profile; then SYNC, NMT, PDOs of any length."""
    kind = chance.random()
    if kind < 0.7:
        at = chance.choice(entries)
        size = WIRE.nodes[node_id].dictionary.entries[at].data_type.size
        write = 0x23 | (4 - size) << 2 if 0 < size <= 4 else 0x23
        head = chance.choice([write, write, write, 0x40, 0x80, chance.randrange(256)])
        word = chance.choice([*WORDS, chance.randbytes(4)])
        return Frame(0x600 + node_id, bytes((head, at >> 8 & 0xFF, at >> 16, at & 0xFF)) + word)
    if kind < 0.85:
        return Frame(0x80)
    if kind < 0.9:
        return Frame(0, bytes((chance.choice(COMMANDS), node_id)))
    return Frame(chance.choice(heard), chance.randbytes(chance.choice([2, 4, 8, chance.randrange(9)])))


def felt(application: Drive | TensionSensor, chance: random.Random, now_ns: int) -> None:
    """Let the drive tick, the converter convert, whatever they were told."""
    if isinstance(application, Drive):
        assert abs(application.tick(now_ns, chance.uniform(-0.1, 0.1), chance.uniform(-1.0, 1.0))) < 1e6
    else:
        application.sample(now_ns, chance.randrange(-(1 << 23), 1 << 23), chance.choice([0, 0, 0, 1]))


@pytest.mark.parametrize("node_id", sorted(WIRE.nodes))
def test_nothing_brings_a_device_down(node_id: int) -> None:
    chance = random.Random(node_id)
    device, application = build(node_id, WIRE)
    device.power_on(0)
    entries = sorted(WIRE.nodes[node_id].dictionary.entries)
    for now_ns in range(0, FOR_NS, STEP_NS):
        device.receive(any_frame(chance, node_id, entries, sorted(device.filters)), now_ns)
        due_ns = device.next_ns()
        if due_ns is not None and due_ns <= now_ns:
            device.poll(now_ns)
        if now_ns % 500_000 == 0:
            felt(application, chance, now_ns)
        for frame in device.outbox:
            if frame.can_id == 0x580 + node_id and frame.data[0] == 0x80:
                assert int.from_bytes(frame.data[4:], "little") in set(Abort)
        device.outbox.clear()
    restored(device, node_id, FOR_NS)


def restored(device, node_id: int, now_ns: int) -> None:  # type: ignore[no-untyped-def]
    """Defaults and a reset make it as good as new: it boots, answers, and sends its PDO with the next SYNC."""
    for frame in (Frame(0, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 0))),
                  Frame(0x600 + node_id, b"\x80" + bytes(7)),
                  Frame(0x600 + node_id, b"\x23\x11\x10\x01load"),
                  Frame(0, bytes((NmtCommand.RESET_NODE, 0)))):
        device.receive(frame, now_ns)
    device.poll(now_ns)
    assert Frame(0x700 + node_id, b"\0") in device.outbox
    device.outbox.clear()
    read = Frame(0x600 + node_id, b"\x40\x00\x10" + bytes(5))
    for frame in (Frame(0, bytes((NmtCommand.START, 0))), Frame(0x80), read):
        device.receive(frame, now_ns)
    sent = {frame.can_id: frame.data for frame in device.outbox}
    assert sent[0x580 + node_id][0] == 0x43
    assert 0x180 + node_id in sent
    if node_id < 3:
        assert state_of(int.from_bytes(sent[0x180 + node_id][:2], "little")) is not None
