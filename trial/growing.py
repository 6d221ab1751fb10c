"""A trial that another process still writes: its complete rows so far.

Only complete records count, and each is read once; bytes behind the last complete record are read again when the file
has grown.
"""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from trial.mcap_file import cdr, records
from trial.mcap_file import container as mcap

HEAD_BYTES: Final = 9
"""Opcode and length of a record."""
ROW_TOPIC: Final = cdr.CYCLE


class GrowingTrial:
    """Rows of `/cycle` of a file that may still be written; `columns` are known once its header is there.

    `closed`: the writer has written its summary, and no row will follow.  `replaced`: a file that is there already is
    an older trial, which is about to be overwritten.
    """

    def __init__(self, path: Path, *, replaced: bool = False) -> None:
        self.path = path
        self._older = _identity(path) if replaced else None
        self.columns: tuple[str, ...] = ()
        self.closed = False
        self._at = len(mcap.MAGIC)
        self._described = records.Descriptions()
        self._channel: int | None = None

    def rows(self, most: int = 8_192) -> NDArray[np.float64]:
        """Return rows that have come since the last call, shape (rows, columns); none before the file is there.

        `most`: number of rows after which the others are left to the next call.

        Raises `InputError` for a file that is no trial of this project.
        """
        found: list[NDArray[np.float64]] = []
        count = 0
        if not self.closed and self._grown():
            with records.mapped(self.path) as view:
                while not self.closed and count < most and self._at + HEAD_BYTES <= len(view):
                    end = self._at + HEAD_BYTES + int.from_bytes(view[self._at + 1:self._at + HEAD_BYTES], "little")
                    if end > len(view):
                        break
                    part = self._record(view, view[self._at], self._at + HEAD_BYTES, end)
                    found, count, self._at = [*found, *part], count + sum(map(len, part)), end
        return np.concatenate(found) if found else np.zeros((0, len(self.columns)))

    def _grown(self) -> bool:
        """Return whether the file has unread bytes."""
        identity = _identity(self.path)
        return identity is not None and identity != self._older and identity[1] > self._at

    def _record(self, view: records.View, opcode: int, begin: int, end: int) -> list[NDArray[np.float64]]:
        """Read one complete record: descriptions are stored, rows of a chunk returned."""
        try:
            self._described.take(opcode, view, begin, end)
            if opcode == mcap.CHANNEL:
                self._find_rows()
            elif opcode == mcap.CHUNK:
                return self._unpacked(records.unpack(view, begin, end)[0])
            self.closed = opcode == mcap.DATA_END
        except (records.CutError, ValueError) as error:
            raise InputError(f"{self.path}: the record at byte {begin} is damaged; end the watch and say bowden "
                             f"recover {self.path} -o FILE.") from error
        return []

    def _find_rows(self) -> None:
        for channel in self._described.channels.values():
            if channel.topic == ROW_TOPIC and (names := cdr.cycle_columns(channel.schema)) is not None:
                self.columns, self._channel = names, channel.number

    def _unpacked(self, data: bytes) -> list[NDArray[np.float64]]:
        if self._channel is None:
            return []
        dtype = cdr.cycle_record(len(self.columns))
        whole = [data[at - HEAD_BYTES:end] for opcode, at, end in records.records(data, 0, len(data))
                 if opcode == mcap.MESSAGE and int.from_bytes(data[at:at + 2], "little") == self._channel]
        rows = np.frombuffer(b"".join(whole), dtype)
        return [np.asarray(rows["values"], np.float64)] if rows.size else []


def _identity(path: Path) -> tuple[int, int, int] | None:
    """Return inode, size and time of change of a file; None if it does not exist."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns
