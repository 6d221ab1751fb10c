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
import pytest

from eds.error_frames import BUS_OFF, CONTROLLER, COUNTERS, PASSIVE_STATE, PROTOCOL
from master.network.link import Link, LinkError
from master.network.socketcan import KernelBus
from tests.socketcan import rig
from trial.mcap_file.cdr import ERROR

pytestmark = pytest.mark.guest("native", "uml")

SHORT = ("--cycles", 1, "--settle", 0, "--period", 1, "--peak", 20, "--dry-run")
ENDLESS = (*SHORT, "--cycles", 600)
"""Ten minutes of gait: such a trial ends by the fault, or fails its test."""
TARGETS = 0x201
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
def test_a_trial_completes_and_candump_holds_the_same_frames(tmp_path: Path) -> None:
    log = tmp_path / "candump.log"
    with log.open("w") as file, subprocess.Popen(["candump", "-r", "8000000", "-L", "vcan0"], stdout=file) as candump:
        told = rig.trial(tmp_path, "vcan0", *rig.patient(tmp_path), *SHORT).wait()
        candump.terminate()
    assert (told.status, told.result["outcome"]) == (0, "completed"), told
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


def test_an_interface_that_is_removed_ends_bench_and_trial(tmp_path: Path, own: str) -> None:
    with rig.bench(tmp_path, own, *rig.patient(tmp_path)) as bench:
        with KernelBus(own) as watching:
            process = rig.trial(tmp_path, own, *rig.patient(tmp_path), *ENDLESS)
            rig.heard(watching, TARGETS, 5)
        rig.shell(f"ip link del {own}")
        told, served = process.wait(), bench.wait()
    assert (told.status, served.status) == (1, 1), (told, served)
    assert re.match(rf"(bus failed: .*{own}: (No such device|Network is down)|{STARVED}|SYNC missing: none for)",
                    told.result["stop_reason"]), told
    assert own in served.stderr
    assert "Traceback" not in told.stderr + served.stderr


@pytest.mark.usefixtures("nodes", "shaped")
def test_a_bus_that_loses_every_frame_stops_the_trial(tmp_path: Path) -> None:
    process = running(tmp_path, *ENDLESS)
    rig.shell("tc qdisc add dev vcan0 root netem loss 100%")
    told = process.wait()
    assert told.status == 1
    assert re.fullmatch(r"(SYNC missing: none for \d+ ms|inputs too old: .*)", told.result["stop_reason"]), told


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
