"""One complete control cycle between the master's targets and the last input of the next SYNC, compiled.

Events run in the order of the event heap, (time, priority), by the same functions as one by one: plant, drive ticks,
converters, channels, set-points and stuffing. An event outside these functions ends the call with all numbers
restored; the cycle is then run event by event.

All numbers are in two records, declared once for the compiled code and for Python: `CycleState` (`m` below), which a
cycle changes, and `CycleTable` (`t`), which it reads. Times are in ns. `rows` gets the frames, three words each, as
`trial.mcap_file.cdr.FRAME_ROW` has them. `rings` are the converters' rings, (`GAUGES`, `RING`, 2).
"""

import hashlib
from ctypes import Structure, c_double, c_int64
from pathlib import Path
from typing import Any, Final

import numpy as np
from numba import njit

from nodes.drives import axis_law
from nodes.sensors import channel_law
from physics import converter, drive_loops
from physics.drive_loops import DRIVE_TICK_NS
from physics.plant import bench_plant, step
from physics.plant.state_layout import SIZE, SLOT
from virtual_bus.wire import bit_counts, bits
from virtual_bus.wire.bits import INTERMISSION_BITS, TRAILER_BITS

AXES: Final = 2
GAUGES: Final = 2
NODES: Final = AXES + GAUGES
"""Two drives, servo and knee, then two tension sensors: their places in the tables."""
SENDS: Final = 6
TAKES: Final = 8
"""Largest number of TPDOs sent at a SYNC, and of RPDOs that receive a frame of the cycle."""
FIELDS: Final = 4
"""Greatest number of fields in a TPDO."""
ROWS: Final = 32
"""Capacity of `rows` in frames: the remainder of the cycle before, and those of this one."""
WAIT: Final = SENDS + 2 * NODES + 6
"""Greatest number of frames that wait for the wire."""
TRUTHS: Final = 128
"""Rows of true signals that are collected before they are written."""


def _integers(names: str) -> list[tuple[str, type[c_int64]]]:
    return [(name, c_int64) for name in names.split()]


class FrameRecord(Structure):
    """A frame on the wire or waiting for it; `sender` is a TPDO's place, or one of `FROM_…`."""

    _fields_ = _integers("ready can_id size data sender")


class FieldRecord(Structure):
    """A field of a TPDO: index of its value in the node's numbers, width in bits, signed or not."""

    _fields_ = _integers("source bits signed")


class TpdoRecord(Structure):
    """A TPDO that is sent at every SYNC: place of its node, identifier, length in bytes, and its first `count` fields.
    """

    _fields_ = [*_integers("node can_id size count"), ("fields", FieldRecord * FIELDS)]


class RpdoRecord(Structure):
    """An RPDO: its one object, the rest of `axis_law.RpdoEffect`, and the object's limits, if it is `bounded`."""

    _fields_ = [*_integers("node can_id size synchronous deadline_ns shift bits signed bounded least greatest action"),
                ("unit", c_double), ("origin", c_double), ("most", c_double)]


class ReceptionRecord(Structure):
    """State of an RPDO: 1 while its frame waits for SYNC, and its data; 1 once one was taken, and the last; deadline.
    """

    _fields_ = _integers("waiting data taken last due")


class SentRecord(Structure):
    """The last frame of a TPDO: when it ended, and its data."""

    _fields_ = _integers("end data")


class NodeState(Structure):
    """State of a node: last call; next heartbeat, end of the last (−1: none in this cycle); when it misses the master.
    """

    _fields_ = _integers("called beat beat_end watch")


class NodeTable(Structure):
    """Heartbeats of a node: identifier, data and period of its own, and time limit for the master's (0: none)."""

    _fields_ = _integers("can_id data period timeout")


