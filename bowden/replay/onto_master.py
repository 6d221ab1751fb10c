"""The recorded nodes with a running master, and a comparison of its frames.

On the virtual bus the master is this process's own and runs the recorded experiment; on a real bus it is another
program.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from bowden.bench.buses import BusSettings, opened_one
from bowden.progress import SILENT, Progress
from bowden.replay.onto_plant import lengths_ns
from bowden.trials.recorded import experiment, script, sections
from parameters import InputError

if TYPE_CHECKING:
    from bowden.replay.master_comparison import MasterComparison
    from nodes.recorded_nodes import RecordedNodes
    from trial.read import Trial

SILENCE_NS = 3_000_000_000
"""Silence of a master after which it has finished."""


def replay(recorded: Trial, chosen: BusSettings, bitrate: int, *, progress: Progress = SILENT) -> MasterComparison:
    """Let a master run against the recorded nodes; return its differences from the recorded master.

    Raises `InputError` for a trial without frames.
    """
    from bowden.replay.master_comparison import compare, on_wire, said
    from bowden.replay.plant_residuals import commands
    from eds.bench.bench_network import wire
    from nodes.recorded_nodes import RecordedNodes

    masters = commands(wire(sections(recorded)["network"])).cob_ids
    frames = recorded.frames
    if not len(frames):
        raise InputError(f"{recorded.path}: the trial holds no CAN frames; give one that was recorded on a bus.")
    nodes = RecordedNodes(on_wire(frames, lengths_ns(frames, bitrate)), masters)
    if chosen.simulated:
        with progress.waiting("a master runs against the recorded nodes"):
            _own(recorded, nodes, str(chosen.arguments["channel"]), bitrate)
    else:
        _theirs(nodes, chosen, bitrate, progress)
    return compare(said(frames, masters), nodes.heard)


def _own(recorded: Trial, nodes: RecordedNodes, channel: str, bitrate: int) -> None:
    """Run the recorded experiment by this process's master on a wire with the recorded nodes."""
    from master.motion import scripted_experiments
    from master.motion.experiment_run import run
    from master.network.link import Link
    from virtual_bus.bench import Bench
    from virtual_bus.bus import BowdenBus

    planned, scripted = experiment(recorded, scripts=True), script(recorded)
    bench = Bench([nodes], channel=channel, bitrate=bitrate, node_turnaround_ns=0)
    with BowdenBus(channel, bench=bench) as bus, BowdenBus(channel) as tap:
        link = Link(bus, bus.time_ns)
        if scripted:
            scripted_experiments.run(link, tap, None, planned, scripted)
        else:
            run(link, tap, None, planned)


def _theirs(nodes: RecordedNodes, chosen: BusSettings, bitrate: int, progress: Progress) -> None:
    """Run the recorded nodes on a real bus, until all frames are sent or the master has finished."""
    from virtual_bus.bench import Bench
    from virtual_bus.serve import serve

    bench = Bench([nodes], bitrate=bitrate, node_turnaround_ns=0)
    progress.remark("the recorded nodes are on the bus; start a master.")

    def finished() -> bool:
        return bool(nodes.heard) and bench.kernel.now_ns - nodes.last_ns > SILENCE_NS

    with opened_one(chosen, bitrate) as bus:
        serve(bus, bench, time.monotonic_ns, finished, echoes=chosen.arguments["interface"] == "udp_multicast")
