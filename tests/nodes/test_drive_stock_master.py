"""Stock masters, canopen's `RemoteNode` and `BaseNode402` with their threads, on a served bench with its plant.

The bench is `bowden bench` in a process of its own, over UDP multicast that does not leave this computer, and once
more in a thread over python-can's `virtual`, for computers without multicast.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from eds import dictionary
from eds.bench.bench_network import END, FILES, KNEE, SERVO, START
from virtual_bus.build import build
from virtual_bus.bus_options import Options
from virtual_bus.serve import serve

pytestmark = pytest.mark.walltime
PATIENCE_S = 60.0
"""Bounds a hung test, not a drive: the machine may be busy."""
PORT = 42_000 + os.getpid() % 20_000
MULTICAST = {"interface": "udp_multicast", "channel": "239.74.163.2", "port": PORT, "hop_limit": 0}
VIRTUAL = {"interface": "virtual", "channel": "stock-masters"}
COMMAND = [sys.executable, "-c", "from bowden.cli import main; main()", "bench", "--json",
           "--interface", "udp_multicast", "--channel", "239.74.163.2", "--option", f"port={PORT}",
           "--option", "hop_limit=0"]
HOMING_OFFSET = 500
MOVE = {SERVO: 3000, KNEE: -3000}
"""0.001 mm of rope, 0.001° of the knee."""
PRELOAD_N = 5.0


def until(what: Callable[[], bool]) -> None:
    """Wait for something that other threads or another process do."""
    deadline = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@contextmanager
def in_a_process() -> Iterator[dict[str, Any]]:
    """Run `bowden bench`; it ends on SIGTERM, with what it did as JSON."""
    try:
        with can.Bus(**MULTICAST) as bus:
            bus.send(can.Message(arbitration_id=0x77F, is_extended_id=False))
    except (can.CanError, OSError) as error:
        pytest.skip(f"no multicast on this computer: {error}")
    root = Path(__file__).resolve().parents[2]
    with subprocess.Popen(COMMAND, cwd=root, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            yield MULTICAST
        finally:
            process.terminate()
            told, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 128 + signal.SIGTERM
    assert json.loads(told)["lost"] == 0


@contextmanager
def in_a_thread() -> Iterator[dict[str, Any]]:
    """Serve the same bench from a thread of this process."""
    ended = threading.Event()
    with can.Bus(**VIRTUAL) as bus:
        thread = threading.Thread(
            target=serve, args=(bus, build(Options(), "stock"), time.monotonic_ns, ended.is_set))
        thread.start()
        yield VIRTUAL
        ended.set()
        thread.join()


@pytest.fixture(scope="module", params=[in_a_process, in_a_thread])
def served(request: pytest.FixtureRequest) -> Iterator[dict[str, Any]]:
    with request.param() as arguments:
        yield arguments


@contextmanager
def connected(arguments: dict[str, Any]) -> Iterator[canopen.Network]:
    network = canopen.Network()
    network.connect(**arguments)
    try:
        yield network
    finally:
        network.disconnect()


@pytest.fixture
def network(served: dict[str, Any]) -> Iterator[canopen.Network]:
    with connected(served) as network:
        yield network


def joined(network: canopen.Network, node_id: int) -> Any:
    """Add a node, wait until it is there, give it its defaults again; it is PRE-OPERATIONAL then."""
    kind = BaseNode402 if node_id in (SERVO, KNEE) else canopen.RemoteNode
    node = kind(node_id, str(dictionary.packaged(FILES[node_id])))
    network.add_node(node)
    until(lambda: answers(node))
    node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    booted = threading.Event()  # canopen's own wait_for_bootup misses a boot-up that comes at once
    network.subscribe(0x700 + node_id, lambda _can_id, data, _time: booted.set() if data == b"\0" else None)
    node.nmt.state = "RESET"
    assert booted.wait(PATIENCE_S)
    return node


def answers(node: Any) -> bool:
    try:
        return bool(node.sdo[0x1000].raw & 0xFFFF in (402, 404))
    except canopen.SdoCommunicationError:
        return False


def drive_402(network: canopen.Network, node_id: int) -> Any:
    node = joined(network, node_id)
    node.TIMEOUT_CHECK_TPDO = node.TIMEOUT_SWITCH_STATE_SINGLE = node.TIMEOUT_SWITCH_STATE_FINAL = PATIENCE_S
    node.setup_402_state_machine()
    for pdo in node.rpdo.values():
        if pdo.enabled:  # UDP multicast brings own frames back; canopen takes an RPDO that it hears for a periodic one
            network.unsubscribe(pdo.cob_id)
    node.nmt.state = "OPERATIONAL"
    return node


def moved(node: Any, target: int) -> int:
    """Give a target, again and again as CSP wants it; return where the drive is."""
    node.sdo[0x607A].raw = target
    return int(node.sdo[0x6064].raw)


@pytest.mark.parametrize("node_id", [SERVO, KNEE])
@pytest.mark.slow
def test_a_stock_master_homes_moves_faults_and_resets_a_drive(network: canopen.Network, node_id: int) -> None:
    node = drive_402(network, node_id)
    for method in (37, 35):
        node.op_mode = "HOMING"
        node.sdo[0x6098].raw = method
        node.sdo[0x607C].raw = HOMING_OFFSET + method
        assert node.homing(timeout=PATIENCE_S)
        assert node.sdo[0x6064].raw == pytest.approx(HOMING_OFFSET + method, abs=20)
        node.controlword = 0x000F
    node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
    until(lambda: abs(moved(node, MOVE[node_id]) - MOVE[node_id]) < 100)
    node.sdo[0x6065].raw, node.sdo[0x6066].raw = 100, 10
    moved(node, 5 * MOVE[node_id])
    until(lambda: bool(node.state == "FAULT"))
    assert node.sdo[0x603F].raw == 0x8611
    assert [error.code for error in node.emcy.log] == [0x8611]
    node.reset_from_fault()
    until(lambda: bool(node.state == "OPERATION ENABLED"))
    node.state = "SWITCH ON DISABLED"
    assert node.state == "SWITCH ON DISABLED"


def remapped(pdo: Any, index: int, subindex: int, **parameters: int) -> None:
    """Give a PDO one object and other communication parameters, as canopen writes them."""
    pdo.clear()
    pdo.add_variable(index, subindex)
    for name, value in parameters.items():
        setattr(pdo, name, value)
    pdo.enabled = True
    pdo.save()


def test_a_stock_master_homes_the_servo_to_a_preload(network: canopen.Network) -> None:
    start, servo = joined(network, START), drive_402(network, SERVO)
    start.tpdo.read()
    remapped(start.tpdo[1], 0x7130, 1, event_timer=5)
    remapped(servo.rpdo[3], 0x2011, 0, cob_id=start.tpdo[1].cob_id)
    start.nmt.state = "OPERATIONAL"
    servo.sdo[0x2010].raw = round(100 * PRELOAD_N)
    servo.sdo[0x6098].raw, servo.sdo[0x607C].raw = -1, 0
    assert servo.homing(timeout=PATIENCE_S)
    assert start.sdo[0x6130][1].raw == pytest.approx(PRELOAD_N, abs=1.5)  # 0.6 N of band, noise of a sample besides
    assert servo.sdo[0x6064].raw == pytest.approx(0, abs=50)
    servo.state = "SWITCH ON DISABLED"
    until(lambda: bool(abs(start.sdo[0x6130][1].raw) < 1.5))


@pytest.mark.parametrize("node_id", [START, END])
def test_a_stock_master_reads_and_tares_a_sensor(network: canopen.Network, node_id: int) -> None:
    sensor = joined(network, node_id)
    assert (sensor.sdo[0x6131][1].raw, sensor.sdo[0x6132][1].raw) == (0x00210000, 2)
    sensor.sdo[0x61A1][1].raw = 100
    until(lambda: bool(sensor.sdo[0x6150][1].raw == 0))
    sensor.sdo[0x6125][1].raw = 0x6F72657A
    sensor.tpdo.read()
    sensor.nmt.state = "OPERATIONAL"
    assert sensor.tpdo[1].wait_for_reception(PATIENCE_S) is not None
    tension = sensor.tpdo[1].map[0]
    assert abs(tension.raw) < 50  # 0.5 N: a mean of 100 samples with 0.15 N of noise each
    assert abs(sensor.sdo[0x6130][1].raw) < 0.5


def test_two_masters_listen_at_once(served: dict[str, Any], network: canopen.Network) -> None:
    """One commands and makes the SYNC; the other hears every node, and the same EMCY, and may ask as well."""
    with connected(served) as witness:
        own, other = drive_402(network, KNEE), BaseNode402(KNEE, str(dictionary.packaged(FILES[KNEE])))
        witness.add_node(other)
        heard: list[bytes] = []
        witness.subscribe(0x282, lambda _can_id, data, _time: heard.append(bytes(data)))
        own.sdo[0x1017].raw = 20
        other.nmt.wait_for_heartbeat(PATIENCE_S)
        assert other.nmt.state == "OPERATIONAL"
        own.sdo[0x1801][1].raw = 0x80000282
        own.sdo[0x1801][2].raw = 1
        own.sdo[0x1801][1].raw = 0x282
        network.sync.start(0.01)
        until(lambda: len(heard) > 20)
        network.sync.stop()
        network.send_message(0x80, b"\x01")  # a SYNC of a length that is not expected
        until(lambda: bool(other.emcy.log) and bool(own.emcy.log))
        assert other.emcy.log[0].code == own.emcy.log[0].code == 0x8240
        other.sdo.RESPONSE_TIMEOUT = PATIENCE_S
        assert other.sdo[0x6502].raw == own.sdo[0x6502].raw
