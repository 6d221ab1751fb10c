"""Checks of every control cycle, against the table of `safety`.

A check reads the data of the cycle. It raises `StopError` with the name of the fault and its number, the cause before
its consequences, and decides nothing else.
"""

import signal
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import TypeVar

from eds.bench.bench_network import WireLayout
from eds.cia301 import Emcy, NmtState
from eds.cia402 import State, Status
from eds.emcy_codes import emcy_text
from master.cycle import repetition
from master.cycle.blame import blamed
from master.cycle.inputs import END, KNEE, SERVO, START, CycleAnnotations, Inputs, places
from master.cycle.log import Log
from master.cycle.plausibility import AXES, Plausibility
from master.cycle.reception import ENOUGH, Reception
from master.cycle.repetition import Repetition
from master.cycle.safety import Condition, StopError
from master.network.link import EmcyMessage, Link
from master.settings import Limits

T = TypeVar("T")

_ENABLED_MASK, _ENABLED = State.OPERATION_ENABLED.value
_FOLLOWING_ERROR, _INTERNAL_LIMIT = int(Status.FOLLOWING_ERROR), int(Status.INTERNAL_LIMIT)  # `&` of an enum takes a µs
WATCH_NS = 10_000_000
"""Period at which signals and heartbeats are looked at, ns: short against a heartbeat's timeout, 250 ms."""
LIMITED_NS = 300_000_000
"""Time for which a drive may report that an internal limit holds it back (statusword bit 11)."""
YIELDED_M = 2e-3
"""Additional distance, m, from the expected position that is permitted to a servo which its tension bound holds back.
"""
_CONSEQUENCES = (Emcy.RPDO_TIMEOUT, Emcy.GENERIC, Emcy.PDO_TOO_SHORT, Emcy.PDO_TOO_LONG)
PATIENT = 5
"""Factor on the number of cycles a node may miss while the exchange begins: programs that just started stall."""
_LEFT = {int(NmtState.STOPPED): "STOPPED", int(NmtState.PRE_OPERATIONAL): "PRE-OPERATIONAL"}
REMEMBERED = 3
"""Cycles after a missed input in which an EMCY of a drive is attributed to it."""


