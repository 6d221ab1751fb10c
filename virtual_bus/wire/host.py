"""The computer on the wire: one CAN controller, any number of sockets, as SocketCAN has it.

A socket receives every frame that its filters match, from the wire and from other sockets of this computer. It
receives its own frames only on request.
"""

import struct
from collections import deque
from typing import Final

import can
from can.typechecking import CanFilters

from eds.cia301 import Frame
from eds.error_frames import (
    ACTIVE_STATE,
    BUS_ERROR,
    BUS_OFF,
    CONTROLLER,
    COUNTERS,
    CRC_SEQUENCE,
    NO_ACKNOWLEDGE,
    PASSIVE_STATE,
    PROTOCOL,
    RESTARTED,
    TRANSMITTING,
)
from virtual_bus.wire.station import EXTENDED, Confinement, ErrorKind, Station

ERROR_CLASS: Final = {ErrorKind.BIT: BUS_ERROR | PROTOCOL, ErrorKind.CRC: BUS_ERROR | PROTOCOL,
                      ErrorKind.ACKNOWLEDGE: NO_ACKNOWLEDGE}
STATE_BITS: Final = {Confinement.ACTIVE: ACTIVE_STATE, Confinement.PASSIVE: PASSIVE_STATE}
_ERROR_DATA: Final = struct.Struct("6B2B")


class BowdenMessage(can.Message):
    """A message with its exact time in ns; sockets share it, so copy it before changing it."""

    __slots__ = ("time_ns",)
    time_ns: int


def message_of(frame: Frame, time_ns: int, received: bool, channel: str) -> BowdenMessage:
    """Return `frame` as a message; `received` is True for a frame from the wire, False for one of this computer."""
    message = BowdenMessage.__new__(BowdenMessage)
    can_id, data, remote, extended, error, dlc = frame
    message.time_ns = time_ns
    message.timestamp = time_ns / 1e9
    message.arbitration_id = can_id
    message.data = bytearray(data)
    message.dlc = len(data) if dlc is None else dlc
    message.is_extended_id = extended
    message.is_remote_frame = remote
    message.is_error_frame = error
    message.is_rx = received
    message.channel = channel
    message.is_fd = message.bitrate_switch = message.error_state_indicator = False
    return message


class Socket:
    """Receive queue of one program on the bus, with its filters; `lost` counts messages that came while it was full."""

    __slots__ = ("filters", "limit", "lost", "own", "queue")

    def __init__(self, *, own: bool, limit: int) -> None:
        self.queue: deque[BowdenMessage] = deque()
        self.own = own
        self.limit = limit
        self.lost = 0
        self.filters: CanFilters | None = None

    def accepts(self, route: int) -> bool:
        """Return whether one of its filters matches; no filters match everything."""
        if not self.filters:
            return True
        can_id, extended = route & ~EXTENDED, bool(route & EXTENDED)
        return any(
            (rule["can_id"] ^ can_id) & rule["can_mask"] == 0 and rule.get("extended", extended) == extended
            for rule in self.filters
        )


class Host(Station):
    """The computer's controller; frames of its sockets are transmitted in the order of sending."""

    def __init__(self, channel: str, node: int, *, limit: int, restart_ns: int) -> None:
        super().__init__("host", self.receive, node=node, limit=limit, fifo=True, restart_ns=restart_ns)
        self.channel = channel
        self.sockets: list[Socket] = []
        self._matching: dict[int, tuple[Socket, ...]] = {}

    def rematch(self) -> None:
        """Clear the routes; call it when sockets or their filters have changed."""
        self._matching.clear()

    def receive(self, frame: Frame, now_ns: int, received: bool = True, origin: object = None) -> None:
        """Pass a frame to every socket whose filter accepts it, except to the socket of its origin."""
        route = frame.can_id | EXTENDED if frame.extended else frame.can_id
        sockets = self._matching.get(route)
        if sockets is None:
            sockets = self._matching[route] = tuple(socket for socket in self.sockets if socket.accepts(route))
        if not sockets:
            return
        message = message_of(frame, now_ns, received, self.channel)
        for socket in sockets:
            if socket is not origin or socket.own:
                queue = socket.queue
                if len(queue) < socket.limit:
                    queue.append(message)
                else:
                    socket.lost += 1

    def sent(self, frame: Frame, origin: object, now_ns: int) -> None:
        """Pass an own frame, once it is on the wire, to the other sockets, and to its sender on request."""
        self.receive(frame, now_ns, False, origin)

    def errs(self, kind: ErrorKind, sending: bool, now_ns: int) -> None:
        """Report an error frame seen on the wire."""
        where = CRC_SEQUENCE if kind is ErrorKind.CRC else 0
        self._report(ERROR_CLASS[kind], now_ns, kind=TRANSMITTING if sending else 0, where=where)

    def confined(self, previous: Confinement, now_ns: int) -> None:
        """Report that the controller's state has changed."""
        if self.state is Confinement.BUS_OFF:
            self._report(BUS_OFF, now_ns)
        else:
            error = RESTARTED if previous is Confinement.BUS_OFF else CONTROLLER
            self._report(error, now_ns, controller=STATE_BITS[self.state])

    def _report(self, error: int, now_ns: int, *, controller: int = 0, kind: int = 0, where: int = 0) -> None:
        counters = min(self.tec, 255), min(self.rec, 255)
        data = _ERROR_DATA.pack(0, controller, kind, where, 0, 0, *counters)
        message = message_of(Frame(error | COUNTERS, data, error=True), now_ns, True, self.channel)
        for socket in self.sockets:
            if len(socket.queue) < socket.limit:
                socket.queue.append(message)
            else:
                socket.lost += 1


class Room:
    """Number of free places in a station's transmit queue, as the length of a buffer that `Kernel.run` can wait for."""

    def __init__(self, station: Station) -> None:
        self._station = station

    def __len__(self) -> int:
        return max(0, self._station.limit - self._station.waiting)


def frame_of(message: can.Message) -> Frame:
    """Return a message as a frame; raises `can.CanError` for one that a classical bus cannot carry."""
    largest = 0x1FFFFFFF if message.is_extended_id else 0x7FF
    if not 0 <= message.arbitration_id <= largest:
        raise can.CanOperationError(f"identifier {message.arbitration_id:#x} is outside 0 … {largest:#x}")
    if message.is_fd or message.is_error_frame or len(message.data) > 8:
        raise can.CanOperationError("only classical data and remote frames of up to 8 bytes can be sent")
    data = b"" if message.is_remote_frame else bytes(message.data)
    dlc = None if message.dlc == len(data) else message.dlc
    return Frame(message.arbitration_id, data, message.is_remote_frame, message.is_extended_id, False, dlc)
