"""`bowden monitor` and `bowden record`: the frames of a bus in words, or everything on it in MCAP; both only listen."""

from __future__ import annotations

import json as json_text
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.options import Bus, argument, option
from bowden.cli.terminal import CommandAnswer
from parameters import InputError

if TYPE_CHECKING:
    from bowden.bench.buses import BusSettings
    from bowden.trials.recording import BusRecording
    from eds.dictionary import Dictionary


KINDS: Final = ("nmt", "sync", "time", "emcy", "pdo", "sdo", "heartbeat", "lss", "other")
Source = Annotated[Path | None, argument("[FILE]", "Trial, log (.log, .asc, .blf), - for candump.")]


@app.command()
def monitor(
    reached: Bus,
    source: Source = None,
    eds: Annotated[list[str] | None, option(
        "EDS or DCF of a node; default: the bench's.", "--eds", metavar="ID=FILE")] = None,
    only: Annotated[str | None, option(f"Only {', '.join(KINDS)}.", "--only", metavar="KINDS")] = None,
    nodes: Annotated[str | None, option("Only these node ids.", "--node", metavar="IDS")] = None,
    seconds: Annotated[float | None, option(
        "Time to listen (default: until Ctrl-C; simulated: 1 s).", "--for", metavar="S", min=0.0)] = None,
    table: Annotated[bool, option("Only the table of rates and load, at the end.", "--table")] = False,
    dbc: Annotated[Path | None, option("Write the PDOs' layout as DBC.", "--dbc", metavar="FILE")] = None,
    mf4: Annotated[Path | None, option("Write the PDOs' values as MF4.", "--mf4", metavar="FILE")] = None,
    overwrite: options.Overwrite = False,
) -> CommandAnswer | int:
    """Show each frame of a bus or of a file in words.

    PDO values have names and units, SDO transfers are put together, abort and EMCY codes are in words.
    With --json one object a line.

    Example: bowden monitor --for 0.2 --only sdo,pdo,emcy
    """
    from eds.bench.bench_network import wire
    from eds.bench.bus_load import frame_bits
    from master.node_access.frame_words import FrameReader, FrameWords, of_wire
    from master.node_access.signal_files import SignalRecording, write_dbc

    network = reached.network()
    kinds, wanted = _kinds(only), _nodes(nodes)
    reader = FrameReader(_dictionaries(eds)) if eds else of_wire(wire(network))
    output_files.refuse([dbc, mf4], overwrite=overwrite, inputs=[source])
    output_files.refuse_ending(dbc, ".dbc", what="a layout of PDOs")
    output_files.refuse_ending(mf4, ".mf4", what="a recording of values")
    if dbc is not None:
        terminal.remark(f"{dbc}: {write_dbc(reader, dbc, overwrite=overwrite)} PDOs.")
    recording = SignalRecording(reader)
    counts: Counter[int] = Counter()
    names: dict[int, str] = {}
    bits, first_ns, last_ns, lost = 0, None, 0, 0
    chosen = None if source is not None else reached.configured()
    for can_id, data, time_ns, special, dropped in _frames(source, chosen, network.bitrate, seconds):
        lost = dropped
        if special == "lost":
            continue
        words = FrameWords("other", 0, special) if special else reader.read(can_id, data)
        first_ns, last_ns = time_ns if first_ns is None else first_ns, time_ns
        counts[can_id] += 1
        if mf4 is not None and not special:
            recording.take(time_ns, can_id, data)
        names.setdefault(can_id, words.text.partition(":")[0] if words.kind == "pdo" else words.kind)
        bits += frame_bits(len(data))
        if table or words.kind not in kinds or (wanted and words.node_id not in wanted):
            continue
        if terminal.quiet():
            print(json_text.dumps({"time_ns": time_ns, "can_id": can_id, "data": data.hex(), **words._asdict()},
                                  ensure_ascii=False))
        else:
            node = f"{words.node_id:3}" if words.node_id else "   "
            print(f"{(time_ns - first_ns) / 1e9:12.6f}  {can_id:03X}  {node}  {words.text}")
    span_s = max((last_ns - (first_ns or 0)) / 1e9, 1e-9)
    if mf4 is not None:
        terminal.remark(f"{mf4}: values of {recording.write(mf4, overwrite=overwrite)} PDOs.")
    if lost:
        terminal.remark(f"{lost} frames were lost, because they came faster than they were read.")
    if not table:
        return 0
    load = 100.0 * bits / span_s / network.bitrate
    return CommandAnswer({"load_percent": load, "seconds": span_s, "lost": lost, "identifiers": [
        {"can_id": can_id, "name": names[can_id], "frames": count, "per_second": count / span_s}
        for can_id, count in sorted(counts.items())]}, [
        *(f"{can_id:03X}  {names[can_id]:10}  {count:8} frames  {count / span_s:10.1f} /s"
          for can_id, count in sorted(counts.items())),
        f"{sum(counts.values())} frames in {span_s:.3f} s, {load:.1f} % of the bus at most."])