class Guard:
    """The checks of a running cycle; `enabled`: places of the drives that must stay in OPERATION ENABLED.

    `active` False disables all checks: during bring-up, and once a stop is under way. `beginning`: the exchange is
    not established yet, drives off, and EMCYs about missed cycles are logged and waited through. `interrupted` gives
    the number of the signal that requested an end, 0 for none. `others` are nodes that the guard of another force
    path watches. `joint_held`: another path that leads the joint lacks inputs and holds it, so that signals are not
    compared.
    """

    def __init__(
        self, link: Link, wire: WireLayout, log: Log, limits: Limits, timeout_ns: int,
        interrupted: Callable[[], int] = lambda: 0, others: Collection[int] = (),
    ) -> None:
        self.limits = limits
        self.active = True
        self.beginning = self.joint_held = False
        self.enabled: tuple[int, ...] = ()
        self.plausibility: Plausibility | None = None
        self.repetition: Repetition | None = None
        self._link, self._wire, self._log = link, wire, log
        self._timeout_ns = timeout_ns
        self._others = others
        self._interrupted = interrupted
        self._watch_ns = 0
        self._limited_ns = [0, 0]
        self._order = places(wire)
        self._path = wire.path
        self._missed = [(0, 0)] * len(self._order)
        # order in which lost nodes are named: without servo or START the rope would be pulled blindly
        self._by_weight = tuple(node for place in (SERVO, START, KNEE, END) if (node := self._path[place]))
        self._watched = (*self._by_weight, *(node for node in wire.nodes if node not in self._order))
        self._period_ns = wire.period_ns

    def check(self, inputs: Inputs, late_in_row: Sequence[int], targets: tuple[float, float], rehoming: bool,
              reception: Reception) -> None:
        """Raise `StopError` where the inputs of one SYNC, or what came with them, break a limit."""
        link = self._link
        watch = link.watch
        if inputs.missing:
            self._missed = [(late, inputs.sync_ns) if late else was
                            for late, was in zip(late_in_row, self._missed, strict=True)]
        # causes before consequences: what was said on the bus, then limits, then missing inputs, then relations
        if (watch is not None and watch.found) or link.emergencies or link.boots or link.controller.events:
            self.heed(inputs.sync_ns, reception)
        # a stop goes on by its first cause: what happens meanwhile is recorded and begins no other one
        if not self.active:
            return
        limits = self.limits
        if inputs.start_n > limits.start_n:
            raise self._limit(Condition.START_LIMIT, f"{inputs.start_n:.1f} N of {limits.start_n:g} N",
                              self._path.start)
        if inputs.end_n > limits.end_n:  # never for NaN, of a bench without END
            raise self._limit(Condition.END_LIMIT, f"{inputs.end_n:.1f} N of {limits.end_n:g} N", self._path.end)
        if inputs.missing:
            self._refuse_strange(reception)
            self._refuse_stale(late_in_row)
        # drives that are off follow no target, and a person may move the leg: there is nothing to compare
        if self.enabled:
            self._refuse_disabled(inputs)
            self._supervise(inputs, targets, rehoming)
        if inputs.sync_ns >= self._watch_ns:
            self._watch(inputs.sync_ns)

    # ---- motion and signals ----

    def check_gait(self, inputs: Inputs, annotations: CycleAnnotations) -> None:
        """Raise `StopError` if a control cycle of the gait departs from the desired one or from earlier cycles."""
        if self.active and self.enabled and self.repetition is not None:
            if self.plausibility is not None:
                self.plausibility.follow_zero(annotations.zero_m)
            found = self.repetition.check(inputs, annotations)
            if found is not None:
                raise repetition.stop(found)

    def _supervise(self, inputs: Inputs, targets: tuple[float, float], rehoming: bool) -> None:
        """Check the knee's limits, the drives' status and the plausibility of every signal, or of one axis alone."""
        limits, knee = self.limits, inputs.knee_angle_rad
        # one axis that a person moves may stand beyond its limits, or be held by the rope: the jog itself says so
        alone = AXES[self.enabled[0]] if len(self.enabled) == 1 else ()
        if not alone:
            self._refuse_reported(inputs, rehoming)
        if not alone and not limits.knee_low_rad <= knee <= limits.knee_high_rad:
            raise StopError(Condition.OUT_OF_LIMITS, f"knee at {57.2958 * knee:.1f}°, allowed are "
                            f"{57.2958 * limits.knee_low_rad:.0f}° … {57.2958 * limits.knee_high_rad:.0f}°",
                            self._path.knee)
        plausibility = self.plausibility
        if plausibility is None or rehoming:
            return
        # an incomplete cycle proves nothing: on a bus that loses frames no sensor is blamed for it
        if inputs.missing or self.joint_held:
            plausibility.coast(targets)
            return
        limited = YIELDED_M if self._limited_ns[0] else 0.0
        finding = plausibility.check(limited, targets, inputs.servo_position_m, inputs.servo_force_n, knee,
                                     inputs.start_n, inputs.end_n, alone)
        if finding is not None:
            raise blamed(finding, self._path)

    def _refuse_reported(self, inputs: Inputs, rehoming: bool) -> None:
        """Stop if a drive reports a following error (statusword bit 13) or an internal limit for too long (bit 11)."""
        for i, (node, word) in enumerate(zip(self._path, (inputs.servo_status, inputs.knee_status), strict=False)):
            # in homing mode bit 13 is the homing error (CiA 402), which `drives.set_home` reads
            if word & _FOLLOWING_ERROR and not rehoming:
                raise StopError(Condition.OFF_TARGET, f"{self._name(node)} reports a following error (statusword "
                                                      f"0x{word:04X}, bit 13)", node)
            since = self._limited_ns[i]
            if not word & _INTERNAL_LIMIT:
                self._limited_ns[i] = 0
            elif not since:
                self._limited_ns[i] = inputs.sync_ns
            elif inputs.sync_ns - since > LIMITED_NS:
                raise StopError(Condition.OFF_TARGET, f"{self._name(node)} has been held back by an internal limit for "
                                                      f"{LIMITED_NS / 1e6:.0f} ms (statusword bit 11)", node)

    def _limit(self, condition: Condition, text: str, node: int) -> StopError:
        """Return the stop for a passed limit; if a relation is nearly violated as well, the sentence names it."""
        doubt = self.plausibility.doubt() if self.plausibility is not None and self.enabled else None
        if doubt is None:
            return StopError(condition, text, node)
        # the reading beyond its limit may be the lie: the reaction must not unwind by it
        suspicion = blamed(doubt, self._path)
        return StopError(suspicion.condition, f"{suspicion.detail}; {condition.value}, {text}", suspicion.node_id)

    # ---- communication ----

    def _refuse_strange(self, reception: Reception) -> None:
        for i, node in enumerate(self._order):
            if reception.refused[i] >= ENOUGH:
                raise StopError(Condition.IMPLAUSIBLE, f"{self._name(node)} says {reception.refusal(i)}, "
                                                       f"{reception.refused[i]} cycles in a row", node)

    def _refuse_stale(self, late_in_row: Sequence[int]) -> None:
        limit = self.limits.stale_cycles * (PATIENT if self.beginning else 1)
        # all nodes at once: not a node is lost but the SYNC that they answer
        if min(late_in_row) >= limit:
            raise StopError(Condition.SYNC_LOST, f"no node has answered it for {min(late_in_row)} cycles")
        for node in self._by_weight:
            late = late_in_row[self._order.index(node)]
            if late >= limit:
                raise StopError(Condition.STALE, f"{self._name(node)} missed {late} cycles in a row", node)

    def _refuse_disabled(self, inputs: Inputs) -> None:
        for place in self.enabled:
            node, word = self._path[place], inputs.knee_status if place == KNEE else inputs.servo_status
            if word & _ENABLED_MASK != _ENABLED and node in self._wire.drives:
                raise StopError(Condition.NOT_ENABLED, f"{self._name(node)}, statusword 0x{word:04X}", node)

    def _watch(self, now_ns: int) -> None:
        self._watch_ns = now_ns + WATCH_NS
        number = self._interrupted()
        if number:
            name = "the operator (Ctrl-C)" if number == signal.SIGINT else signal.Signals(number).name
            raise StopError(Condition.INTERRUPTED, f"by {name}")
        for node in self._watched:
            beat = self._link.beats.get(node)
            if beat is None or now_ns - beat.time_ns > self._timeout_ns:
                raise StopError(Condition.NODE_LOST, f"{self._name(node)}, for {self._timeout_ns / 1e6:.0f} ms", node)
            if self.enabled and beat.state in _LEFT:
                raise StopError(Condition.LEFT, f"{self._name(node)}, its heartbeat says {_LEFT[beat.state]}", node)

    def heed(self, now_ns: int, reception: Reception) -> None:
        """Process foreign frames, emergencies and boot-ups; raises `StopError` for the first serious one."""
        link, first = self._link, self._strangers()
        for emergency in _taken(link.emergencies, lambda emergency: emergency.node_id in self._others):
            text = self._described(emergency)
            self._log.event(emergency.time_ns, "emcy", self._name(emergency.node_id), text)
            if emergency.code != Emcy.NO_ERROR and not (self.beginning and emergency.code in _CONSEQUENCES):
                first = first or self._cause(emergency, text, now_ns, reception)
        # a node that booted has the limits and deadlines of power-on, not those that bring-up wrote
        for node in _taken(link.boots, self._others.__contains__):
            self._log.event(now_ns, "nmt", self._name(node), "boot-up.")
            first = first or StopError(Condition.BOOTED, self._name(node), node)
        if first is not None and self.active:
            raise first

    def heed_strangers(self) -> None:
        """Raise `StopError` if a foreign command is the reason why SYNC or inputs are missing."""
        first = self._strangers()
        if first is not None and self.active:
            raise first

    def _strangers(self) -> StopError | None:
        first: StopError | None = None
        self._log.controller(self._link.controller)
        watch = self._link.watch
        while watch is not None and watch.found:
            stranger = watch.found.popleft()
            self._log.event(stranger.time_ns, "bus", "master", f"{stranger.text}.")
            if stranger.moves:
                first = first or StopError(Condition.FOREIGN, stranger.text)
        return first

    def _cause(self, emergency: EmcyMessage, text: str, now_ns: int, reception: Reception) -> StopError:
        """Return the cause of an emergency: a drive reports missed or excessive cycles before the master gives up."""
        # a drive whose inputs stayed away reports a consequence; a node that missed cycles just before is the cause
        if emergency.code in _CONSEQUENCES:
            since = now_ns - REMEMBERED * self._period_ns
            late = [count if at >= since else 0 for count, at in self._missed]
            if min(late) > 0:
                return StopError(Condition.SYNC_LOST, f"no node has answered it for {min(late)} cycles ({text})")
            worst = max(range(len(late)), key=late.__getitem__)
            node = self._order[worst]
            if late[worst] and node != emergency.node_id:
                return StopError(
                    Condition.STALE, f"{self._name(node)} missed {late[worst]} cycles in a row ({text})", node)
        if emergency.code == Emcy.TENSION_LIMIT:
            start = self._path.start
            if reception.refused[START]:
                return StopError(Condition.IMPLAUSIBLE, f"{self._name(start)} says {reception.refusal(START)} ({text})",
                                 start)
            return self._limit(Condition.EMERGENCY, text, self._path.servo)
        return StopError(Condition.EMERGENCY, text, emergency.node_id)

    def _described(self, emergency: EmcyMessage) -> str:
        return f"{self._name(emergency.node_id)}: 0x{emergency.code:04X}, {emcy_text(emergency.code)}"

    def _name(self, node_id: int) -> str:
        entry = self._wire.nodes.get(node_id)
        return entry.name if entry else f"node {node_id}"


def _taken(waiting: deque[T], another_s: Callable[[T], bool]) -> Iterator[T]:
    """Remove and yield the waiting items; items of another guard go on waiting."""
    for _ in range(len(waiting)):
        first = waiting.popleft()
        if another_s(first):
            waiting.append(first)
        else:
            yield first
