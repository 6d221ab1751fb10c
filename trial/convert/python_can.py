"""`.mcap` in python-can: `can.LogReader`, `can.Logger`, `can.logconvert` and `can.player` read and write trials.

The rule of this file: the only one of the room that imports `can`; python-can loads it by entry point, the room
itself only where a CAN log of python-can's formats is asked for.  Times stay integers as long as they can: a
message read from a trial carries `time_ns` beside python-can's seconds.
"""

import io
import os
import re
import shutil
import struct
import tempfile
import zlib
from array import array
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, Final

import can
import numpy as np
from can.io.generic import BinaryIOMessageReader, SizedMessageWriter, TextIOMessageReader
from can.io.player import MESSAGE_READERS
from numpy.typing import NDArray

from parameters import InputError
from parameters.files import BoundedFile, refuse_large, refuse_special, unpacked_ending
from trial.convert.frames import END_MISSING, ChannelNumbers, DamageRemarks, FrameRows, LoggedFrames
from trial.mcap_file import cdr
from trial.read import frame_blocks
from trial.record import Recorder

ROWS_AT_ONCE = 4096
UNPACKED_LIMIT = 1 << 30  # of a gzipped trial, bytes
CONTAINER_LIMIT = 64 << 20  # of a BLF container, bytes; loggers write some 128 KiB
_OBJECT, _CONTAINER, _DEFLATED = struct.Struct("<4sHHLL"), 10, b"\x02"  # as can.io.blf reads them


class TrialMessage(can.Message):
    """A message with its exact time: `timestamp` is `time_ns` in seconds, as near as a float comes."""

    __slots__ = ("time_ns",)

    def __init__(self, time_ns: int, **fields: Any) -> None:
        super().__init__(timestamp=time_ns / 1e9, **fields)
        self.time_ns = time_ns


def messages(rows: NDArray[np.void]) -> Iterator[TrialMessage]:
    """Turn `cdr.FRAME_ROW`s into messages; channels are `can0`, `can1` … as the trial names them."""
    parts = (rows[at:at + ROWS_AT_ONCE].tolist() for at in range(0, len(rows), ROWS_AT_ONCE))
    for time_ns, can_id, flags, dlc, channel, sent, data in chain.from_iterable(parts):
        remote = bool(flags & cdr.REMOTE)
        yield TrialMessage(
            time_ns, arbitration_id=can_id, is_extended_id=bool(flags & cdr.EXTENDED), is_remote_frame=remote,
            is_error_frame=bool(flags & cdr.ERROR), channel=f"can{channel}", dlc=dlc,
            data=None if remote else bytes(data[:dlc]), is_rx=not sent,
        )


def time_ns_of(message: can.Message) -> int:
    """Return a message's time: exact where it carries it, else to the microsecond that its format has."""
    exact = getattr(message, "time_ns", None)
    return exact if isinstance(exact, int) else round(message.timestamp * 1e6) * 1000


def flags_of(message: can.Message) -> int:
    """Return the flags of `cdr`."""
    return (message.is_remote_frame * cdr.REMOTE | message.is_extended_id * cdr.EXTENDED
            | message.is_error_frame * cdr.ERROR)


def payload_of(message: can.Message) -> bytes:
    """Return the bytes to record; for a remote frame, as many zeros as its DLC."""
    return bytes(min(message.dlc, 8)) if message.is_remote_frame else bytes(message.data)


class McapReader(BinaryIOMessageReader):
    """Iterates over the CAN frames of a trial, in order of recording."""

    def __init__(self, file: str | os.PathLike[str] | BinaryIO, **_options: Any) -> None:
        super().__init__(file)
        self._where = str(getattr(file, "name", file))

    def __iter__(self) -> Iterator[can.Message]:
        with self.file:
            data = self.file.read(UNPACKED_LIMIT + 1)
        if len(data) > UNPACKED_LIMIT:
            raise InputError(f"{self._where}: larger than {UNPACKED_LIMIT} bytes; unpack it first.")
        for rows in frame_blocks(data, self._where):
            yield from messages(rows)


