"""What one bus cycle costs: SYNC, four answers, targets, and a tap that hears all six frames.

    python -m benchmarks.virtual_bus

Both sides do the same exchange in one thread of this process: the virtual bus with arbitration, exact bit times,
acknowledge and one shared clock; python-can's `virtual` interface with plain queues. The devices are the same
few lines on both. Times are the least of several repetitions, of this process's CPU.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import can

from eds.cia301 import Frame
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.wire.bits import frame_bits

SIZES = {1: 8, 2: 6, 3: 2, 4: 2}
LISTENS = {1: (0x183, 0x201), 2: (0x201,), 3: (), 4: ()}
CYCLES, REPETITIONS = 200, 60
TARGETS = can.Message(arbitration_id=0x201, is_extended_id=False, data=bytes(8))
SYNC = can.Message(arbitration_id=0x080, is_extended_id=False)


class Answering:
    """A device that answers SYNC with a counting TPDO."""

    def __init__(self, node_id: int) -> None:
        self.node_id = node_id
        self.filters = frozenset({0x080, *LISTENS[node_id]})
        self.outbox: deque[Frame] = deque()
        self._cob_id, self._size, self._count = 0x180 + node_id, SIZES[node_id], 0

    def receive(self, frame: Frame, now_ns: int) -> None:
        if frame.can_id == 0x080:
            self._count += 7919
            self.outbox.append(Frame(self._cob_id, self._count.to_bytes(8, "little")[: self._size]))

    def power_on(self, now_ns: int) -> None: ...

    def poll(self, now_ns: int) -> None: ...

    def next_ns(self) -> int | None:
        return None

    def bus_off(self, now_ns: int) -> None: ...

    def bus_recovered(self, now_ns: int) -> None: ...


def ours() -> tuple[Callable[[], None], Callable[[], None]]:
    """Return a cycle on the virtual bus, and what closes it."""
    bus = BowdenBus("benchmark", bench=Bench([Answering(n) for n in SIZES]))
    tap = BowdenBus("benchmark")
    bus.send_periodic(SYNC, 0.001)

    def cycle() -> None:
        for _ in range(5):
            bus.recv(0.01)
        bus.send(TARGETS)
        while tap.recv(0) is not None:
            pass

    return cycle, lambda: (bus.shutdown(), tap.shutdown(), None)[-1]


def theirs() -> tuple[Callable[[], None], Callable[[], None]]:
    """Return the same exchange on python-can's `virtual` interface."""
    bus, tap = (can.Bus(interface="virtual", channel="benchmark") for _ in range(2))
    ends = {n: can.Bus(interface="virtual", channel="benchmark") for n in SIZES}
    devices = {n: Answering(n) for n in SIZES}

    def serve() -> None:
        for node_id, end in ends.items():
            device = devices[node_id]
            while (message := end.recv(0)) is not None:
                if message.arbitration_id in device.filters:
                    device.receive(Frame(message.arbitration_id, bytes(message.data)), 0)
            while device.outbox:
                frame = device.outbox.popleft()
                end.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))

    def cycle() -> None:
        bus.send(SYNC)
        serve()
        for _ in range(4):
            bus.recv(0)
        bus.send(TARGETS)
        while tap.recv(0) is not None:
            pass

    return cycle, lambda: [each.shutdown() for each in (bus, tap, *ends.values())] and None


def least_us(cycle: Callable[[], None], cycles: int) -> float:
    """Return the CPU time of one cycle, µs."""
    began = time.process_time_ns()
    for _ in range(cycles):
        cycle()
    return (time.process_time_ns() - began) / cycles / 1e3


def main() -> None:
    """Print both, and their ratio."""
    frame_bits(Frame(0))
    (our_cycle, our_end), (their_cycle, their_end) = ours(), theirs()
    mine = [(least_us(our_cycle, CYCLES), least_us(their_cycle, CYCLES)) for _ in range(REPETITIONS)]
    our_end()
    their_end()
    us, peer = (min(column) for column in zip(*mine, strict=True))
    frame = Frame(0x181, bytes(range(8)))
    bits = min(least_us(lambda: frame_bits(frame), 2_000) for _ in range(REPETITIONS))
    print(f"virtual bus            {us:7.1f} µs a cycle, with arbitration, exact bits and time")
    print(f"python-can's virtual   {peer:7.1f} µs a cycle, without")
    print(f"ratio                  {peer / us:7.1f}")
    print(f"bits of one frame      {bits:7.2f} µs")


if __name__ == "__main__":
    main()
