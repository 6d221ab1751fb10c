"""Behaviour of a virtual node beyond its EDS: functions at writes and reads, a state table, refusals.

It adds to a device profile (`nodes.Application`) and replaces none of it; functions are called with raw values, in
the order of their declaration.
"""

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any

from eds.cia301 import Emcy, NmtState
from eds.datatype import Value
from nodes import Application, ProfileHost

Table = Mapping[tuple[Hashable, int, Value | None], tuple[Hashable, Mapping[int, Value]]]
"""(state, key, value written or None for any) → (next state, {key: value to set})."""


@dataclass
class StateTable:
    """A state machine as a table of writes; `state` is the present one."""

    state: Hashable
    table: Table

    def step(self, key: int, value: Value) -> Mapping[int, Value]:
        """Return the values to set by object after a write. A write that the table does not list changes nothing."""
        row = self.table.get((self.state, key, value), self.table.get((self.state, key, None)))
        if row is None:
            return {}
        self.state, to_set = row
        return to_set


@dataclass
class Refusal:
    """An SDO abort code for the next `count` writes, None for all."""

    code: int
    count: int | None


class Behaviour(Application):
    """Functions of a test, called before those of a device profile."""

    def __init__(self, profile: Application) -> None:
        self.profile = profile
        self.writers: dict[int, list[Callable[[Any], object]]] = {}
        self.readers: dict[int, Callable[[], Any]] = {}
        self.refusals: dict[int, Refusal] = {}
        self.machines: list[StateTable] = []
        self.busy = 0

    def attach(self, device: ProfileHost) -> None:
        """Attach the profile, and listen to every object that a master may write."""
        self.device = device
        self.profile.attach(device)
        self.watched = frozenset(at for at, entry in device.objects.entries.items() if entry.writable)
        self.unstored = frozenset(self.profile.unstored)

    def check_write(self, key: int, value: Value) -> int:
        """Return the abort code of a refusal that the test asked for, else the profile's answer."""
        refusal = self.refusals.get(key)
        if refusal is None:
            return self.profile.check_write(key, value)
        if refusal.count is not None:
            refusal.count -= 1
            if refusal.count == 0:
                del self.refusals[key]
        return refusal.code

    def written(self, key: int, value: Value, now_ns: int) -> None:
        """Report a write to the profile, the state tables and the functions of the test."""
        self.busy += 1
        try:
            if key in self.profile.watched:
                self.profile.written(key, value, now_ns)
            for machine in self.machines:
                self.device.values.update(machine.step(key, value))
            for function in self.writers.get(key, ()):
                function(value)
        finally:
            self.busy -= 1

    def latch(self, now_ns: int) -> None:
        """Update the process inputs at a SYNC."""
        self.profile.latch(now_ns)
        self._read()

    def refresh(self, now_ns: int) -> None:
        """Bring process inputs up to date before an upload or an event-driven TPDO."""
        self.profile.refresh(now_ns)
        self._read()

    def _read(self) -> None:
        for key, function in self.readers.items():
            self.device.values[key] = function()

    def nmt_changed(self, state: NmtState, now_ns: int) -> None:
        """Report the NMT state to the profile."""
        self.profile.nmt_changed(state, now_ns)

    def communication_lost(self, reason: Emcy, now_ns: int) -> None:
        """Report the loss of communication to the profile."""
        self.profile.communication_lost(reason, now_ns)

    def reset(self, now_ns: int) -> None:
        """Report the reset to the profile."""
        self.profile.reset(now_ns)

    def poll(self, now_ns: int) -> None:
        """Run all due actions of the profile."""
        self.profile.poll(now_ns)

    def next_ns(self) -> int | None:
        """Return the time of the profile's next action."""
        return self.profile.next_ns()
