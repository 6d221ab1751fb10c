"""What is watched in every control cycle, against the table of `safety`.

The rule of this file: a check reads what the cycle already has; it raises `StopError` with the node's name and
the number that broke the limit, and decides nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from eds.bench import END, KNEE, SERVO, START, Wire
from eds.cia301 import Emcy, emcy_text
from eds.cia402 import State
from master.cycle.log import Log
from master.cycle.safety import Condition, StopError
from master.network.link import Emergency, Link
from master.settings import Limits

if TYPE_CHECKING:
    from master.cycle.exchange import Inputs

_ENABLED_MASK, _ENABLED = State.OPERATION_ENABLED.value
WATCH_NS = 10_000_000


class Guard:
    """The checks of a running cycle; `enabled` says that both drives must stay in OPERATION ENABLED.

    `active` False lets everything pass: during bring-up, and once a stop is under way.
    """

    def __init__(
        self, link: Link, wire: Wire, log: Log, limits: Limits, timeout_ns: int,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        self.limits = limits
        self.active = True
        self.enabled = False
        self._link, self._wire, self._log = link, wire, log
        self._timeout_ns = timeout_ns
        self._interrupted = interrupted
        self._watch_ns = 0

    def check(self, inputs: Inputs, late_in_row: Sequence[int]) -> None:
        """Raise `StopError` where the inputs of one SYNC, or what came with them, break a limit."""
        link = self._link
        if link.emergencies or link.boots:
            self._heed(inputs.sync_ns)
        if not self.active:
            return
        limits = self.limits
        if inputs.start_n > limits.start_n:
            raise StopError(Condition.START_LIMIT, f"{inputs.start_n:.1f} N of {limits.start_n:g} N", START)
        if inputs.end_n > limits.end_n:
            raise StopError(Condition.END_LIMIT, f"{inputs.end_n:.1f} N of {limits.end_n:g} N", END)
        if inputs.missing:
            self._refuse_stale(late_in_row)
        if self.enabled and not (
            inputs.servo_status & _ENABLED_MASK == _ENABLED == inputs.knee_status & _ENABLED_MASK
        ):
            self._refuse_disabled(inputs)
        if inputs.sync_ns >= self._watch_ns:
            self._watch(inputs.sync_ns)

    def _refuse_stale(self, late_in_row: Sequence[int]) -> None:
        limit = self.limits.stale_cycles
        for node, late in zip((SERVO, START, KNEE, END), (late_in_row[i] for i in (0, 2, 1, 3)), strict=True):
            if late >= limit:
                raise StopError(Condition.STALE, f"{self._name(node)} missed {late} cycles in a row", node)

    def _refuse_disabled(self, inputs: Inputs) -> None:
        for node, word in ((SERVO, inputs.servo_status), (KNEE, inputs.knee_status)):
            if word & _ENABLED_MASK != _ENABLED:
                raise StopError(Condition.NOT_ENABLED, f"{self._name(node)}, statusword 0x{word:04X}", node)

    def _watch(self, now_ns: int) -> None:
        self._watch_ns = now_ns + WATCH_NS
        if self._interrupted():
            raise StopError(Condition.INTERRUPTED, "by the operator")
        for node in (SERVO, START, KNEE, END):
            beat = self._link.beats.get(node)
            if beat is None or now_ns - beat.time_ns > self._timeout_ns:
                raise StopError(Condition.NODE_LOST, f"{self._name(node)}, for {self._timeout_ns / 1e6:.0f} ms", node)

    def _heed(self, now_ns: int) -> None:
        link = self._link
        first: StopError | None = None
        while link.emergencies:
            emergency = link.emergencies.popleft()
            text = self._described(emergency)
            self._log.event(emergency.time_ns, "emcy", self._name(emergency.node_id), text)
            if emergency.code != Emcy.NO_ERROR:
                first = first or StopError(Condition.EMERGENCY, text, emergency.node_id)
        while link.boots:
            node = link.boots.popleft()
            self._log.event(now_ns, "nmt", self._name(node), "boot-up.")
            first = first or StopError(Condition.BOOTED, self._name(node), node)
        if first is not None and self.active:
            raise first

    def _described(self, emergency: Emergency) -> str:
        return f"{self._name(emergency.node_id)}: 0x{emergency.code:04X}, {emcy_text(emergency.code)}"

    def _name(self, node_id: int) -> str:
        entry = self._wire.nodes.get(node_id)
        return entry.name if entry else f"node {node_id}"
