"""`bowden monitor` and `bowden record`: the frames of a bus in words, or everything on it in MCAP; both only listen."""

from __future__ import annotations

import json as json_text
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

from bowden.bench import buses
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.options import Bus, argument, new_file, option
from bowden.cli.terminal import CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    import can

    from bowden.trials.recording import BusRecording
    from eds.bench.bench_network import wire
    from eds.bench.bus_load import frame_bits
    from eds.dictionary import Dictionary, read
    from eds.error_frames import decode
    from master.network import link
    from master.node_access.frame_words import FrameReader, FrameWords, of_wire
    from master.node_access.signal_files import SignalRecording, write_dbc
    from trial.convert import candump
    from trial.convert.python_can import flags_of
    from trial.mcap_file import cdr


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
    dbc: Annotated[Path | None, new_file(
        "Write the PDOs' layout as DBC.", "a layout of PDOs", ".dbc", name="--dbc")] = None,
    mf4: Annotated[Path | None, new_file(
        "Write the PDOs' values as MF4.", "a recording of values", ".mf4", name="--mf4")] = None,
) -> CommandAnswer | int:
    """Show each frame of a bus or of a file in words.

    PDO values have names and units, SDO transfers are put together, abort and EMCY codes are in words.
    With --json one object a line.

    Example: bowden monitor --for 0.2 --only sdo,pdo,emcy
    """
    network = reached.network()
    kinds, wanted = _kinds(only), _nodes(nodes)
    reader = FrameReader(_dictionaries(eds)) if eds else of_wire(wire(network))
    if dbc is not None:
        terminal.remark(f"{dbc}: {write_dbc(reader, dbc, overwrite=True)} PDOs.")
    recording = SignalRecording(reader)
    counts: Counter[int] = Counter()
    names: dict[int, str] = {}
    bits, first_ns, last_ns = 0, None, 0
    with ExitStack() as opened:
        chosen = None if source is not None else reached.configured()
        bus = None if chosen is None else opened.enter_context(buses.opened_one(chosen, network.bitrate))
        if seconds is None and chosen is not None and chosen.simulated:
            seconds = 1.0
        for frame in _of_bus(bus, seconds) if source is None else _of_file(source):
            special = frame.in_words()
            words = FrameWords("other", 0, special) if special else reader.read(frame.can_id, frame.data)
            first_ns, last_ns = frame.time_ns if first_ns is None else first_ns, frame.time_ns
            counts[frame.can_id] += 1
            if mf4 is not None and not special:
                recording.take(frame.time_ns, frame.can_id, frame.data)
            names.setdefault(frame.can_id, words.text.partition(":")[0] if words.kind == "pdo" else words.kind)
            bits += frame_bits(len(frame.data))
            if table or words.kind not in kinds or (wanted and words.node_id not in wanted):
                continue
            if terminal.quiet():
                print(json_text.dumps({"time_ns": frame.time_ns, "can_id": frame.can_id, "data": frame.data.hex(),
                                       **words._asdict()}, ensure_ascii=False))
            else:
                node = f"{words.node_id:3}" if words.node_id else "   "
                print(f"{(frame.time_ns - first_ns) / 1e9:12.6f}  {frame.can_id:03X}  {node}  {words.text}")
        lost = getattr(bus, "lost", 0)
    span_s = max((last_ns - (first_ns or 0)) / 1e9, 1e-9)
    if mf4 is not None:
        terminal.remark(f"{mf4}: values of {recording.write(mf4, overwrite=True)} PDOs.")
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


class MonitoredFrame(NamedTuple):
    """A frame of a bus or a file; `flags` are those of `trial.mcap_file.cdr`."""

    time_ns: int
    can_id: int
    flags: int
    dlc: int
    data: bytes

    def in_words(self) -> str:
        """Describe a frame that is no data frame of the base format; "" for one that is."""
        if self.flags & cdr.ERROR:
            return f"error frame: {decode(self.can_id, self.data)}"
        if self.flags & cdr.REMOTE:
            return f"remote request of {self.dlc} bytes"
        return f"extended identifier: {self.data.hex(' ')}" if self.flags & cdr.EXTENDED else ""


