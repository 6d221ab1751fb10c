"""One complete control cycle between the master's targets and the last input of the next SYNC, compiled.

Events run in the order of the event heap, (time, priority), by the same functions as one by one: plant, drive ticks,
converters, channels, set-points and stuffing. An event outside these functions ends the call with all arrays
restored; the cycle is then run event by event.

All numbers are in two flat arrays: `f`, float64, laid out as `FLOATS`, and `i`, int64 (times in ns), as `INTEGERS`;
`rows` gets the frames, three words each, as `trial.mcap_file.cdr.FRAME_ROW` has them. `rings` are the converters'
rings, (`GAUGES`, `RING`, 2), a separate array, because one `reshape` took two seconds to compile, for the text of its
error.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numba import njit

from nodes.drives import axis_law
from nodes.sensors import channel_law
from physics import converter, drive_loops
from physics.drive_loops import DRIVE_TICK_NS
from physics.plant import bench_plant, step, truth_row
from physics.plant.state_layout import SIZE, SLOT
from virtual_bus.wire import bit_counts, bits
from virtual_bus.wire.bits import INTERMISSION_BITS, TRAILER_BITS

_Part = tuple[str, tuple[int, ...]]
"""Name and shape of one field of a memory layout."""
AXES: Final = 2
GAUGES: Final = 2
NODES: Final = AXES + GAUGES
"""Two drives, servo and knee, then two tension sensors: their places in the tables."""
SENDS: Final = 6
TAKES: Final = 8
"""Capacity of the tables: TPDOs, and RPDOs reached by a cycle's frames."""
ROWS: Final = 32
"""Capacity of `rows` in frames: the remainder of the cycle before, and those of this one."""

_STATE, _SET = axis_law.STATES, axis_law.SETTINGS
CONVERTER, SENSOR = 5, 11
"""Numbers of a converter's history, and of its parameters."""
TRUTHS: Final = 128
"""Rows of true signals that are collected before they are written."""
TRUTH_WIDTH: Final = len(truth_row.NAMES)
ACTION_WIDTH: Final = 3
"""Unit, origin and range of an RPDO object's effect: `axis_law.RpdoEffect`."""
TOOK_WIDTH: Final = 5
"""Fields of an RPDO: waiting (1), data that waits, taken (1), data taken last, deadline."""
PENDING_WIDTH: Final = 5
"""Frames that wait for the wire: ready, identifier, size, data, sender (a TPDO's place, or one of those below)."""
WAIT: Final = SENDS + 2 * NODES + 6
"""Greatest number of waiting frames; one more place holds the frame on the wire."""
SEND_WIDTH: Final = 4 + 3 * 4
"""Fields of a TPDO: node, identifier, size, fields; each field its source, bits, signed."""
TAKE_WIDTH: Final = 12
"""Per RPDO: node, identifier, size, synchronous, deadline, action, shift, bits, signed, bounded, least, greatest."""


def _memory(code: str, kept: Sequence[_Part], rest: Sequence[_Part]) -> np.dtype[np.void]:
    """Return the layout of a memory of 8-byte words: the changing part, the rest, a copy of the changing part.

    The copy (`before`) restores a cycle that is given up.
    """
    changed, other = (np.dtype([(name, code, shape) for name, shape in parts]) for parts in (kept, rest))
    return np.dtype([("kept", changed), ("rest", other), ("before", changed)])


