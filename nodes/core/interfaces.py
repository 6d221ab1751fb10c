"""Interface of a device towards its profile, which the profiles of plug-ins use as well."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from eds.datatype import Value
from nodes.core.objects import Objects

if TYPE_CHECKING:
    from nodes.core.heartbeat import Consumer


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
    def consumer(self) -> Consumer: ...

    def emergency(self, code: int, register: int, vendor: bytes = b"") -> None: ...

    def recover(self, code: int) -> None: ...