class McapWriter(SizedMessageWriter):
    """Writer of CAN messages into a trial without cycles, on a separate thread; an existing file is replaced.

    A file object opened for writing bytes gets the whole file when the writer stops; it stays open.

    CAN FD frames do not fit `can_msgs/msg/Frame` and are left out, counted in the result as `fd_frames`.
    """

    def __init__(self, file: str | os.PathLike[str] | BinaryIO, append: bool = False, **_options: Any) -> None:
        name = getattr(file, "name", file)
        if append:
            raise InputError(f"{name}: a trial cannot be appended to; give a new name.")
        self._handed: Any = file if hasattr(file, "write") else None
        if self._handed is None:
            self._path = Path(str(file))
        else:  # a recording needs a file of its own while it grows; the object gets it whole
            self._folder = tempfile.TemporaryDirectory(prefix="bowden-")
            self._path = Path(self._folder.name) / "recording.mcap"
        self._recorder = Recorder(self._path, metadata={"source": "python-can"}, attachments={}, overwrite=True,
                                  signals=())
        self._channels = ChannelNumbers()
        self._fd_frames = 0

    def on_message_received(self, msg: can.Message) -> None:
        """Record one message."""
        if msg.is_fd:
            self._fd_frames += 1
            return
        self._recorder.frame(time_ns_of(msg), msg.arbitration_id, payload_of(msg), flags_of(msg),
                             self._channels.number(msg.channel), not msg.is_rx)

    def stop(self) -> None:
        """Write all pending messages and close the file."""
        self._recorder.close({"fd_frames": self._fd_frames, "channels": self._channels.names})
        if self._handed is not None and self._path.exists():
            with self._path.open("rb") as whole:
                shutil.copyfileobj(whole, self._handed)
            self._folder.cleanup()

    def file_size(self) -> int:
        """Return the size of the file now, in bytes."""
        return self._path.stat().st_size


def _refuse_bomb(path: Path) -> int:
    """Return how many bytes the last object of a BLF file lacks.

    Raises `InputError` for a container that no logger wrote; python-can unpacks each whole, however large.
    """
    with path.open("rb") as file:
        file.seek(int.from_bytes(file.read(8)[4:], "little"))
        while len(head := file.read(_OBJECT.size)) == _OBJECT.size:
            signature, _, _, size, kind = _OBJECT.unpack(head)
            if signature != b"LOBJ" or size < _OBJECT.size:
                return 0  # python-can says what is wrong
            body = file.read(size - _OBJECT.size)
            if len(body) < size - _OBJECT.size:
                return int(size) - _OBJECT.size - len(body)
            file.read(size % 4)
            if kind == _CONTAINER and body[:1] == _DEFLATED:
                unpacked = zlib.decompressobj().decompress(body[16:], CONTAINER_LIMIT + 1)
                if len(unpacked) > CONTAINER_LIMIT:
                    raise InputError(f"{path}: a container unpacks to more than {CONTAINER_LIMIT} bytes; "
                                     "it is no measured log, do not open it.")
    return 0


_EVENT = {
    ".asc": re.compile(r"(?!\s*-?\d+(\.\d*)?(\s+\d+(\s+[0-9A-Fa-f]+x?(\s.*)?)?|\s+CANFD(\s.*)?)?\s*$)"),
    ".trc": re.compile(r"\s*($|;|.*\b(Warng|Error|ST|ER|EC|EV|FFFFFFFF)\b)"),
    ".csv": re.compile(r".*"),
}
"""Lines of a text log, by ending, that python-can passes over and that are no frame: headers, comments, bus states."""
_HALF_BYTE = re.compile(r".*\s(?:d|[RT]x\s+[0-9A-Fa-f]+(?:\s+-)?)\s+\d+(?:\s+[0-9A-Fa-f]{2})*\s+[0-9A-Fa-f]\s*$")
"""Line of a frame whose last byte has one digit where those before it have two."""
_DECIMAL = re.compile(r"\s*base\s+dec", re.IGNORECASE)


