"""candump's log file, read and written: `(1700000000.000123) can0 181#3706102700000A00`.

The rule of this file: stamps stay integers; a line that is none is counted, and only a file that is mostly
such lines is refused.  Format: `candump -L` of can-utils; a remote frame carries its DLC, `R` or `T` behind a
frame its direction.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trial.convert.frames import ChannelNumbers, Frames, Gathered, Row
from trial.mcap_file import cdr

_LINE = re.compile(
    r"\((-?\d+)\.(\d{1,9})\) (\S+) ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(R[0-8]?|(?:[0-9A-Fa-f]{2}){0,8})(?: ([RT]))?$")
_FD_LINE = re.compile(r"\(-?\d+\.\d+\) \S+ [0-9A-Fa-f]+##")
ERROR_BIT, EXTENDED_MASK = 0x20000000, 0x1FFFFFFF


def read(lines: Iterable[str]) -> Frames:
    """Read a candump log; `counts` tells malformed lines and CAN FD frames, which a trial cannot hold."""
    rows = Gathered()
    channels = ChannelNumbers()
    malformed = fd_frames = 0
    for line in lines:
        found = _LINE.match(line.strip())
        if found is None:
            fd_frames += bool(_FD_LINE.match(line))
            malformed += not _FD_LINE.match(line) and bool(line.strip())
            continue
        rows.add(_row(found, channels))
    counts = {"malformed_lines": malformed, "fd_frames": fd_frames}
    return Frames(rows.rows(), channels.names, counts)


def _row(found: re.Match[str], channels: ChannelNumbers) -> Row:
    seconds, fraction, channel, identifier, data, direction = found.groups()
    time_ns = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0")) * (-1 if seconds.startswith("-") else 1)
    can_id, flags = int(identifier, 16), cdr.EXTENDED if len(identifier) == 8 else 0
    if flags and can_id & ERROR_BIT:
        flags = cdr.ERROR
    can_id &= EXTENDED_MASK
    if data.startswith("R"):
        dlc, payload, flags = int(data[1:] or 0), b"", flags | cdr.REMOTE
    else:
        payload = bytes.fromhex(data)
        dlc = len(payload)
    return time_ns, can_id, flags, dlc, channels.number(channel), direction == "T", payload


def lines(rows: NDArray[np.void]) -> Iterator[str]:
    """Write frames as candump's lines; the format knows microseconds, what is finer is cut off."""
    for time_ns, can_id, flags, dlc, channel, sent, data in rows.tolist():
        seconds, rest = divmod(time_ns, 1_000_000_000)
        identifier = f"{can_id:08X}" if flags & cdr.EXTENDED else f"{can_id:03X}"
        if flags & cdr.ERROR:
            identifier = f"{can_id | ERROR_BIT:08X}"
        body = f"R{dlc}" if flags & cdr.REMOTE else bytes(data[:dlc]).hex().upper()
        yield f"({seconds}.{rest // 1000:06d}) can{channel} {identifier}#{body} {'T' if sent else 'R'}\n"


def write(path: Path, rows: NDArray[np.void], progress: Callable[[float], None] = lambda share: None) -> None:
    """Write a candump log; `progress` is told the share done, 0 … 1."""
    with path.open("w", encoding="ascii") as file:
        for at in range(0, len(rows), 4096):
            file.writelines(lines(rows[at:at + 4096]))
            progress(min(1.0, (at + 4096) / len(rows)))
