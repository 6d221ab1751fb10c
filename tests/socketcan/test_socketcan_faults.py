"""What goes wrong on a real bus, done to the kernel's: every run ends with a named reason, or goes on and counts.

The rule of this file: one bench serves all tests, so each also shows that the nodes survived the one before.
"""

from __future__ import annotations

import re
import socket
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from eds.error_frames import BUS_OFF, CONTROLLER, COUNTERS, PASSIVE_STATE, PROTOCOL
from master.network.link import Link, LinkError
from master.network.socketcan import KernelBus
from tests.socketcan import rig
from trial.mcap_file.cdr import ERROR

pytestmark = pytest.mark.guest("native", "uml", "icount")

SHORT = ("--cycles", 1, "--settle", 0, "--period", 1, "--peak", 20, "--dry-run")
ENDLESS = (*SHORT, "--cycles", 600)
"""Ten minutes of gait: such a trial ends by the fault, or fails its test."""
TARGETS = 0x201
FOREIGN = "foreign command on the bus: .*"
STARVED = r"emergency message: \w+: 0x8250, RPDO time-out"
"""ip and tc hold this guest's one processor for longer than the drives wait for targets."""
ERROR_FLAG = 0x20000000


@pytest.fixture(scope="module")
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with rig.bench(tmp_path_factory.mktemp("bench"), "vcan0", *rig.patient(tmp_path_factory.getbasetemp())):
        yield


@pytest.fixture
def shaped() -> Iterator[None]:
    """The interface's queueing discipline is put back."""
    yield
    subprocess.run(["tc", "qdisc", "del", "dev", "vcan0", "root"], check=False, stderr=subprocess.DEVNULL)


def running(folder: Path, *arguments: object) -> rig.Process:
    """A trial whose cycle runs already."""
    with KernelBus("vcan0") as watching:
        process = rig.trial(folder, "vcan0", *rig.patient(folder), *arguments)
        rig.heard(watching, TARGETS, 5)
    return process


def raw(can_id: int, data: bytes) -> None:
    """Send a frame that python-can would not."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sender:
        sender.bind(("vcan0",))
        sender.send(struct.pack("=IB3x8s", can_id, len(data), data))


def send_many(link: Link) -> None:
    for number in range(12):
        link.send(0x10, bytes([number]))


@pytest.mark.usefixtures("nodes")
def test_candump_holds_the_same_frames(tmp_path: Path) -> None:
    log = tmp_path / "candump.log"
    with log.open("w") as file, subprocess.Popen(["candump", "-r", "8000000", "-L", "vcan0"], stdout=file) as candump:
        told = rig.trial(tmp_path, "vcan0", *rig.patient(tmp_path), *SHORT).wait()
        candump.terminate()
    assert told.status == 0, told
    theirs = [(round(float(stamp) * 1e6), int(can_id, 16), bytes.fromhex(data)) for stamp, can_id, data in re.findall(
        r"^\((\S+)\) vcan0 ([0-9A-F]{3})#([0-9A-F]*)", log.read_text(), re.MULTILINE)]
    frames = rig.recorded(tmp_path).frames
    ours = [(int(time_ns) // 1000, int(can_id), bytes(data)[:dlc]) for time_ns, can_id, dlc, data in zip(
        frames["time_ns"], frames["can_id"], frames["dlc"], frames["data"], strict=True)]
    first = theirs.index(ours[0])
    assert theirs[first:first + len(ours)] == ours


@pytest.mark.usefixtures("nodes")
def test_a_link_that_goes_down_ends_the_trial_and_the_next_one_runs(tmp_path: Path) -> None:
    process = running(tmp_path, *(option for option in ENDLESS if option != "--dry-run"))
    rig.shell("ip link set vcan0 down")
    told = process.wait()
    rig.shell("ip link set vcan0 up")
    assert (told.status, told.result["outcome"]) == (1, "stopped")
    assert re.match(r"bus failed: .*vcan0: Network is down", told.result["stop_reason"]), told
    (tmp_path / "again").mkdir()
    again = rig.trial(tmp_path / "again", "vcan0", *rig.patient(tmp_path), *SHORT).wait()
    assert again.result["outcome"] == "completed", again


@pytest.mark.parametrize(("can_id", "count"), [(0x604, 3), (TARGETS, 5)], ids=["in bring-up", "in the cycle"])
def test_an_interface_that_is_removed_ends_bench_and_trial(
    tmp_path: Path, own: str, can_id: int, count: int
) -> None:
    with rig.bench(tmp_path, own, *rig.patient(tmp_path)) as bench:
        with KernelBus(own) as watching:
            process = rig.trial(tmp_path, own, *rig.patient(tmp_path), *ENDLESS)
            rig.heard(watching, can_id, count)
        rig.shell(f"ip link del {own}")
        told, served = process.wait(), bench.wait()
    assert (told.status, served.status) == (1, 1), (told, served)
    assert re.match(rf"(bus failed: .*{own}: (No such device|Network is down)|{STARVED}|SYNC missing: none for)",
                    told.result["stop_reason"]), told
    assert own in served.stderr
    assert "Traceback" not in told.stderr + served.stderr


@pytest.mark.usefixtures("nodes", "shaped")
def test_lost_frames_are_counted(tmp_path: Path) -> None:
    process = running(tmp_path, *SHORT, "--cycles", 4)
    rig.shell("tc qdisc add dev vcan0 root netem loss 20%")
    told = process.wait()
    assert told.result["missed_cycles"] > 0
    assert told.result["stop_reason"] is None or re.match(
        r"(inputs too old|heartbeat lost|emergency message|SYNC missing): ", told.result["stop_reason"]), told


@pytest.mark.usefixtures("nodes", "shaped")
@pytest.mark.parametrize(("discipline", "reason"), [
    ("loss 100%", r"(SYNC missing: none for \d+ ms|inputs too old: .*)"),
    # netem gives delayed frames back without the mark that they are the sender's own: SYNC then looks foreign
    ("delay 300ms", rf"(inputs too old: \w+ missed 100 cycles in a row|{STARVED}|{FOREIGN})"),
    ("limit 1 delay 2s", rf"(SYNC missing: none for \d+ ms|inputs too old: .*|emergency message: .*|{FOREIGN})"),
])
def test_a_bus_that_cannot_keep_up_stops_the_trial(tmp_path: Path, discipline: str, reason: str) -> None:
    process = running(tmp_path, *ENDLESS)
    rig.shell(f"tc qdisc add dev vcan0 root netem {discipline}")
    told = process.wait()
    assert told.status == 1
    assert re.fullmatch(reason, told.result["stop_reason"]), told


@pytest.mark.usefixtures("nodes", "shaped")
def test_at_one_mbit_the_pdos_take_their_time(tmp_path: Path) -> None:
    """netem's rate counts 16 bytes a frame, 0.128 ms; four TPDOs answer SYNC."""
    rig.shell("tc qdisc add dev vcan0 root netem rate 1mbit")
    told = rig.trial(tmp_path, "vcan0", *rig.patient(tmp_path), *SHORT).wait()
    assert told.result["outcome"] == "completed", told
    arrival = rig.recorded(tmp_path).columns["end_pdo_arrival_ns"]
    assert np.nanmedian(arrival) > 4 * 128_000


