"""The master's records: every frame of the bus, one row a cycle, and events.

The recorder receives every frame by a monitor socket that is drained in every cycle. The monitor socket is a second,
unfiltered bus, or the master's bus if that hands over blocks of all received frames. A recorder that fails stops the
trial.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import can

from master.cycle.safety import Condition, StopError
from master.network.controller_errors import ControllerErrors
from master.network.link import LinkError, stamp_ns
from trial.mcap_file.cdr import ERROR, EXTENDED, REMOTE
from trial.record import RecordingError

_FAILURES = (RecordingError, OSError)


class CycleSink(Protocol):
    """Interface of `trial.record.Recorder` that the master uses."""

    def frame(
        self, time_ns: int, can_id: int, data: bytes, flags: int = 0, channel: int = 0, sent: bool = False
    ) -> None: ...

    def frames(self, rows: Any, count: int, last_ns: int) -> None: ...

    def cycle(self, time_ns: int, values: Sequence[float]) -> None: ...

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None: ...


Row = tuple[int, int, bytes, int, bool]
"""A frame for the recorder: time stamp, ns, identifier, data (zeros for a remote frame), flags, sent from here."""


def _rows(tap: can.BusABC | None) -> Iterator[Row]:
    """Receive every waiting frame of a bus that delivers no blocks."""
    while tap is not None and (message := tap.recv(0)) is not None:
        flags, data = 0, bytes(message.data)
        if message.is_remote_frame or message.is_extended_id or message.is_error_frame:
            flags = REMOTE * message.is_remote_frame | EXTENDED * message.is_extended_id
            flags |= ERROR * message.is_error_frame
            data = bytes(message.dlc) if message.is_remote_frame else data
        yield stamp_ns(message), message.arbitration_id, data, flags, not message.is_rx


class Log:
    """The recorder and its monitor socket; both may be absent.

    `target_stamp_ns` is when the last frame `targets_cob_id` was on the bus, −1 before any.  After the recorder
    has failed, which raises `StopError` once unless `quiet`, frames are still drained and nothing is recorded.
    """

    def __init__(self, tap: can.BusABC | None, recorder: CycleSink | None, targets_cob_id: int) -> None:
        self._tap = tap
        self._recorder = recorder
        self._targets_cob_id = targets_cob_id
        self.tap, self.taps = tap, tap is not None
        self._block: Callable[[int], tuple[Any, int, int, int]] | None = getattr(tap, "block", None)
        self.target_stamp_ns = -1
        self.quiet = False

    def drain(self) -> None:
        """Record every frame that waits at the monitor socket; raises `StopError` or `LinkError`."""
        if not self.taps:
            return
        recorder, targets = self._recorder, self._targets_cob_id
        try:
            if self._block is not None:
                rows, count, last_ns, target_ns = self._block(targets)
                if count:
                    self.take(rows, count, last_ns, target_ns if target_ns >= 0 else self.target_stamp_ns)
                return
            for time_ns, can_id, data, flags, sent in _rows(self._tap):
                if can_id == targets:
                    self.target_stamp_ns = time_ns
                if recorder is not None:
                    recorder.frame(time_ns, can_id, data, flags, 0, sent)
        except can.CanError as error:
            raise LinkError(f"the recorder's tap failed: {error}") from error
        except _FAILURES as error:
            self._give_up(error)

    def take(self, rows: Any, count: int, last_ns: int, target_stamp_ns: int) -> None:
        """Record frames up to `last_ns`, bytes of `cdr.FRAME_ROW`s, the last targets among them; raises `StopError`."""
        self.target_stamp_ns = target_stamp_ns
        self._tell("frames", rows, count, last_ns)

    def controller(self, errors: ControllerErrors) -> None:
        """Record the waiting events of the CAN controller; raises `StopError`."""
        while errors.events:
            time_ns, text = errors.events.popleft()
            self.event(time_ns, "bus", "master", f"{text}.")

    def tell_reception(self, time_ns: int) -> None:
        """Record how many frames the monitor socket's full receive queue lost, and whose time stamps they have."""
        lost = getattr(self._tap, "lost", 0)
        if lost:
            self.event(time_ns, "lost", "recorder", f"{lost} frames found the recorder's receive queue full.")
        if (stamps := getattr(self._tap, "stamps", None)) is not None:
            self.event(time_ns, "host", "recorder", f"{stamps}.")

    def row(self, time_ns: int, values: Sequence[float]) -> None:
        """Record one control cycle, in the order of `trial.signals.SIGNALS`; raises `StopError`."""
        self._tell("cycle", time_ns, values)

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None:
        """Record an event: kind, source and one sentence; raises `StopError`."""
        self._tell("event", time_ns, kind, source, text)

    def _tell(self, what: str, *values: Any) -> None:
        """Call a method of the recorder, if there is one that has not failed."""
        if self._recorder is not None:
            try:
                getattr(self._recorder, what)(*values)
            except _FAILURES as error:
                self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        self._recorder = None
        if not self.quiet:
            raise StopError(Condition.RECORDING, str(error)) from error
