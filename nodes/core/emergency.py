"""EMCY producer: error register 0x1001, history 0x1003, COB-ID 0x1014, inhibit time 0x1015 (CiA 301, 7.5.2.17 f.).

One message when an error comes, one when it goes, none while it lasts (CiA 301, 7.2.7). Messages held back by the
inhibit time or by STOPPED are sent later, from STOPPED only the newest.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from eds.cia301 import SERVICES, Abort, Emcy, ErrorRegister, Frame, NmtState, Service
from eds.dictionary import key
from nodes.core import cob_id
from nodes.core.parts import FAR_NS, US, Part

if TYPE_CHECKING:
    from nodes.core.device import Device

REGISTER: Final = key(0x1001)
HISTORY: Final = 0x1003
COB_ID: Final = 0x1014
INHIBIT: Final = 0x1015

QUEUE: Final = 16
"""Messages kept during the inhibit time; the oldest are discarded first."""

_LAYOUT: Final = struct.Struct("<HB5s")


class Emergency(Part):
    """Errors of one device: the active ones, and the messages sent and pending."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._active: dict[tuple[int, int], int] = {}
        self._pending: deque[bytes] = deque(maxlen=QUEUE)
        self._free_ns = 0
        self._depth = sum(1 for sub in range(1, 255) if key(HISTORY, sub) in device.objects.entries)
        # only 0 may be written to 0x1003:00, which clears the history (CiA 301, 7.5.2.4)
        self.checks = {HISTORY: lambda _, value: None if value == 0 else Abort.INVALID_VALUE,
                       COB_ID: lambda _, value: cob_id.check(device, key(COB_ID), int(value))}
        self.applied = {HISTORY: lambda _sub, _value, _now: self._forget()}

    @property
    def silent(self) -> bool:
        """True if no EMCY message waits for its inhibit time."""
        return not self._pending

    def reset(self, now_ns: int) -> None:
        """Clear communication errors and pending messages; a device error survives a communication reset."""
        self._pending.clear()
        self._free_ns = now_ns
        # 81xxh and 82xxh are errors of communication (CiA 301, table 26)
        self._active = {at: bits for at, bits in self._active.items() if at[0] >> 8 not in (0x81, 0x82)}
        self._show_register()
        self._forget()

    def forget_all(self) -> None:
        """Clear every error at power-on and reset node."""
        self._active.clear()

    def set(self, code: int, register: int, vendor: bytes = b"", source: int = 0) -> None:
        """Report error `code` of `source`, once while it lasts."""
        bits = int(register | ErrorRegister.GENERIC)
        if self._active.get((code, source)) == bits:
            return
        self._active[code, source] = bits
        self._show_register()
        self._remember(code, vendor)
        self._send(code, vendor)

    def clear(self, code: int, source: int | None = None) -> None:
        """Report the end of error `code`, of `source` or of all sources; 0x1001 still shows the errors that remain."""
        gone = [at for at in self._active if at[0] == code and source in (None, at[1])]
        if not gone:
            return
        for at in gone:
            del self._active[at]
        self._show_register()
        left = next(reversed(self._active), (0, 0))[0]
        self._send(Emcy.NO_ERROR, left.to_bytes(2, "little") if left else b"")

    def state_entered(self, state: NmtState, now_ns: int) -> None:
        """Send the messages that were held back in INITIALISING or STOPPED."""
        if self._pending:
            self._device.wake(self.poll(now_ns))

    def poll(self, now_ns: int) -> int:
        """Send the messages that the inhibit time held back."""
        while self._pending and self._free_ns <= now_ns and self._may_send():
            self._emit(self._pending.popleft(), now_ns)
        return self._free_ns if self._pending and self._may_send() else FAR_NS

    def cob_ids(self) -> Iterator[tuple[int, int]]:
        """Yield the COB-ID in use with its object."""
        if can_id := cob_id.in_use(self._device.objects, key(COB_ID)):
            yield key(COB_ID), can_id

    def _send(self, code: int, vendor: bytes) -> None:
        if self._device.nmt.state is NmtState.STOPPED:
            self._pending.clear()
        register = self._device.objects.number(REGISTER)
        self._pending.append(_LAYOUT.pack(code, register, vendor[:5]))
        self._device.wake(self.poll(self._device.now_ns))

    def _emit(self, data: bytes, now_ns: int) -> None:
        for _at, can_id in self.cob_ids():
            self._device.outbox.append(Frame(can_id, data))
            self._free_ns = now_ns + self._device.objects.number(key(INHIBIT)) * 100 * US

    def _may_send(self) -> bool:
        return Service.EMCY in SERVICES[self._device.nmt.state]

    def _show_register(self) -> None:
        register = 0
        for bits in self._active.values():
            register |= bits
        self._device.values[REGISTER] = register

    def _remember(self, code: int, vendor: bytes) -> None:
        """Put the error at 0x1003:01 and push the older ones down."""
        values, depth = self._device.values, self._depth
        if not depth:
            return
        count = min(self._device.objects.number(key(HISTORY)) + 1, depth)
        for sub in range(count, 1, -1):
            values[key(HISTORY, sub)] = values[key(HISTORY, sub - 1)]
        values[key(HISTORY, 1)] = code | int.from_bytes(vendor[:2], "little") << 16
        values[key(HISTORY)] = count

    def _forget(self) -> None:
        values = self._device.values
        for sub in range(1, self._depth + 1):
            values.pop(key(HISTORY, sub), None)
        if self._depth:
            values[key(HISTORY)] = 0
