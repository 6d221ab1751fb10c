"""`bowden replay --onto bus --nodes-only`: the recorded nodes before a master that lives, and what it answers.

The rule of this file: on the virtual bus the master is this process's own, running the recorded experiment; on a
real one it is whoever is there.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from bowden.buses import Chosen, opened_one
from bowden.cli import terminal
from bowden.recorded import experiment, script, sections
from bowden.replay.onto_plant import lengths_ns
from parameters import InputError

if TYPE_CHECKING:
    from bowden.replay.recorded_nodes import Answer, RecordedNodes
    from trial.read import Trial

SILENCE_NS = 3_000_000_000
"""A master that says nothing for so long has finished."""


def replay(recorded: Trial, chosen: Chosen, bitrate: int, *, json: bool) -> int:
    """Let a master meet the recorded nodes; 1 where it does not say what the recorded one said."""
    from bowden.replay.plant_residuals import commands
    from bowden.replay.recorded_nodes import RecordedNodes, compare, said
    from eds.bench import wire

    masters = commands(wire(sections(recorded)["network"])).cob_ids
    frames = recorded.frames
    if not len(frames):
        raise InputError(f"{recorded.path}: the trial holds no CAN frames; give one that was recorded on a bus.")
    nodes = RecordedNodes(frames, frames["time_ns"] - lengths_ns(frames, bitrate), masters)
    if chosen.simulated:
        with terminal.waiting("a master meets the recorded nodes", shown=not json):
            _own(recorded, nodes, str(chosen.arguments["channel"]), bitrate)
    else:
        _theirs(nodes, chosen, bitrate)
    found = compare(said(frames, masters), nodes.heard)
    terminal.emit({"trial": str(recorded.path), "onto": "bus", "nodes_only": True, **found.as_json()}) \
        if json else _tell(found)
    return 0 if found.same else 1


def _own(recorded: Trial, nodes: RecordedNodes, channel: str, bitrate: int) -> None:
    """The recorded experiment, run by this process's master on a wire with the recorded nodes on it."""
    from master.motion import scripted_experiments
    from master.motion.experiment import run
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


def _theirs(nodes: RecordedNodes, chosen: Chosen, bitrate: int) -> None:
    """The recorded nodes on a real bus, until nothing is left to say or the master has finished."""
    from virtual_bus.bench import Bench
    from virtual_bus.serve import serve

    bench = Bench([nodes], bitrate=bitrate, node_turnaround_ns=0)
    terminal.remark("the recorded nodes are on the bus; start a master.")

    def finished() -> bool:
        return bool(nodes.heard) and bench.kernel.now_ns - nodes.last_ns > SILENCE_NS

    with opened_one(chosen, bitrate) as bus:
        serve(bus, bench, time.monotonic_ns, finished, echoes=chosen.arguments["interface"] == "udp_multicast")


def _tell(found: Answer) -> None:
    print(f"{found.frames} frames of the master compared, {found.beyond} after the recording's end; "
          f"times differ by {found.timing_max_us:.1f} µs at most.")
    if found.first is None:
        print("The same, byte for byte.")
        return
    first = found.first
    print(f"First difference: {first.cob_id:03X} number {first.number}, {first.time_s:.3f} s from the master's first "
          f"frame: was {first.recorded}, now {first.live}.")
    terminal.table("frames that differ", ("COB-ID", "frames"), [
        (name, str(count)) for name, count in found.differing.items()])