def test_a_full_transmit_queue_is_waited_for_then_named(own: str) -> None:
    rig.shell(f"tc qdisc add dev {own} root netem limit 3 delay 10ms")
    with KernelBus(own) as bus:
        link = Link(bus, rig.wall_clock)
        assert not list(link.listen(1_000_000))
        send_many(link)  # each waits for room by receiving
        rig.shell(f"tc qdisc change dev {own} root netem limit 3 delay 10s")
        with pytest.raises(LinkError, match=f"sending failed: {own}: No buffer space available"):
            send_many(link)


def test_what_a_full_receive_queue_drops_is_counted(own: str) -> None:
    with KernelBus(own, receive_buffer=4096) as narrow, KernelBus(own) as sender:
        message = can.Message(arbitration_id=0x7E0, is_extended_id=False)
        for _ in range(100):
            sender.send(message)
        kept = sum(1 for _ in iter(lambda: narrow.recv(0), None))
        sender.send(message)
        kept += narrow.recv(1.0) is not None
        assert 0 < kept < 100
        assert narrow.lost + kept == 101


@pytest.mark.usefixtures("nodes")
def test_error_frames_are_recorded_and_bus_off_ends_the_trial(tmp_path: Path) -> None:
    process = running(tmp_path, *ENDLESS)
    raw(ERROR_FLAG | PROTOCOL, bytes(8))
    raw(ERROR_FLAG | CONTROLLER | COUNTERS, bytes([0, PASSIVE_STATE, 0, 0, 0, 0, 136, 0]))
    raw(ERROR_FLAG | BUS_OFF, bytes(8))
    told = process.wait()
    assert told.status == 1
    assert re.match(r"bus failed: the CAN controller is bus-off", told.result["stop_reason"]), told
    recorded = rig.recorded(tmp_path)
    assert "CAN controller: ERROR-PASSIVE; transmit error counter 136, receive error counter 0." in [
        event.text for event in recorded.events if event.kind == "bus"]
    frames = recorded.frames
    assert set(frames["can_id"][(frames["flags"] & ERROR) != 0].tolist()) >= {PROTOCOL}


def test_an_interface_that_is_not_there_is_named(tmp_path: Path) -> None:
    told = rig.trial(tmp_path, "can9", *SHORT).wait()
    assert told.status == 2
    assert "channel can9: cannot be opened" in told.stderr
