"""Runs on the virtual bench, each to the digest of its trial and of its truth file.

The rule of this file: a run is a whole experiment through the wire; nothing in it knows how its cycles are computed.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import can

from eds.bench.bench_network import END, KNEE, SERVO, START, Network
from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.run_safely import run_safely
from master.motion.experiment_run import ExperimentSetup, PreparedExperiment
from master.network.link import WANTED, Link
from master.settings import Gait, Limits
from physics.reference import paper_reference
from trial.record import Recorder
from virtual_bus.bus import BowdenBus
from virtual_bus.wire.faults import Fault

Hook = Callable[[Exchange], object]


class Case(NamedTuple):
    """One run: options of the bench, cycles a second, and what happens at which cycle of `scripted`; a gait if none."""

    options: Mapping[str, Any] = {}
    rate_hz: int = 250
    script: Mapping[int, Hook] | None = None
    cycles: int = 300
    faults: tuple[Fault, ...] = ()
    controller: str = "paper"


class Ran(NamedTuple):
    """The digest of both files and of how the run ended; how many of its cycles were run at once; why it stopped."""

    digest: str
    complete_cycles: int
    reason: str | None


def ran(case: Case, folder: Path) -> Ran:
    """Run a case in an empty folder."""
    network = Network(rate_hz=case.rate_hz)
    bus = BowdenBus(str(folder), rate_hz=case.rate_hz, truth=str(folder / "truth.mcap"), faults=case.faults,
                    **case.options)
    tap = BowdenBus(str(folder))
    bus.set_filters(WANTED)
    recorder = Recorder(folder / "trial.mcap", metadata={}, attachments={}, threaded=False, overwrite=True)
    perform = _gait(network, case.controller) if case.script is None else _scripted(case)
    try:
        outcome = run_safely(Link(bus, bus.time_ns), tap, recorder, network, Limits(), perform)
        recorder.close({})
        complete_cycles = bus.complete_cycles
        ends = (outcome, bus.time_ns(), bus.bench.wire.frames, bus.bench.wire.busy_bits, bus.lost, tap.lost)
    finally:
        tap.shutdown()
        bus.shutdown()
    told = hashlib.sha256(repr(ends).encode())
    for name in ("trial.mcap", "truth.mcap"):
        told.update((folder / name).read_bytes())
    return Ran(told.hexdigest(), complete_cycles, outcome.reason)


def _gait(network: Network, controller: str) -> Callable[[Exchange], None]:
    gait = Gait(peak_n=30.0, period_s=0.8, cycles=1, settle=0, controller=controller)
    return PreparedExperiment(ExperimentSetup(paper_reference(30.0, 0.8), network, gait=gait)).perform


def _scripted(case: Case) -> Callable[[Exchange], None]:
    script = case.script or {}

    def perform(exchange: Exchange) -> None:
        drives.enable(exchange)
        inputs = exchange.inputs
        servo, knee = inputs.servo_position_m, inputs.knee_angle_rad
        for cycle in range(case.cycles):
            exchange.advance(servo - 2e-6 * cycle, knee + 1e-4 * (cycle % 50))
            if cycle in script:
                script[cycle](exchange)

    return perform


# ---- what may happen at a cycle ----

def read(node: int, index: int, sub: int = 0) -> Hook:
    """Read an object by SDO."""
    return lambda exchange: exchange.link.sdo_read(node, index, sub)


def write(node: int, index: int, sub: int, data: bytes) -> Hook:
    """Write an object by SDO."""
    return lambda exchange: exchange.link.sdo_write(node, index, sub, data)


def second_socket(cycles: int, filters: Any = None) -> Hook:
    """Open a second socket, use it for a while, close it; what it heard goes into an event."""
    def hook(exchange: Exchange) -> None:
        other = BowdenBus(exchange.link.bus.channel_info.rpartition(" ")[2],
                          can_filters=filters)  # type: ignore[attr-defined]
        heard = hashlib.sha256()
        for _ in range(cycles):
            exchange.hold()
            while (message := other.recv(0)) is not None:
                heard.update(repr((message.time_ns, message.arbitration_id, bytes(message.data))).encode())
        other.send(can.Message(arbitration_id=0x6F0, data=b"other", is_extended_id=False))
        exchange.hold()
        other.shutdown()
        exchange.log.event(exchange.inputs.sync_ns, "test", "socket", heard.hexdigest())
    return hook


def quick_stop(exchange: Exchange) -> None:
    """Quick stop both drives without a word to the guard."""
    exchange.guard.enabled = False
    exchange.command(0x0002, 0x0002)


def pause(exchange: Exchange) -> None:
    """Stop SYNC for a while and start it again at another phase."""
    exchange.link.sync_stop()
    exchange.link.wait(3_700_000)
    exchange.link.sync_start(exchange.wire.period_ns)
    exchange.hold()


def leap(exchange: Exchange) -> None:
    """Ask the servo for a step that it refuses."""
    exchange.advance(exchange.targets[0] + 0.05, exchange.targets[1])


def silence(exchange: Exchange) -> None:
    """Let the master's heartbeat fail for a while."""
    exchange.link.heed([(exchange.link.heartbeat[0], exchange.inputs.sync_ns + 400_000_000, 5)])


