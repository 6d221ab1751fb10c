"""Frames in the buffers of `recvmmsg`, read by compiled code: rows for the recorder, and one cycle's inputs.

Memory in, numbers out, and of system calls only those of a control cycle. A slot is a frame and its ancillary data,
`SLOT` words of 64 bits; a header is its `struct mmsghdr`, `HEADER` words. A frame that does not plainly belong to the
cycle is reported, and the frames are then processed one by one elsewhere.
"""

from typing import Any, Final

import numpy as np
from numba import njit, types
from numba.np.numpy_support import carray

from eds.cia301 import HEARTBEAT_BASE, SYNC_COB_ID, NmtState
from trial.mcap_file.cdr import ERROR, EXTENDED, REMOTE

SLOT, HEADER, ROW = 18, 8, 3
"""Sizes, in words, of a slot, a header and a `cdr.FRAME_ROW`."""
ROW_BYTES: Final = 8 * ROW
BATCH: Final = 32
"""Number of slots, and of headers, of one `recvmmsg`."""
SLOTS: Final = BATCH * HEADER
KNOWN: Final = SLOTS + BATCH * SLOT
"""Place, in 8-byte words, of the state of the rows in a socket's memory, behind message headers and slots."""
EFF, RTR, ERR, ID = 0x80000000, 0x40000000, 0x20000000, 0x1FFFFFFF
HERE: Final = 4
"""MSG_DONTROUTE: a program on this computer sent the frame."""
OWN: Final = 0x800
"""MSG_CONFIRM: the receiving socket itself sent the frame."""
ANCILLARY: Final = 8 * (SLOT - 2)
"""Bytes behind a frame: the kernel's time stamp (32), the adapter's (64) if it has one, lost frames (24)."""
DONT_WAIT: Final = 0x40
PLAIN: Final = 32
"""Ancillary bytes of a message with a time stamp only."""
NS: Final = 1_000_000_000

SO_TIMESTAMPING: Final = 37
STAMPED: Final = PLAIN + 64
"""Least ancillary bytes of a message with the adapter's time stamp (struct scm_timestamping: three timespecs)."""
LOST: Final = 24
"""Ancillary bytes of the count of lost frames."""
DRIFT: Final = 10_000
"""Inverse of the largest relative drift between the clocks of adapter and computer: 100 ppm, as of crystals."""

MARKED_NS, SYNC_END, FIRST, TAKEN, OFFSET_NS, HARDWARE_NS, LATEST_NS, ECHOED, FRAMES_STAMPED, WORST_NS, TOLD = range(11)
"""State of the rows: time stamp of the last marked frame, −1 for none; the place behind the last SYNC; the first row
that is not yet fetched, and the end. State of the adapter's clock: its offset to the kernel's; its last time stamp;
the last time stamp given to a frame; 1 once a frame of this computer had one; frames with one; the largest delay of
the kernel's time stamp behind the adapter's."""
MEMORY: Final = KNOWN + TOLD
INPUTS: Final = 4
MISSING, AT_NS, DROPPED, BEATS, BEAT = 0, 1, 2, 3, 4
"""Results of `heed`: a bit for each missing input, −1 before SYNC; time of SYNC; lost frames, −1 if the kernel gave
no number; heartbeats and, from `BEAT` on, identifier, time and state of each."""
MOST_BEATS: Final = 8
FRAMES: Final = BEAT + 3 * MOST_BEATS
"""Offset of the time stamps and data of the inputs in the buffer."""
HEEDED: Final = FRAMES + 2 * INPUTS
OPERATIONAL: Final = int(NmtState.OPERATIONAL)
DONE, WAITING, STRANGE = 1, 0, -1
"""Results of a reception: all inputs complete; some missing; another frame arrived."""


