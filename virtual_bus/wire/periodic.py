"""Periodic messages, sent by the wire's clock as the kernel's broadcast manager sends them.

The rule of this file: the n-th sending is at an exact multiple of the period on the bus's clock,
whatever anybody computes meanwhile.
"""

from collections.abc import Callable, Sequence
from typing import Final

import can
from can.broadcastmanager import LimitedDurationCyclicSendTaskABC, ModifiableCyclicTaskABC, RestartableCyclicTaskABC

from virtual_bus.kernel import NEVER, TIMER, Kernel

Modifier = Callable[[can.Message], None]
Send = Callable[[can.Message], None]
SYNC: Final = 0x080


class PeriodicTask(LimitedDurationCyclicSendTaskABC, ModifiableCyclicTaskABC, RestartableCyclicTaskABC):
    """Sends its messages in turn, one each period, from the next multiple of the period on."""

    def __init__(
        self,
        kernel: Kernel,
        send: Send,
        messages: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None,
        modifier: Modifier | None,
        touched: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(messages, period, duration)
        if self.period_ns <= 0:
            raise ValueError(f"a period of {period!r} s is none; give more than a nanosecond")
        self._kernel = kernel
        self._send = send
        self._modifier = modifier
        self._touched = touched
        self.next_ns = NEVER
        """Bus time of the next transmission, ns; `NEVER` while the task is stopped."""
        self._stop_ns = NEVER
        self._turn = 0

    def start(self) -> None:
        """Begin at the next multiple of the period, now included; goes on where it runs already."""
        self._touched()
        if self.next_ns != NEVER:
            return
        now_ns = self._kernel.now_ns
        self._turn = 0
        self._stop_ns = NEVER if self.duration is None else now_ns + round(self.duration * 1e9)
        self.go_on(-(-now_ns // self.period_ns) * self.period_ns)

    def stop(self) -> None:
        """Stop sending; `start` begins again."""
        self._touched()
        self.next_ns = NEVER

    def modify_data(self, messages: Sequence[can.Message] | can.Message) -> None:
        """Change the data of the messages; identifiers stay."""
        self._touched()
        super().modify_data(messages)

    @property
    def sync(self) -> bool:
        """True if the task sends only SYNC without data, without end."""
        message, *more = self.messages
        return not more and self._modifier is None and self._stop_ns == NEVER and message.arbitration_id == SYNC \
            and not (message.is_extended_id or message.is_remote_frame or message.dlc or message.data)

    def go_on(self, until_ns: int) -> None:
        """Schedule the next transmission, also after compiled cycles took over the events of this task."""
        self.next_ns = until_ns if until_ns < self._stop_ns else NEVER
        if self.next_ns != NEVER:
            self._kernel.at(until_ns, TIMER, self._due)

    def _due(self) -> None:
        now_ns = self._kernel.now_ns
        if now_ns != self.next_ns:
            return  # stopped since
        message = self.messages[self._turn]
        self._turn = (self._turn + 1) % len(self.messages)
        if self._modifier is not None:
            self._modifier(message)
        self._send(message)
        self.go_on(now_ns + self.period_ns)
