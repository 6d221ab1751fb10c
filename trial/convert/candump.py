"""candump's log files, read and written: `(1700000000.000123) can0 181#3706102700000A00`.

Time stamps stay integers. A line that is not a frame is counted; a file that consists mostly of such lines is
refused. Format: `candump -L` of can-utils. A remote frame carries its DLC; `R` or `T` after a frame is its direction,
`_9` … `_F` after its data a DLC above 8. candump's screen output (`(0.000123) can0 181 [8] 37 06 10 27 00 00 0A 00`)
is read, too, if its lines have time stamps.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from trial.convert.frames import END_MISSING, ChannelNumbers, DamageRemarks, FrameRows, LoggedFrames
from trial.mcap_file import cdr

NS = 1_000_000_000
_STAMP = r"\((?:(-?(?:[1-8]\d{9}|\d{1,9}))\.(\d{1,9})|[-\d :.]+)\)"
_LINE = re.compile(
    rf"{_STAMP} (\S+) ([0-9A-Fa-f]{{3}}|[0-9A-Fa-f]{{8}})#(R[0-8]?|(?:[0-9A-Fa-f]{{2}}\.?){{0,8}})"
    r"(?:_([9A-Fa-f]))?(?: ([RT]))?$")
_SCREEN = re.compile(
    rf"(?:{_STAMP}\s+)?(\S+)\s+(?:([RT])X [-B] [-E]\s+)?([0-9A-Fa-f]{{3}}|[0-9A-Fa-f]{{8}})\s+\[(\d{{1,2}})\]"
    r"(?:\s+(remote request)|((?:\s+[0-9A-Fa-f]{2}){0,64}))(?:\s.*)?$")
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
LONGEST = 400  # characters that candump writes for a frame of 64 bytes, at most
REMEDY = "record it with candump -L"
_FD_LINE = re.compile(r"\(-?\d+\.\d+\) \S+ [0-9A-Fa-f]+##")
ERROR_BIT, EXTENDED_MASK = 0x20000000, 0x1FFFFFFF


class CandumpLine(NamedTuple):
    """One classical frame of candump: `time_ns` None without a time in seconds; `shown`: of the screen's format.

    `long` marks a DLC above 8. `flags` are those of `cdr`; a remote frame has a `dlc` and no `payload`.
    """

    time_ns: int | None
    channel: str
    can_id: int
    flags: int
    dlc: int
    sent: bool
    payload: bytes
    shown: bool
    long: bool


def parse(line: str) -> CandumpLine | None:
    """Return the frame of a line of candump's log or screen; None for a CAN FD frame or another line."""
    text = _COLOURS.sub("", line).strip()
    if len(text) > LONGEST:
        return None
    found = _LINE.match(text)
    if found is not None:
        seconds, fraction, channel, identifier, body, long, direction = found.groups()
        remote, size, data = body.startswith("R"), body[1:], body.replace(".", "")
    else:
        found = _SCREEN.match(text)
        if found is None:
            return None
        seconds, fraction, channel, direction, identifier, size, request, octets = found.groups()
        if len(size) > 1 or int(size) > 8:  # of a CAN FD frame it has two digits
            return None
        remote, long, data = request is not None, None, "".join((octets or "").split())[:2 * int(size)]
        if not remote and len(data) < 2 * int(size):
            return None
    time_ns = None if seconds is None else (
        int(seconds) * NS + int(fraction.ljust(9, "0")) * (-1 if seconds.startswith("-") else 1))
    can_id, flags = int(identifier, 16), cdr.EXTENDED if len(identifier) == 8 else 0
    if flags and can_id & ERROR_BIT:
        flags = cdr.ERROR
    payload = b"" if remote else bytes.fromhex(data)
    return CandumpLine(time_ns, channel, can_id & EXTENDED_MASK, flags | (cdr.REMOTE if remote else 0),
                       int(size or 0) if remote else len(payload), direction == "T", payload,
                       found.re is _SCREEN, long is not None)


