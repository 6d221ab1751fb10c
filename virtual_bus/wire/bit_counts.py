"""Bit counts of whole recordings and of compiled cycles: `bits.frame_bits`, compiled for arrays."""

from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_bus.wire.bits import TRAILER_BITS

Counts = NDArray[np.int64]


@numba.njit("int64(int64, int64, uint64, int64)", cache=True)
def stuffed_bits(head: int, head_bits: int, payload: int, payload_bits: int) -> int:
    """Return the bits of header, payload and CRC-15 with their stuff bits."""
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
        counts[row] = stuffed_bits(head, width, payload, 8 * size) + TRAILER_BITS
    return counts
