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
    """Yield the frames of candump's lines as they come; `remark` is called with a sentence on each damaged line.

    The sentences are those that `read` lists, from the first frame on, and at the end the number of further ones.

    Raises `InputError` for lines of which none is a frame, and at the end if most of them are none.
    """
    damage, frames, malformed = DamageRemarks(), 0, 0
    for number, line in enumerate(lines, 1):
        frame = parse(line)
        anomaly, sentence = _damage(line, frame)
        malformed += anomaly == "malformed_lines"
        if sentence:
            damage.add(f"line {number}", sentence)
        if frame is not None:
            frames += 1
            yield frame
        for place in damage.unread() if frames else ():
            remark(f"{name}: {place}.")
        if not frames and damage.full:
            break
    if not frames and damage.sentences:
        raise InputError(f"{name}: holds no classical CAN frame ({damage.sentences[0]}); {REMEDY}.")
    if damage.further:
        remark(f"{name}: {damage.further}.")
    _refuse_no_log(malformed, frames, f"{name}: ")


def read(lines: Iterable[str]) -> LoggedFrames:
    """Read a candump log; `counts` holds malformed lines, CAN FD frames (a trial cannot store them) and DLCs above 8.

    `damage` lists malformed lines, and a last line without an end, whose payload may be cut.

    Raises `InputError` for screen output without a time, or with the time since the line before, and for a text most of
    whose lines are malformed.
    """
    rows = FrameRows()
    channels = ChannelNumbers()
    counts = {"malformed_lines": 0, "fd_frames": 0, "dlc_above_8": 0, "unstamped_lines": 0}
    shown, damage = 0, DamageRemarks()
    for number, line in enumerate(lines, 1):
        frame = parse(line)
        anomaly, sentence = _damage(line, frame)
        if anomaly:
            counts[anomaly] += 1
        if sentence and anomaly != "fd_frames":  # these are counted alone
            damage.add(f"line {number}", sentence)
        if frame is None:
            continue
        if frame.time_ns is None:
            counts["unstamped_lines"] += 1
        else:
            shown += frame.shown
            counts["dlc_above_8"] += frame.long
            rows.add((frame.time_ns, frame.can_id, frame.flags, frame.dlc, channels.number(frame.channel), frame.sent,
                      frame.payload), number)
    _refuse_screen(rows, counts, shown)
    _refuse_no_log(counts["malformed_lines"], len(rows))
    return LoggedFrames(rows.rows(), channels.names, counts, damage, rows.lines)


def _damage(line: str, frame: CandumpLine | None) -> tuple[str, str]:
    """Return the count that a line without the classical `frame` belongs to, and a sentence on a damaged line.

    Both are "" for a whole frame and for an empty line.
    """
    text = _COLOURS.sub("", line).strip()
    if frame is not None or not text:
        return "", "" if line.endswith("\n") or not text else END_MISSING
    found = _SCREEN.match(text) if len(text) <= LONGEST else None
    if (found and (len(found[6]) > 1 or int(found[6]) > 8)) or (len(text) <= LONGEST and _FD_LINE.match(text)):
        return "fd_frames", f"{text[:60]!r} is a CAN FD frame; left out"
    return "malformed_lines", f"{text[-60:]!r} is no whole frame; left out"


def _refuse_no_log(malformed: int, frames: int, source: str = "") -> None:
    """Raise `InputError` for a text with more malformed lines than frames; `source`: its name and a colon."""
    if malformed > frames:
        raise InputError(f"{source}{malformed} lines are not as candump -L writes them; give such a log.")


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