class CycleState(Structure):
    """State of bench, wire and master that a compiled cycle changes; restored if the cycle is given up."""

    _fields_ = [
        *_integers(
            # the plant's time; next tick of the drives, next SYNC; when the wire is idle, frames and bits on it
            "now plant_ns tick_ns sync_ns idle_ns frames busy "
            # rows: first to keep, end, the one after SYNC's; ends of SYNC and of the targets
            "first_row last_row sync_row sync_at targets_at "
            # the master's heartbeat: when it is due, when it was sent last; heartbeats of nodes on the wire
            "own_ns own_at beats truth_rows waiting"),
        ("sample_ns", c_int64 * GAUGES), ("node", NodeState * NODES), ("sent", SentRecord * SENDS),
        ("took", ReceptionRecord * TAKES), ("pending", FrameRecord * WAIT), ("sending", FrameRecord),
        ("counted", c_int64 * axis_law.COUNTS * AXES),
        ("plant", c_double * SIZE), ("axis", c_double * axis_law.STATES * AXES),
        ("setting", c_double * axis_law.SETTINGS * AXES), ("channel", c_double * channel_law.SIZE * GAUGES),
        ("converter", c_double * converter.HISTORY * GAUGES), ("torque", c_double * AXES),
    ]


class CycleTable(Structure):
    """Numbers that a cycle reads, and the true signals that it collects; `returned` is its result."""

    _fields_ = [
        *_integers(
            # a cycle ends before `limit`, its SYNC after `after`, the rest within `budget` of that; turnarounds
            "limit after budget period bit_ns master_ns node_ns "
            # the master's frame; whether a recorder hears frames, and a file gets the truth; the master's heartbeat
            "targets_id targets_size targets_data heard truth own_id own_data own_period returned sends takes"),
        ("node", NodeTable * NODES), ("interval", c_int64 * GAUGES), ("seed", c_int64 * GAUGES),
        # by axis the statusword for each of 16 flags
        ("words", c_int64 * 16 * AXES), ("send", TpdoRecord * SENDS), ("take", RpdoRecord * TAKES),
        ("truth_ns", c_int64 * TRUTHS), ("truths", c_double * len(step.TRUTH_NAMES) * TRUTHS),
        ("sensor", c_double * converter.SENSOR * GAUGES),
    ]


STATE, TABLE = np.dtype(CycleState), np.dtype(CycleTable)
STATUS_SOURCE: Final = axis_law.COUNTS - 1
"""Index of the statusword among an axis' counts."""
FROM_TARGETS, FROM_SYNC, FROM_OWN, FROM_NODE = -1, -2, -3, -4
"""Marks of a frame's origin: master's targets, SYNC, master's heartbeat; `FROM_NODE` − n: heartbeat of node place n."""
NEVER: Final = 1 << 62

DONE, UNKNOWN, LATE = 1, 0, -1
"""Result of a cycle: complete; given up for an unsupported event; given up because it would reach its limit."""

SYNC_ID: Final = 0x080

_advance, _axis_step, _axis_counts = step.advance, axis_law.step, axis_law.counts
_convert, _sample, _process = converter.convert, channel_law.sample, channel_law.process
_target, _way, _feel, _truth_row = axis_law.target, axis_law.way, axis_law.feel, step.truth_row
_stuffed_bits = bit_counts.stuffed_bits


def digest() -> int:
    """Return a number of the sources that the compiled cycle is made of, for numba's cache sees its own file alone."""
    made = (axis_law, channel_law, converter, drive_loops, bit_counts, bits, bench_plant)
    text = b"".join(Path(str(module.__file__)).read_bytes() for module in made)
    return int.from_bytes(hashlib.sha256(text).digest()[:7], "big") ^ step.digest()


@njit
def act(m: Any, t: Any, rings: Any, now: int) -> bool:
    """Advance the plant to `now`, tick the drives and sample the sensors that are due; False if one has an event."""
    steps = (now - m.plant_ns) // step.STEP_NS
    m.plant_ns += steps * step.STEP_NS
    plant, torque = m.plant[:], m.torque
    if not np.isfinite(torque[0] + torque[1]):
        return False
    _advance(plant, steps, torque[0], torque[1])
    if m.tick_ns == now:
        m.tick_ns = now + DRIVE_TICK_NS
        for k in range(AXES):
            s = m.axis[k]
            felt = SLOT.out_servo_x + 2 * k
            torque[k] = _axis_step(s, m.setting[k], now, plant[felt], plant[felt + 1])
            if s[axis_law.EVENTS] != 0.0:
                return False
    for k in range(GAUGES):
        if m.sample_ns[k] == now:
            m.sample_ns[k] = now + t.interval[k]
            c = m.channel[k]
            counts = int(_convert(m.converter[k], rings[k], t.sensor[k], np.uint64(t.seed[k]), now,
                                  plant[SLOT.out_start + k]))
            if _sample(c, counts, 0) != c[channel_law.VERDICT]:
                return False
    return True


