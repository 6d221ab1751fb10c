"""The bench as it is used: real devices and plant behind `can.Bus(interface="bowden")`."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

import eds
from eds.bench.bench_network import END, KNEE, SERVO, START
from eds.cia301 import Frame
from trial import read
from virtual_bus.bus import BowdenBus
from virtual_bus.wire.bits import frame_bits
from virtual_bus.wire.faults import Fault

NETWORK = eds.Network()
SYNC = can.Message(arbitration_id=0x080, is_extended_id=False)
CHANNELS = (f"bench {n}" for n in itertools.count())


def send(bus: Any, can_id: int, data: bytes) -> None:
    bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


def download(bus: Any, node_id: int, index: int, subindex: int, value: int, size: int) -> None:
    """Write one object by expedited SDO and wait for the answer."""
    head = bytes([0x23 | (4 - size) << 2]) + index.to_bytes(2, "little") + bytes([subindex])
    send(bus, 0x600 + node_id, head + value.to_bytes(4, "little", signed=value < 0))
    while (answer := bus.recv(0.1)) is not None:
        if answer.arbitration_id == 0x580 + node_id:
            assert answer.data[0] == 0x60, f"{index:04X}:{subindex:02X} refused: {answer.data.hex()}"
            return
    raise AssertionError(f"node {node_id} does not answer")


def operational(bus: Any) -> None:
    """Configure every node as the agreement says and start all."""
    wire = eds.wire(NETWORK)
    while bus.recv(0.01) is not None:
        pass
    for node_id, node in wire.nodes.items():
        for index, subindex, value in wire.setup(node_id):
            assert isinstance(value, int)
            size = node.dictionary.entries[eds.key(index, subindex)].data_type.bits // 8
            download(bus, node_id, index, subindex, value, size)
    send(bus, 0x000, b"\x01\x00")
    bus.recv(0.001)


@pytest.fixture
def channel() -> str:
    return next(CHANNELS)


@pytest.fixture
def bus(channel: str) -> Iterator[Any]:
    with can.Bus(interface="bowden", channel=channel, serial=3, seed=5) as opened:
        yield opened


def cycles(bus: Any, count: int) -> list[list[can.Message]]:
    """Start SYNC and return the frames of `count` whole cycles, each beginning with its SYNC."""
    bus.send_periodic(SYNC, NETWORK.period_us / 1e6)
    found: list[list[can.Message]] = []
    while len(found) <= count:
        message = bus.recv(0.1)
        if message.arbitration_id == 0x080:
            found.append([])
        if found:
            found[-1].append(message)
    return found[:count]


def test_every_node_boots_once_lowest_identifier_first(bus: Any) -> None:
    seen = list(iter(lambda: bus.recv(0.05), None))
    assert [(m.arbitration_id, bytes(m.data)) for m in seen] == [(0x700 + n, b"\0") for n in (1, 2, 3, 4)]


def test_a_cycle_is_sync_and_four_answers_after_the_stated_turnaround(bus: Any) -> None:
    operational(bus)
    for cycle in cycles(bus, 20):
        ids = [m.arbitration_id for m in cycle if m.arbitration_id < 0x700]
        assert ids == [0x080, 0x181, 0x182, 0x183, 0x184]
        sync, servo = cycle[0], cycle[1]
        assert (sync.time_ns - frame_bits(Frame(0x080)) * 1_000) % 1_000_000 == 0
        bits = frame_bits(Frame(servo.arbitration_id, bytes(servo.data)))
        assert servo.time_ns == sync.time_ns + NETWORK.node_turnaround_us * 1_000 + bits * 1_000


def test_sensors_feel_the_plant_through_the_converter(bus: Any) -> None:
    """The rope is slack: what START and END say is offset and noise, and not always the same."""
    operational(bus)
    plan = eds.wire(NETWORK).tpdo
    for can_id in (0x183, 0x184):
        tensions = [plan[can_id].unpack_si(m.data)[0] for c in cycles(bus, 50) for m in c if m.arbitration_id == can_id]
        bus.stop_all_periodic_tasks()
        assert max(map(abs, tensions)) < 2.0
        assert len(set(tensions)) > 5


def frames_of(channel: str, **options: Any) -> list[tuple[int, int, bytes]]:
    with BowdenBus(channel, **options) as bus, BowdenBus(channel) as tap:
        operational(bus)
        cycles(bus, 30)
        return [(m.time_ns, m.arbitration_id, bytes(m.data)) for m in iter(lambda: tap.recv(0), None)]


def test_the_truth_is_written_beside_and_moves_nothing(channel: str, tmp_path: Path) -> None:
    path = tmp_path / "trial.truth.mcap"
    with_truth = frames_of(channel, truth=str(path))
    assert with_truth == frames_of(channel)
    side = read.open_table(path, "/truth")
    assert side.time_ns.tolist() == [time_ns for time_ns, can_id, _ in with_truth if can_id == 0x080]
    assert {"true_start_n", "true_end_n", "true_knee_angle_rad"} <= set(side.columns)
    assert (side.units["true_end_n"], side.units["true_knee_angle_rad"]) == ("N", "rad")
    assert side.metadata["serial"] == "1"


def test_a_node_without_supply_boots_late(channel: str) -> None:
    with BowdenBus(channel, faults=[Fault("power_off", node=START, stop_s=0.02)]) as bus:
        seen = [(m.arbitration_id, m.time_ns // 1_000_000) for m in iter(lambda: bus.recv(0.05), None)]
    assert seen == [(0x701, 0), (0x702, 0), (0x704, 0), (0x703, 20)]


def test_a_device_reports_that_it_was_off_the_bus(channel: str) -> None:
    with BowdenBus(channel, faults=[Fault("disturb", node=END, start_s=0.0, stop_s=0.003)]) as bus:
        seen = [m for m in iter(lambda: bus.recv(0.05), None) if m.arbitration_id == 0x084]
    assert [bytes(m.data[:2]) for m in seen][:1] == [b"\x40\x81"]


def test_the_servo_reacts_by_itself_when_it_does_not_hear_the_tension(channel: str) -> None:
    """START is connected, and speaks, but not to the servo: its RPDO's deadline expires (EMCY 8250h)."""
    with BowdenBus(channel, faults=[Fault("deaf", node=SERVO, cob_id=0x183, start_s=0.5)]) as bus:
        operational(bus)
        assert bus.time_ns() < 500_000_000
        bus.send_periodic(SYNC, 0.001)
        emergencies = []
        while bus.time_ns() < 600_000_000:
            message = bus.recv(0.1)
            if message is not None and message.arbitration_id == 0x081:
                emergencies.append((bytes(message.data[:2]), message.time_ns))
    assert [code for code, at_ns in emergencies if at_ns > 500_000_000][:1] == [b"\x50\x82"]