class NumberedLines(io.TextIOWrapper):
    """Lines of a text log for python-can's reader; lines of cut frames, which it passes over, go to `damage`.

    `number` and `text` are those of the line last read. `ending` is the log's, such as ".asc". `hexadecimal` is False
    once the header of an ASC log states decimal bytes, which may have one digit.
    """

    def __init__(self, raw: io.BufferedReader, ending: str, damage: DamageRemarks) -> None:
        super().__init__(raw, encoding="utf-8", errors="replace")
        self.number, self.text, self.lost, self.hexadecimal = 0, "", 0, True
        self._ending, self._damage, self._used = ending, damage, True

    def __next__(self) -> str:  # type: ignore[override]  # typeshed's base of all streams yields bytes
        self.finish()
        self.text = super().__next__()
        self.number += 1
        self._used = False
        self.hexadecimal = self.hexadecimal and not (self.number < 20 and _DECIMAL.match(self.text))
        return self.text

    def use(self) -> int:
        """Mark the line as one that a frame was read from; return its number."""
        self._used = True
        return self.number

    def finish(self) -> None:
        """Note the damage if the line last read is of a frame that python-can passed over."""
        if not self._used and not _EVENT[self._ending].match(self.text):
            self.lost += 1
            self._damage.add(f"line {self.number}", f"{self.text.strip()[-60:]!r} is not read as a frame; left out")
        self._used = True


CSV_HEADER = "timestamp,arbitration_id,extended,remote,error,dlc,data"


@contextmanager
def _messages(path: Path, damage: DamageRemarks) -> Iterator[tuple[Any, NumberedLines | None, Callable[[], float]]]:
    """Yield an iterator over a log's messages, the lines of a text, and a function that returns the share read so far.

    `damage` receives lines that are no whole frame.
    """
    ending = unpacked_ending(path)
    if ending == ".db":
        yield _sqlite(path), None, lambda: 0.0
        return
    reader_type: Any = _mdf_reader() if ending == ".mf4" else MESSAGE_READERS[ending]
    text = issubclass(reader_type, TextIOMessageReader)
    if ending == ".mf4":
        with reader_type(path) as reader:
            yield reader, None, lambda: 0.0
        return
    with BoundedFile(path, lines=text) as raw:
        whole: Any = io.BufferedReader(raw, 1 << 16)
        lines = NumberedLines(whole, ending, damage) if text else None
        with reader_type(lines or whole) as reader:
            yield reader, lines, raw.share


def _mdf_reader() -> Any:
    """Return python-can's reader of MDF files, loaded again where python-can was imported without asammdf."""
    import importlib

    from can.io import mf4

    if getattr(mf4, "asammdf", None) is None:
        importlib.reload(mf4)
    return mf4.MF4Reader


def _sqlite(path: Path) -> Iterator[can.Message]:
    """Yield the messages of python-can's SQLite log, opened for reading only."""
    import sqlite3

    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as found:
        for timestamp, can_id, extended, remote, error, dlc, data in found.execute(
                "SELECT ts, arbitration_id, extended, remote, error, dlc, data FROM messages"):
            yield can.Message(timestamp=timestamp, arbitration_id=can_id, is_extended_id=bool(extended),
                              is_remote_frame=bool(remote), is_error_frame=bool(error), dlc=dlc, data=data,
                              is_fd=len(data or b"") > 8)


LATEST_S: Final = 9e9
"""Time stamp beyond which a signed count of nanoseconds holds none, s."""
LAST_IDENTIFIER: Final = 0x1FFF_FFFF
"""29 bits at most (ISO 11898-1)."""