@njit(inline="always")
def put(m: Any, ready: int, can_id: int, size: int, data: Any, sender: int) -> None:
    """Queue a frame for the wire."""
    frame = m.pending[m.waiting]
    frame.ready, frame.can_id, frame.size, frame.data, frame.sender = ready, can_id, size, data, sender
    m.waiting += 1


@njit
def latch(m: Any, t: Any, now: int) -> bool:
    """Latch every node's values and queue its TPDOs; False if a value does not fit its field."""
    for k in range(AXES):
        _axis_counts(m.axis[k], m.setting[k], m.counted[k])
    for k in range(GAUGES):
        _process(m.channel[k])
    for n in range(t.sends):
        pdo, sent = t.send[n], m.sent[n]
        data, shift = np.uint64(0), 0
        for place in range(pdo.count):
            field = pdo.fields[place]
            width = field.bits
            value = latched(m, t, pdo.node, field.source)
            low = -(1 << (width - 1)) if field.signed else 0
            if not low <= value < low + (1 << width):
                return False
            data |= (np.uint64(value) & np.uint64((1 << width) - 1)) << np.uint64(shift)
            shift += width
        sent.end, sent.data = 0, np.int64(data)
        put(m, now + t.node_ns, pdo.can_id, pdo.size, np.int64(data), n)
    return True


@njit(inline="always")
def latched(m: Any, t: Any, node: int, source: int) -> Any:
    """Return the raw value that a node latched: one of an axis' counts, or a channel's integer."""
    if node >= AXES:
        return int(m.channel[node - AXES, source])
    value = m.counted[node, source]
    return t.words[node, value] if source == STATUS_SOURCE else value


@njit
def take(m: Any, t: Any, n: int) -> Any:
    """Apply the waiting data of RPDO `n`; False if the effect is more than a new set-point."""
    pdo, took = t.take[n], m.took[n]
    data = np.uint64(took.data)
    took.waiting, took.taken, took.last = 0, 1, took.data
    width = pdo.bits
    raw: Any = np.int64((data >> np.uint64(pdo.shift)) & np.uint64((1 << width) - 1))
    if pdo.signed and raw >> (width - 1):
        raw -= 1 << width
    if pdo.bounded and not pdo.least <= raw <= pdo.greatest:
        return False
    s = m.axis[pdo.node]
    if pdo.action == axis_law.FOLLOWS:
        if _way(s, pdo.unit, pdo.origin, raw) > pdo.most:
            return False
        _target(s, pdo.unit, pdo.origin, raw)
    elif pdo.action == axis_law.FEELS:
        return raw != axis_law.NO_TENSION and _feel(s, raw) <= pdo.most
    return True


@njit
def hear(m: Any, t: Any, now: int, can_id: int, data: int) -> bool:
    """Pass a frame to every RPDO with its identifier; False if compiled code cannot handle its effect."""
    for n in range(t.takes):
        pdo, took = t.take[n], m.took[n]
        if pdo.can_id == can_id:
            m.node[pdo.node].called = now
            took.waiting, took.data = 1, data
            if pdo.deadline_ns:
                took.due = now + pdo.deadline_ns
            if not pdo.synchronous and not take(m, t, n):
                return False
    return True


@njit
def synchronise(m: Any, t: Any, now: int) -> bool:
    """Process a SYNC in every node: latch, send, apply RPDOs; False to give up."""
    for node in range(NODES):
        m.node[node].called = now
    if not latch(m, t, now):
        return False
    for n in range(t.takes):
        if m.took[n].waiting and not take(m, t, n):
            return False
    if t.truth:
        t.truth_ns[m.truth_rows] = now
        _truth_row(m.plant[:], t.truths[m.truth_rows])
        m.truth_rows += 1
    return True


@njit(inline="always")
def beat(m: Any, t: Any, now: int) -> None:
    """Queue the heartbeat of every node that is due."""
    for place in range(NODES):
        node, own = m.node[place], t.node[place]
        if node.beat == now:
            node.called, node.beat = now, now + own.period
            put(m, now + t.node_ns, own.can_id, 1, own.data, FROM_NODE - place)