def _of_message(message: Any) -> MonitoredFrame:
    return MonitoredFrame(link.stamp_ns(message), message.arbitration_id, flags_of(message), message.dlc,
                          bytes(message.data or b""))


def _of_bus(bus: Any, seconds: float | None) -> Iterator[MonitoredFrame]:
    """Yield the frames that a bus receives for so many seconds, or until Ctrl-C."""
    clock = buses.clock_of(bus)
    end_ns = None if seconds is None else clock() + round(seconds * 1e9)
    while end_ns is None or clock() < end_ns:
        try:
            message = bus.recv(1.0 if end_ns is None else max(0.0, (end_ns - clock()) / 1e9))
        except link.FAILURES as error:
            raise InputError(f"bus: {error}; see bowden doctor.") from None
        if message is not None:
            yield _of_message(message)


def _of_file(source: Path) -> Iterator[MonitoredFrame]:
    """Yield the frames of a recorded file; `-` is candump's output on standard input."""
    if str(source) == "-":
        yield from _of_candump(sys.stdin, "-")
    elif not source.is_file():
        raise InputError(f"{source}: no such file; give a trial (.mcap), a CAN log (.log, .asc, .blf), or - for "
                         "candump's lines on standard input.")
    elif source.suffix.lower() in (".log", ".txt"):
        with source.open(encoding="utf-8", errors="replace") as lines:
            yield from _of_candump(lines, str(source))
    else:
        yield from _of_log(source)


def _of_candump(lines: Iterable[str], name: str) -> Iterator[MonitoredFrame]:
    """Yield the frames of candump's lines; a line without a time counts as at 0, a damaged line is remarked."""
    for frame in candump.each(lines, name, terminal.remark):
        yield MonitoredFrame(frame.time_ns or 0, frame.can_id, frame.flags, frame.dlc, frame.payload)


def _of_log(source: Path) -> Iterator[MonitoredFrame]:
    """Yield the frames of a file that python-can reads."""
    count = 0
    try:
        reader = can.LogReader(source)
        try:
            for count, message in enumerate(reader, 1):
                if len(message.data or b"") < min(message.dlc, 8) and not (
                        message.is_remote_frame or message.is_error_frame):
                    terminal.remark(f"{source}: frame {count}, {message.arbitration_id:03X}, is cut: it has "
                                    f"{len(message.data or b'')} of {message.dlc} bytes.")
                yield _of_message(message)
            if (missing := getattr(reader, "file_size", 0) - source.stat().st_size) > 0:  # of a BLF file, by its header
                terminal.remark(f"{source}: {missing} bytes are missing at its end; these are the frames before them.")
        finally:
            reader.stop()
    except InputError:
        raise
    except (can.CanError, OSError, ValueError, EOFError, KeyError, IndexError) as error:
        if count:
            raise InputError(f"{source}: after frame {count}: {error}; mend the file or cut it there.") from None
        raise InputError(f"{source}: is no CAN log of its ending; give .mcap, .log, .asc or .blf.") from None


def _dictionaries(given: list[str]) -> dict[int, Dictionary]:
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


NewRecording = Annotated[Path, new_file("File to write.", *options.RECORDING)]
Frames = Annotated[int | None, option("End after so many frames.", metavar="N", min=1)]
MaxSize = Annotated[float | None, option("A new file after so many MB.", metavar="MB", min=0.01)]
MaxTime = Annotated[float | None, option("A new file after so many s of bus time.", metavar="S", min=0.001)]


@app.command()
def record(
    output: NewRecording, interface: options.AnyInterface, channel: options.Channel = None,
    bitrate: options.Bitrate = None, option: options.Extra = None, *, seconds: options.Seconds = None,
    frames: Frames = None, max_size: MaxSize = None, max_time: MaxTime = None, config: options.Config = None,
) -> CommandAnswer:
    """Record a bus, listening only.

    Every frame and the control cycles that they make, until Ctrl-C; the master may be any.  With --max-size or
    --max-time FILE-001, FILE-002 … follow each other, each whole; bowden merge makes them one.

    Example: bowden record --interface virtual --channel bench --for 1 -o bus.mcap
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
