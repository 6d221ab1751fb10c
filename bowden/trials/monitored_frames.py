"""Frames of a bus, a CAN log or a trial, one at a time and in words, with their rates and the load of the bus."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import can

from bowden.bench import buses
from eds.bench.bus_load import frame_bits
from eds.error_frames import decode
from master.network import link
from master.node_access.frame_words import FrameReader, FrameWords
from parameters import InputError
from trial.convert import candump
from trial.convert.python_can import flags_of
from trial.mcap_file import cdr

Remark = Callable[[str], None]


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


class FrameStatistics:
    """Reads frames in words, and counts them by identifier."""

    def __init__(self, reader: FrameReader) -> None:
        self._reader, self._bits, self._last_ns = reader, 0, 0
        self.first_ns: int | None = None
        self._counts: Counter[int] = Counter()
        self._names: dict[int, str] = {}

    def read(self, frame: MonitoredFrame) -> FrameWords:
        """Count a frame and return its words."""
        special = frame.in_words()
        words = FrameWords("other", 0, special) if special else self._reader.read(frame.can_id, frame.data)
        self.first_ns, self._last_ns = frame.time_ns if self.first_ns is None else self.first_ns, frame.time_ns
        self._counts[frame.can_id] += 1
        self._names.setdefault(frame.can_id, words.text.partition(":")[0] if words.kind == "pdo" else words.kind)
        self._bits += frame_bits(len(frame.data))
        return words

    def as_json(self, bitrate: int, lost: int) -> dict[str, Any]:
        """Return load, time span, frames that the adapter lost, and count and rate of each identifier."""
        span_s = max((self._last_ns - (self.first_ns or 0)) / 1e9, 1e-9)
        return {"load_percent": 100.0 * self._bits / span_s / bitrate, "seconds": span_s, "lost": lost, "identifiers": [
            {"can_id": can_id, "name": self._names[can_id], "frames": count, "per_second": count / span_s}
            for can_id, count in sorted(self._counts.items())]}


def of_bus(bus: Any, seconds: float | None) -> Iterator[MonitoredFrame]:
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


def of_file(source: Path, remark: Remark) -> Iterator[MonitoredFrame]:
    """Yield the frames of a recorded file; `-` is candump's output on standard input; damage goes to `remark`."""
    if str(source) == "-":
        yield from _of_candump(sys.stdin, "-", remark)
    elif not source.is_file():
        raise InputError(f"{source}: no such file; give a trial (.mcap), a CAN log (.log, .asc, .blf), or - for "
                         "candump's lines on standard input.")
    elif source.suffix.lower() in (".log", ".txt"):
        with source.open(encoding="utf-8", errors="replace") as lines:
            yield from _of_candump(lines, str(source), remark)
    else:
        yield from _of_log(source, remark)


def _of_message(message: Any) -> MonitoredFrame:
    return MonitoredFrame(link.stamp_ns(message), message.arbitration_id, flags_of(message), message.dlc,
                          bytes(message.data or b""))


def _of_candump(lines: Iterable[str], name: str, remark: Remark) -> Iterator[MonitoredFrame]:
    """Yield the frames of candump's lines; a line without a time counts as at 0, a damaged line is remarked."""
    for frame in candump.each(lines, name, remark):
        yield MonitoredFrame(frame.time_ns or 0, frame.can_id, frame.flags, frame.dlc, frame.payload)


def _of_log(source: Path, remark: Remark) -> Iterator[MonitoredFrame]:
    """Yield the frames of a file that python-can reads."""
    count = 0
    try:
        with can.LogReader(source) as reader:
            for count, message in enumerate(reader, 1):
                if len(message.data or b"") < min(message.dlc, 8) and not (
                        message.is_remote_frame or message.is_error_frame):
                    remark(f"{source}: frame {count}, {message.arbitration_id:03X}, is cut: it has "
                           f"{len(message.data or b'')} of {message.dlc} bytes.")
                yield _of_message(message)
            if (missing := getattr(reader, "file_size", 0) - source.stat().st_size) > 0:  # of a BLF file, by its header
                remark(f"{source}: {missing} bytes are missing at its end; these are the frames before them.")
    except InputError:
        raise
    except (can.CanError, OSError, ValueError, EOFError, KeyError, IndexError) as error:
        if count:
            raise InputError(f"{source}: after frame {count}: {error}; mend the file or cut it there.") from None
        raise InputError(f"{source}: is no CAN log of its ending; give .mcap, .log, .asc or .blf.") from None