def places(memory: np.dtype[np.void]) -> dict[str, int]:
    """Return the first 8-byte word of each part of a memory; `before` and the whole, `size`, with them."""
    found = {"before": _word(memory, "before"), "size": memory.itemsize // 8}
    for half in ("kept", "rest"):
        part = memory[half]
        found |= {name: _word(memory, half) + _word(part, name) for name in part.names or ()}
    return found


def _word(kind: np.dtype[np.void], name: str) -> int:
    assert kind.fields is not None
    return int(kind.fields[name][1]) // 8


FLOATS: Final = _memory("f8", [
    ("plant", (SIZE,)), ("state", (AXES, _STATE)), ("set", (AXES, _SET)), ("channel", (GAUGES, channel_law.SIZE)),
    ("converter", (GAUGES, CONVERTER)), ("torque", (AXES,)),
], [
    ("truth", (TRUTHS, TRUTH_WIDTH)), ("action", (TAKES, ACTION_WIDTH)), ("sensor", (GAUGES, SENSOR)),
])
"""Layout of the floating-point memory `f`."""
INTEGERS: Final = _memory("i8", [
    # now; the plant's time; next tick of the drives, sample of each converter, SYNC
    ("now", ()), ("plant_ns", ()), ("tick_ns", ()), ("sample_ns", (GAUGES,)), ("sync_ns", ()),
    # the wire: when it is idle, frames and bits on it; rows: first to keep, end, the one after SYNC's
    ("idle_ns", ()), ("frames", ()), ("busy", ()), ("first_row", ()), ("last_row", ()), ("sync_row", ()),
    # ends of SYNC and of the targets; the master's heartbeat: when it is due, when it was sent last
    ("sync_at", ()), ("targets_at", ()), ("own_ns", ()), ("own_at", ()),
    # heartbeats heard; rows of the truth; frames that wait
    ("beats", ()), ("truth_rows", ()), ("waiting", ()),
    # by node: when it was last given a frame or its heartbeat's time; next heartbeat, end of the last one (−1: none in
    # this cycle); when it will miss the master's heartbeat
    ("told", (NODES,)), ("beat_ns", (NODES, 2)), ("watch_ns", (NODES,)),
    # by axis the integers of the last latch; by TPDO when its frame ended, and its data
    ("counted", (AXES, axis_law.COUNTS)), ("sent", (SENDS, 2)),
    ("took", (TAKES, TOOK_WIDTH)), ("pending", (WAIT + 1, PENDING_WIDTH)),
], [
    # a cycle ends before `limit`, its SYNC after `after`, the rest within `budget` of that; SYNC's period; bit time;
    # turnarounds of the master and of a node
    ("limit", ()), ("after", ()), ("budget", ()), ("period", ()), ("bit_ns", ()), ("master_ns", ()), ("node_ns", ()),
    # the master's frame; whether a recorder hears frames, and a file gets the truth; the master's heartbeat
    ("targets_id", ()), ("targets_size", ()), ("targets_data", ()), ("heard", ()), ("truth", ()),
    ("own_id", ()), ("own_data", ()), ("own_period", ()), ("returned", ()),
    # by node its heartbeat's identifier, data, period, and after how long it misses the master's; by gauge the interval
    # and the seed of its samples; by axis the statusword for each of 16 flags
    ("beat", (NODES, 4)), ("interval", (GAUGES,)), ("seed", (GAUGES,)), ("words", (AXES, 16)),
    ("send_count", ()), ("send", (SENDS, SEND_WIDTH)), ("take_count", ()), ("take", (TAKES, TAKE_WIDTH)),
    ("truth_ns", (TRUTHS,)),
])
"""Layout of the integer memory `i`; `returned` is how the cycle ended."""

_F, _I = places(FLOATS), places(INTEGERS)
F_PLANT: Final = _F["plant"]
F_STATE: Final = _F["state"]
F_SET: Final = _F["set"]
F_CHANNEL: Final = _F["channel"]
F_CONVERTER: Final = _F["converter"]
F_TORQUE: Final = _F["torque"]
F_TRUTH: Final = _F["truth"]
F_ACTION: Final = _F["action"]
F_SENSOR: Final = _F["sensor"]
F_KEPT: Final = FLOATS["kept"].itemsize // 8
"""Length of the floats that are restored after an abandoned cycle; `I_KEPT` is that of the integers."""
F_BEFORE: Final = _F["before"]
F_SIZE: Final = _F["size"]

NOW: Final = _I["now"]
PLANT_NS: Final = _I["plant_ns"]
TICK_NS: Final = _I["tick_ns"]
SAMPLE_NS: Final = _I["sample_ns"]
SYNC_NS: Final = _I["sync_ns"]
IDLE_NS: Final = _I["idle_ns"]
FRAMES: Final = _I["frames"]
BUSY: Final = _I["busy"]
FIRST_ROW: Final = _I["first_row"]
LAST_ROW: Final = _I["last_row"]
SYNC_ROW: Final = _I["sync_row"]
SYNC_AT: Final = _I["sync_at"]
TARGETS_AT: Final = _I["targets_at"]
OWN_NS: Final = _I["own_ns"]
OWN_AT: Final = _I["own_at"]
BEATS: Final = _I["beats"]
TRUTH_ROWS: Final = _I["truth_rows"]
WAITING: Final = _I["waiting"]
TOLD: Final = _I["told"]
BEAT_NS: Final = _I["beat_ns"]
WATCH_NS: Final = _I["watch_ns"]
COUNTED: Final = _I["counted"]
SENT: Final = _I["sent"]
TOOK: Final = _I["took"]
PENDING: Final = _I["pending"]
LIMIT: Final = _I["limit"]
AFTER: Final = _I["after"]
BUDGET: Final = _I["budget"]
PERIOD: Final = _I["period"]
BIT_NS: Final = _I["bit_ns"]
MASTER_NS: Final = _I["master_ns"]
NODE_NS: Final = _I["node_ns"]
TARGETS_ID: Final = _I["targets_id"]
TARGETS_SIZE: Final = _I["targets_size"]
TARGETS_DATA: Final = _I["targets_data"]
HEARD: Final = _I["heard"]
TRUTH: Final = _I["truth"]
OWN_ID: Final = _I["own_id"]
OWN_DATA: Final = _I["own_data"]
OWN_PERIOD: Final = _I["own_period"]
RETURNED: Final = _I["returned"]
BEAT: Final = _I["beat"]
INTERVAL: Final = _I["interval"]
SEED: Final = _I["seed"]
WORDS: Final = _I["words"]
SEND_COUNT: Final = _I["send_count"]
SEND: Final = _I["send"]
TAKE_COUNT: Final = _I["take_count"]
TAKE: Final = _I["take"]
TRUTH_NS: Final = _I["truth_ns"]
I_KEPT: Final = INTEGERS["kept"].itemsize // 8
I_BEFORE: Final = _I["before"]
I_SIZE: Final = _I["size"]

STATUS_SOURCE: Final = axis_law.COUNTS - 1
"""Index of the statusword among an axis' counts."""
FROM_TARGETS, FROM_SYNC, FROM_OWN, FROM_NODE = -1, -2, -3, -4
"""Senders: the master's targets, SYNC, the master's heartbeat; from `FROM_NODE` down, nodes' heartbeats."""
NEVER: Final = 1 << 62

DONE, UNKNOWN, LATE = 1, 0, -1
"""Result of a cycle: complete; given up for an unsupported event; given up because it would reach its limit."""

SYNC_ID: Final = 0x080

_advance, _axis_step, _axis_counts = step.advance, axis_law.step, axis_law.counts
_convert, _sample, _process = converter.convert, channel_law.sample, channel_law.process
_target, _way, _feel, _truth_row = axis_law.target, axis_law.way, axis_law.feel, truth_row.truth_row
FOLLOWS, FEELS = axis_law.FOLLOWS, axis_law.FEELS
_stuffed_bits = bit_counts.stuffed_bits


def digest() -> int:
    """Return a number of the sources that the compiled cycle is made of, for numba's cache sees its own file alone."""
    made = (axis_law, channel_law, converter, drive_loops, bit_counts, bits, truth_row, bench_plant)
    text = b"".join(Path(str(module.__file__)).read_bytes() for module in made)
    return int.from_bytes(hashlib.sha256(text).digest()[:7], "big") ^ step.digest()


@njit
def act(f: Any, i: Any, rings: Any, now: int) -> bool:
    """Advance the plant to `now`, tick the drives and sample the sensors that are due; False if one has an event."""
    steps = (now - i[PLANT_NS]) // step.STEP_NS
    i[PLANT_NS] += steps * step.STEP_NS
    m = f[F_PLANT:F_PLANT + SIZE]
    if not np.isfinite(f[F_TORQUE] + f[F_TORQUE + 1]):
        return False
    _advance(m, steps, f[F_TORQUE], f[F_TORQUE + 1])
    if i[TICK_NS] == now:
        i[TICK_NS] = now + DRIVE_TICK_NS
        for k in range(AXES):
            s = f[F_STATE + k * _STATE:F_STATE + (k + 1) * _STATE]
            g = f[F_SET + k * _SET:F_SET + (k + 1) * _SET]
            felt = SLOT.out_servo_x + 2 * k
            f[F_TORQUE + k] = _axis_step(s, g, now, m[felt], m[felt + 1])
            if s[axis_law.EVENTS] != 0.0:
                return False
    for k in range(GAUGES):
        if i[SAMPLE_NS + k] == now:
            i[SAMPLE_NS + k] = now + i[INTERVAL + k]
            c = f[F_CHANNEL + k * channel_law.SIZE:F_CHANNEL + (k + 1) * channel_law.SIZE]
            state = f[F_CONVERTER + k * CONVERTER:F_CONVERTER + (k + 1) * CONVERTER]
            p = f[F_SENSOR + k * SENSOR:F_SENSOR + (k + 1) * SENSOR]
            counts = int(_convert(state, rings[k], p, np.uint64(i[SEED + k]), now, m[SLOT.out_start + k]))
            if _sample(c, counts, 0) != c[channel_law.VERDICT]:
                return False
    return True


@njit(inline="always")
def put(i: Any, ready: int, can_id: int, size: int, data: Any, sender: int) -> None:
    """Queue a frame for the wire."""
    at = PENDING + i[WAITING] * PENDING_WIDTH
    i[at], i[at + 1], i[at + 2], i[at + 3], i[at + 4] = ready, can_id, size, data, sender
    i[WAITING] += 1


@njit
def latch(f: Any, i: Any, now: int) -> bool:
    """Latch every node's values and queue its TPDOs; False if a value does not fit its field."""
    for k in range(AXES):
        s = f[F_STATE + k * _STATE:F_STATE + (k + 1) * _STATE]
        g = f[F_SET + k * _SET:F_SET + (k + 1) * _SET]
        _axis_counts(s, g, i[COUNTED + k * axis_law.COUNTS:COUNTED + (k + 1) * axis_law.COUNTS])
    for k in range(GAUGES):
        c = f[F_CHANNEL + k * channel_law.SIZE:F_CHANNEL + (k + 1) * channel_law.SIZE]
        _process(c)
    for n in range(i[SEND_COUNT]):
        at = SEND + n * SEND_WIDTH
        data, shift = np.uint64(0), 0
        for field in range(i[at + 3]):
            source, width = i[at + 4 + 3 * field], i[at + 5 + 3 * field]
            value = latched(f, i, i[at], source)
            signed = i[at + 6 + 3 * field]
            low = -(1 << (width - 1)) if signed else 0
            if not low <= value < low + (1 << width):
                return False
            data |= (np.uint64(value) & np.uint64((1 << width) - 1)) << np.uint64(shift)
            shift += width
        i[SENT + 2 * n], i[SENT + 2 * n + 1] = 0, np.int64(data)
        put(i, now + i[NODE_NS], i[at + 1], i[at + 2], np.int64(data), n)
    return True


@njit(inline="always")
def latched(f: Any, i: Any, node: int, source: int) -> Any:
    """Return the raw value that a node latched: one of an axis' counts, or a channel's integer."""
    if node >= AXES:
        return int(f[F_CHANNEL + (node - AXES) * channel_law.SIZE + source])
    value = i[COUNTED + node * axis_law.COUNTS + source]
    return i[WORDS + 16 * node + value] if source == STATUS_SOURCE else value


@njit
def take(f: Any, i: Any, n: int) -> Any:
    """Apply the waiting data of RPDO `n`; False if the effect is more than a new set-point."""
    at, kept = TAKE + n * TAKE_WIDTH, TOOK + TOOK_WIDTH * n
    data = np.uint64(i[kept + 1])
    i[kept], i[kept + 2], i[kept + 3] = 0, 1, i[kept + 1]
    width = i[at + 7]
    raw: Any = np.int64((data >> np.uint64(i[at + 6])) & np.uint64((1 << width) - 1))
    if i[at + 8] and raw >> (width - 1):
        raw -= 1 << width
    if i[at + 9] and not i[at + 10] <= raw <= i[at + 11]:
        return False
    node, action = i[at], i[at + 5]
    s = f[F_STATE + node * _STATE:F_STATE + (node + 1) * _STATE]
    unit, origin, most = F_ACTION + ACTION_WIDTH * n, F_ACTION + ACTION_WIDTH * n + 1, F_ACTION + ACTION_WIDTH * n + 2
    if action == FOLLOWS:
        if _way(s, f[unit], f[origin], raw) > f[most]:
            return False
        _target(s, f[unit], f[origin], raw)
    elif action == FEELS:
        return raw != axis_law.NO_TENSION and _feel(s, raw) <= f[most]
    return True


@njit
def hear(f: Any, i: Any, now: int, can_id: int, data: int) -> bool:
    """Pass a frame to every RPDO with its identifier; False if the effect is more than a new set-point."""
    for n in range(i[TAKE_COUNT]):
        at, kept = TAKE + n * TAKE_WIDTH, TOOK + TOOK_WIDTH * n
        if i[at + 1] == can_id:
            i[TOLD + i[at]] = now
            i[kept], i[kept + 1] = 1, data
            if i[at + 4]:
                i[kept + 4] = now + i[at + 4]
            if not i[at + 3] and not take(f, i, n):
                return False
    return True


@njit
def synchronise(f: Any, i: Any, now: int) -> bool:
    """Process a SYNC in every node: latch, send, apply RPDOs; False to give up."""
    for node in range(NODES):
        i[TOLD + node] = now
    if not latch(f, i, now):
        return False
    for n in range(i[TAKE_COUNT]):
        if i[TOOK + TOOK_WIDTH * n] and not take(f, i, n):
            return False
    if i[TRUTH]:
        row = F_TRUTH + i[TRUTH_ROWS] * TRUTH_WIDTH
        i[TRUTH_NS + i[TRUTH_ROWS]] = now
        _truth_row(f[F_PLANT:F_PLANT + SIZE], f[row:row + TRUTH_WIDTH])
        i[TRUTH_ROWS] += 1
    return True


@njit(inline="always")
def beat(i: Any, now: int) -> None:
    """Queue the heartbeat of every node that is due."""
    for node in range(NODES):
        if i[BEAT_NS + 2 * node] == now:
            at = BEAT + 4 * node
            i[TOLD + node] = now
            i[BEAT_NS + 2 * node] = now + i[at + 2]
            put(i, now + i[NODE_NS], i[at], 1, i[at + 1], FROM_NODE - node)


@njit(inline="always")
def watch(i: Any, now: int) -> None:
    """Restart the heartbeat consumer of every node that monitors the master."""
    for node in range(NODES):
        if i[BEAT + 4 * node + 3]:
            i[TOLD + node] = now
            i[WATCH_NS + node] = now + i[BEAT + 4 * node + 3]


@njit
def frame_time(i: Any, at: int) -> Any:
    """Return the duration of a waiting frame, ns, and count its bits."""
    size, word = i[at + 2], np.uint64(i[at + 3])
    payload: Any = np.uint64(0)
    for _ in range(size):
        payload = (payload << np.uint64(8)) | (word & np.uint64(0xFF))
        word >>= np.uint64(8)
    count = _stuffed_bits(i[at + 1] << 7 | size, 19, payload, 8 * size) + TRAILER_BITS
    i[BUSY] += count + INTERMISSION_BITS
    return count * i[BIT_NS]


@njit
def winner(i: Any, now: int) -> int:
    """Return the place of the frame that wins an arbitration at `now`; of the computer's frames only the oldest
    contends."""
    best, oldest = -1, -1
    for n in range(i[WAITING]):
        at = PENDING + n * PENDING_WIDTH
        if i[at] > now:
            continue
        if FROM_NODE < i[at + 4] < 0:
            if oldest < 0 or i[at] < i[PENDING + oldest * PENDING_WIDTH]:
                oldest = n
        elif best < 0 or i[at + 1] < i[PENDING + best * PENDING_WIDTH + 1]:
            best = n
    if best < 0 or (oldest >= 0 and i[PENDING + oldest * PENDING_WIDTH + 1] < i[PENDING + best * PENDING_WIDTH + 1]):
        return oldest
    return best


@njit(inline="always")
def earliest(i: Any) -> Any:
    """Return the time, ns, at which the first of the waiting frames is ready."""
    first = NEVER
    for n in range(i[WAITING]):
        first = min(first, i[PENDING + n * PENDING_WIDTH])
    return first


@njit(inline="always")
def write_row(i: Any, rows: Any, now: int, at: int, data: int) -> None:
    """Store a frame for the recorder."""
    row = i[LAST_ROW]
    rows[row, 0] = np.uint64(now)
    sent = np.uint64(1) << np.uint64(56) if FROM_NODE < i[at + 4] < 0 else np.uint64(0)
    rows[row, 1] = np.uint64(i[at + 1]) | np.uint64(i[at + 2]) << np.uint64(40) | sent
    rows[row, 2] = np.uint64(data)
    i[LAST_ROW] = row + 1


@njit
def begin(i: Any, rows: Any) -> Any:
    """Move the remaining rows to the front, clear the results of the cycle before, put the targets.

    Return False if an event is already due. The nearest deadline limits the cycle.
    """
    kept = i[LAST_ROW] - i[FIRST_ROW]
    for row in range(kept):
        for word in range(3):
            rows[row, word] = rows[i[FIRST_ROW] + row, word]
    i[FIRST_ROW], i[LAST_ROW], i[SYNC_AT], i[TARGETS_AT], i[OWN_AT], i[BEATS] = 0, kept, -1, -1, -1, 0
    for node in range(NODES):
        i[BEAT_NS + 2 * node + 1] = -1
        i[LIMIT] = min(i[LIMIT], i[WATCH_NS + node])
        if i[BEAT_NS + 2 * node] <= i[NOW]:
            return False
    for n in range(i[TAKE_COUNT]):
        i[LIMIT] = min(i[LIMIT], i[TOOK + TOOK_WIDTH * n + 4])
    if i[TRUTH_ROWS] == TRUTHS or kept + i[WAITING] + SENDS + NODES + 3 > ROWS or i[WAITING] + SENDS + NODES + 3 > WAIT:
        return False
    put(i, i[NOW] + i[MASTER_NS], i[TARGETS_ID], i[TARGETS_SIZE], i[TARGETS_DATA], FROM_TARGETS)
    if i[OWN_NS] <= i[NOW]:
        beat_own(i, i[NOW])
    return True


@njit(inline="always")
def beat_own(i: Any, now: int) -> None:
    """Queue the master's heartbeat now."""
    i[OWN_NS], i[OWN_AT] = now + i[OWN_PERIOD], now
    put(i, now + i[MASTER_NS], i[OWN_ID], 1, i[OWN_DATA], FROM_OWN)


@njit
def deliver(f: Any, i: Any, rows: Any, now: int, at: int) -> Any:
    """Pass a completed frame to all receivers; False to give up."""
    can_id, data, sender = i[at + 1], i[at + 3], i[at + 4]
    i[FRAMES] += 1
    if i[HEARD]:
        write_row(i, rows, now, at, data)
    if sender == FROM_SYNC and now <= i[AFTER]:
        return False
    if sender == FROM_SYNC:
        i[SYNC_AT], i[SYNC_ROW] = now, i[LAST_ROW]
        i[LIMIT] = min(i[LIMIT], now + i[BUDGET] + 1)
        return synchronise(f, i, now)
    if sender == FROM_OWN:
        watch(i, now)
        return True
    if sender <= FROM_NODE:
        i[BEAT_NS + 2 * (FROM_NODE - sender) + 1] = now
        i[BEATS] += 1
        return True
    if sender == FROM_TARGETS:
        i[TARGETS_AT] = now
    else:
        i[SENT + 2 * sender] = now
    return hear(f, i, now, can_id, data)


@njit(inline="always")
def next_beat(i: Any) -> Any:
    """Return the time of the first due heartbeat of a node."""
    first = NEVER
    for node in range(NODES):
        first = min(first, i[BEAT_NS + 2 * node])
    return first


@njit
def arbitrate(i: Any, now: int, sending: int) -> Any:
    """Start the winner of an arbitration; return the time of its end."""
    place = winner(i, now)
    for word in range(PENDING_WIDTH):
        i[sending + word] = i[PENDING + place * PENDING_WIDTH + word]
    i[WAITING] -= 1
    for word in range(place * PENDING_WIDTH, i[WAITING] * PENDING_WIDTH):
        i[PENDING + word] = i[PENDING + word + PENDING_WIDTH]
    return now + frame_time(i, sending)


@njit
def run(f: Any, i: Any, rows: Any, rings: Any) -> int:
    """Run events in the kernel's order until every input of the next SYNC has been sent."""
    if not begin(i, rows):
        return LATE
    sending, end, left = PENDING + WAIT * PENDING_WIDTH, NEVER, i[SEND_COUNT]
    beating = next_beat(i)
    while True:
        tick = min(i[TICK_NS], min(i[SAMPLE_NS], i[SAMPLE_NS + 1]))
        start = max(i[IDLE_NS], earliest(i)) if end == NEVER else NEVER
        now = min(min(min(tick, end), min(i[SYNC_NS], start)), min(beating, i[OWN_NS]))
        if now >= i[LIMIT]:
            return LATE
        i[NOW] = now
        if tick == now:
            if not act(f, i, rings, now):
                return UNKNOWN
        elif end == now:
            end = NEVER
            i[IDLE_NS] = now + INTERMISSION_BITS * i[BIT_NS]
            if not deliver(f, i, rows, now, sending):
                return UNKNOWN
            if i[sending + 4] >= 0:
                left -= 1
                if not left:
                    return DONE
        elif i[SYNC_NS] == now:
            i[SYNC_NS] = now + i[PERIOD]
            if i[SYNC_AT] >= 0:
                return UNKNOWN
            put(i, now, SYNC_ID, 0, 0, FROM_SYNC)
        elif beating == now:
            beat(i, now)
            beating = next_beat(i)
        elif start == now:
            end = arbitrate(i, now, sending)
        else:
            beat_own(i, now)


def _compile(sources: int) -> Any:
    @njit(cache=True)
    def cycle(f: Any, i: Any, rows: Any, rings: Any) -> int:
        _ = sources
        for n in range(F_KEPT):  # as slices these four would each take half a second to compile
            f[F_BEFORE + n] = f[n]
        for n in range(I_KEPT):
            i[I_BEFORE + n] = i[n]
        ended = run(f, i, rows, rings)
        if ended != DONE:
            for n in range(F_KEPT):
                f[n] = f[F_BEFORE + n]
            for n in range(I_KEPT):
                i[n] = i[I_BEFORE + n]
            i[FIRST_ROW], i[LAST_ROW] = 0, i[I_BEFORE + LAST_ROW] - i[I_BEFORE + FIRST_ROW]
        i[RETURNED] = ended
        return int(ended)

    return cycle


cycle: Any = _compile(digest())
"""`cycle(f, i, rows, rings)` runs one complete control cycle and returns `DONE`; another result means no change."""


def prepare() -> bool:
    """Compile the cycle, or load it from numba's cache; return whether it had to be compiled."""
    before = sum(cycle.stats.cache_misses.values())
    cycle(np.zeros(F_SIZE), np.zeros(I_SIZE, np.int64), np.zeros((ROWS, 3), np.uint64),
          np.zeros((GAUGES, converter.RING, 2)))
    return bool(sum(cycle.stats.cache_misses.values()) > before)