def is_log(line: str) -> bool:
    """Return whether a line is candump's, of its log or of its screen."""
    text = _COLOURS.sub("", line).strip()
    return bool(_LINE.match(text) or _FD_LINE.match(text) or _SCREEN.match(text))


def each(lines: Iterable[str], name: str, remark: Callable[[str], None]) -> Iterator[CandumpLine]:
    """Yield the frames of candump's lines; empty lines are passed over, and a line without a classical frame is an
    `InputError` with its number.

    A last line without an end may be torn: `remark` is called with a sentence.
    """
    for number, line in enumerate(lines, 1):
        frame, torn = parse(line), not line.endswith("\n")
        if torn and line.strip():
            remark(f"{name}:{number}: the last line has no end and may be torn: {line.strip()[-60:]!r}"
                   f"{'' if frame else '; it is left out'}.")
        if frame is not None:
            yield frame
        elif line.strip() and not torn:
            raise InputError(f"{name}:{number}: {line.strip()[:60]!r} is no line of candump with a classical CAN "
                             "frame; write the log by candump -L.")


def read(lines: Iterable[str]) -> LoggedFrames:
    """Read a candump log; `counts` holds malformed lines, CAN FD frames (a trial cannot store them) and DLCs above 8.

    `damage` lists malformed lines, and a last line without an end, whose payload may be cut.

    Raises `InputError` for screen output without a time, or with the time since the line before.
    """
    rows = FrameRows()
    channels = ChannelNumbers()
    counts = {"malformed_lines": 0, "fd_frames": 0, "dlc_above_8": 0, "unstamped_lines": 0}
    shown, damage, line = 0, DamageRemarks(), "\n"
    for number, line in enumerate(lines, 1):
        frame = parse(line)
        if frame is None and line.strip():
            anomaly = _anomaly(line)
            counts[anomaly] += 1
            if anomaly == "malformed_lines":
                damage.add(f"line {number}", f"{line.strip()[-60:]!r} is no whole frame; left out")
        elif frame is None:
            pass
        elif frame.time_ns is None:
            counts["unstamped_lines"] += 1
        else:
            shown += frame.shown
            counts["dlc_above_8"] += frame.long
            rows.add((frame.time_ns, frame.can_id, frame.flags, frame.dlc, channels.number(frame.channel), frame.sent,
                      frame.payload), number)
    if not line.endswith("\n") and parse(line) is not None:
        damage.add(f"line {number}", END_MISSING)
    _refuse_screen(rows, counts, shown)
    return LoggedFrames(rows.rows(), channels.names, counts, damage, rows.lines)


def _anomaly(line: str) -> str:
    """Return the count that a line without a classical frame belongs to."""
    text = line.strip()
    return "fd_frames" if len(text) <= LONGEST and (_FD_LINE.match(text) or _SCREEN.match(text)) else "malformed_lines"


def _refuse_screen(rows: FrameRows, counts: dict[str, int], shown: int) -> None:
    unstamped = counts.pop("unstamped_lines")
    if unstamped > len(rows):
        raise InputError(f"{unstamped} lines are as candump shows them on a screen, without a time; {REMEDY}.")
    if shown:
        times = rows.rows()["time_ns"]
        if np.count_nonzero(np.diff(times) < 0) > 0.1 * len(times):
            raise InputError(f"the times are since the line before, as candump -td shows them; {REMEDY}.")
    if unstamped:
        counts["unstamped_lines"] = unstamped


def lines(rows: NDArray[np.void]) -> Iterator[str]:
    """Write frames as candump's lines; the format's resolution is 1 µs, finer digits are cut off."""
    for time_ns, can_id, flags, dlc, channel, sent, data in rows.tolist():
        seconds, rest = divmod(time_ns, NS)
        identifier = f"{can_id:08X}" if flags & cdr.EXTENDED else f"{can_id:03X}"
        if flags & cdr.ERROR:
            identifier = f"{can_id | ERROR_BIT:08X}"
        body = f"R{dlc}" if flags & cdr.REMOTE else bytes(data[:dlc]).hex().upper()
        yield f"({seconds}.{rest // 1000:06d}) can{channel} {identifier}#{body} {'T' if sent else 'R'}\n"
