"""`bowden monitor` and `bowden record`: the frames of a bus in words, or everything on it in MCAP; both only listen."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Final

from bowden.bench import buses
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.options import Bus, argument, keyed, new_file, option, parsed
from bowden.cli.terminal import CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    from bowden.trials.monitored_frames import FrameStatistics, of_bus, of_file
    from bowden.trials.recording import BusRecording
    from eds.bench.bench_network import wire
    from eds.dictionary import Dictionary, read
    from master.node_access.frame_words import FrameReader, of_wire
    from master.node_access.signal_files import SignalRecording, write_dbc

KINDS: Final = ("nmt", "sync", "time", "emcy", "pdo", "sdo", "heartbeat", "lss", "other")


@app.command(example="bowden monitor --for 0.2 --only sdo,pdo,emcy")
def monitor(
    reached: Bus,
    source: Annotated[Path | None, argument("[FILE]", "Trial, log (.log, .asc, .blf), - for candump.")] = None,
    eds: Annotated[list[str] | None, option("EDS or DCF of a node; default: the bench's.", "ID=FILE", "--eds")] = None,
    only: Annotated[str | None, option(f"Only {', '.join(KINDS)}.", "KINDS")] = None,
    nodes: Annotated[str | None, option("Only these node ids.", "IDS", "--node")] = None,
    seconds: Annotated[float | None, option(
        "Time to listen (default: until Ctrl-C; simulated: 1 s).", "S", "--for", min=0.0)] = None,
    table: Annotated[bool, option("Only the table of rates and load, at the end.")] = False,
    dbc: Annotated[Path | None, new_file(
        "Write the PDOs' layout as DBC.", "a layout of PDOs", ".dbc", name="--dbc")] = None,
    mf4: Annotated[Path | None, new_file(
        "Write the PDOs' values as MF4.", "a recording of values", ".mf4", name="--mf4")] = None,
) -> CommandAnswer | int:
    """Show each frame of a bus or of a file in words.

    PDO values have names and units, SDO transfers are put together, abort and EMCY codes are in words.
    With --json one object a line.
    """
    network = reached.network()
    kinds = frozenset(KINDS if only is None else only.split(","))
    if unknown := sorted(kinds - set(KINDS)):
        raise InputError(f"--only {unknown[0]}: is no kind of frame; give some of {','.join(KINDS)}.")
    wanted = parsed("--node", nodes or "", "expected node ids; write for instance 1,5", lambda ids: {
        int(one) for one in ids.split(",") if ids})
    reader = FrameReader(dict(keyed("--eds", eds, "ID=FILE; write for instance 5=vendor.eds", _dictionary))
                         ) if eds else of_wire(wire(network))
    if dbc is not None:
        terminal.remark(f"{dbc}: {write_dbc(reader, dbc, overwrite=True)} PDOs.")
    recording, seen, bus = SignalRecording(reader), FrameStatistics(reader), None
    with ExitStack() as opened:
        if source is None:
            chosen = reached.configured()
            bus = opened.enter_context(buses.opened_one(chosen, network.bitrate))
            seconds = 1.0 if seconds is None and chosen.simulated else seconds
        for frame in of_bus(bus, seconds) if source is None else of_file(source, terminal.remark):
            words = seen.read(frame)
            if mf4 is not None and not frame.in_words():
                recording.take(frame.time_ns, frame.can_id, frame.data)
            if table or words.kind not in kinds or (wanted and words.node_id not in wanted):
                continue
            if terminal.quiet():
                print(json.dumps({"time_ns": frame.time_ns, "can_id": frame.can_id, "data": frame.data.hex(),
                                  **words._asdict()}, ensure_ascii=False))  # no number here is undefined
            else:
                print(f"{(frame.time_ns - (seen.first_ns or 0)) / 1e9:12.6f}  {frame.can_id:03X}  "
                      f"{words.node_id or '':3}  {words.text}")
        lost = getattr(bus, "lost", 0)
    if mf4 is not None:
        terminal.remark(f"{mf4}: values of {recording.write(mf4, overwrite=True)} PDOs.")
    if lost:
        terminal.remark(f"{lost} frames were lost, because they came faster than they were read.")
    if not table:
        return 0
    result = seen.as_json(network.bitrate, lost)
    return CommandAnswer(result, [
        *("{can_id:03X}  {name:10}  {frames:8} frames  {per_second:10.1f} /s".format_map(one)
          for one in result["identifiers"]),
        f"{sum(one['frames'] for one in result['identifiers'])} frames in {result['seconds']:.3f} s, "
        f"{result['load_percent']:.1f} % of the bus at most."])


def _dictionary(node: str, path: str) -> tuple[int, Dictionary]:
    if not node.isdecimal() or not 1 <= int(node) <= 127:
        raise ValueError
    return int(node), read(path, int(node))


@app.command(example="bowden record --interface virtual --channel bench --for 1 -o bus.mcap")
def record(
    output: options.NewRecording, interface: options.AnyInterface, channel: options.Channel = None,
    bitrate: options.Bitrate = None, option: options.Extra = None, *, seconds: options.Seconds = None,
    frames: Annotated[int | None, option("End after so many frames.", "N", min=1)] = None,
    max_size: Annotated[float | None, option("A new file after so many MB.", "MB", min=0.01)] = None,
    max_time: Annotated[float | None, option("A new file after so many s of bus time.", "S", min=0.001)] = None,
    config: options.Config = None,
) -> CommandAnswer:
    """Record a bus, listening only.

    Every frame and the control cycles that they make, until Ctrl-C; the master may be any.  With --max-size or
    --max-time FILE-001, FILE-002 … follow each other, each whole; bowden merge makes them one.
    """
    reached = Bus(interface, channel, bitrate, option, config=config)
    network, chosen = reached.network(), reached.chosen()
    about = {"interface": interface, "channel": channel or "", "bitrate": str(bitrate or network.bitrate)}
    with buses.opened_one(chosen, network.bitrate) as heard, BusRecording(
            output, wire(network), overwrite=True, about=about,
            max_bytes=None if max_size is None else round(max_size * 1e6),
            max_ns=None if max_time is None else round(max_time * 1e9)) as made:
        terminal.remark(f"recording {chosen.in_words}; Ctrl-C ends it.")
        try:
            failure = made.listen(heard, seconds, frames)
        except KeyboardInterrupt:
            made.close()
            terminal.show(_answer(made, None))
            raise
    return _answer(made, failure)


def _answer(made: BusRecording, failure: str | None) -> CommandAnswer:
    result: dict[str, Any] = made.as_json()
    if failure is not None:
        terminal.remark(f"the bus has failed: {failure}; what it gave is recorded.")
    left = f", {result['left_out']} CAN FD frames left out" if result["left_out"] else ""
    return CommandAnswer(result, f"{', '.join(result['files'])}: {result['frames']} frames, {result['cycles']} control "
                         f"cycles{left}.", 0 if failure is None else 1)
