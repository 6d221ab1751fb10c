"""One control cycle: SYNC → inputs → (whoever calls steps) → targets → SYNC.

The rule of this file: `Exchange.advance` is the only way from one SYNC to the next; in every cycle it sends
targets, records, and checks what safety checks.  An input that this SYNC did not latch never comes out unmarked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import can

from eds.bench.bench_network import WireLayout, tpdo_cob_id
from eds.bench.complete_cycle import CompleteCycle, CompleteCycles
from eds.cia301 import SYNC_COB_ID
from eds.pdo_plan import JoinedUnpacker
from eds.scale_factors import drum_radius_m
from master.cycle.guard import Guard
from master.cycle.inputs import END, KNEE, NOTHING, CycleAnnotations, Inputs, KeptCycle, observer_slots, places
from master.cycle.log import Log
from master.cycle.plausibility import Plausibility
from master.cycle.reception import Reception
from master.cycle.safety import Condition, StopError
from master.network.link import Link, LinkError, stamp_ns
from trial.signals import CycleRow

NAN = math.nan
FIRST_SENSOR = 2
NO_VALUE = -32767.5
"""Raw counts of 0x7130 below which a sensor reports an invalid value: the least INTEGER16 alone."""
UNSEEN = "the bus does not show SYNC to its sender; the master sends it from its own clock, with more jitter."
UNHEARD = (NAN, NAN, NAN, NAN)
KNEE_BIT = 1 << KNEE
NEEDED = 0b0111
"""Bits of the inputs that a control cycle needs: without them it holds the last targets. END is not among them."""


class SyncCycle:
    """Reception of one SYNC after another, and of the PDOs that answer it, for the force paths in `paths`.

    `budget_ns` is the time after a SYNC at which its inputs must have arrived.
    """

    paths: Sequence[Exchange] = ()

    def __init__(self, link: Link, wire: WireLayout, log: Log, budget_ns: int) -> None:
        self.link, self.wire, self.log = link, wire, log
        self._budget_ns, self._early_ns = budget_ns, -1
        self._hearing: dict[int, list[Exchange]] = {}

    def _run_paths(self) -> None:
        """List the force paths that receive each COB-ID, and set the longest wait for a SYNC, ns."""
        self._patience_ns = self.paths[0].guard.limits.stale_cycles * self.wire.period_ns
        for path in self.paths:
            for can_id in path.heard:
                self._hearing.setdefault(can_id, []).append(path)

    @property
    def guards(self) -> tuple[Guard, ...]:
        """The guards of all paths."""
        return tuple(path.guard for path in self.paths)

    def forget_misses(self) -> None:
        """Set every path's counters of missed inputs and outputs to 0."""
        for path in self.paths:
            path.missed_cycles = path.stale_inputs = 0

    def begin(self) -> None:
        """Wait for a first SYNC and its inputs; an SDO's wait runs control cycles from here on."""
        sync_ns = self._await_sync()
        if sync_ns < 0:
            self.link.sync_pace(self.wire.period_ns)
            self.log.event(self.link.clock(), "warning", "master", UNSEEN)
            sync_ns = self._await_sync()
        self.log.drain()
        # without targets during an SDO's wait the drives let go after 100 ms (0x1400:05)
        self.link.pump = lambda _deadline_ns: self.hold()
        for path in self.paths:
            path.first_ns = sync_ns
        self._latch(sync_ns)
        for path in self.paths:
            path.begun()

    def end(self) -> None:
        """End the cyclic exchange: SDO transfers wait by receiving again."""
        self.link.pump = self.link.receive
        self.log.drain()

    def hold(self) -> Any:
        """Run one cycle with the targets of the last one."""
        raise NotImplementedError

    def _latch(self, sync_ns: int) -> Any:
        """Collect the PDOs of one SYNC until they are all there or the deadline has come; then check safety."""
        raise NotImplementedError

    def _await_sync(self) -> int:
        """Return the time stamp of the next SYNC, −1 after the patience; TPDOs that come before it are stored late."""
        early, self._early_ns = self._early_ns, -1
        if early >= 0:
            return early
        receive, hearing = self.link.receive, self._hearing
        deadline = self.link.clock() + self._patience_ns
        while (message := receive(deadline)) is not None:
            if message.arbitration_id == SYNC_COB_ID:
                if not self.paths[0].repeats(stamp_ns(message)):
                    return stamp_ns(message)
            else:
                for path in hearing.get(message.arbitration_id, ()):
                    path.hear_late(message)
        return -1

    def _in_time(self, sync_ns: int, sent: bool) -> bool:
        """Return whether targets that were `sent` were on the bus before the SYNC that ended their cycle."""
        return sent and (not self.log.taps or self.paths[0].inputs.sync_ns <= self.log.target_stamp_ns <= sync_ns)

    def _refuse_silence(self, sync_ns: int) -> None:
        """Raise `StopError` where no SYNC has come."""
        if sync_ns < 0:
            self.paths[0].guard.heed_strangers()  # a foreign command is the cause, the silence its consequence
            raise StopError(Condition.SYNC_LOST, f"none for {self._patience_ns / 1e6:.0f} ms")

    def _collect(self, sync_ns: int) -> None:
        """Receive the PDOs of one SYNC that are absent, until its deadline."""
        receive, hearing, paths = self.link.receive, self._hearing, self.paths
        deadline = sync_ns + self._budget_ns
        while any(path.absent for path in paths) and (message := receive(deadline)) is not None:
            if message.arbitration_id != SYNC_COB_ID:
                for path in hearing.get(message.arbitration_id, ()):
                    path.hear(message, sync_ns)
            elif (stamp := stamp_ns(message)) - sync_ns > self.wire.period_ns // 2:
                self._early_ns = stamp  # to wait on for this cycle's inputs would make the next one late, too
                break
            else:
                paths[0].note_repeated(stamp)


