"""Timing of the master's cycle on the kernel's CAN and of a stock canopen master's, in guest time: docs/bench.md.

    python -m benchmarks.socketcan                   # prints the table, and writes it into docs/bench.md
    python -m benchmarks.socketcan --cycles 10000    # longer; missed cycles are scaled to 10⁵ either way
    python -m benchmarks.socketcan --adapters        # rate that each kind of adapter carries, by calculation

Needs `../shared/run_in_vm.sh` (back end `icount`): the guest's clock counts instructions, so any machine prints equal
figures.  The nodes and a master are two processes of the guest's one processor.  Every figure but the processor time is
read off the bus by a third socket, in one way for every master: SYNC, four TPDOs, one frame of targets for both drives,
no drive enabled.  A master is a function that runs a number of cycles and returns the processor time of one.
"""

import argparse
import dataclasses
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import can
import canopen
import numpy as np

from benchmarks.frame import DOCS, ROOT, map_pdo, markdown, put
from bowden.bench.examination import upper_bound
from eds.bench import bus_load
from eds.bench.bench_network import FILES, MASTER, SERVO, TARGETS_COB_ID, Network, WireLayout, wire
from eds.bench.bus_load import rate_that_fits
from eds.cia301 import HEARTBEAT_BASE, SYNC_COB_ID, TPDO_BASE, NmtCommand, NmtState
from eds.datatype import encode
from eds.dictionary import key, packaged
from master.cycle.exchange import Exchange
from master.cycle.guard import Guard
from master.cycle.log import Log
from master.cycle.run_safely import run_safely
from master.motion.experiment_run import ExperimentSetup, PreparedExperiment
from master.network.host_computer import collector_frozen, prepared
from master.network.link import WANTED, Link
from master.network.recorded_bus import RecordedBus
from master.network.socketcan import KernelBus
from master.settings import Gait, Limits
from physics.reference import paper_reference
from tests.socketcan import rig
from trial.record import Recorder

GUEST = ROOT.parent / "shared" / "run_in_vm.sh"
PAGE = DOCS / "bench.md"
LIMIT_S = 7200
RUNS = (("vcan0", "vcan0", 500, True), ("can0", "can1", 500, True), ("vcan0", "vcan0", 1000, False),
        ("can0", "can1", 1000, False))
"""Channel of the master, of the nodes; SYNC, Hz; nodes by `bowden bench`, or answers alone."""
MISSED = "missed per 10⁵ (95 % bound)"
HEAD = ("master on, nodes on", "nodes", "SYNC asked (Hz)", "master", "cycles", "SYNC held (Hz)", MISSED,
        "SYNC jitter, 99 % / worst (µs)", "last TPDO after SYNC, median / worst (µs)",
        "targets after SYNC, median / worst (µs)", "CPU per cycle (µs)")
ADAPTERS = (("PCIe", 90, "measured, mean"), ("USB high speed", 250, "two microframes of 125 µs"),
            ("USB full speed", 1000, "measured, upper end"), ("USB full speed", 2000, "two frames of 1 ms"))
"""Round trip of an adapter without the frames themselves (wire to program, program to wire), µs, and its origin."""
PEAK_N, PERIOD_S = 20.0, 1.0
QUEUE = 256 << 20
"""Bytes of the watching socket's queue; the kernel charges about 770 for a frame."""
BEATEN = 100
"""Cycles from one heartbeat to the next of who answers in a bench's place."""
EDGE = 50
"""Cycles at either end that are left out: starting and ending."""


