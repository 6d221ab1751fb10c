"""A master that is killed, stopped, cut off or contradicted, on the kernel's bus: the drives let go by themselves.

The rule of this file: drives are enabled, and what they did is read from them by SDO afterwards; nothing here is timed.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from eds.bench.bench_network import KNEE, SERVO
from eds.cia402 import State, state_of
from master.network.link import Link
from master.network.sdo import SdoError
from master.network.socketcan import KernelBus
from tests.socketcan import rig

pytestmark = pytest.mark.guest("native", "uml")

ENDLESS = ("--cycles", 600, "--settle", 0, "--period", 1, "--peak", 20)
"""Ten minutes of gait: such a trial ends by what is done to it, or completes and so fails its test."""
SERVO_PDO, KNEE_PDO, TARGETS = 0x181, 0x182, 0x201
LOOKS = 1200
"""Looks at a drive, 50 ms of the bus apart: three times the longest deadline; only a failing test needs all."""


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[rig.Process]:
    with rig.bench(tmp_path, "vcan0", *rig.patient(tmp_path)) as process:
        yield process


def pulling(folder: Path) -> rig.Process:
    """A trial on vcan0 whose drives are both enabled, by what their PDOs say."""
    with KernelBus("vcan0") as watching:
        process = rig.trial(folder, "vcan0", *rig.patient(folder), *ENDLESS)
        enabled: set[int] = set()
        while enabled != {SERVO_PDO, KNEE_PDO}:
            heard = watching.recv(60.0)
            assert heard is not None, "the trial does not run"
            if heard.arbitration_id in (SERVO_PDO, KNEE_PDO):
                told = state_of(int.from_bytes(heard.data[:2], "little"))
                (enabled.add if told is State.OPERATION_ENABLED else enabled.discard)(heard.arbitration_id)
    return process


def reaches(node_id: int, state: State) -> bool:
    """Look at a drive by SDO, as `bowden doctor` does, until it is in that state; False where it never is."""
    with KernelBus("vcan0") as bus:
        link = Link(bus, rig.wall_clock, heartbeat_ms=None)
        for _ in range(LOOKS):
            try:
                word = int.from_bytes(link.sdo_read(node_id, 0x6041), "little")
            except SdoError:
                continue
            if state_of(word) is state:
                return True
            list(link.listen(50_000_000))
    return False


def test_a_master_that_is_killed_leaves_both_drives_without_torque(
    tmp_path: Path, bench: rig.Process
) -> None:
    process = pulling(tmp_path)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait().status == -signal.SIGKILL
    assert reaches(SERVO, State.SWITCH_ON_DISABLED)
    assert reaches(KNEE, State.SWITCH_ON_DISABLED)


def test_a_master_that_is_stopped_finds_its_drives_gone_and_ends(tmp_path: Path, bench: rig.Process) -> None:
    process = pulling(tmp_path)
    os.kill(process.pid, signal.SIGSTOP)
    assert reaches(SERVO, State.SWITCH_ON_DISABLED)
    os.kill(process.pid, signal.SIGCONT)
    told = process.wait()
    assert (told.status, told.result["outcome"]) == (1, "stopped"), told
    assert (rig.recorded(tmp_path).result or {})["outcome"] == "stopped"


def test_nodes_that_are_cut_off_stop_the_trial(tmp_path: Path, bench: rig.Process) -> None:
    process = pulling(tmp_path)
    os.kill(bench.pid, signal.SIGSTOP)
    told = process.wait()
    os.kill(bench.pid, signal.SIGCONT)
    assert (told.status, told.result["outcome"]) == (1, "stopped"), told
    assert re.match(r"(inputs too old|heartbeat lost|SYNC missing): ", told.result["stop_reason"]), told
    assert reaches(SERVO, State.SWITCH_ON_DISABLED)


def test_a_second_master_is_refused_and_does_not_stop_the_first(tmp_path: Path, bench: rig.Process) -> None:
    process = pulling(tmp_path)
    (tmp_path / "second").mkdir()
    second = rig.trial(tmp_path / "second", "vcan0", *rig.patient(tmp_path), *ENDLESS).wait()
    assert second.status == 1
    assert re.match(r"refused: (another master \(node 127\) is on the bus|somebody sends SYNC already)",
                    second.result["stop_reason"]), second
    reason = process.end().result["stop_reason"]
    assert reason == "interrupted: by SIGTERM", reason


def test_targets_of_another_program_stop_the_trial(tmp_path: Path, bench: rig.Process) -> None:
    process = pulling(tmp_path)
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sender:
        sender.bind(("vcan0",))
        sender.send(struct.pack("=IB3x8s", TARGETS, 8, struct.pack("<ii", 1_000, 0)))
    told = process.wait()
    assert told.status == 1
    assert re.match(r"foreign command on the bus: targets \(201h\) from another master",
                    told.result["stop_reason"]), told
    assert reaches(SERVO, State.SWITCH_ON_DISABLED)