def _frames(source: Path | None, chosen: BusSettings | None, bitrate: int,
            seconds: float | None) -> Iterator[tuple[int, bytes, int, str, int]]:
    """Yield identifier, data, time (ns), words for a frame that is no plain data frame, and frames lost so far."""
    from bowden.bench import buses
    from master.network.link import FAILURES, stamp_ns

    if source is not None:
        yield from _of_file(source)
        return
    assert chosen is not None
    if seconds is None and chosen.simulated:
        seconds = 1.0
    with buses.opened_one(chosen, bitrate) as bus:
        clock = buses.clock_of(bus)
        end_ns = None if seconds is None else clock() + round(seconds * 1e9)
        while end_ns is None or clock() < end_ns:
            try:
                message = bus.recv(1.0 if end_ns is None else max(0.0, (end_ns - clock()) / 1e9))
            except FAILURES as error:
                raise InputError(f"bus: {error}; see bowden doctor.") from None
            if message is not None:
                yield (message.arbitration_id, bytes(message.data), stamp_ns(message), _special(message),
                       getattr(bus, "lost", 0))
        yield 0, b"", 0, "lost", getattr(bus, "lost", 0)


def _of_file(source: Path) -> Iterator[tuple[int, bytes, int, str, int]]:
    """Yield the frames of a recorded file as `_frames` does; `-` is candump's output on standard input."""
    from master.network.link import stamp_ns

    if str(source) == "-":
        yield from _dumped(sys.stdin, "-")
    elif not source.is_file():
        raise InputError(f"{source}: no such file; give a trial (.mcap), a CAN log (.log, .asc, .blf), or - for "
                         "candump's lines on standard input.")
    elif source.suffix.lower() in (".log", ".txt"):
        with source.open(encoding="utf-8", errors="replace") as lines:
            yield from _dumped(lines, str(source))
    else:
        for message in _recorded(source):
            yield message.arbitration_id, bytes(message.data or b""), stamp_ns(message), _special(message), 0


def _dumped(lines: Iterable[str], name: str) -> Iterator[tuple[int, bytes, int, str, int]]:
    """Yield the frames of candump's lines; a line without a time counts as at 0."""
    from trial.convert import candump
    from trial.mcap_file import cdr

    for frame in candump.each(lines, name):
        special = _special_of(frame.can_id, frame.payload, frame.dlc, error=frame.flags & cdr.ERROR != 0,
                              remote=frame.flags & cdr.REMOTE != 0, extended=frame.flags & cdr.EXTENDED != 0)
        yield frame.can_id, frame.payload, frame.time_ns or 0, special, 0


