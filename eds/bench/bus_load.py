"""Bus load and worst-case response times.

The results are bounds, not estimates. Frame lengths are at maximum stuffing; response times by Davis, Burns, Bril and
Lukkien, "Controller Area Network (CAN) schedulability analysis: refuted, revisited and revised", Real-Time Systems 35
(2007). A network that cannot keep its own deadline is refused.

A cycle is a chain: SYNC, then the inputs, then the targets. Each link waits at most for one frame of lower priority
that has begun. The chain holds for the sustained traffic. An EMCY or an SDO in a cycle may cost that cycle its
deadline, which the master counts as a miss; `responses` gives the worst lateness.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

from eds import cia301
from eds.bench.bench_network import MASTER, MONITOR, WireLayout, fits_one_byte
from eds.pdo_plan import PdoPlan
from parameters import InputError

LOAD_GOAL_PERCENT: Final = 60.0
LEAST_RATE_HZ: Final = 10
"""Smallest control rate that `rate_hz` may have."""
EMCY_SIZE: Final = 8
SDO_SIZE: Final = 8


def frame_bits(size: int) -> int:
    """Bit times of an 11-bit data frame of `size` bytes with its interframe space, at maximum stuffing.

    Worst case (Davis 2007, eq. 1 with g = 34): 34 + 8n + 13 + ⌊(34 + 8n − 1) / 4⌋ = 55 + 10n.
    """
    return 47 + 8 * size + (33 + 8 * size) // 4


class Kind(Enum):
    """Purpose of a stream on the bus."""

    CYCLIC = "each cycle"
    HEARTBEAT = "heartbeat"
    EVENT = "on events, at most once a cycle"
    EMCY = "EMCY, at its inhibit time"
    SDO = "SDO, at most one frame a cycle"


@dataclass(frozen=True, slots=True)
class Stream:
    """Frames of one COB-ID: `period_ns` is the least time between two releases, `jitter_ns` their scatter."""

    name: str
    can_id: int
    size: int
    period_ns: int
    kind: Kind
    jitter_ns: int = 0

    def bits(self) -> int:
        """Bit times of one frame at worst."""
        return frame_bits(self.size)


@dataclass(frozen=True, slots=True)
class Budget:
    """Figures of `bowden check config`; times in ns, `inputs_ns` and `deadline_ns` from the SYNC's own instant."""

    load_percent: float
    inputs_ns: int
    targets_ns: int
    compute_ns: int
    deadline_ns: int
    responses: tuple[tuple[Stream, int | None], ...]

    @property
    def holds(self) -> bool:
        """Return whether the last input arrives by its deadline in every cycle of the sustained traffic."""
        return self.inputs_ns <= self.deadline_ns


def bit_ns(wire: WireLayout) -> int:
    """Length of a bit; whole nanoseconds at every bit rate of `BITRATES`."""
    return 1_000_000_000 // wire.network.bitrate


def streams(wire: WireLayout) -> tuple[Stream, ...]:
    """Every stream of the bench, by priority."""
    return tuple(sorted(_streams(wire), key=lambda s: s.can_id))


def load_percent(wire: WireLayout) -> float:
    """Sustained load: cyclic frames, heartbeats and EMCY at their periods, at maximum stuffing, % of the bus."""
    kinds = (Kind.CYCLIC, Kind.HEARTBEAT, Kind.EMCY)
    return 100.0 * bit_ns(wire) * sum(s.bits() / s.period_ns for s in _streams(wire) if s.kind in kinds)