PLANT = '''
from physics.plant import Outputs

class Spring:
    """Pulls with what the drum winds up."""
    def __init__(self, parameters, seed):
        self.parameters, self.seed, self.times = parameters, seed, []
    def reset(self, time_ns):
        return Outputs(0.0, 0.0, -0.5, 0.0, -0.5, 12.5, 7.5)
    def advance(self, until_ns, servo_torque_nm, knee_torque_nm):
        self.times.append(until_ns)
        assert len(self.times) < 2 or self.times[-2] < until_ns
        return self.reset(until_ns)
    def truth(self):
        return {"true_end_n": 7.5}
'''


def test_another_plant_stands_behind_the_same_nodes(
    channel: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "springs.py").write_text(PLANT)
    described = tmp_path / "springs-1.0.dist-info"
    described.mkdir()
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: springs\nVersion: 1.0\n")
    (described / "entry_points.txt").write_text("[bowden.plants]\nspring = springs:Spring\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    plan = eds.wire(NETWORK).tpdo
    with BowdenBus(channel, plant="spring", serial=0) as bus:
        operational(bus)
        last = {m.arbitration_id: m for c in cycles(bus, 20) for m in c}
    assert plan[0x183].unpack_si(last[0x183].data)[0] == pytest.approx(12.5, abs=1.0)  # noise 0.15 N rms, filtered
    assert plan[0x184].unpack_si(last[0x184].data)[0] == pytest.approx(7.5, abs=1.0)
    assert plan[0x182].unpack_si(last[0x182].data)[1] == pytest.approx(-0.5, abs=1e-3)  # one user unit: 1 mdeg


def test_a_scattered_servo_keeps_its_trim_through_a_reset(channel: str) -> None:
    """0x60FB:01 of serial 3 is not the dictionary's, before and after reset node."""
    with BowdenBus(channel, serial=3) as bus:
        first = upload(bus, SERVO, 0x60FB, 1)
        send(bus, 0x000, b"\x81\x01")
        bus.recv(0.01)
        assert upload(bus, SERVO, 0x60FB, 1) == first != 125_000
        assert upload(bus, KNEE, 0x60FB, 1) != first


def upload(bus: Any, node_id: int, index: int, subindex: int) -> int:
    send(bus, 0x600 + node_id, b"\x40" + index.to_bytes(2, "little") + bytes([subindex]) + bytes(4))
    while (answer := bus.recv(0.1)) is not None:
        if answer.arbitration_id == 0x580 + node_id:
            return int.from_bytes(answer.data[4:8], "little")
    raise AssertionError(f"node {node_id} does not answer")
