"""Frames as `recvmmsg` leaves them, read by compiled code: rows for the recorder, and one cycle's inputs.

The rule of this file: memory in, numbers out.  A slot is a frame and its ancillary data, `SLOT` words of 64 bits; a
header is its `struct mmsghdr`, `HEADER` words.  Whoever finds in a cycle what is not plainly its own says so, and the
frames are looked at one by one elsewhere.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit

from eds.cia301 import HEARTBEAT_BASE, SYNC_COB_ID, NmtState
from trial.mcap_file.cdr import ERROR, EXTENDED, REMOTE

SLOT, HEADER, ROW = 10, 8, 3
"""Words of a slot, of a header, of a `cdr.FRAME_ROW`."""
EFF, RTR, ERR, ID = 0x80000000, 0x40000000, 0x20000000, 0x1FFFFFFF
OWN: Final = 4
"""MSG_DONTROUTE: the frame was sent by this computer."""
PLAIN: Final = 32
"""Ancillary bytes of a message that tells its time stamp alone."""
NS: Final = 1_000_000_000

LAST_NS, MARKED_NS, SYNC_NS, SYNC_END, LOST, TAKEN = range(6)
"""What `rows` tells: time stamps of the last frame, of the last marked one and of the last SYNC, −1 for none; the
place behind that SYNC; lost frames, −1 where none was told; the number of rows."""
INPUTS: Final = 4
MISSING, AT_NS, DROPPED, BEATS, BEAT = 0, 1, 2, 3, 4
"""What `heed` tells: a bit for each input that is not there yet, −1 before SYNC; when SYNC came; lost frames, as above;
heartbeats and, from `BEAT` on, identifier, time and state of each."""
MOST_BEATS: Final = 8
FRAMES: Final = BEAT + 3 * MOST_BEATS
"""From here on time stamp and data of each input."""
HEEDED: Final = FRAMES + 2 * INPUTS
OPERATIONAL: Final = int(NmtState.OPERATIONAL)
DONE, WAITING, STRANGE = 1, 0, -1
"""All inputs are there; some are not yet; something else came."""


@njit(cache=True)
def rows(slots: Any, headers: Any, count: int, block: Any, at: int, marked_id: int, told: Any) -> None:
    """Write `count` frames into `block`, rows of `ROW` words, from row `at` on; `told` says what they were."""
    for n in range(count):
        raw, size = slots[n, 0] & np.uint64(0xFFFFFFFF), (slots[n, 0] >> np.uint64(32)) & np.uint64(0xFF)
        time_ns = np.int64(slots[n, 4]) * NS + np.int64(slots[n, 5])
        flags, can_id, data = np.uint64(0), raw, slots[n, 1]
        if raw > np.uint64(0x7FF):
            can_id = raw & np.uint64(ID)
            flags |= np.uint64(EXTENDED) if raw & np.uint64(EFF) else np.uint64(0)
            flags |= np.uint64(ERROR) if raw & np.uint64(ERR) else np.uint64(0)
            if raw & np.uint64(RTR):
                flags |= np.uint64(REMOTE)
                data = np.uint64(0)
        if size < np.uint64(8):
            data &= (np.uint64(1) << (np.uint64(8) * size)) - np.uint64(1)
        own = np.uint64(headers[n, 6] & np.uint64(OWN) != np.uint64(0))
        block[at + n, 0] = np.uint64(time_ns)
        block[at + n, 1] = can_id | flags << np.uint64(32) | size << np.uint64(40) | own << np.uint64(56)
        block[at + n, 2] = data
        told[LAST_NS] = time_ns
        if raw == np.uint64(marked_id):
            told[MARKED_NS] = time_ns
        if raw == np.uint64(SYNC_COB_ID):
            told[SYNC_NS], told[SYNC_END] = time_ns, at + n + 1
        if headers[n, 5] > np.uint64(PLAIN):
            told[LOST] = np.int64(slots[n, 8] & np.uint64(0xFFFFFFFF))
    told[TAKEN] = at + count


@njit(cache=True)
def heed(slots: Any, headers: Any, count: int, inputs: Any, sizes: Any, told: Any) -> int:
    """Take the frames of a cycle after its targets: this computer's SYNC, then each input once; heartbeats at any time.

    `inputs` and `sizes` are the inputs' identifiers, each with its node's number in the last seven bits, and least
    sizes; only these nodes' heartbeats are known.  `told` goes on from the call before.
    """
    for n in range(count):
        raw = np.int64(slots[n, 0] & np.uint64(0xFFFFFFFF))
        size = np.int64((slots[n, 0] >> np.uint64(32)) & np.uint64(0xFF))
        time_ns = np.int64(slots[n, 4]) * NS + np.int64(slots[n, 5])
        if headers[n, 5] > np.uint64(PLAIN):
            told[DROPPED] = np.int64(slots[n, 8] & np.uint64(0xFFFFFFFF))
        if raw == SYNC_COB_ID:
            if told[MISSING] >= 0 or not headers[n, 6] & np.uint64(OWN):
                return STRANGE
            told[MISSING], told[AT_NS] = (1 << INPUTS) - 1, time_ns
            continue
        place, known = -1, False
        for k in range(INPUTS):
            if raw == inputs[k]:
                place = k
            known = known or (raw - HEARTBEAT_BASE) == (inputs[k] & 0x7F)
        if place >= 0:
            if told[MISSING] < 0 or not told[MISSING] >> place & 1 or size < sizes[place]:
                return STRANGE
            told[MISSING] &= ~(1 << place)
            told[FRAMES + 2 * place], told[FRAMES + 2 * place + 1] = time_ns, np.int64(slots[n, 1])
            continue
        state = np.int64(slots[n, 1] & np.uint64(0xFF))
        if not known or size != 1 or state != OPERATIONAL or told[BEATS] == MOST_BEATS:
            return STRANGE
        beat = BEAT + 3 * told[BEATS]
        told[beat], told[beat + 1], told[beat + 2] = raw, time_ns, state
        told[BEATS] += 1
    return DONE if told[MISSING] == 0 else WAITING


def prepare() -> None:
    """Compile both, or load them from numba's cache, before time matters."""
    slots, headers = np.zeros((1, SLOT), np.uint64), np.zeros((1, HEADER), np.uint64)
    told = np.zeros(HEEDED, np.int64)
    rows(slots, headers, 0, np.zeros((1, ROW), np.uint64), 0, 0, told)
    heed(slots, headers, 0, np.zeros(INPUTS, np.int64), np.zeros(INPUTS, np.int64), told)
