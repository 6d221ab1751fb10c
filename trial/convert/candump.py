"""candump's log files, read and written: `(1700000000.000123) can0 181#3706102700000A00`.

Time stamps stay integers. A line that is not a frame is counted; a file that consists mostly of such lines is
refused. Format: `candump -L` of can-utils. A remote frame carries its DLC; `R` or `T` after a frame is its direction,
`_9` … `_F` after its data a DLC above 8. candump's screen output (`(0.000123) can0 181 [8] 37 06 10 27 00 00 0A 00`)
is read, too, if its lines have time stamps.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from trial.convert.frames import ChannelNumbers, Gathered, LoggedFrames, Row
from trial.mcap_file import cdr

_LINE = re.compile(
    r"\((-?(?:[1-8]\d{9}|\d{1,9}))\.(\d{1,9})\) (\S+) ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"#(R[0-8]?|(?:[0-9A-Fa-f]{2}){0,8})"
    r"(?:_([9A-Fa-f]))?(?: ([RT]))?$")
_SCREEN = re.compile(
    r"(?:\((-?(?:[1-8]\d{9}|\d{1,9}))\.(\d{1,9})\)\s+)?(\S+)\s+(?:([RT])X [-B] [-E]\s+)?"
    r"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[(\d{1,2})\]"
    r"(?:\s+remote request|((?:\s+[0-9A-Fa-f]{2}){0,64}))(?:\s.*)?$")
LONGEST = 400  # characters that candump writes for a frame of 64 bytes, at most
REMEDY = "record it with candump -L"
_FD_LINE = re.compile(r"\(-?\d+\.\d+\) \S+ [0-9A-Fa-f]+##")
ERROR_BIT, EXTENDED_MASK = 0x20000000, 0x1FFFFFFF


def is_log(line: str) -> bool:
    """Return whether a line is candump's, of its log or of its screen."""
    return bool(_LINE.match(line.strip()) or _FD_LINE.match(line) or _SCREEN.match(line.strip()))


def read(lines: Iterable[str]) -> LoggedFrames:
    """Read a candump log; `counts` holds malformed lines, CAN FD frames (a trial cannot store them) and DLCs above 8.

    Raises `InputError` for screen output without a time, or with the time since the line before.
    """
    rows = Gathered()
    channels = ChannelNumbers()
    counts = {"malformed_lines": 0, "fd_frames": 0, "dlc_above_8": 0, "unstamped_lines": 0}
    for line in lines:
        text = line.strip()
        if len(text) > LONGEST:
            counts["malformed_lines"] += 1
            continue
        found = _LINE.match(text)
        row = _row(found, channels, counts) if found is not None else _shown(text, channels, counts)
        if row is not None:
            rows.add(row)
    _refuse_screen(rows, counts)
    return LoggedFrames(rows.rows(), channels.names, counts)


def _refuse_screen(rows: Gathered, counts: dict[str, int]) -> None:
    unstamped, shown = counts.pop("unstamped_lines"), counts.pop("_shown", 0)
    if unstamped > len(rows):
        raise InputError(f"{unstamped} lines are as candump shows them on a screen, without a time; {REMEDY}.")
    if shown:
        times = rows.rows()["time_ns"]
        if np.count_nonzero(np.diff(times) < 0) > 0.1 * len(times):
            raise InputError(f"the times are since the line before, as candump -td shows them; {REMEDY}.")
    if unstamped:
        counts["unstamped_lines"] = unstamped


def _row(found: re.Match[str], channels: ChannelNumbers, counts: dict[str, int]) -> Row:
    seconds, fraction, channel, identifier, data, long, direction = found.groups()
    counts["dlc_above_8"] += long is not None
    return _made((seconds, fraction), channel, identifier, data, direction == "T", channels)


def _shown(text: str, channels: ChannelNumbers, counts: dict[str, int]) -> Row | None:
    """Read a line of candump's screen output; a line that is not a frame is counted and gives None."""
    found = _SCREEN.match(text)
    if found is None:
        fd_frame = bool(_FD_LINE.match(text))
        counts["fd_frames"] += fd_frame
        counts["malformed_lines"] += not fd_frame and bool(text)
        return None
    seconds, fraction, channel, direction, identifier, length, data = found.groups()
    if len(length) > 1 or int(length) > 8:  # of a CAN FD frame it has two digits
        counts["fd_frames"] += 1
        return None
    if seconds is None:
        counts["unstamped_lines"] += 1
        return None
    counts["_shown"] = counts.get("_shown", 0) + 1
    body = f"R{length}" if data is None else "".join(data.split())[:2 * int(length)]
    return _made((seconds, fraction), channel, identifier, body, direction == "T", channels)


def _made(
    stamp: tuple[str, str], channel: str, identifier: str, data: str, sent: bool, channels: ChannelNumbers
) -> Row:
    seconds, fraction = stamp
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
    return time_ns, can_id, flags, dlc, channels.number(channel), sent, payload


def lines(rows: NDArray[np.void]) -> Iterator[str]:
    """Write frames as candump's lines; the format's resolution is 1 µs, finer digits are cut off."""
    for time_ns, can_id, flags, dlc, channel, sent, data in rows.tolist():
        seconds, rest = divmod(time_ns, 1_000_000_000)
        identifier = f"{can_id:08X}" if flags & cdr.EXTENDED else f"{can_id:03X}"
        if flags & cdr.ERROR:
            identifier = f"{can_id | ERROR_BIT:08X}"
        body = f"R{dlc}" if flags & cdr.REMOTE else bytes(data[:dlc]).hex().upper()
        yield f"({seconds}.{rest // 1000:06d}) can{channel} {identifier}#{body} {'T' if sent else 'R'}\n"