def read_log(path: Path, progress: Callable[[float], None] = lambda share: None) -> LoggedFrames:
    """Read a log in a format of python-can (.asc, .blf, .trc …, its own .csv and .db; some packed by gzip).

    `counts` holds CAN FD frames, which a trial cannot store, DLCs above 8 of classical frames, and malformed frames.
    It also holds lines and frames that are cut, and how many bytes a BLF file lacks; `damage` lists where.
    `progress` receives the share read, 0 … 1. Raises `InputError` if the file is malformed.
    """
    refuse_special(path)
    frames = LoggedFrames(np.empty(0, cdr.FRAME_ROW), {}, {
        "fd_frames": 0, "malformed_frames": 0, "dlc_above_8": 0, "cut_frames": 0})
    rows, channels, lines = FrameRows(), ChannelNumbers(), None
    try:
        refuse_large(path)
        lacking = _refuse_bomb(path) if path.suffix.lower() == ".blf" else 0
        with _messages(path, frames.damage) as (reader, lines, share):
            for number, message in enumerate(reader, start=1):
                if number % ROWS_AT_ONCE == 0:
                    progress(share())
                _take(message, rows, channels, frames, number, lines)
            if path.suffix.lower() == ".blf":  # its header states the size that its writer closed it with
                _lacking(frames, max(lacking, reader.file_size - path.stat().st_size), len(rows))
            if lines is not None:
                lines.finish()
                frames.counts["malformed_lines"] = lines.lost
                if rows.lines[-1:] == array("I", [lines.number]) and not lines.text.endswith("\n"):
                    frames.damage.add(f"line {lines.number}", END_MISSING)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a CAN log.") from None
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{path}: is too large for this computer's memory; cut it.") from None
    except Exception as error:  # python-can's readers raise whatever their parsing meets
        reason = (str(error) or type(error).__name__)[:200]
        place = f"after {len(rows)} frames" if lines is None else f"line {lines.number}: {lines.text.strip()[-60:]!r}"
        raise InputError(f"{path}: {place}: {reason}; mend the file or cut it there.") from None
    return replace(frames, rows=rows.rows(), channels=channels.names, lines=rows.lines)


def _take(message: can.Message, rows: FrameRows, channels: ChannelNumbers, frames: LoggedFrames, number: int,
          lines: NumberedLines | None) -> None:
    line = lines.use() if lines else 0
    counts, place = frames.counts, f"line {line}" if line else f"frame {number}"
    whole, data = min(message.dlc, 8), payload_of(message)
    if message.is_fd or len(message.data or b"") > 8:
        counts["fd_frames"] += 1
    elif not (abs(message.timestamp) < LATEST_S and 0 <= message.arbitration_id <= LAST_IDENTIFIER):
        counts["malformed_frames"] += 1
        frames.damage.add(place, f"identifier {message.arbitration_id:X} at {message.timestamp:g} s is no frame's; "
                                 "left out")
    elif len(data) < whole and not message.is_error_frame:
        counts["cut_frames"] += 1
        frames.damage.add(place, f"identifier {message.arbitration_id:03X} has {len(data)} of the {whole} bytes that "
                                 "its length states; left out")
    elif lines and lines.hexadecimal and message.data and _HALF_BYTE.match(lines.text):
        counts["cut_frames"] += 1
        frames.damage.add(place, f"the last byte of identifier {message.arbitration_id:03X} has one of two digits; "
                                 "left out")
    else:
        counts["dlc_above_8"] += message.dlc > 8
        rows.add((time_ns_of(message), message.arbitration_id, flags_of(message), len(data),
                  channels.number(message.channel), not message.is_rx, data), line)


def _lacking(frames: LoggedFrames, missing: int, count: int) -> None:
    """Note the bytes that the end of a BLF file lacks."""
    frames.counts["missing_bytes"] = max(0, missing)
    if missing > 0:
        frames.damage.add(f"after frame {count}", f"{missing} bytes are missing at the end of the file, and the frames "
                                                  "in them")


def write_log(path: Path, blocks: Iterable[NDArray[np.void]]) -> int:
    """Write frames in the format that the file's ending names (.asc, .blf, .log, .trc …); returns their number."""
    count = 0
    try:
        with can.Logger(path) as writer:
            for rows in blocks:
                for message in messages(rows):
                    writer.on_message_received(message)
                count += len(rows)
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: cannot be written ({error}); give another name.") from None
    return count


__all__ = ["McapReader", "McapWriter", "TrialMessage", "messages", "read_log", "write_log"]
