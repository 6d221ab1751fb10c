"""Frames as `recvmmsg` leaves them, read by compiled code: rows for the recorder, and one cycle's inputs.

The rule of this file: memory in, numbers out, and of system calls only those of a control cycle.  A slot is a frame
and its ancillary data, `SLOT` words of 64 bits; a header is its `struct mmsghdr`, `HEADER` words.  Whoever finds in a
cycle what is not plainly its own says so, and the frames are looked at one by one elsewhere.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit, types
from numba.np.numpy_support import carray

from eds.cia301 import HEARTBEAT_BASE, SYNC_COB_ID, NmtState
from trial.mcap_file.cdr import ERROR, EXTENDED, REMOTE

SLOT, HEADER, ROW = 10, 8, 3
"""Words of a slot, of a header, of a `cdr.FRAME_ROW`."""
EFF, RTR, ERR, ID = 0x80000000, 0x40000000, 0x20000000, 0x1FFFFFFF
OWN: Final = 4
"""MSG_DONTROUTE: the frame was sent by this computer."""
ANCILLARY: Final = 64
DONT_WAIT: Final = 0x40
PLAIN: Final = 32
"""Ancillary bytes of a message that tells its time stamp alone."""
NS: Final = 1_000_000_000

LAST_NS, MARKED_NS, SYNC_NS, SYNC_END, LOST, FIRST, TAKEN, TOLD = range(8)
"""What is known of rows: time stamps of the last frame, of the last marked one and of the last SYNC, −1 for none; the
place behind that SYNC; lost frames, −1 where none was told; the first row that nobody has taken, and the end."""
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
def rows(slots: Any, headers: Any, count: int, block: Any, marked_id: int, told: Any) -> None:
    """Write `count` frames into `block`, rows of `ROW` words, behind those there; `told` says what they were."""
    at = told[TAKEN]
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
def to_front(block: Any, told: Any) -> None:
    """Move the rows that nobody has taken to the front."""
    first, left = told[FIRST], told[TAKEN] - told[FIRST]
    for n in range(left if first else 0):
        for word in range(ROW):
            block[n, word] = block[first + n, word]
    told[FIRST], told[TAKEN], told[SYNC_NS], told[SYNC_END] = 0, left, -1, -1


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


# ---- one cycle ----

MAIN, TAP, TRIGGER, TARGETS, LAST, PATIENCE, BUDGET, AFTER, ERRNO, COUNT, SPEC, WOKEN, POLL, SETTINGS = (
    *range(11), 12, 14, 15)
"""Settings of `cycle`: sockets, −1 for no tap; identifiers of the targets and of the input that wakes; ns; what failed;
frames fetched last; memory of system calls (struct timespec, a frame, struct pollfd)."""
WHOLE, BY_HAND, FETCHED, NOT_SENT, FAILED = range(5)
"""How a cycle ended: all of it is here; nothing was read; the frames that were read are not, or not yet, a whole cycle;
nothing was sent; a socket failed."""
_POLLIN: Final = 1 << 32
_EAGAIN: Final = 11

_i, _p = types.int32, types.intp
_send: Any = types.ExternalFunction("send", _p(_i, _p, _p, _i))
_recv: Any = types.ExternalFunction("recv", _p(_i, _p, _p, _i))
_recvmmsg: Any = types.ExternalFunction("recvmmsg", _i(_i, _p, types.uint32, _i, _p))
_ppoll: Any = types.ExternalFunction("ppoll", _i(_p, _p, _p, _p))
_clock_gettime: Any = types.ExternalFunction("clock_gettime", _i(_i, _p))
_pointer: Any = types.CPointer
_errno: Any = types.ExternalFunction("__errno_location", _pointer(_i)())
_carray: Any = carray


@njit
def now(c: Any) -> Any:
    """Return the kernel's time, ns."""
    _clock_gettime(np.int32(0), c.ctypes.data + 8 * SPEC)
    return c[SPEC] * NS + c[SPEC + 1]


