"""The bits of a classical CAN frame: fields, CRC-15, stuffing (ISO 11898-1, 10.4).

The time of a frame on the wire is counted from its bits, never estimated. `sequence` writes them out; `frame_bits`
counts them by tables of whole bytes, because every frame needs it. `bit_counts` counts those of a whole recording.
"""

from collections.abc import Iterator
from typing import Final

from eds.cia301 import Frame

CRC_POLYNOMIAL: Final = 0x4599
TRAILER_BITS: Final = 10
"""CRC delimiter, acknowledge slot and delimiter, end of frame (7): never stuffed."""
INTERMISSION_BITS: Final = 3
ERROR_FRAME_BITS: Final = 20
"""Error flag with its longest superposition (12) and error delimiter (8)."""
SUSPEND_BITS: Final = 8
"""Further wait of an error-passive transmitter after the intermission, bits."""
RECOVERY_BITS: Final = 128 * 11
"""Recessive bits after which a node that is bus-off may take part again."""
BITRATES: Final = (125_000, 250_000, 500_000, 800_000, 1_000_000)


def header(frame: Frame) -> tuple[int, int]:
    """Return (value, number of bits) of the fields from start of frame to DLC."""
    dlc = len(frame.data) if frame.dlc is None else frame.dlc
    if frame.extended:
        base, low = frame.can_id >> 18, frame.can_id & 0x3FFFF
        return ((((base << 2 | 3) << 18 | low) << 1 | frame.remote) << 6) | dlc, 39
    return (frame.can_id << 1 | frame.remote) << 6 | dlc, 19


def arbitration(frame: Frame) -> int:
    """Return the frame's place in arbitration: of two frames the smaller wins.

    Identifier bit by bit, then data before remote, then base before extended format.
    """
    can_id, _, remote, extended, _, _ = frame
    if not extended and not remote:
        return can_id << 21
    if extended:
        return ((can_id >> 18 << 2 | 3) << 18 | can_id & 0x3FFFF) << 1 | remote
    return can_id << 21 | remote << 20


def frame_bits(frame: Frame) -> int:
    """Return the bit times from start to end of frame, stuff bits included, intermission not.

    At most 52 + 10 n for n data bytes in base format, so 55 + 10 n with the intermission.
    """
    can_id, data, remote, extended, _, dlc = frame
    if remote or extended or dlc is not None:
        head, width = header(frame)
        if remote:
            data = b""
    else:
        head, width = can_id << 7 | len(data), 19
    octets = head.to_bytes((width + 7) >> 3, "big") + data
    crc = 0
    for octet in octets:
        crc = (crc << 8 & 0x7F00) ^ _CRC[crc >> 7 ^ octet]
    entry = _FIRST[width & 7][octets[0]]
    count, table = entry >> 4, _STUFFED[8]
    for octet in octets[1:]:
        entry = table[(entry & 15) << 8 | octet]
        count += entry >> 4
    entry = table[(entry & 15) << 8 | crc >> 7]
    count += (entry >> 4) + (_STUFFED[7][(entry & 15) << 8 | crc & 0x7F] >> 4)
    return width + 8 * len(data) + 15 + count + TRAILER_BITS


def crc15(bits: list[int]) -> int:
    """Return the CRC-15 of the unstuffed bits from start of frame to the end of the data field."""
    crc = 0
    for bit in bits:
        flip = bit ^ crc >> 14
        crc = crc << 1 & 0x7FFF ^ (CRC_POLYNOMIAL if flip else 0)
    return crc


def sequence(frame: Frame) -> list[int]:
    """Return the frame bit by bit as its transmitter sends it, 0 dominant; the acknowledge slot is recessive."""
    value, width = header(frame)
    plain = _digits(value, width) + [b for byte in (b"" if frame.remote else frame.data) for b in _digits(byte, 8)]
    return [*_stuff(plain + _digits(crc15(plain), 15)), *[1] * TRAILER_BITS]


def first_difference(one: Frame, other: Frame) -> int:
    """Return how many bits of two unequal frames pass until their transmitters have seen that they differ."""
    pairs = zip(sequence(one), sequence(other), strict=False)
    return 1 + next(place for place, (a, b) in enumerate(pairs) if a != b)


def _digits(value: int, width: int) -> list[int]:
    return [value >> place & 1 for place in reversed(range(width))]


def _stuff(bits: list[int]) -> Iterator[int]:
    run, last = 0, -1
    for bit in bits:
        yield bit
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            run, last = 1, 1 - bit
            yield last


def _stuffed_table(width: int) -> list[int]:
    """Stuff bits of `width` bits by state << 8 | bits: their number << 4 | next state.

    A state is 2 (run − 1) + bit for a run of 1 to 4 equal bits.
    """
    return [_after(width, state >> 1, state & 1, octet) for state in range(8) for octet in range(256)]


def _after(width: int, run: int, last: int, value: int) -> int:
    count, run = 0, run + 1
    for bit in _digits(value, width):
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count, run, last = count + 1, 1, 1 - bit
    return count << 4 | (run - 1) << 1 | last


_CRC: Final = [crc15(_digits(octet, 8)) for octet in range(256)]
"""CRC-15 of each byte."""
_STUFFED: Final = {width: _stuffed_table(width) for width in (7, 8)}
_FIRST: Final = {width: [_after(width, -1, -1, octet) for octet in range(256)] for width in (3, 7)}
"""Stuff bits before the first whole byte: a base header has 19 bits, an extended one 39."""
