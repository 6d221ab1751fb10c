"""Checks before a trial, of the computer, the interface and the bus: each finding with the command to type.

A check only reads: it changes nothing and enables nothing. On the bus it listens, and sends nothing but SDO reads of
identities (0x1000, 0x1018).
"""

import json
import os
import platform
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import can

from eds.bench.bench_network import MASTER, WireLayout
from eds.bench.bus_load import frame_bits
from eds.cia301 import HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID, NmtState
from master.network import host_computer
from master.network.bringup import BringUpError, identify
from master.network.link import Link
from master.network.sdo import SdoError

NET: Final = Path("/sys/class/net")
CLOCK_SOURCE: Final = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
RECEIVE_LIMIT: Final = Path("/proc/sys/net/core/rmem_max")
ARPHRD_CAN: Final = "280"
GOOD_CLOCKS: Final = frozenset({"tsc", "arch_sys_counter", "kvm-clock"})
WANTED_BUFFER: Final = 4 << 20
QUEUE: Final = 64
"""Frames that the interface's transmit queue should hold: a bring-up's longest burst, and room."""
OTHER_INTERFACE: Final = "name the adapter's own interface of python-can: --interface pcan, kvaser, slcan, …"
TROUBLED: Final = frozenset({"ERROR-WARNING", "ERROR-PASSIVE", "BUS-OFF", "STOPPED"})


class DoctorFinding(NamedTuple):
    """One check: whether it is `good`, the observation, and the command to type if it is not."""

    what: str
    good: bool
    seen: str
    remedy: str = ""


def interface(channel: str, bitrate: int) -> Iterator[DoctorFinding]:
    """The SocketCAN interface: present, CAN, up, its bit rate, its controller's state and its queue."""
    if not host_computer.IS_LINUX:
        yield DoctorFinding("interface", False, "SocketCAN is a part of Linux alone", OTHER_INTERFACE)
        return
    at = NET / channel
    setup = f"sudo ip link set {channel} up type can bitrate {bitrate} restart-ms 100"
    if not at.exists():
        present = [path.name for path in NET.iterdir() if _read(path / "type") == ARPHRD_CAN] if NET.exists() else []
        others = f"there is {', '.join(sorted(present))}" if present else "there is none"
        yield DoctorFinding("interface", False, f"{channel} does not exist; {others}",
                            "plug the adapter in and load its driver (sudo dmesg | tail), or for a dry run: "
                            f"sudo ip link add {channel} type vcan && sudo ip link set {channel} up")
        return
    if _read(at / "type") != ARPHRD_CAN:
        yield DoctorFinding("interface", False, f"{channel} is no CAN interface",
                            "name one of: ip -br link show type can")
        return
    told = _ip(channel)
    kind = told.get("linkinfo", {}).get("info_kind", "can")
    up = bool(int(_read(at / "flags") or "0", 16) & 1)
    yield DoctorFinding("interface", up, f"{channel} ({kind}) is {'up' if up else 'down'}",
                        f"sudo ip link set {channel} up" if kind != "can" else setup)
    yield from _controller(channel, bitrate, told.get("linkinfo", {}).get("info_data", {}), setup)
    clock = "adapter" if host_computer.hardware_stamps(channel) else "kernel"
    yield DoctorFinding("time stamps", True, f"of the {clock}")
    queue = int(_read(at / "tx_queue_len") or "0")
    yield DoctorFinding("transmit queue", queue >= QUEUE or kind == "vcan", f"{queue} frames",
                        f"sudo ip link set {channel} txqueuelen {QUEUE}")


def _controller(channel: str, bitrate: int, data: dict[str, Any], setup: str) -> Iterator[DoctorFinding]:
    rate = data.get("bittiming", {}).get("bitrate")
    if rate is not None:
        yield DoctorFinding("bit rate", rate == bitrate, f"{rate} bit/s, the configuration has {bitrate}",
                            f"sudo ip link set {channel} down && {setup}")
    state = data.get("state")
    if state is not None:
        counters = data.get("berr_counter", {})
        sent, heard = (counters.get(way, "?") for way in ("tx", "rx"))
        yield DoctorFinding("controller", state not in TROUBLED,
                            f"{state}, transmit errors {sent}, receive errors {heard}",
                            "check termination (60 Ω across CAN-H and CAN-L), ground and bit rate, then "
                            f"sudo ip link set {channel} down && {setup}")