@njit(cache=True)
def settle(slots: Any, headers: Any, count: int, told: Any) -> None:
    """Replace the kernel's time stamps by the adapter's, on the kernel's scale, and remove the ancillary bytes of both.

    The kernel takes its stamp when the driver hands a frame over: later than the frame by the adapter's delay, never
    earlier. The offset between the clocks is therefore the least difference seen, raised by `DRIFT` meanwhile: a
    constant delay stays in, its jitter goes. Stamps are used once frames of this computer (SYNC) have them, too, since
    ages compare both, and never run backwards.
    """
    for n in range(count):
        held = np.int64(headers[n, 5])
        if held < STAMPED or np.int64(slots[n, 7] >> np.uint64(32)) != SO_TIMESTAMPING:
            continue
        headers[n, 5] = np.uint64(held - 64)
        if held == STAMPED + LOST:
            slots[n, 8] = slots[n, 16]
        hardware_ns = np.int64(slots[n, 12]) * NS + np.int64(slots[n, 13])
        kernel_ns = np.int64(slots[n, 4]) * NS + np.int64(slots[n, 5])
        delay_ns = kernel_ns - hardware_ns
        elapsed_ns = hardware_ns - told[HARDWARE_NS]
        if told[FRAMES_STAMPED] == 0 or elapsed_ns < -NS:  # the adapter's clock began anew
            told[OFFSET_NS] = delay_ns
        else:
            told[OFFSET_NS] = min(delay_ns, told[OFFSET_NS] + max(elapsed_ns, 0) // DRIFT)
        told[HARDWARE_NS] = hardware_ns
        told[FRAMES_STAMPED] += 1
        told[WORST_NS] = max(told[WORST_NS], delay_ns - told[OFFSET_NS])
        if headers[n, 6] & np.uint64(HERE):
            told[ECHOED] = 1
        if told[ECHOED]:
            stamp_ns = max(hardware_ns + told[OFFSET_NS], told[LATEST_NS])
            told[LATEST_NS] = stamp_ns
            slots[n, 4], slots[n, 5] = np.uint64(stamp_ns // NS), np.uint64(stamp_ns % NS)


@njit(cache=True)
def rows(slots: Any, headers: Any, count: int, block: Any, told: Any) -> None:
    """Append `count` received frames to `block`, one row of `ROW` words each; `told` holds the block's counters."""
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
        sent = np.uint64(headers[n, 6] & np.uint64(HERE) != np.uint64(0))
        block[at + n, 0] = np.uint64(time_ns)
        block[at + n, 1] = can_id | flags << np.uint64(32) | size << np.uint64(40) | sent << np.uint64(56)
        block[at + n, 2] = data
        if raw == np.uint64(SYNC_COB_ID):
            told[SYNC_END] = at + n + 1
    told[TAKEN] = at + count


@njit(cache=True)
def to_front(block: Any, told: Any) -> None:
    """Move the rows that were not fetched to the front."""
    first, left = told[FIRST], told[TAKEN] - told[FIRST]
    for n in range(left if first else 0):
        for word in range(ROW):
            block[n, word] = block[first + n, word]
    told[FIRST], told[TAKEN], told[SYNC_END] = 0, left, -1


@njit(cache=True)
def mark(block: Any, count: int, marked_id: int, told: Any) -> None:
    """Return the time stamp of the last data frame `marked_id` (base format) among the first `count` rows."""
    for n in range(count - 1, -1, -1):
        if block[n, 1] & np.uint64(0xFFFFFFFFFF) == np.uint64(marked_id):
            told[MARKED_NS] = np.int64(block[n, 0])
            return


@njit(cache=True)
def heed(slots: Any, headers: Any, count: int, inputs: Any, sizes: Any, told: Any) -> int:
    """Process the frames of a cycle after its targets: this computer's SYNC, each input once, heartbeats at any time.

    Frames that the socket itself has sent are passed over. `inputs` and `sizes` are the inputs' identifiers, each with
    its node's number in the last seven bits, and least sizes; only these nodes' heartbeats are accepted. `told` goes on
    from the call before.
    """
    for n in range(count):
        raw = np.int64(slots[n, 0] & np.uint64(0xFFFFFFFF))
        size = np.int64((slots[n, 0] >> np.uint64(32)) & np.uint64(0xFF))
        time_ns = np.int64(slots[n, 4]) * NS + np.int64(slots[n, 5])
        if headers[n, 5] > np.uint64(PLAIN):
            told[DROPPED] = np.int64(slots[n, 8] & np.uint64(0xFFFFFFFF))
        if headers[n, 6] & np.uint64(OWN):
            continue
        if raw == SYNC_COB_ID:
            if told[MISSING] >= 0 or not headers[n, 6] & np.uint64(HERE):
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

MAIN, TRIGGER, TARGETS, PATIENCE, AFTER, ERRNO, COUNT, ALIVE, SPEC, WOKEN, POLL, FRAME, BEAT_FRAME = (
    *range(9), 10, 12, 13, 15)
"""Numbers of `cycle`: sockets; identifier of the targets; how long after `AFTER` the last input is waited for, ns; time
that SYNC has to come after, ns; what failed; frames fetched last; 1 where the heartbeat is due, 0 once it is sent;
memory of system calls: struct timespec, a frame received, struct pollfd, the targets' frame, the heartbeat's."""
IDS: Final = BEAT_FRAME + 2
SIZES: Final = IDS + INPUTS
HEED: Final = SIZES + INPUTS
NUMBERS: Final = HEED + HEEDED
"""Further indices: COB-IDs of the inputs, their least sizes, results of `heed`."""
COMPLETE, FETCHED, NOT_SENT, FAILED = range(4)
"""Result of a cycle: all inputs received; frames read, but inputs missing; no frame could be sent; a socket failed."""
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
    """Wait for a frame at the trigger socket; return its identifier, 0 after `timeout_ns`, −1 if the socket failed."""
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
def fetch(c: Any, headers: Any) -> Any:
    """Read the waiting frames of the socket into memory; return their number, −1 if the socket failed."""
    for n in range(len(headers)):
        headers[n, 1], headers[n, 5], headers[n, 6], headers[n, 7] = 0, ANCILLARY, 0, 0
    count = _recvmmsg(np.int32(c[MAIN]), headers.ctypes.data, len(headers), np.int32(DONT_WAIT), 0)
    if count < 0:
        c[ERRNO] = _carray(_errno(), 1)[0]
        return 0 if c[ERRNO] == _EAGAIN else -1
    return count


@njit(cache=True, nogil=True)
def cycle(c: Any, memory: Any, block: Any) -> int:
    """Send the targets and read every frame up to the last input of the next SYNC, as rows and as inputs.

    The heartbeat follows the targets if it is due; if the queue is full it is left to the next cycle. `c`: `NUMBERS`;
    `memory`: `MEMORY`, of the socket; `block`: rows, continued as in `rows`.
    """
    headers, slots = memory[:SLOTS].reshape(BATCH, HEADER), memory[SLOTS:KNOWN].reshape(BATCH, SLOT)
    heard = memory[KNOWN:].view(np.int64)
    to_front(block, heard)
    if heard[TAKEN] + BATCH > len(block):
        return NOT_SENT
    if _send(np.int32(c[MAIN]), c.ctypes.data + 8 * FRAME, 16, np.int32(0)) != 16:
        return NOT_SENT
    if c[ALIVE] and _send(np.int32(c[MAIN]), c.ctypes.data + 8 * BEAT_FRAME, 16, np.int32(0)) == 16:
        c[ALIVE] = 0
    told = c[HEED:]
    told[MISSING], told[DROPPED], told[BEATS] = -1, -1, 0
    woke = woken(c, c[AFTER] + c[PATIENCE] - now(c))
    if woke < 0:
        return FAILED
    c[COUNT] = count = fetch(c, headers)
    if count < 0:
        return FAILED
    settle(slots, headers, count, heard)
    rows(slots, headers, count, block, heard)
    status = heed(slots, headers, count, c[IDS:SIZES], c[SIZES:HEED], told)
    if status != DONE or told[AT_NS] <= c[AFTER]:
        return FETCHED
    mark(block, heard[SYNC_END], c[TARGETS], heard)
    c[WOKEN] = woke
    return COMPLETE


def prepare() -> None:
    """Compile everything, or load it from numba's cache, before time matters."""
    slots, headers = np.zeros((1, SLOT), np.uint64), np.zeros((1, HEADER), np.uint64)
    block, heard = np.zeros((BATCH, ROW), np.uint64), np.zeros(TOLD, np.int64)
    settle(slots, headers, 0, heard)
    rows(slots, headers, 0, block, heard)
    to_front(block, heard)
    mark(block, 0, 0, heard)
    c = np.full(NUMBERS, -1, np.int64)
    heed(slots, headers, 0, c[IDS:SIZES], c[SIZES:HEED], c[HEED:])
    if cycle(c, np.zeros(MEMORY, np.uint64), block) != NOT_SENT:
        raise RuntimeError("send() took a socket that there is not")
