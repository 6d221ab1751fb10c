"""The safety monitor as a CANopen node: it receives heartbeats alone, and sends its own, its cause and its digest.

The node has no object dictionary, no SDO server and no NMT slave: no frame changes it. It is a device for a simulated
bus and for a program on a real one alike; the sensors and the enable line are handed in.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final

from eds.cia301 import EMCY_BASE, HEARTBEAT_BASE, TPDO_BASE, Frame, NmtState
from safety_monitor.checks import MS, STEP_NS, MonitorState, PathInputs, step
from safety_monitor.person import Bounds

BEAT_NS: Final = 100 * MS
"""Period of the monitor's heartbeat; CiA 301, 7.2.8.2.2."""
REPORT_NS: Final = 1000 * MS
"""Period of the digest's frame while no drive is OPERATIONAL (it would delay the inputs of a control cycle), and of the
EMCY after the line has opened, so that a late listener has it."""
DIGEST_BYTES: Final = 8
PENDING: Final = 64
"""Heartbeats kept between two steps; more come in 1 ms only from a babbler, and the newest count."""

Sensors = Callable[[int], Sequence[PathInputs]]
Line = Callable[[bool], None]


class MonitorNode:
    """The monitor on a bus. `sensors` returns the monitor's own inputs at a time, ns; `line` opens or closes STO.

    `state` is read-only for everybody else. Until `power_on` the line is open.
    """

    def __init__(self, node_id: int, bounds: Bounds, master: int, drives: Sequence[int], sensors: Sensors, line: Line
                 ) -> None:
        self.node_id, self.bounds, self.state = node_id, bounds, MonitorState()
        self.outbox: deque[Frame] = deque()
        self.filters = frozenset(HEARTBEAT_BASE + node for node in (master, *drives))
        self._master, self._drives = master, tuple(drives)
        self._sensors, self._line = sensors, line
        self._frames: deque[Frame] = deque(maxlen=PENDING)
        self._step_ns: int | None = None
        self._beat_ns = self._report_ns = 0

    def power_on(self, now_ns: int) -> None:
        """Begin with an empty memory, close the line and send the boot-up message."""
        self.state = MonitorState()
        self._frames.clear()
        self._step_ns, self._beat_ns, self._report_ns = now_ns + STEP_NS, now_ns + BEAT_NS, now_ns + BEAT_NS
        self._line(True)
        self.outbox.append(Frame(HEARTBEAT_BASE + self.node_id, bytes([NmtState.INITIALISING])))

    def power_off(self) -> None:
        """Open the line: a monitor without supply holds no relay."""
        self._step_ns = None
        self._line(False)

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Keep a heartbeat for the next step."""
        del now_ns
        if frame.can_id in self.filters:
            self._frames.append(frame)

    def poll(self, now_ns: int) -> None:
        """Make the step that is due, open the line if it breaks a bound, and send what is due."""
        if self._step_ns is None or now_ns < self._step_ns:
            return
        before, sensed = self.state, self._sensors(now_ns)
        self.state = step(before, self.bounds, self._master, self._drives, now_ns, self._frames, sensed)
        self._frames.clear()
        self._step_ns = now_ns + STEP_NS
        if before.enabled and not self.state.enabled:
            self._line(False)
            self._report_ns = now_ns
        self._send(now_ns)

    def next_ns(self) -> int | None:
        """Return the time of the next step; None without supply."""
        return self._step_ns

    def bus_off(self, now_ns: int) -> None:
        """Do nothing: the checks need no bus, and heartbeats that are missing open the line."""

    bus_recovered = bus_off

    def _send(self, now_ns: int) -> None:
        if now_ns >= self._beat_ns:
            self._beat_ns += BEAT_NS
            beat = NmtState.OPERATIONAL if self.state.enabled else NmtState.STOPPED
            self.outbox.append(Frame(HEARTBEAT_BASE + self.node_id, bytes([beat])))
        if now_ns < self._report_ns:
            return
        self._report_ns = now_ns + REPORT_NS
        cause = self.state.cause
        digest = bytes.fromhex(self.bounds.sha256)[:DIGEST_BYTES]
        if cause is None and self.state.working_ns < 0:
            self.outbox.append(Frame(TPDO_BASE + self.node_id, digest))
        elif cause is not None:
            self.outbox.append(Frame(EMCY_BASE + self.node_id, int(cause).to_bytes(2, "little")
                                     + bytes([cause.register]) + digest[:5]))
