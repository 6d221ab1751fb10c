"""Checks before a trial: each finding with the command to type.

A check only reads: it changes nothing, it enables nothing, and on the bus it only listens and reads identities.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from master.network import host_computer

NET: Final = Path("/sys/class/net")
CLOCK_SOURCE: Final = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
RECEIVE_LIMIT: Final = Path("/proc/sys/net/core/rmem_max")
ARPHRD_CAN: Final = "280"
GOOD_CLOCKS: Final = frozenset({"tsc", "arch_sys_counter", "kvm-clock"})
WANTED_BUFFER: Final = 4 << 20
QUEUE: Final = 64
"""Frames that the interface's transmit queue should hold: a bring-up's longest burst, and room."""
TROUBLED: Final = frozenset({"ERROR-WARNING", "ERROR-PASSIVE", "BUS-OFF", "STOPPED"})


class DoctorFinding(NamedTuple):
    """One check: whether it is `good`, the observation, and the command to type if it is not."""

    what: str
    good: bool
    seen: str
    remedy: str = ""


def interface(channel: str, bitrate: int) -> Iterator[DoctorFinding]:
    """The SocketCAN interface: present, CAN, up, its bit rate, its controller's state and its queue."""
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


def jitter(seconds: float, period_s: float = 1e-3, goal_s: float = 250e-6) -> DoctorFinding:
    """Measure the delay of this computer's wake-ups from waits as in the cycle, over `seconds` of wall time."""
    late = []
    with host_computer.prepared():
        due = time.perf_counter() + period_s
        end = due + seconds
        while due < end:
            select.select((), (), (), max(0.0, due - time.perf_counter()))
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

