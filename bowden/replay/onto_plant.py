"""`bowden replay --onto plant`: the recorded commands into the simulated bench, residuals out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bowden import provenance, session
from bowden.buses import Chosen, opened_one
from bowden.cli import outputs, terminal
from bowden.recorded import sections

if TYPE_CHECKING:
    from bowden.replay.plant_residuals import Residuals
    from bowden.replay.schedule import Rows
    from eds.bench import Wire
    from trial.read import Trial


def replay(recorded: Trial, chosen: Chosen, output: Path | None, *, overwrite: bool, json: bool) -> int:
    """Play what the master sent, compare what the nodes answer; 1 where it is not the same, bit for bit."""
    from bowden.replay.plant_residuals import residuals
    from eds.bench import wire

    outputs.refuse([output], overwrite=overwrite)
    described = wire(sections(recorded)["network"])
    session.compile_laws(simulated=True, quiet=json)
    found = residuals(recorded, simulate(recorded, chosen, described, quiet=json), described)
    if output is not None:
        _write(recorded, found, output, overwrite=overwrite)
    result = {"trial": str(recorded.path), "onto": "plant", "serial": chosen.serial, **found.as_json()}
    terminal.emit(result) if json else _tell(found, output)
    return 0 if found.same else 1


def simulate(recorded: Trial, chosen: Chosen, described: Wire, *, quiet: bool) -> Rows:
    """Every frame of a simulated bench that is told what the recorded one was told, at the same bus times."""
    from bowden.replay import plant_residuals, playing_bus
    from bowden.replay.player import Player
    from bowden.replay.schedule import plan
    from trial.convert.frames import Gathered

    frames = recorded.frames
    bitrate = described.network.bitrate
    with opened_one(chosen, bitrate, rate_hz=described.network.rate_hz, receive_own_messages=True) as bus:
        lead_ns = lengths_ns(frames, bitrate) + bus.bench.master_turnaround_ns
        schedule = plan(frames, plant_residuals.commands(described), lead_ns)
        heard = Gathered()
        player = Player(schedule, playing_bus.Outlet({}, bus).send)
        origin_ns = plant_residuals.origin_ns(int(frames["time_ns"].min()), int(schedule.times[0]))

        def hear(message: Any) -> None:
            data = bytes(message.data)
            heard.add((message.time_ns, message.arbitration_id, 0, len(data), 0, not message.is_rx, data))

        with terminal.progress("plant", shown=not quiet) as update:
            playing_bus.wait(bus, bus.time_ns, origin_ns, hear)
            player.play(origin_ns)
            playing_bus.run(player, bus, bus.time_ns, hear, update)
    return heard.rows()


def lengths_ns(frames: Rows, bitrate: int) -> np.ndarray[Any, np.dtype[np.int64]]:
    """How long each recorded frame was on the wire."""
    from trial.mcap_file import cdr
    from virtual_bus.bits import bits_of

    flags = frames["flags"]
    bits = bits_of(frames["can_id"], frames["dlc"], frames["data"], flags & cdr.REMOTE != 0, flags & cdr.EXTENDED != 0)
    return bits * (1_000_000_000 // bitrate)


def _write(recorded: Trial, found: Residuals, output: Path, *, overwrite: bool) -> None:
    from bowden.replay.plant_residuals import table
    from trial.assemble import Content, write

    signals, columns = table(recorded, found)
    write(output, Content(found.time_ns, columns, signals=signals),
          metadata={**recorded.metadata, "experiment": "residuals", "commit": provenance.commit()},
          result={}, attachments=recorded.attachments, overwrite=overwrite)


def _tell(found: Residuals, output: Path | None) -> None:
    print(f"{len(found.time_ns)} control cycles, recorded − simulated:"
          f" {'the same, bit for bit.' if found.same else 'they differ.'}")
    terminal.table("residuals", ("signal", "unit", "rows", "RMS", "in the gait", "largest", "at (s)"), [
        (name, row.unit, str(row.differing + row.one_sided), *(
            f"{value:.3g}" for value in (row.rms, row.gait_rms, row.largest, row.largest_at_s)))
        for name, row in found.figures.items()])
    if output is not None:
        print(f"Residuals: {output}")