class Exchange(SyncCycle):
    """Control cycle of a bench over a link: `advance` sends the targets and returns the inputs of the next SYNC.

    SYNC must be running. `missed_cycles` counts cycles whose inputs or targets were late; `stale_inputs` counts PDOs
    older than one cycle that a control step used. `name` is the force path in events, "" if the bench has one path.
    `own` is the number of columns that the controller adds to a row; `told` is true once this cycle's row is recorded.
    `annotations` are the controller's entries in a row if `advance` receives none. `kept`, if a list, collects complete
    cycles. `paths` are the force paths that this cycle runs, here itself. `rehoming` is true while homing sets another
    servo zero; `rehomed` ends it. `absent` has a bit for each input of the present SYNC that has not been received.
    """

    alone, mirrors = True, False
    """Whether no other force path is on the bus, so that the bus may run complete cycles by itself; and whether the
    path counts the joint's angle mirrored."""

    def __init__(self, link: Link, wire: WireLayout, log: Log, guard: Guard, budget_ns: int) -> None:
        super().__init__(link, wire, log, budget_ns)
        self.guard = guard
        self.missed_cycles = self.stale_inputs = self.absent = 0
        self.paths: tuple[Exchange, ...] = (self,)
        self.inputs = Inputs(-1, 0, NAN, NAN, 0, NAN, NAN, NAN, (1 << len(places(wire))) - 1)
        self.targets = (0.0, 0.0)
        self.annotations = NOTHING
        self.kept: list[KeptCycle] | None = None
        self.path = wire.path
        self._order = places(wire)
        self.all = (1 << len(self._order)) - 1
        self._none_late = [0] * len(self._order)
        plans = [wire.tpdo[tpdo_cob_id(node)] for node in self._order]
        self._slots = {plan.cob_id: (i, plan.size) for i, plan in enumerate(plans)}
        self.knee_driven = self.path.knee in wire.drives
        self._unpack = [plan.unpack_si for plan in plans]
        if not self.knee_driven:
            self._unpack[KNEE] = _without_status(plans[KNEE].unpack_si)
        self._unpack_all = JoinedUnpacker(plans).unpack_si
        self._no_value = [-math.inf, -math.inf, *(NO_VALUE * plan.fields[0].scale for plan in plans[FIRST_SENSOR:])]
        self._newtons = 1.0 / drum_radius_m(wire.nodes[self.path.servo].dictionary)
        self._pack_targets = wire.targets.pack_si
        self._values: Sequence[tuple[float, ...]] = ((0.0, NAN, NAN), (0.0, NAN), (NAN,), (NAN,))
        self._latched_ns: Sequence[float] = [0 if node else NAN for node in self.path]
        self._arrival_ns: Sequence[float] = UNHEARD
        self._late_in_row = self._none_late
        self.first_ns = self._velocity_ns = -1
        self._count = 0
        self.told = self._doubled_sync = False
        self.own, self.name = 0, "master"
        self._answered_ns = self._step_ns = 0
        # What is late: SYNC by a time, inputs by a count.  A busy computer makes up for it, which is no repetition.
        self._overdue_ns, self._overdue_inputs = 0, [0, 0, 0, 0]
        self._misses = 0
        self._miss_text = ""
        self._lengths: set[int] = set()
        self.rehoming = False
        self.plausibility = guard.plausibility = Plausibility(wire.period_ns * 1e-9, with_end=self.path[END] > 0,
                                                            with_knee=self.knee_driven)
        self._reception = Reception(wire.period_ns * 1e-9, guard.limits)
        self._velocity = self._position = NAN
        offer: Callable[..., CompleteCycles | None] | None = getattr(link.bus, "cycles", None)
        self._observers = observer_slots(wire)
        self._unknown = (NAN,) * sum(len(slots.places) for slots in self._observers.values())
        self.observed = self._unknown
        whole = self.alone and len(plans) == len(wire.nodes) == len(self.path) and self.knee_driven
        self._complete_cycles = None if offer is None or not whole else offer(
            log.tap, (wire.targets.cob_id, wire.targets.size), [(plan.cob_id, plan.size) for plan in plans],
            wire.period_ns, budget_ns, link.heartbeat)
        self._run_paths()

    def begun(self) -> None:
        """Clear the overdue time; the target of a joint without a drive is its measured angle: hold it where it is."""
        self._overdue_ns = 0
        if not self.knee_driven and not self.inputs.missing & KNEE_BIT:
            self.targets = (self.targets[0], self.inputs.knee_angle_rad)

    @property
    def heard(self) -> tuple[int, ...]:
        """COB-IDs that this path receives: inputs and observers."""
        return (*self._slots, *self._observers)

    def hold(self) -> Inputs:
        """Run one cycle with the targets of the last one."""
        return self.advance(*self.targets)

    def rehomed(self, by_m: float) -> None:
        """Shift the servo's position by `by_m` after homing."""
        self.rehoming = False
        self.plausibility.shift(by_m)

    def command(self, servo_word: int, knee_word: int) -> None:
        """Send the drives' controlwords, event-driven: they act when they arrive; the knee's only where it has one."""
        plan = self.wire.controlwords
        self.link.send(plan.cob_id, plan.pack(servo_word, knee_word) if self.knee_driven else plan.pack(servo_word))

    def advance(self, servo_m: float, knee_rad: float, annotations: CycleAnnotations | None = None) -> Inputs:
        """Send the targets that answer `inputs`, and return the inputs of the next SYNC.

        Raises `StopError` for a condition of safety's table, `LinkError` if the bus is gone.
        """
        link, inputs = self.link, self.inputs
        self.answer(servo_m, knee_rad, annotations)
        data = self._pack_targets(servo_m, knee_rad)
        if link.watch is not None:
            link.watch.sent(self.wire.targets.cob_id, data)
        sent = False
        if self._complete_cycles is not None and not inputs.missing and self._early_ns < 0:
            try:
                complete = self._complete_cycles.run(data, link.due_ns, inputs.sync_ns + self.wire.period_ns // 2)
            except can.CanError as error:
                raise LinkError(f"receiving failed: {error}") from error
            if not isinstance(complete, bool):
                return self._at_once(complete, annotations)
            sent = complete
        sent = sent or link.try_send(can.Message(
            arbitration_id=self.wire.targets.cob_id, data=data, is_extended_id=False))
        sync_ns = self._await_sync()
        self.log.drain()
        # recorded before anything may stop, so that the file has the cycle that ends the trial
        self._record(sync_ns, sent, annotations)
        self._refuse_silence(sync_ns)
        return self._latch(sync_ns)

    def answer(self, servo_m: float, knee_rad: float, annotations: CycleAnnotations | None) -> None:
        """Store the targets that were computed from `inputs`; nothing is sent yet."""
        inputs = self.inputs
        if annotations is not None:  # before the targets go out: a gait that departs gets no further one
            self.guard.check_gait(inputs, annotations)
        self.targets = (servo_m, knee_rad)
        self._step_ns = self.link.clock() - self._answered_ns
        if self.kept is not None and not inputs.missing:
            said = annotations or NOTHING
            self.kept.append(KeptCycle(target=servo_m, position=inputs.servo_position_m, knee=inputs.knee_angle_rad,
                                       start=inputs.start_n, end=inputs.end_n, desired=said.desired_force_n,
                                       estimated=said.estimated_end_force_n))

    def _at_once(self, complete: CompleteCycle, annotations: CycleAnnotations | None) -> Inputs:
        """Record a complete cycle that the bus has run, and return its inputs."""
        sync_ns = complete.sync_ns
        if complete.heartbeats:
            self.link.heed(complete.heartbeats)
        try:
            if self.log.taps:
                self.log.take(complete.frames, complete.frame_count, sync_ns, complete.target_ns)
            self._record(sync_ns, True, annotations)
        except StopError:  # the recorder failed; the cycle was run all the same
            with suppress(StopError):
                self._latch(sync_ns, complete.inputs)
            raise
        return self._latch(sync_ns, complete.inputs)

    def _record(self, sync_ns: int, sent: bool, annotations: CycleAnnotations | None) -> None:
        """Record the cycle that the newest SYNC has ended."""
        sent = self._in_time(sync_ns, sent)
        self.note(sent)
        if not self.told:
            self.told = True
            told = annotations or self.annotations
            self.log.row(self.inputs.sync_ns, self.row_of(told, sent).values(self.observed, told.own))

    def note(self, sent: bool) -> None:
        """Count the misses of a cycle; `sent`: its targets were transmitted in time."""
        if not sent or self.inputs.missing:
            self._note_miss(sent)
        elif self._misses:
            self._end_misses()

    def hear_late(self, message: can.Message) -> None:
        """Process a TPDO that arrives after the deadline of its cycle."""
        can_id = message.arbitration_id
        if can_id in self._observers:
            self._observe(message)
            return
        i = self._slots[can_id][0]
        if self.inputs.missing >> i & 1:
            self._take(message, self.inputs.sync_ns)
            self._overdue_inputs[i] = 0
        else:
            self._note_doubled(message, i)

    def hear(self, message: can.Message, sync_ns: int) -> None:
        """Store a TPDO that a SYNC has latched."""
        can_id = message.arbitration_id
        if can_id in self._observers:
            self._observe(message)
        elif self.absent >> self._slots[can_id][0] & 1:
            self.absent &= ~self._take(message, sync_ns)
        else:
            self._note_doubled(message, self._slots[can_id][0])

    def repeats(self, sync_ns: int) -> bool:
        """Return whether a SYNC comes within half a period of the last one: it is doubled, and begins no cycle."""
        if self.inputs.sync_ns < 0 or sync_ns - self.inputs.sync_ns > self.wire.period_ns // 2:
            return False
        self.note_repeated(sync_ns)
        return True

    def note_repeated(self, sync_ns: int) -> None:
        """Report a SYNC that comes too soon, unless one is overdue: a busy computer sends it late, and the next one in
        time."""
        self._doubled_sync = True
        if self._overdue_ns > self.wire.period_ns // 2:
            self._overdue_ns -= self.wire.period_ns
        elif self.link.watch is not None:
            self.link.watch.doubled(sync_ns, self._count, "SYNC")

    def _note_doubled(self, message: can.Message, i: int) -> None:
        """Report an input that arrived twice with one SYNC, unless a late input is overdue or the exchange is only
        beginning."""
        if self._overdue_inputs[i]:
            self._overdue_inputs[i] -= 1
        elif self.link.watch is not None and not (self._doubled_sync or self.guard.beginning):
            name = self.wire.nodes[self._order[i]].name
            self.link.watch.doubled(stamp_ns(message), self._count, f"the inputs of {name}")

    def _take(self, message: can.Message, sync_ns: int) -> int:
        """Store a TPDO as latched by `sync_ns`; return its bit, or 0 if it is short, invalid or impossible."""
        i, size = self._slots[message.arbitration_id]
        if len(message.data) != size:
            self._tell_length(i, len(message.data), size, stamp_ns(message))
            if len(message.data) < size:
                return 0
        values = self._unpack[i](bytes(message.data))
        if i >= FIRST_SENSOR and values[0] <= self._no_value[i]:
            return 0
        if not self._reception.accepts(i, values, self.rehoming):
            self._tell_refused(i, stamp_ns(message))
            return 0
        self._keep(i, values, sync_ns, stamp_ns(message))
        return 1 << i

    def _keep_all(self, sync_ns: int, frames: Any) -> int:
        """Store all TPDOs, as `eds.pdo_plan.JoinedUnpacker` reads them; return the bits of those that were refused."""
        ends, values = self._unpack_all(frames)
        servo, knee, start, end = values
        # `accepts` permits the step of a zero that homing sets, `takes_all` knows none
        if (start[0] > self._no_value[2] and end[0] > self._no_value[3] and not self.rehoming
                and self._reception.takes_all(servo[1], knee[1], start[0], end[0])):
            self._values, self._latched_ns = values, (sync_ns, sync_ns, sync_ns, sync_ns)
            self._arrival_ns = (ends[0] - sync_ns, ends[1] - sync_ns, ends[2] - sync_ns, ends[3] - sync_ns)
            return 0
        return self._keep_singly(sync_ns, ends, values)

    def _keep_singly(self, sync_ns: int, ends: Sequence[int], values: Sequence[tuple[float, ...]]) -> int:
        """Store each accepted value by itself, if a value of this SYNC or the last one was refused."""
        self._reception.begin()
        missing = 0
        for i, each in enumerate(values):
            if each[0] <= self._no_value[i] or not self._reception.accepts(i, each, self.rehoming):
                missing |= 1 << i
            else:
                self._keep(i, each, sync_ns, ends[i])
        for i, each in enumerate(values):
            if missing >> i & 1 and each[0] > self._no_value[i]:
                self._tell_refused(i, ends[i])
        return missing

    def _keep(self, i: int, values: tuple[float, ...], sync_ns: int, stamp: int) -> None:
        """Store the values of input i, latched by the SYNC at `sync_ns`."""
        kept, latched, arrival = list(self._values), list(self._latched_ns), list(self._arrival_ns)
        kept[i], latched[i], arrival[i] = values, sync_ns, stamp - sync_ns
        self._values, self._latched_ns, self._arrival_ns = kept, latched, arrival

    def _tell_length(self, i: int, length: int, size: int, stamp: int) -> None:
        """Record once that a node's PDO has another length than its mapping."""
        if i not in self._lengths:
            self._lengths.add(i)
            name = self.wire.nodes[self._order[i]].name
            self.log.event(stamp, "miss", "master", f"{name}: a PDO of {length} bytes, mapped are {size}.")

    def _tell_refused(self, i: int, stamp: int) -> None:
        self.log.event(stamp, "miss", "master",
                       f"{self.wire.nodes[self._order[i]].name}: {self._reception.refusal(i)}; not taken.")

    def _latch(self, sync_ns: int, frames: Any = None) -> Inputs:
        """Collect the PDOs of one SYNC, or take `frames`, as `eds.pdo_plan.JoinedUnpacker` does; then check safety."""
        self.begin_latch(sync_ns)
        if frames is None:
            self.expect()
        else:
            self.absent = self._keep_all(sync_ns, frames)
        self._collect(sync_ns)
        self.latched(sync_ns)
        return self.checked()

    def begin_latch(self, sync_ns: int) -> None:
        """Begin a cycle: no input of this SYNC has been received."""
        self._arrival_ns, self.observed = UNHEARD, self._unknown
        self.told = self._doubled_sync = False
        overdue_ns = self._overdue_ns + sync_ns - self.inputs.sync_ns - self.wire.period_ns
        self._overdue_ns = min(max(overdue_ns, 0), self._patience_ns)

    def latched(self, sync_ns: int) -> None:
        """Set `inputs` from the values received since the SYNC at `sync_ns`; mark an input without a PDO as missing."""
        missing = self.absent
        servo, knee, start, end = self._values
        self.inputs = inputs = Inputs(
            sync_ns=sync_ns, servo_status=int(servo[0]), servo_position_m=servo[1],
            servo_force_n=servo[2] * self._newtons, knee_status=int(knee[0]), knee_angle_rad=knee[1],
            start_n=start[0], end_n=end[0], missing=missing)
        self._derive(inputs)
        late = self._late_in_row
        if missing or late != self._none_late:
            self._late_in_row = [count + 1 if missing >> i & 1 else 0 for i, count in enumerate(late)]
            self._overdue_inputs = [n + (missing >> i & 1) for i, n in enumerate(self._overdue_inputs)]

    def checked(self) -> Inputs:
        """Return the inputs of this cycle, checked against the table of `safety`."""
        self.guard.check(self.inputs, self._late_in_row, self.targets, self.rehoming, self._reception)
        self._answered_ns = self.link.clock()
        return self.inputs

    def expect(self) -> None:
        """Begin the reception of a SYNC's inputs: all are absent."""
        self._reception.begin()
        self.absent = self.all

    def _observe(self, message: can.Message) -> None:
        """Keep the content of an observer's TPDO for the row of this cycle."""
        plan, places = self._observers[message.arbitration_id]
        if len(message.data) < plan.size:
            return
        values, row = plan.unpack_si(bytes(message.data)), list(self.observed)
        for field, column in places:
            row[column] = values[field]
        self.observed = tuple(row)

    def _derive(self, inputs: Inputs) -> None:
        if inputs.missing & 1:
            self._velocity = NAN
            return
        if self._velocity_ns >= 0:
            self._velocity = (inputs.servo_position_m - self._position) * 1e9 / (inputs.sync_ns - self._velocity_ns)
        self._position, self._velocity_ns = inputs.servo_position_m, inputs.sync_ns

    def _note_miss(self, sent: bool) -> None:
        inputs = self.inputs
        self.missed_cycles += 1
        if not inputs.missing & NEEDED:
            self.stale_inputs += inputs.missing.bit_count()
        names = [self.wire.nodes[node].name for i, node in enumerate(self._order) if inputs.missing >> i & 1]
        text = " and ".join([*(f"no inputs of {name}" for name in names), *([] if sent else ["targets too late"])])
        if text == self._miss_text:
            self._misses += 1
            return
        if self._misses:
            self._end_misses()
        self._misses, self._miss_text = 1, text
        self.log.event(inputs.sync_ns, "miss", "master", f"{text}.")

    def _end_misses(self) -> None:
        """Log the length of a run of equal misses once it is over; a single one has been logged."""
        if self._misses > 1:
            self.log.event(self.inputs.sync_ns, "miss", "master", f"{self._miss_text}, {self._misses} cycles in a row.")
        self._misses, self._miss_text = 0, ""

    def row_of(self, annotations: CycleAnnotations, sent: bool) -> CycleRow:
        """Return this cycle's row."""
        inputs, latched, told = self.inputs, self._latched_ns, annotations
        sync_ns = inputs.sync_ns
        servo_heard, knee_heard, start_heard, end_heard = self._arrival_ns
        count, self._count = self._count, self._count + 1
        return CycleRow(
            time_s=(sync_ns - self.first_ns) * 1e-9, gait_percent=told.gait_percent, cycle=told.cycle, held=told.held,
            servo_target_m=self.targets[0], servo_position_m=inputs.servo_position_m, servo_velocity_m_s=self._velocity,
            servo_force_n=inputs.servo_force_n, knee_target_rad=self.targets[1], knee_angle_rad=inputs.knee_angle_rad,
            tension_start_n=inputs.start_n, tension_end_n=inputs.end_n,
            servo_pdo_age_ns=sync_ns - latched[0], knee_pdo_age_ns=sync_ns - latched[1],
            start_pdo_age_ns=sync_ns - latched[2], end_pdo_age_ns=sync_ns - latched[3],
            servo_pdo_arrival_ns=servo_heard, knee_pdo_arrival_ns=knee_heard,
            start_pdo_arrival_ns=start_heard, end_pdo_arrival_ns=end_heard,
            servo_statusword=inputs.servo_status, knee_statusword=inputs.knee_status if self.knee_driven else NAN,
            missed_inputs=inputs.missing.bit_count(), missed_outputs=0.0 if sent else 1.0,
            sync_jitter_ns=sync_ns - self.first_ns - count * self.wire.period_ns,
            step_duration_ns=self._step_ns or NAN,
            desired_force_n=told.desired_force_n, estimated_end_force_n=told.estimated_end_force_n,
            estimated_end_half_n=told.estimated_end_half_n, feedforward_m=told.feedforward_m,
            impedance_dx_m=told.impedance_dx_m, friction_ratio=told.friction_ratio,
            rope_direction=told.rope_direction, strain_direction=told.strain_direction,
        )


def _without_status(unpack: Callable[[bytes], tuple[float, ...]]) -> Callable[[bytes], tuple[float, ...]]:
    """Return a decoder that reads an encoder's frame as a knee drive's, with a statusword of 0 before the angle."""
    return lambda data: (0, *unpack(data))
