"""Base of the core's parts: the device passes them states, frames and time.

A part reaches other parts only through its device.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Final

from eds.cia301 import Abort, NmtState, Service
from eds.datatype import Value

FAR_NS: Final = 1 << 62
"""Time of an action that never comes due."""

US: Final = 1_000
MS: Final = 1_000_000

Handler = Callable[[bytes, int], None]
"""Function of the data of a received frame and the time of its arrival, ns."""

Check = Callable[[int, Value], Abort | None]
"""(sub-index, value) → None or the abort that refuses a write."""

Applied = Callable[[int, Value, int], None]
"""(sub-index, value, now_ns): called after a write."""

Command = Callable[[int, Value, int], Abort | None]
"""(sub-index, value, now_ns) → None or the abort: runs the requested command and keeps no value."""


class Part:
    """One service of the device core; the device asks it for handlers, rules of its objects, and due actions."""

    service: Service = Service.NMT
    """Service that the NMT state must allow for the part's handlers to be called."""

    checks: Mapping[int, Check] = {}
    applied: Mapping[int, Applied] = {}
    commands: Mapping[int, Command] = {}
    """By index: the rules for writing the objects that this part owns."""

    def reset(self, now_ns: int) -> None:
        """Restart from the power-on values of the communication objects."""

    def state_entered(self, state: NmtState, now_ns: int) -> None:
        """Process a change of the NMT state to `state`."""

    def handlers(self) -> Iterable[tuple[int, Handler]]:
        """Return the COB-IDs listened to, each with its handler."""
        return ()

    def cob_ids(self) -> Iterable[tuple[int, int]]:
        """Return the configurable identifiers in use, each with the key of the object that holds it."""
        return ()

    def poll(self, now_ns: int) -> int:
        """Run due actions; return the time of the next one, `FAR_NS` for never."""
        return FAR_NS
