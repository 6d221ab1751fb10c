"""Lines of candump, of a file or of standard input: the log format (`-L`), and the one for people.

`(1.5) can0 181#0102`, and `(1.5)  can0  TX - -  181   [2]  01 02` with the time and the direction left out or not.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Final

import can

from parameters import InputError

_LOG: Final = re.compile(r"\((\d+(?:\.\d+)?)\)\s+(\S+)\s+([0-9A-Fa-f]{3,8})#(R\d?|[0-9A-Fa-f.]*)(?:\s+[RT])?")
_SHOWN: Final = re.compile(r"(?:\(([-\d. :]+)\)\s+)?(\S+)\s+(?:(RX|TX)\s+\S+\s+\S+\s+)?([0-9A-Fa-f]{3,8})\s+"
                           r"\[(\d+)\]\s*(remote request|(?:[0-9A-Fa-f]{2}(?:\s+|$))*)(?:\s*(?:'.*'|ERRORFRAME))?")
_ERROR: Final = 0x20000000
_COLOURS: Final = re.compile(r"\x1b\[[0-9;]*m")


def messages(lines: Iterable[str], name: str) -> Iterator[can.Message]:
    """Yield the frames of candump's lines; empty lines are passed over, and a CAN FD frame or another line is an
    `InputError` with its number.
    """
    for place, line in enumerate(lines, 1):
        text = _COLOURS.sub("", line).strip()
        if text:
            message = _logged(text) or _shown(text)
            if message is None:
                raise InputError(f"{name}:{place}: {text[:60]!r} is no line of candump with a classical CAN frame; "
                                 "write the log by candump -L.")
            yield message


def _logged(text: str) -> can.Message | None:
    match = _LOG.fullmatch(text)
    if match is None:
        return None
    stamp, channel, can_id, data = match.groups()
    if data.startswith("R"):
        return _message(stamp, channel, can_id, b"", int(data[1:] or 0))
    octets = data.replace(".", "")
    return None if len(octets) % 2 or len(octets) > 16 else _message(stamp, channel, can_id, bytes.fromhex(octets))


def _shown(text: str) -> can.Message | None:
    match = _SHOWN.fullmatch(text)
    if match is None:
        return None
    stamp, channel, direction, can_id, size, data = match.groups()
    remote = data == "remote request"
    octets = b"" if remote else bytes.fromhex(data)
    if int(size) > 8 or (not remote and len(octets) != int(size)):
        return None
    try:
        float(stamp or "0")
    except ValueError:  # candump -t A: a date, which frames without an offset of the day do not need
        stamp = None
    return _message(stamp, channel, can_id, octets, int(size) if remote else None, received=direction != "TX")


def _message(stamp: str | None, channel: str, can_id: str, data: bytes, remote: int | None = None, *,
             received: bool = True) -> can.Message:
    identifier = int(can_id, 16)
    return can.Message(
        float(stamp or 0.0), identifier & 0x1FFFFFFF, is_extended_id=len(can_id) > 3, is_rx=received, channel=channel,
        is_error_frame=bool(identifier & _ERROR) and len(can_id) > 3, is_remote_frame=remote is not None,
        dlc=len(data) if remote is None else remote, data=data)