@njit(inline="always")
def watch(m: Any, t: Any, now: int) -> None:
    """Restart the heartbeat consumer of every node that monitors the master."""
    for place in range(NODES):
        if t.node[place].timeout:
            m.node[place].called, m.node[place].watch = now, now + t.node[place].timeout


@njit
def frame_time(m: Any, t: Any) -> Any:
    """Return the duration of the frame on the wire, ns, and count its bits."""
    frame = m.sending
    size, word = frame.size, np.uint64(frame.data)
    payload: Any = np.uint64(0)
    for _ in range(size):
        payload = (payload << np.uint64(8)) | (word & np.uint64(0xFF))
        word >>= np.uint64(8)
    count = _stuffed_bits(frame.can_id << 7 | size, 19, payload, 8 * size) + TRAILER_BITS
    m.busy += count + INTERMISSION_BITS
    return count * t.bit_ns


@njit
def winner(m: Any, now: int) -> int:
    """Return the place of the frame that wins an arbitration at `now`; of the computer's frames only the oldest
    contends."""
    best, oldest = -1, -1
    for n in range(m.waiting):
        frame = m.pending[n]
        if frame.ready > now:
            continue
        if FROM_NODE < frame.sender < 0:
            if oldest < 0 or frame.ready < m.pending[oldest].ready:
                oldest = n
        elif best < 0 or frame.can_id < m.pending[best].can_id:
            best = n
    if best < 0 or (oldest >= 0 and m.pending[oldest].can_id < m.pending[best].can_id):
        return oldest
    return best


@njit(inline="always")
def earliest(m: Any) -> Any:
    """Return the time, ns, at which the first of the waiting frames is ready."""
    first = NEVER
    for n in range(m.waiting):
        first = min(first, m.pending[n].ready)
    return first


@njit(inline="always")
def write_row(m: Any, rows: Any, now: int) -> None:
    """Store the frame on the wire for the recorder."""
    frame, row = m.sending, m.last_row
    rows[row, 0] = np.uint64(now)
    sent = np.uint64(1) << np.uint64(56) if FROM_NODE < frame.sender < 0 else np.uint64(0)
    rows[row, 1] = np.uint64(frame.can_id) | np.uint64(frame.size) << np.uint64(40) | sent
    rows[row, 2] = np.uint64(frame.data)
    m.last_row = row + 1


@njit
def begin(m: Any, t: Any, rows: Any) -> Any:
    """Move the remaining rows to the front, clear the results of the cycle before, put the targets.

    Return False if an event is already due. The nearest deadline limits the cycle.
    """
    kept = m.last_row - m.first_row
    for row in range(kept):
        for word in range(3):
            rows[row, word] = rows[m.first_row + row, word]
    m.first_row, m.last_row, m.sync_at, m.targets_at, m.own_at, m.beats = 0, kept, -1, -1, -1, 0
    for place in range(NODES):
        node = m.node[place]
        node.beat_end = -1
        t.limit = min(t.limit, node.watch)
        if node.beat <= m.now:
            return False
    for n in range(t.takes):
        t.limit = min(t.limit, m.took[n].due)
    if m.truth_rows == TRUTHS or kept + m.waiting + SENDS + NODES + 3 > ROWS or m.waiting + SENDS + NODES + 3 > WAIT:
        return False
    put(m, m.now + t.master_ns, t.targets_id, t.targets_size, t.targets_data, FROM_TARGETS)
    if m.own_ns <= m.now:
        beat_own(m, t, m.now)
    return True


@njit(inline="always")
def beat_own(m: Any, t: Any, now: int) -> None:
    """Queue the master's heartbeat now."""
    m.own_ns, m.own_at = now + t.own_period, now
    put(m, now + t.master_ns, t.own_id, 1, t.own_data, FROM_OWN)