def computer() -> Iterator[DoctorFinding]:
    """Check kernel, clock source, permissions for a cycle in wall time, and receive buffers."""
    if not host_computer.IS_LINUX:
        yield DoctorFinding("kernel", True, f"{platform.system()} {platform.release()}: no SocketCAN, no real time")
        return
    preempt = "PREEMPT_RT" in os.uname().version or _read(Path("/sys/kernel/realtime")) == "1"
    yield DoctorFinding("kernel", True, f"Linux {os.uname().release}, {'PREEMPT_RT' if preempt else 'not PREEMPT_RT'}")
    source = _read(CLOCK_SOURCE)
    yield DoctorFinding("clock source", source in GOOD_CLOCKS or not source, source or "not told",
                        f"reading {source} costs microseconds; boot with clocksource=tsc tsc=reliable, where there is "
                        "one")
    yield from _permissions()
    limit = int(_read(RECEIVE_LIMIT) or "0")
    privileged = os.geteuid() == 0
    yield DoctorFinding("receive buffers", privileged or limit >= WANTED_BUFFER or not limit, f"up to {limit} bytes",
                        f"sudo sysctl -w net.core.rmem_max={WANTED_BUFFER}")


def _permissions() -> Iterator[DoctorFinding]:
    python = os.path.realpath(sys.executable)
    with host_computer.prepared() as refused:
        yield DoctorFinding("permissions", not refused, "; ".join(refused) or "SCHED_FIFO and mlockall permitted",
                            f"{host_computer.PERMIT} {python}")


def jitter(seconds: float) -> DoctorFinding:
    """Measure the delay of this computer's wake-ups from waits as in the cycle, over `seconds` of wall time."""
    period_s, goal_s, late = 1e-3, 250e-6, []
    # select on Windows waits for sockets alone
    wait = partial(select.select, (), (), ()) if host_computer.IS_LINUX else time.sleep
    with host_computer.prepared():
        due = time.perf_counter() + period_s
        end = due + seconds
        while due < end:
            wait(max(0.0, due - time.perf_counter()))
            late.append(time.perf_counter() - due)
            due += period_s
    late.sort()
    p99, worst = late[int(0.99 * len(late))], late[-1]
    return DoctorFinding("timer", worst < goal_s,
                         f"wakes late by {p99 * 1e6:.0f} µs (99 %), {worst * 1e6:.0f} µs at most, "
                         f"in {seconds:g} s at {1 / period_s:g} Hz",
                         f"a cycle of {1 / period_s:g} Hz wants {goal_s * 1e6:.0f} µs: lower --rate, end other work, "
                         "isolate a processor (isolcpus=), or boot a PREEMPT_RT kernel")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _ip(channel: str) -> dict[str, Any]:
    """Return iproute2's properties of an interface; {} if it is not installed."""
    try:
        told = subprocess.run(["ip", "-json", "-details", "link", "show", channel], capture_output=True, text=True,
                              timeout=10, check=False).stdout
        found: list[dict[str, Any]] = json.loads(told)
    except (OSError, subprocess.TimeoutExpired, ValueError):
        return {}
    return found[0] if found else {}


SURVEY_NS: Final = 1_000_000_000
LISTEN_NS: Final = 1_200_000_000
"""Time for which another master is listened for: longer than the heartbeat of 1 s that most masters send."""
_DEVICE_TYPE: Final = 0x1000
_RPDOS: Final = (0x200, 0x300, 0x400, 0x500)
"""Bases of the predefined RPDO identifiers 1 to 4 (CiA 301, 7.3.3)."""


