"""The bits of a classical CAN frame: fields, CRC-15, stuffing (ISO 11898-1, 10.4).

The time of a frame on the wire is counted from its bits, never estimated. `sequence` writes them out; `frame_bits`
counts them, compiled, because every frame needs it; `bits_of` counts those of a whole recording.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

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


Counts = NDArray[np.int64]
_big_endian = int.from_bytes


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
    bits: int = _stuffed_bits(head, width, _big_endian(data), 8 * len(data))
    return bits + TRAILER_BITS


@numba.njit("int64(int64, int64, uint64, int64)", cache=True)
def _stuffed_bits(head: int, head_bits: int, payload: int, payload_bits: int) -> int:
    total = head_bits + payload_bits
    count, run, last, crc = 0, 0, -1, 0
    for place in range(total + 15):
        if place < head_bits:
            bit = (head >> (head_bits - 1 - place)) & 1
        elif place < total:
            bit = (payload >> (total - 1 - place)) & 1
        else:
            bit = (crc >> (total + 14 - place)) & 1
        if place < total:
            flip = bit ^ ((crc >> 14) & 1)
            crc = (crc << 1) & 0x7FFF
            if flip:
                crc ^= 0x4599
        count += 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count += 1
            last = 1 - bit
            run = 1
    return count


def bits_of(can_id: ArrayLike, dlc: ArrayLike, data: ArrayLike, remote: ArrayLike, extended: ArrayLike) -> Counts:
    """Return `frame_bits` of n frames at once; `data` has shape (n, 8), what lies behind the DLC does not count."""
    counts: Counts = _bits_of(
        np.ascontiguousarray(can_id, np.int64), np.ascontiguousarray(dlc, np.int64),
        np.ascontiguousarray(data, np.uint8), np.ascontiguousarray(remote, np.bool_),
        np.ascontiguousarray(extended, np.bool_),
    )
    return counts


@numba.njit(cache=True)
def _bits_of(can_id: Any, dlc: Any, data: Any, remote: Any, extended: Any) -> Any:
    counts = np.empty(len(can_id), np.int64)
    for row in range(len(can_id)):
        size = 0 if remote[row] else min(dlc[row], 8)
        payload: Any = np.uint64(0)
        for place in range(size):
            payload = (payload << np.uint64(8)) | np.uint64(data[row, place])
        if extended[row]:
            fields = (can_id[row] >> 18 << 2 | 3) << 18 | can_id[row] & 0x3FFFF
            head, width = (fields << 1 | remote[row]) << 6 | dlc[row], 39
        else:
            head, width = (can_id[row] << 1 | remote[row]) << 6 | dlc[row], 19
        counts[row] = _stuffed_bits(head, width, payload, 8 * size) + TRAILER_BITS
    return counts


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
