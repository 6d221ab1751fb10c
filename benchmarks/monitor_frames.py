"""Frames that `bowden monitor` puts into words in a second of one processor, beside cantools' decoder.

    python -m benchmarks.monitor_frames

Both sides have the frames of a short trial as python-can messages and write one line of text a frame to nowhere. Ours
puts every frame into words; cantools decodes the PDOs by the DBC that `bowden monitor --dbc` writes, and shows the
bytes of all others. The last line is the whole command on that trial, reading and printing included.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import can

import bowden
from benchmarks.paired import Turn, compare
from bowden.cli import app as cli
from eds.bench.bench_network import Network, wire
from master.node_access.frame_words import of_wire
from master.node_access.signal_files import write_dbc

TURNS = 30
FRAMES = 2000
ASKED_PER_S = 20_000


def recorded(trial: bowden.Trial) -> list[can.Message]:
    """Return the first frames of a trial."""
    return [can.Message(int(frame["time_ns"]) / 1e9, int(frame["can_id"]), is_extended_id=False,
                        data=bytes(frame["data"][:frame["dlc"]])) for frame in trial.frames[:FRAMES]]


def lines_of_ours(messages: list[can.Message], out: TextIO) -> Iterator[None]:
    """Write each frame in words."""
    read = of_wire(wire(Network())).read
    while True:
        for message in messages:
            words = read(message.arbitration_id, bytes(message.data))
            print(f"{message.timestamp:12.6f}  {message.arbitration_id:03X}  {words.node_id:3}  {words.text}", file=out)
        yield


def lines_of_cantools(messages: list[can.Message], out: TextIO, dbc: Path) -> Iterator[None]:
    """Write each PDO by cantools' decoder, each other frame as bytes."""
    import cantools

    database: Any = cantools.database.load_file(dbc)
    known = {message.frame_id: message for message in database.messages}
    while True:
        for message in messages:
            layout = known.get(message.arbitration_id)
            if layout is None:
                text = message.data.hex(" ")
            else:
                values = layout.decode(bytes(message.data))
                text = f"{layout.name}: " + ", ".join(
                    f"{signal.name} {values[signal.name]} {signal.unit or ''}" for signal in layout.signals)
            print(f"{message.timestamp:12.6f}  {message.arbitration_id:03X}  {text}", file=out)
        yield


def whole_command(trial: bowden.Trial, out: TextIO) -> float:
    """Return the frames that the command shows in a second of this process's processor time."""
    with contextlib.redirect_stdout(out):
        cli.run(["monitor", str(trial.path), "--for", "0"])
        began = time.process_time()
        cli.run(["monitor", str(trial.path)])
        return len(trial.frames) / (time.process_time() - began)


def main() -> None:
    """Print the processor time of a frame, ours and cantools', and the frames a second of the whole command."""
    trial = bowden.run(bowden.Experiment(period_s=1.1, cycles=2, settle=0))
    messages = recorded(trial)
    with tempfile.TemporaryDirectory() as folder, open(os.devnull, "w", encoding="utf-8") as nowhere:
        dbc = Path(folder) / "bench.dbc"
        write_dbc(of_wire(wire(Network())), dbc)

        def repeated(each: Iterator[None], turn: Turn) -> None:
            while True:
                turn()
                next(each)

        found = compare(lambda turn: repeated(lines_of_ours(messages, nowhere), turn),
                        lambda turn: repeated(lines_of_cantools(messages, nowhere, dbc), turn),
                        units=len(messages), turns=TURNS)
        shown_per_s = whole_command(trial, nowhere)
    print(found.row(f"a frame in words, µs (below {1e6 / ASKED_PER_S:.0f}: {ASKED_PER_S} frames/s)",
                    "the same frames, PDOs by cantools"))
    print(f"bowden monitor {len(trial.frames)} frames: {shown_per_s:.0f} frames/s of one processor")


if __name__ == "__main__":
    main()
