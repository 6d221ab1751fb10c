"""Interface between a device profile and the device core, which the profiles of plug-ins use as well.

The core calls the methods of `Application`, the profile overrides those that it needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from eds.cia301 import Emcy, NmtState
from eds.datatype import Value
from eds.dictionary import key as key_of
from nodes.core.objects import Objects

if TYPE_CHECKING:
    from nodes.core.nmt import HeartbeatConsumer

class ProfileHost(Protocol):
    """A `device.Device` as its profile sees it: `values` are the present values of `objects` by key.

    `now_ns` is the time of the device's last call. `emergency` reports an error once while it lasts, `recover` its end.
    """

    now_ns: int

    @property
    def objects(self) -> Objects: ...

    @property
    def values(self) -> dict[int, Value]: ...

    @property
    def consumer(self) -> HeartbeatConsumer: ...

    def emergency(self, code: int, register: int, vendor: bytes = b"") -> None: ...

    def recover(self, code: int) -> None: ...


class Application:
    """A profile behind a `Device`; subclass it and override the methods that the profile needs.

    Times are nanoseconds of the caller's clock, keys are `eds.dictionary.key(index, subindex)`, values raw.
    """

    device: ProfileHost
    values: dict[int, Value]

    watched: frozenset[int] = frozenset()
    """Keys of the objects whose writes are reported to `written`; read once, after `attach`."""

    unstored: frozenset[int] = frozenset()
    """Keys that 0x1010 never saves, beyond those that an RPDO may write; read once, after `attach`."""

    def attach(self, device: ProfileHost) -> None:
        """Keep `device` and its `values`; called once, before power-on, when the values already are the defaults."""
        self.device, self.values = device, device.values

    def number(self, index: int, subindex: int = 0, missing: int = 0) -> int:
        """Return the value of an integer object; `missing` where the dictionary has none."""
        return self.device.objects.number(key_of(index, subindex), missing)

    def check_write(self, key: int, value: Value) -> int:
        """Return 0 or an SDO abort code; asked for SDO writes above 0x1FFF and for watched keys in an RPDO."""
        return 0

    def written(self, key: int, value: Value, now_ns: int) -> None:
        """Process a write to a watched object, by SDO or RPDO; `device.values` already holds the value."""

    def latch(self, now_ns: int) -> None:
        """Bring process inputs into `device.values`: at SYNC, before the TPDOs are packed (OPERATIONAL only)."""

    def refresh(self, now_ns: int) -> None:
        """Bring process values up to date without a SYNC: before an SDO upload, an event-driven or requested TPDO."""

    def nmt_changed(self, state: NmtState, now_ns: int) -> None:
        """Process a change of the NMT state to `state`; INITIALISING occurs at either reset."""

    def communication_lost(self, reason: Emcy, now_ns: int) -> None:
        """React to a lost heartbeat, RPDO or bus; 0x1029 acts on the NMT state afterwards."""

    def reset(self, now_ns: int) -> None:
        """Clear all state at power-on or reset node; `device.values` holds stored or default values."""

    def poll(self, now_ns: int) -> None:
        """Run all actions that are due."""

    def next_ns(self) -> int | None:
        """Return the time of the next action of `poll`, or None."""
        return None