def bus(link: Link, wire: WireLayout, listen_ns: int = SURVEY_NS) -> Iterator[DoctorFinding]:
    """Listen, then read each node's identity; raises `LinkError` if the interface fails."""
    bits, frames, before = 0, 0, link.controller.count
    rival: str | None = None
    for message in link.listen(listen_ns):
        rival = rival or master_sign(message)
        bits += frame_bits(len(message.data))
        frames += 1
    load = 100.0 * bits / (wire.network.bitrate * listen_ns * 1e-9)
    yield DoctorFinding("bus load", load <= 80.0, f"{load:.1f} % at most, {frames} frames in {listen_ns * 1e-9:g} s",
                        "find who talks so much: candump -td can0")
    errors, told = link.controller.count - before, [event.text for event in link.controller.events]
    yield DoctorFinding("error frames", not errors, "; ".join((f"{errors} in {listen_ns * 1e-9:g} s", *told)),
                        "check termination (60 Ω), wiring, ground and that every node has the same bit rate")
    yield DoctorFinding("other masters", rival is None, "none" if rival is None else f"one is there: {rival}",
                        "stop the other master first")
    for node_id in sorted(wire.nodes):
        yield _node(link, wire, node_id)
    for node_id in sorted(set(link.beats) - set(wire.nodes) - {MASTER}):
        yield DoctorFinding(f"node {node_id}", False, "beats, but is none of the bench's nodes",
                            "give it another bus, or mend node ids")


def _node(link: Link, wire: WireLayout, node_id: int) -> DoctorFinding:
    entry = wire.nodes[node_id]
    what = f"{entry.name} (node {node_id})"
    beat = link.beats.get(node_id)
    state = "no heartbeat" if beat is None else _named(beat.state)
    try:
        link.sdo_read(node_id, _DEVICE_TYPE)
        serial = identify(link, entry)
    except SdoError as error:
        return DoctorFinding(what, False, f"{state}; {error}",
                             "check its supply, its node id, its bit rate and the wiring")
    except BringUpError as error:
        return DoctorFinding(what, False, f"{state}; {error}", "connect that device, or name its EDS in bench.toml")
    described = entry.dictionary.path.rsplit("/", 1)[-1]
    return DoctorFinding(what, True, f"{state}; as {described} says, serial number {serial}")


def master_sign(message: can.Message) -> str | None:
    """Return in words what in a frame shows another master: its heartbeat, NMT, SDO requests, SYNC or RPDOs."""
    can_id = message.arbitration_id
    if can_id == HEARTBEAT_BASE + MASTER:
        return f"its heartbeat {can_id:X}h is on the bus"
    if not message.is_rx:
        return None
    if can_id == NMT_COB_ID:
        return "it sends NMT commands"
    if SDO_REQUEST_BASE < can_id <= SDO_REQUEST_BASE + 127:
        return f"it sends SDO requests to node {can_id - SDO_REQUEST_BASE}"
    if can_id == SYNC_COB_ID:
        return "it sends SYNC"
    node_id = can_id & 0x7F
    if node_id and can_id - node_id in _RPDOS:
        return f"it sends RPDO {can_id:X}h to node {node_id}"
    return None


def other_master(link: Link) -> str | None:
    """Listen for 1.2 s; return in words what shows that another master is on the bus, None where nothing does.

    A heartbeat of a node that answers no SDO counts, too, if its state allows SDO: masters are seldom SDO servers.
    """
    before = set(link.beats)
    for message in link.listen(LISTEN_NS):
        if (sign := master_sign(message)) is not None:
            return sign
    for node_id in sorted(set(link.beats) - before):
        if link.beats[node_id].state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL):
            try:
                link.sdo_read(node_id, _DEVICE_TYPE)
            except SdoError as error:
                if error.code is None:
                    return f"node {node_id} has a heartbeat and answers no SDO"
    return None


def _named(state: int) -> str:
    known = {int(s): s.name for s in NmtState} | {0: "booted"}
    return known.get(state, f"state {state}").replace("_", "-")