@njit
def deliver(m: Any, t: Any, rows: Any, now: int) -> Any:
    """Pass the completed frame to all receivers; False to give up."""
    frame = m.sending
    sender = frame.sender
    m.frames += 1
    if t.heard:
        write_row(m, rows, now)
    if sender == FROM_SYNC and now <= t.after:
        return False
    if sender == FROM_SYNC:
        m.sync_at, m.sync_row = now, m.last_row
        t.limit = min(t.limit, now + t.budget + 1)
        return synchronise(m, t, now)
    if sender == FROM_OWN:
        watch(m, t, now)
        return True
    if sender <= FROM_NODE:
        m.node[FROM_NODE - sender].beat_end = now
        m.beats += 1
        return True
    if sender == FROM_TARGETS:
        m.targets_at = now
    else:
        m.sent[sender].end = now
    return hear(m, t, now, frame.can_id, frame.data)


@njit(inline="always")
def next_beat(m: Any) -> Any:
    """Return the time of the first due heartbeat of a node."""
    first = NEVER
    for place in range(NODES):
        first = min(first, m.node[place].beat)
    return first


@njit
def arbitrate(m: Any, t: Any, now: int) -> Any:
    """Start the winner of an arbitration; return the time of its end."""
    place = winner(m, now)
    move(m.pending[place], m.sending)
    m.waiting -= 1
    for n in range(place, m.waiting):
        move(m.pending[n + 1], m.pending[n])
    return now + frame_time(m, t)


@njit(inline="always")
def move(source: Any, target: Any) -> None:
    """Copy a frame."""
    target.ready, target.can_id, target.size = source.ready, source.can_id, source.size
    target.data, target.sender = source.data, source.sender


@njit
def run(m: Any, t: Any, rows: Any, rings: Any) -> int:
    """Run events in the kernel's order until every input of the next SYNC has been sent."""
    if not begin(m, t, rows):
        return LATE
    end, left, beating = NEVER, t.sends, next_beat(m)
    while True:
        tick = min(m.tick_ns, min(m.sample_ns[0], m.sample_ns[1]))
        start = max(m.idle_ns, earliest(m)) if end == NEVER else NEVER
        now = min(min(min(tick, end), min(m.sync_ns, start)), min(beating, m.own_ns))
        if now >= t.limit:
            return LATE
        m.now = now
        if tick == now:
            if not act(m, t, rings, now):
                return UNKNOWN
        elif end == now:
            end = NEVER
            m.idle_ns = now + INTERMISSION_BITS * t.bit_ns
            if not deliver(m, t, rows, now):
                return UNKNOWN
            if m.sending.sender >= 0:
                left -= 1
                if not left:
                    return DONE
        elif m.sync_ns == now:
            m.sync_ns = now + t.period
            if m.sync_at >= 0:
                return UNKNOWN
            put(m, now, SYNC_ID, 0, 0, FROM_SYNC)
        elif beating == now:
            beat(m, t, now)
            beating = next_beat(m)
        elif start == now:
            end = arbitrate(m, t, now)
        else:
            beat_own(m, t, now)


def _compile(sources: int) -> Any:
    @njit(cache=True)
    def cycle(state: Any, table: Any, before: Any, rows: Any, rings: Any) -> int:
        _ = sources
        states, kept = state.view(STATE), before.view(STATE)
        m, t = states[0], table.view(TABLE)[0]
        kept[0] = m
        ended = run(m, t, rows, rings)
        if ended != DONE:
            states[0] = kept[0]
            m.first_row, m.last_row = 0, m.last_row - m.first_row
        t.returned = ended
        return int(ended)

    return cycle


cycle: Any = _compile(digest())
"""`cycle(*memory())` runs one complete control cycle and returns `DONE`; another result means no change."""


def memory() -> tuple[Any, ...]:
    """Return the arguments of `cycle`, all numbers 0: the state, the table, a copy of the state, `rows` and `rings`.

    The first three are bytes: numba takes 8 µs to recognise records in a call.
    """
    records = (np.zeros(1, each).view(np.uint8) for each in (STATE, TABLE, STATE))
    return (*records, np.zeros((ROWS, 3), np.uint64), np.zeros((GAUGES, converter.RING, 2)))


def prepare() -> bool:
    """Compile the cycle, or load it from numba's cache; return whether it had to be compiled."""
    before = sum(cycle.stats.cache_misses.values())
    cycle(*memory())
    return bool(sum(cycle.stats.cache_misses.values()) > before)