def cpu_s() -> float:
    """Return the processor time of this process, user and system, all threads, s."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def ours(channel: str, rate_hz: int, cycles: int, folder: Path, *, served: bool = True) -> float:
    """Make a dry run of `bowden trial`, controller and recorder in every cycle; return the CPU time of a cycle, s.

    Nodes that are not served by `bowden bench` are not brought up.
    """
    network = Network(rate_hz=rate_hz)
    gait = Gait(peak_n=PEAK_N, period_s=PERIOD_S, cycles=math.ceil(cycles / rate_hz / PERIOD_S), settle=0)
    planned = PreparedExperiment(ExperimentSetup(paper_reference(PEAK_N, PERIOD_S), network, gait=gait, dry_run=True))
    walked = (gait.cycles + 1) * planned.table.samples + planned.rest - planned.first
    used = []

    def perform(exchange: Exchange) -> None:
        before = cpu_s()
        planned.perform(exchange)
        used.append((cpu_s() - before) / walked)

    recorder = Recorder(folder / "ours.mcap", metadata={}, attachments={})  # its writer outside SCHED_FIFO
    with RecordedBus(channel) as bus, prepared():
        bus.set_filters(WANTED)
        link = Link(bus, time.time_ns)
        if served:
            outcome = run_safely(link, bus, recorder, network, Limits(), perform)
            if outcome.reason is not None:
                raise RuntimeError(outcome.reason)
        else:
            _cycle(link, Log(bus, recorder, TARGETS_COB_ID), network, perform)
        recorder.close({})
    return used[0]


def _cycle(link: Link, log: Log, network: Network, perform: Callable[[Exchange], None]) -> None:
    """Run the cycle of `run_safely` without bring-up and safe stop."""
    described = wire(network)
    guard = Guard(link, described, log, Limits(), network.heartbeat_timeout_ms * 1_000_000)
    budget = bus_load.refuse(described).deadline_ns - bus_load.frame_bits(0) * bus_load.bit_ns(described)
    exchange = Exchange(link, described, log, guard, budget)
    guard.active = False
    with collector_frozen():
        link.sync_start(described.period_ns)
        exchange.begin()
        for _ in range(BEATEN):
            exchange.hold()
        guard.active = True
        perform(exchange)
        exchange.end()
        link.sync_stop()


def stock(channel: str, rate_hz: int, cycles: int, folder: Path, *, served: bool = True) -> float:
    """Run canopen's Network and RemoteNodes, python-can's notifier and log writer; return a cycle's CPU time, s."""
    described = wire(Network(rate_hz=rate_hz))
    network = canopen.Network()
    network.connect(interface="socketcan", channel=channel)
    network.notifier.add_listener(can.Logger(folder / "stock.log"))
    nodes = {node: network.add_node(node, str(packaged(name))) for node, name in FILES.items()}
    for number, node in nodes.items():
        map_pdo(node.tpdo[1], described.pdos(number)[0])
    map_pdo(nodes[SERVO].rpdo[1], described.pdos(SERVO)[1])
    if served:
        _brought_up(network, nodes, described)
    network.sync.start(1 / rate_hz)  # the kernel's broadcast manager
    used = _exchange([node.tpdo[1] for node in nodes.values()], nodes[SERVO].rpdo[1], cycles)
    network.sync.stop()
    network.disconnect()
    return used


def _brought_up(network: Any, nodes: Mapping[int, Any], described: WireLayout) -> None:
    network.nmt.send_command(NmtCommand.ENTER_PRE_OPERATIONAL)
    for number, node in nodes.items():
        for index, subindex, value in described.setup(number):
            kind = described.nodes[number].dictionary.entries[key(index, subindex)].data_type
            node.sdo.download(index, subindex, encode(kind, value))
    network.send_periodic(HEARTBEAT_BASE + MASTER, b"\x05", 0.1)
    network.nmt.send_command(NmtCommand.START)


def _exchange(inputs: list[Any], targets: Any, cycles: int) -> float:
    """Wait for the last of the four TPDOs, read all, send targets; return the processor time of a cycle, s."""
    before = cpu_s()
    for _ in range(cycles):
        inputs[-1].wait_for_reception(1.0)
        servo, knee, *_ = [[variable.raw for variable in one.map] for one in inputs]
        targets.map[0].raw, targets.map[1].raw = servo[1], knee[1]
        targets.transmit()
    return (cpu_s() - before) / cycles


