"""Replay of a recording's nodes to a running master, whose frames are compared with the recorded ones.

On the virtual bus the master is this process's own and runs the recorded experiment; on a real bus it is another
program.
"""

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bowden.bench.buses import BusSettings, opened_one
from bowden.progress import SILENT, Progress
from bowden.replay import Comparison
from bowden.replay.onto_plant import commands, lengths_ns
from bowden.replay.player import Integers, Rows, frame_of
from bowden.trials.recorded import experiment, script, sections
from eds.bench.bench_network import wire
from master.motion import scripted_experiments
from master.motion.experiment_run import run
from master.network.link import Link
from nodes.recorded_nodes import MasterFrame, OnWire, RecordedNodes
from parameters import InputError
from trial.mcap_file import cdr
from trial.read import Trial
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.serve import serve


@dataclass(frozen=True)
class FrameDifference:
    """First frame of the live master that differs from the recorded one.

    `number`: among the frames of its COB-ID; `time_s`: since the master's first frame; data in hexadecimal.
    """

    cob_id: int
    number: int
    time_s: float
    recorded: str | None
    live: str | None


@dataclass(frozen=True, kw_only=True)
class MasterComparison(Comparison[FrameDifference]):
    """Frames of a live master against the recorded ones: frames compared; frames that differ by COB-ID.

    `beyond` counts frames after the recording's end; `timing_max_us` is the largest difference in time, both counted
    from the first frame.
    """

    frames: int
    beyond: int
    timing_max_us: float


def compare(recorded: Sequence[MasterFrame], live: Sequence[MasterFrame]) -> MasterComparison:
    """Compare two masters COB-ID by COB-ID: the n-th frame of one with the n-th of the other."""
    one, other = _by_cob_id(recorded), _by_cob_id(live)
    differences: list[FrameDifference] = []
    late_ns = 0
    for can_id, then in one.items():
        now = other.get(can_id, [])
        for number, (time_ns, payload) in enumerate(then):
            answered = now[number] if number < len(now) else None
            if answered is None or answered[1] != payload:
                differences.append(FrameDifference(can_id, number, time_ns / 1e9, payload, answered and answered[1]))
            if answered is not None:
                late_ns = max(late_ns, abs(answered[0] - time_ns))
    end_ns = max((then[-1][0] for then in one.values()), default=0)
    beyond = 0
    for can_id, now in other.items():
        for number in range(len(one.get(can_id, ())), len(now)):
            time_ns, payload = now[number]
            beyond += time_ns > end_ns
            if time_ns <= end_ns:
                differences.append(FrameDifference(can_id, number, time_ns / 1e9, None, payload))
    counted = Counter(f"{difference.cob_id:03X}" for difference in differences)
    first = min(differences, key=lambda difference: difference.time_s, default=None)
    return MasterComparison(frames=len(recorded), beyond=beyond, timing_max_us=late_ns / 1e3,
                            differing=dict(sorted(counted.items())), first=first)


def _by_cob_id(heard: Sequence[MasterFrame]) -> dict[int, list[tuple[int, str]]]:
    """Return by COB-ID the time from the first frame, ns, and payload of each frame."""
    found: dict[int, list[tuple[int, str]]] = {}
    for time_ns, frame in heard:
        found.setdefault(frame.can_id, []).append((time_ns - heard[0].time_ns, frame.data.hex(" ")))
    return found


def on_wire(frames: Rows, lengths_ns: Integers) -> list[OnWire]:
    """Return the frames of a recording with their times on the wire, without error frames."""
    return [OnWire(int(row["time_ns"] - length), int(row["time_ns"]), frame_of(row))
            for row, length in zip(frames, lengths_ns, strict=True) if not row["flags"] & cdr.ERROR]


def said(frames: Rows, masters: frozenset[int]) -> list[MasterFrame]:
    """Return the master's frames of a recording."""
    chosen = frames[np.isin(frames["can_id"], list(masters)) & (frames["flags"] & cdr.ERROR == 0)]
    return [MasterFrame(int(row["time_ns"]), frame_of(row)) for row in chosen]


SILENCE_NS = 3_000_000_000
"""Silence of a master after which it has finished."""


def replay(recorded: Trial, chosen: BusSettings, bitrate: int, *, progress: Progress = SILENT) -> MasterComparison:
    """Let a master run against the recorded nodes; return its differences from the recorded master.

    Raises `InputError` for a trial without frames.
    """
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
    bench = Bench([nodes], bitrate=bitrate, node_turnaround_ns=0)
    progress.remark("the recorded nodes are on the bus; start a master.")

    def finished() -> bool:
        return bool(nodes.heard) and bench.kernel.now_ns - nodes.last_ns > SILENCE_NS

    with opened_one(chosen, bitrate) as bus:
        serve(bus, bench, time.monotonic_ns, finished, echoes=chosen.arguments["interface"] == "udp_multicast")