def _recorded(source: Path) -> Iterator[Any]:
    import can

    try:
        with closing(_reader(source)) as reader:
            yield from reader
    except InputError:
        raise
    except (can.CanError, OSError, ValueError, EOFError, KeyError, IndexError):
        raise InputError(f"{source}: is no CAN log of its ending; give .mcap, .log, .asc or .blf.") from None


def _reader(source: Path) -> Any:
    import can

    reader: Any = can.LogReader(source)
    reader.close = reader.stop
    return reader


def _special(message: Any) -> str:
    return _special_of(message.arbitration_id, bytes(message.data or b""), message.dlc, error=message.is_error_frame,
                       remote=message.is_remote_frame, extended=message.is_extended_id)


def _special_of(can_id: int, data: bytes, dlc: int, *, error: bool, remote: bool, extended: bool) -> str:
    """Return in words what a frame is that is no data frame of the base format; "" for one that is."""
    if error:
        from eds.error_frames import decode

        return f"error frame: {decode(can_id, data)}"
    if remote:
        return f"remote request of {dlc} bytes"
    return f"extended identifier: {data.hex(' ')}" if extended else ""


def _dictionaries(given: list[str]) -> dict[int, Dictionary]:
    from eds.dictionary import read

    found = {}
    for text in given:
        node, equals, path = text.partition("=")
        if not equals or not node.isdecimal() or not 1 <= int(node) <= 127:
            raise InputError(f"--eds {text}: expected ID=FILE; write for instance 5=vendor.eds.")
        found[int(node)] = read(path, int(node))
    return found


def _kinds(only: str | None) -> frozenset[str]:
    asked = frozenset(KINDS if only is None else only.split(","))
    if unknown := sorted(asked - set(KINDS)):
        raise InputError(f"--only {unknown[0]}: is no kind of frame; give some of {','.join(KINDS)}.")
    return asked


def _nodes(nodes: str | None) -> frozenset[int]:
    try:
        return frozenset(int(one) for one in nodes.split(",")) if nodes else frozenset()
    except ValueError:
        raise InputError(f"--node {nodes}: expected node ids; write for instance 1,5.") from None


Frames = Annotated[int | None, option("End after so many frames.", metavar="N", min=1)]
MaxSize = Annotated[float | None, option("A new file after so many MB.", metavar="MB", min=0.01)]
MaxTime = Annotated[float | None, option("A new file after so many s of bus time.", metavar="S", min=0.001)]


@app.command()
def record(
    output: options.Output, interface: options.AnyInterface, channel: options.Channel = None,
    bitrate: options.Bitrate = None, option: options.Extra = None, *, seconds: options.Seconds = None,
    frames: Frames = None, max_size: MaxSize = None, max_time: MaxTime = None, config: options.Config = None,
    overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Record a bus, listening only.

    Every frame and the control cycles that they make, until Ctrl-C; the master may be any.  With --max-size or
    --max-time FILE-001, FILE-002 … follow each other, each whole; bowden merge makes them one.

    Example: bowden record --interface virtual --channel bench --for 1 -o bus.mcap
    """
    import can

    from bowden.bench import buses
    from bowden.trials.recording import BusRecording
    from eds.bench.bench_network import wire

    reached = Bus(interface, channel, bitrate, option, config=config)
    network, chosen = reached.network(), reached.chosen()
    output_files.refuse_ending(output, ".mcap", what="a recording")
    made = BusRecording(output, wire(network), overwrite=overwrite, about={
        "interface": interface, "channel": channel or "", "bitrate": str(bitrate or network.bitrate)},
        max_bytes=None if max_size is None else round(max_size * 1e6),
        max_ns=None if max_time is None else round(max_time * 1e9))
    failure = None
    with buses.opened_one(chosen, network.bitrate) as heard, made:
        terminal.remark(f"recording {interface} {channel or ''}; Ctrl-C ends it.")
        try:
            made.listen(heard, seconds, frames)
        except (can.CanError, OSError) as error:
            failure = str(error)
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