def answering(channel: str) -> int:
    """Answer each SYNC with four TPDOs, and send heartbeats; end 0.5 s after the last SYNC."""
    plans = wire(Network()).tpdo
    frames = [can.Message(arbitration_id=cob_id, data=plan.pack_si(*(0.0,) * len(plan.fields)), is_extended_id=False)
              for cob_id, plan in plans.items()]
    beats = [can.Message(arbitration_id=HEARTBEAT_BASE + node, data=[NmtState.OPERATIONAL], is_extended_id=False)
             for node in FILES]
    patience, answered = None, 0
    with KernelBus(channel) as bus, prepared():
        bus.set_filters([{"can_id": SYNC_COB_ID, "can_mask": 0x7FF, "extended": False}])
        while bus.recv(patience) is not None:
            for frame in frames if answered % BEATEN else beats + frames:
                bus.send(frame)
            patience, answered = 0.5, answered + 1
    return 0


@contextmanager
def peer(folder: Path, channel: str, rate_hz: int, *, served: bool) -> Iterator[None]:
    """Run the answering side: `bowden bench` if `served`, else four TPDOs for each SYNC."""
    if served:
        with rig.bench(folder, channel, "--rate", rate_hz):
            yield
        return
    process = rig.Process(folder, "answering", lambda: answering(channel))
    yield
    process.wait()


def watched(tap: KernelBus, process: rig.Process) -> tuple[rig.Told, list[tuple[int, int]]]:
    """Wait until a master has ended, then read every frame; reading earlier would cost the cycle processor time."""
    told = process.wait()
    return told, [(each.time_ns, each.arbitration_id) for each in iter(lambda: tap.recv(0), None)]


def shown(rows: list[tuple[int, int]], rate_hz: int) -> dict[str, Any]:
    """Return rate, missed cycles and delays after SYNC from recorded frames, without `EDGE` cycles at either end."""
    times = {can_id: np.array([row[0] for row in rows if row[1] == can_id], dtype=np.int64)
             for can_id in (SYNC_COB_ID, TARGETS_COB_ID, *(TPDO_BASE + node for node in FILES))}
    sync = times[SYNC_COB_ID][EDGE:-EDGE]
    inputs = np.column_stack([_after(sync, times[TPDO_BASE + node]) for node in FILES]).max(axis=1)
    targets = _after(sync, times[TARGETS_COB_ID])
    jitter = np.abs(np.diff(sync) - 1e9 / rate_hz)
    return {
        "cycles": len(sync) - 1, "held_hz": (len(sync) - 1) * 1e9 / float(sync[-1] - sync[0]),
        "missed": int(np.count_nonzero(np.isnan(inputs) | np.isnan(targets))),
        "jitter_us": [float(np.quantile(jitter, 0.99)) / 1e3, float(jitter.max()) / 1e3],
        "inputs_us": _middle_and_worst(inputs), "targets_us": _middle_and_worst(targets),
    }