def odd_send(exchange: Exchange) -> None:
    """Send a frame that nobody wants, then one that is late."""
    exchange.link.send(0x555, b"\1\2\3")
    exchange.link.wait(700_000)
    exchange.link.send(0x555, b"")


SCRIPT: dict[int, Hook] = {
    20: read(START, 0x7130, 1), 31: read(SERVO, 0x6064), 32: read(KNEE, 0x6041), 40: write(KNEE, 0x607F, 0, struct.pack(
        "<I", 400_000)), 60: write(START, 0x61A1, 1, b"\3"), 80: second_socket(25),
    120: second_socket(10, [{"can_id": 0x181, "can_mask": 0x7FF}]), 140: odd_send, 150: write(
        END, 0x6114, 1, struct.pack("<I", 400)), 170: read(END, 0x6130, 1), 190: pause, 210: quick_stop,
    230: read(SERVO, 0x6078), 231: read(SERVO, 0x607A), 232: read(SERVO, 0x2011), 233: read(SERVO, 0x60F4),
    240: write(KNEE, 0x1017, 0, b"\x0d\x00"), 260: write(SERVO, 0x1A00, 0, b"\0"),
}


def fault(kind: str, start_s: float, stop_s: float, **more: Any) -> tuple[Fault, ...]:
    """One fault."""
    return (Fault(kind, start_s=start_s, stop_s=stop_s, **more),)


CASES: dict[str, Case] = {
    "gait": Case(),
    "another bench": Case({"serial": 7, "day": 3, "seed": 11}, rate_hz=200),
    "1 kHz": Case(rate_hz=1000, script={100: read(START, 0x7130, 1), 500: second_socket(40)}, cycles=700),
    "script": Case(script=SCRIPT),
    "script at 1 kHz": Case(script=SCRIPT, rate_hz=1000),
    "slow bus": Case({"bitrate": 500_000}, rate_hz=100, script=SCRIPT),
    "emergency stop": Case(script={}, cycles=400, faults=fault("emergency_stop", 1.9, 2.1, node=SERVO)),
    "broken wire": Case(script={}, cycles=400, faults=fault("broken_wire", 1.9, 2.0, node=START)),
    "overload of END": Case(script={}, cycles=400, faults=fault("overload", 1.9013, 1.95, node=END)),
    "drop": Case(script={}, cycles=400, faults=fault("drop", 1.9, 1.904, cob_id=0x182, probability=0.5)),
    "late SYNC": Case(script={}, cycles=400, faults=fault("late_sync", 1.9, 1.93, delay_us=300.0)),
    "disturb": Case(script={}, cycles=400, faults=fault("disturb", 1.9, 1.91, probability=0.3)),
    "power off": Case(script={}, cycles=400, faults=fault("power_off", 1.9, 1.95, node=KNEE)),
    "deaf": Case(script={}, cycles=400, faults=fault("deaf", 1.9, 1.92, node=SERVO, cob_id=0x183)),
    "cut": Case(script={}, cycles=400, faults=fault("cut", 1.9, 1.92, node=END)),
    "another plant model": Case({"serial": 2, "plant_model": {
        "plant": {"mu1": 0.14, "slack_m": 1e-3}, "end_sensor": {"delay_s": 0.004, "quantum_n": 0.5}}}),
    "lost inputs": Case({"plant_model": {"bus": {"lost_share": 0.1}}}, script={}, cycles=200),
    "extended controller": Case({"day": 2}, controller="extended"),
    "two faults far apart": Case(script=SCRIPT, faults=(
        *fault("drop", 1.7, 1.702, cob_id=0x183), *fault("power_off", 1.9003, 1.93, node=END))),
    "stop while the knee moves": Case(rate_hz=1000, script={}, cycles=900, faults=fault(
        "emergency_stop", 0.9012345, 0.95, node=KNEE)),
    "a step that the servo refuses": Case(script={150: leap}),
    "a master that falls silent": Case(script={100: silence}, cycles=400),
    "babble": Case(script={}, cycles=400, faults=fault("babble", 1.9, 1.95, cob_id=0x123, size=8, period_us=900.0)),
}