@njit
def woken(c: Any, timeout_ns: int) -> Any:
    """Return the identifier that woke within so long, 0 where none did, −1 where the socket failed."""
    if timeout_ns <= 0:
        return 0
    c[POLL], c[SPEC], c[SPEC + 1] = c[TRIGGER] | _POLLIN, timeout_ns // NS, timeout_ns % NS
    if _ppoll(c.ctypes.data + 8 * POLL, 1, c.ctypes.data + 8 * SPEC, 0) <= 0:
        return 0
    if _recv(np.int32(c[TRIGGER]), c.ctypes.data + 8 * WOKEN, 16, np.int32(DONT_WAIT)) < 0:
        c[ERRNO] = _carray(_errno(), 1)[0]
        return 0 if c[ERRNO] == _EAGAIN else -1
    return c[WOKEN] & 0xFFFFFFFF


@njit
def fetch(c: Any, which: int, headers: Any) -> Any:
    """Take what waits at a socket into its memory; return how many frames, −1 where the socket failed."""
    for n in range(len(headers)):
        headers[n, 1], headers[n, 5], headers[n, 6], headers[n, 7] = 0, ANCILLARY, 0, 0
    count = _recvmmsg(np.int32(c[which]), headers.ctypes.data, len(headers), np.int32(DONT_WAIT), 0)
    if count < 0:
        c[ERRNO] = _carray(_errno(), 1)[0]
        return 0 if c[ERRNO] == _EAGAIN else -1
    return count


@njit(cache=True, nogil=True)
def cycle(
    c: Any, frame: Any, slots: Any, headers: Any, ids: Any, sizes: Any, told: Any, tap_slots: Any, tap_headers: Any,
    block: Any, tap_told: Any,
) -> int:
    """Send `frame`, wait for SYNC, take what the tap has heard, wait for the last input, take the cycle's frames."""
    if _send(np.int32(c[MAIN]), frame.ctypes.data, 16, np.int32(0)) != 16:
        return NOT_SENT
    told[MISSING], told[DROPPED], told[BEATS] = -1, -1, 0
    woke = woken(c, c[PATIENCE])
    if woke != SYNC_COB_ID:
        return FAILED if woke < 0 else BY_HAND
    sync_ns = now(c)
    if c[TAP] >= 0:
        to_front(block, tap_told)
        count = fetch(c, TAP, tap_headers)
        if count < 0:
            return FAILED
        rows(tap_slots, tap_headers, count, block, c[TARGETS], tap_told)
        sync_ns = tap_told[SYNC_NS]
        if sync_ns < 0:
            return BY_HAND
    woke = woken(c, sync_ns + c[BUDGET] - now(c))
    if woke < 0:
        return FAILED
    c[COUNT] = count = fetch(c, MAIN, headers)
    if count < 0:
        return FAILED
    status = heed(slots, headers, count, ids, sizes, told)
    if status != DONE or told[AT_NS] <= c[AFTER]:
        return FETCHED
    c[WOKEN] = woke
    return WHOLE


def prepare() -> None:
    """Compile everything, or load it from numba's cache, before time matters."""
    slots, headers = np.zeros((1, SLOT), np.uint64), np.zeros((1, HEADER), np.uint64)
    told, tap_told = np.zeros(HEEDED, np.int64), np.zeros(TOLD, np.int64)
    block, ids = np.zeros((1, ROW), np.uint64), np.zeros(INPUTS, np.int64)
    rows(slots, headers, 0, block, 0, tap_told)
    to_front(block, tap_told)
    heed(slots, headers, 0, ids, ids, told)
    c = np.full(SETTINGS, -1, np.int64)
    if cycle(c, np.zeros(16, np.uint8), slots, headers, ids, ids, told, slots, headers, block, tap_told) != NOT_SENT:
        raise RuntimeError("send() took a socket that there is not")