def _after(sync: np.ndarray[Any, Any], stamps: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the time from each SYNC but the last to the first such frame before the next one, ns; NaN without one."""
    place = np.searchsorted(stamps, sync[:-1])
    found = np.append(stamps, np.iinfo(np.int64).max)[place]
    return np.where(found < sync[1:], (found - sync[:-1]).astype(np.float64), np.nan)


def _middle_and_worst(times_ns: np.ndarray[Any, Any]) -> list[float | None]:
    there = times_ns[~np.isnan(times_ns)] / 1e3
    return [float(np.median(there)), float(there.max())] if len(there) else [None, None]


def measured(master_on: str, nodes_on: str, rate_hz: int, served: bool, cycles: int) -> Iterator[dict[str, Any]]:
    """Yield the timing and processor time of each master on one wiring at one rate."""
    rig.rehearse()
    for name, master in (("bowden", ours), ("canopen", stock)):
        with tempfile.TemporaryDirectory() as at:
            folder = Path(at)
            with (peer(folder, nodes_on, rate_hz, served=served),
                  KernelBus(master_on, receive_buffer=QUEUE) as tap):
                run = partial(master, master_on, rate_hz, cycles, folder, served=served)
                told, rows = watched(tap, rig.Process(folder, "master", partial(tell, run)))
            lost = tap.lost
        if told.status or lost:
            raise RuntimeError(f"{name}: {told.stderr or f'{lost} frames found the queue full'}")
        yield {"master": name, "master_on": master_on, "nodes_on": nodes_on, "rate_hz": rate_hz,
               "nodes": "`bowden bench`" if served else "answers", "cpu_us": 1e6 * told.result,
               **shown(rows, rate_hz)}


def tell(run: Callable[[], float]) -> int:
    """Run a master and print its processor time."""
    print(run())
    return 0


def in_guest(arguments: list[str]) -> list[dict[str, Any]]:
    """Run this module in a guest and return the rows of its table."""
    from tests.warm import FOR_GUESTS, warm_guests

    warm_guests()
    with tempfile.TemporaryFile("w+") as out:
        ended = subprocess.run(
            [GUEST, "-b", "icount", "-t", str(LIMIT_S), "-m", "2048", "--", sys.executable, "-m",
             "benchmarks.socketcan", *arguments],
            cwd=ROOT, env={**os.environ, **FOR_GUESTS}, stdout=out, stderr=subprocess.STDOUT, check=False)
        out.seek(0)
        lines = out.read().splitlines()
    if ended.returncode:
        sys.exit("\n".join(["the guest ended with status", str(ended.returncode), *lines[-20:]]))
    return [json.loads(line) for line in lines if line.startswith("{")]


def adapters() -> str:
    """Return the largest rate at which the targets follow the inputs through each adapter within one cycle.

    The round trip adds to the compute budget: `[network] compute_budget_us` of a bench with that adapter.
    """
    head = ("adapter", "round trip (µs)", "origin", "`compute_budget_us`", "rate of the packaged bench (Hz)")
    network, rows = Network(), []
    for name, round_trip_us, origin in ADAPTERS:
        budget_us = network.compute_budget_us + round_trip_us
        rate = rate_that_fits(wire(dataclasses.replace(network, compute_budget_us=budget_us)))
        rows.append((name, str(round_trip_us), origin, str(budget_us), str(rate)))
    return markdown(head, rows)


def _pair(values: Sequence[float | None]) -> str:
    return " / ".join("–" if value is None else f"{value:.0f}" for value in values)


def _missed(told: dict[str, Any]) -> str:
    """Return the missed cycles per 10⁵, and the upper bound of the rate at 95 %."""
    missed, cycles = int(told["missed"]), int(told["cycles"])
    return f"{1e5 * missed / cycles:.0f} (≤ {1e5 * upper_bound(missed, cycles):.0f})"


def _cells(told: dict[str, Any]) -> tuple[str, ...]:
    return (f"{told['master_on']}, {told['nodes_on']}", told["nodes"], str(told["rate_hz"]), told["master"],
            str(told["cycles"]), f"{told['held_hz']:.2f}", _missed(told), _pair(told["jitter_us"]),
            _pair(told["inputs_us"]), _pair(told["targets_us"]), f"{told['cpu_us']:.0f}")


def main() -> None:
    """Run the benchmark in a guest and write its table; in the guest, run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=500)
    parser.add_argument("--run", type=int, choices=range(len(RUNS)), action="append", help="only this row of RUNS")
    parser.add_argument("--adapters", action="store_true", help="rate that each kind of adapter carries")
    chosen = parser.parse_args()
    if "CANVM" in os.environ:
        for i in chosen.run or range(len(RUNS)):
            for row in measured(*RUNS[i], chosen.cycles):
                print(json.dumps(row), flush=True)
        return
    name, text = ("adapters", adapters()) if chosen.adapters else (
        "socketcan", markdown(HEAD, map(_cells, in_guest(sys.argv[1:]))))
    print(text)
    if not chosen.run:
        put(PAGE, name, text)


if __name__ == "__main__":
    main()
