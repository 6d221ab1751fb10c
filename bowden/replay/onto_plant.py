"""The recorded commands into a simulated bench: its responses, and the residuals."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bowden import output_files
from bowden.bench.buses import BusSettings, opened_one, simulating
from bowden.progress import SILENT, Progress
from bowden.trials import provenance, session
from bowden.trials.recorded import sections

if TYPE_CHECKING:
    from bowden.replay.plant_residuals import Residuals
    from bowden.replay.schedule import Rows
    from eds.bench.bench_network import WireLayout
    from trial.read import Trial


def replay(
    recorded: Trial, chosen: BusSettings, output: Path | None = None, *, overwrite: bool = False,
    progress: Progress = SILENT,
) -> Residuals:
    """Play the master's commands to a simulated bench, and compare its nodes' responses with the recording.

    `output` gets the residuals as a separate trial.
    """
    from bowden.replay.plant_residuals import residuals
    from eds.bench.bench_network import wire

    output_files.refuse([output], overwrite=overwrite, inputs=[recorded.path])
    described = wire(sections(recorded)["network"])
    session.compile_laws(simulated=True, progress=progress)
    found = residuals(recorded, simulate(recorded, chosen, described, progress), described)
    if output is not None:
        _write(recorded, found, output, overwrite=overwrite)
    return found


def simulate(recorded: Trial, chosen: BusSettings, described: WireLayout, progress: Progress = SILENT) -> Rows:
    """Return every frame of a simulated bench under the recorded commands, at the same bus times."""
    from bowden.replay import plant_residuals, playing_bus
    from bowden.replay.player import Player
    from bowden.replay.schedule import plan
    from trial.convert.frames import FrameRows

    frames = recorded.frames
    bitrate = described.network.bitrate
    with opened_one(chosen, bitrate, **simulating(described.network), receive_own_messages=True) as bus:
        lead_ns = lengths_ns(frames, bitrate) + bus.bench.master_turnaround_ns
        schedule = plan(frames, plant_residuals.commands(described), lead_ns)
        heard = FrameRows()
        player = Player(schedule, playing_bus.Outlet({}, bus).send)
        origin_ns = plant_residuals.origin_ns(int(frames["time_ns"].min()), int(schedule.times[0]))

        def hear(message: Any) -> None:
            data = bytes(message.data)
            heard.add((message.time_ns, message.arbitration_id, 0, len(data), 0, not message.is_rx, data))

        with progress.running("plant") as update:
            playing_bus.wait(bus, bus.time_ns, origin_ns, hear)
            player.play(origin_ns)
            playing_bus.run(player, bus, bus.time_ns, hear, update)
    return heard.rows()


def lengths_ns(frames: Rows, bitrate: int) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the duration of each recorded frame on the wire, ns."""
    from trial.mcap_file import cdr
    from virtual_bus.wire.bit_counts import bits_of

    flags = frames["flags"]
    bits = bits_of(frames["can_id"], frames["dlc"], frames["data"], flags & cdr.REMOTE != 0, flags & cdr.EXTENDED != 0)
    return bits * (1_000_000_000 // bitrate)


def _write(recorded: Trial, found: Residuals, output: Path, *, overwrite: bool) -> None:
    from bowden.replay.plant_residuals import table
    from trial.assemble import TrialContent, write

    signals, columns = table(recorded, found)
    write(output, TrialContent(found.time_ns, columns, signals=signals),
          metadata={**recorded.metadata, "experiment": "residuals", "commit": provenance.commit()},
          result={}, attachments=recorded.attachments, overwrite=overwrite)