def response_ns(stream: Stream, others: Sequence[Stream], bit: int) -> int | None:
    """Longest time from the queueing of a frame to its end (Davis 2007, eqs. 6 to 12); None where it has no bound.

    `others` may hold `stream` itself; `bit` is the bit time in ns. Equal identifiers count as higher priority.
    """
    higher = [s for s in others if s is not stream and s.can_id <= stream.can_id]
    blocking = max((s.bits() for s in others if s.can_id > stream.can_id), default=0) * bit
    own = stream.bits() * bit
    if sum(s.bits() * bit / s.period_ns for s in (*higher, stream)) >= 1.0:
        return None
    busy, last = own, 0
    while busy != last:
        last, busy = busy, blocking + sum(_demand(s, busy + s.jitter_ns, bit) for s in (*higher, stream))
    worst = 0
    for instance in range(-(-(busy + stream.jitter_ns) // stream.period_ns)):
        wait, last = blocking + instance * own, -1
        while wait != last:
            last = wait
            wait = blocking + instance * own + sum(_demand(s, wait + s.jitter_ns + bit, bit) for s in higher)
        worst = max(worst, wait - instance * stream.period_ns + own)
    return worst


def budget(wire: WireLayout) -> Budget:
    """Compute load, chain and response times of a network."""
    network, bit, found = wire.network, bit_ns(wire), streams(wire)
    blocking = bit * max(s.bits() for s in found if s.kind in (Kind.EVENT, Kind.HEARTBEAT))
    sync = bit * frame_bits(0)
    inputs = bit * sum(frame_bits(plan.size) for plan in wire.tpdo.values())
    targets = blocking + bit * sum(frame_bits(plan.size) for plan in wire.target_frames)
    compute = network.compute_budget_us * 1000
    return Budget(
        load_percent=load_percent(wire),
        inputs_ns=blocking + sync + network.node_turnaround_us * 1000 + blocking + inputs,
        targets_ns=targets,
        compute_ns=compute,
        deadline_ns=wire.period_ns - targets - compute,
        responses=tuple((s, response_ns(s, found, bit)) for s in found),
    )


def refuse(wire: WireLayout) -> Budget:
    """Return the budget of a network that keeps its deadline; `InputError` for one that cannot."""
    found, network = budget(wire), wire.network
    if not found.holds:
        cycle, late, due, frame, compute = (t // 1000 for t in (
            wire.period_ns, found.inputs_ns, found.deadline_ns, found.targets_ns, found.compute_ns))
        fits = rate_that_fits(wire)
        raise InputError(
            f"[network] rate_hz = {network.rate_hz} at bitrate = {network.bitrate}: the last input comes {late} µs "
            f"after SYNC at worst, but is due at {due} µs ({cycle} less {frame} for the targets' frame and {compute} "
            f"for compute_budget_us); lower rate_hz{f' to {fits}' if fits else ''}, raise bitrate or lower "
            "compute_budget_us.")
    return found


def rate_that_fits(wire: WireLayout) -> int | None:
    """Return the largest control rate up to the present one, Hz, that keeps deadline and load goal; None if none."""
    network = wire.network
    for rate in range(network.rate_hz, LEAST_RATE_HZ - 1, -1):
        if 1_000_000 % rate or not fits_one_byte(1_000_000 // rate):
            continue
        found = budget(WireLayout(dataclasses.replace(network, rate_hz=rate), wire.nodes))
        if found.holds and found.load_percent <= LOAD_GOAL_PERCENT:
            return rate
    return None


def _demand(stream: Stream, window_ns: int, bit: int) -> int:
    return -(-window_ns // stream.period_ns) * stream.bits() * bit


def _streams(wire: WireLayout) -> Iterator[Stream]:
    network, cycle = wire.network, wire.period_ns
    latch = network.node_turnaround_us * 1000
    yield Stream("SYNC", cia301.SYNC_COB_ID, 0, cycle, Kind.CYCLIC)
    for entry, plan in zip(wire.nodes.values(), wire.tpdo.values(), strict=True):
        yield Stream(f"TPDO1 {entry.name}", plan.cob_id, plan.size, cycle, Kind.CYCLIC, latch)
    compute = network.compute_budget_us * 1000
    for plan, which in _numbered(wire.target_frames):
        yield Stream(f"targets{which}", plan.cob_id, plan.size, cycle, Kind.CYCLIC, compute)
    for plan, which in _numbered(wire.controlword_frames):
        yield Stream(f"controlwords{which}", plan.cob_id, plan.size, cycle, Kind.EVENT)
    inhibit, heartbeat = network.emcy_inhibit_ms * 1_000_000, network.heartbeat_ms * 1_000_000
    for node, entry in wire.nodes.items():
        yield Stream(f"EMCY {entry.name}", cia301.EMCY_BASE + node, EMCY_SIZE, inhibit, Kind.EMCY)
    yield Stream("SDO response", cia301.SDO_RESPONSE_BASE + wire.drives[0], SDO_SIZE, cycle, Kind.SDO)
    yield Stream("SDO request", cia301.SDO_REQUEST_BASE + wire.drives[0], SDO_SIZE, cycle, Kind.SDO)
    for node, name in (*((node, entry.name) for node, entry in wire.nodes.items()), (MASTER, "master")):
        yield Stream(f"heartbeat {name}", cia301.HEARTBEAT_BASE + node, 1, heartbeat, Kind.HEARTBEAT)
    if network.monitor:
        yield from _of_monitor()


def _of_monitor() -> Iterator[Stream]:
    """Yield the frames of the safety monitor in a control cycle; its digest is sent while no drive is OPERATIONAL."""
    yield Stream("heartbeat safety monitor", cia301.HEARTBEAT_BASE + MONITOR, 1, 100_000_000, Kind.HEARTBEAT)
    yield Stream("EMCY safety monitor", cia301.EMCY_BASE + MONITOR, EMCY_SIZE, 1_000_000_000, Kind.EMCY)


def _numbered(plans: Sequence[PdoPlan]) -> Iterator[tuple[PdoPlan, str]]:
    """Yield each frame with the number that its name ends in, from 1; a single frame has none."""
    for number, plan in enumerate(plans, 1):
        yield plan, f" {number}" if len(plans) > 1 else ""
