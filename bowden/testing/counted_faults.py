"""Faults of single frames, by COB-ID and count: what `can_bus.faults` offers.

The rule of this file: a fault acts on the frames it names, in their order on the wire, and on no other; chance has
no part in it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from eds.cia301 import Frame
from parameters import InputError
from virtual_bus.kernel import NEVER
from virtual_bus.wire.faults import ANY, COPY
from virtual_bus.wire.station import ErrorKind, Station, Waiting

BITS = 64
"""Number of bits in the longest payload: `corrupt` flips one of them."""
NUMBERS = {"drop": None, "delay": "ms", "corrupt": "bit", "duplicate": None, "shorten": "size"}
"""Kinds of faults that a text can state, each with the key whose number it needs; None: it needs no number."""


@dataclass
class CountedFault:
    """One fault of `can_bus.faults`; `struck_ns` lists the times at which it acted."""

    kind: str
    cob_id: int
    node_id: int
    count: int | None
    after: int
    when: Callable[[bytes], bool] | None
    number: int = 0
    struck_ns: list[int] = field(default_factory=list)

    @property
    def struck(self) -> int:
        """Number of frames that this fault has changed or dropped."""
        return len(self.struck_ns)

    @property
    def done(self) -> bool:
        """True once the fault has changed or dropped its declared number of frames."""
        return self.count is not None and self.struck >= self.count

    def stop(self) -> None:
        """Disable the fault."""
        self.count = self.struck

    def strikes(self, station: Station, frame: Frame, now_ns: int) -> bool:
        """Return whether the fault applies to this frame, and count the frame."""
        if self.done or self.cob_id not in (ANY, frame.can_id) or self.node_id not in (ANY, station.node):
            return False
        if self.when is not None and not self.when(frame.data):
            return False
        if self.after > 0:
            self.after -= 1
            return False
        self.struck_ns.append(now_ns)
        return True


class CountedFaults:
    """Faults of the wire; each method adds one and returns it.

    `cob_id` and `node_id` (of the transmitter) choose the frames, None for all; `when(data)` chooses by payload. The
    first `after` of these frames pass, the next `count` are hit (None: all further ones).
    """

    def __init__(self) -> None:
        self.all: list[CountedFault] = []

    def drop(self, cob_id: int | None = None, count: int | None = 1, *, after: int = 0, node_id: int | None = None,
             when: Callable[[bytes], bool] | None = None) -> CountedFault:
        """Drop frames: each is acknowledged on the wire and delivered to no station."""
        return self._add("drop", cob_id, count, after, node_id, when)

    def delay(self, cob_id: int | None = None, count: int | None = 1, *, delay_ns: int, after: int = 0,
              node_id: int | None = None, when: Callable[[bytes], bool] | None = None) -> CountedFault:
        """Delay frames: each takes part in arbitration `delay_ns` later."""
        if delay_ns < 0:
            raise InputError(f"faults.delay: delay_ns = {delay_ns} is negative; give 0 or more nanoseconds.")
        return self._add("delay", cob_id, count, after, node_id, when, delay_ns)

    def corrupt(self, cob_id: int | None = None, count: int | None = 1, *, bit: int = 0, after: int = 0,
                node_id: int | None = None, when: Callable[[bytes], bool] | None = None) -> CountedFault:
        """Flip bit `bit` of the payload (0 is the lowest bit of the first byte); the CRC agrees with it."""
        if not 0 <= bit < BITS:
            raise InputError(f"faults.corrupt: bit = {bit} is outside 0 … {BITS - 1}; give a bit of the payload.")
        return self._add("corrupt", cob_id, count, after, node_id, when, bit)

    def duplicate(self, cob_id: int | None = None, count: int | None = 1, *, after: int = 0,
                  node_id: int | None = None, when: Callable[[bytes], bool] | None = None) -> CountedFault:
        """Duplicate frames: each is sent a second time."""
        return self._add("duplicate", cob_id, count, after, node_id, when)

    def shorten(self, cob_id: int | None = None, count: int | None = 1, *, size: int, after: int = 0,
                node_id: int | None = None, when: Callable[[bytes], bool] | None = None) -> CountedFault:
        """Shorten frames: only the first `size` bytes of the payload are delivered."""
        if not 0 <= size <= 8:
            raise InputError(f"faults.shorten: size = {size} is outside 0 … 8; give a number of bytes.")
        return self._add("shorten", cob_id, count, after, node_id, when, size)

    def disturb(self, cob_id: int | None = None, count: int | None = 1, *, after: int = 0,
                node_id: int | None = None, when: Callable[[bytes], bool] | None = None) -> CountedFault:
        """Disturb frames: an error frame ends each, and its transmitter repeats it."""
        return self._add("disturb", cob_id, count, after, node_id, when)

    def add(self, kind: str, text: str) -> CountedFault:
        """Add the fault `kind` from a text such as "185,count=2,after=10,ms=5", beginning with the COB-ID.

        Raises ValueError or KeyError for another text; `NUMBERS` names the number that a kind needs.
        """
        cob_id, *more = text.split(",")
        numbers = {key: int(value) for key, _, value in (one.partition("=") for one in more)}
        count, after, needed = numbers.pop("count", None), numbers.pop("after", 0), NUMBERS[kind]
        if set(numbers) != ({needed} if needed else set()):
            raise ValueError(text)
        if needed == "ms":
            numbers = {"delay_ns": numbers["ms"] * 1_000_000}
        added: CountedFault = getattr(self, kind)(int(cob_id, 16), count, after=after, **numbers)
        return added

    def clear(self) -> None:
        """Remove every fault."""
        for fault in self.all:
            fault.stop()

    def _add(self, kind: str, cob_id: int | None, count: int | None, after: int, node_id: int | None,
             when: Callable[[bytes], bool] | None, number: int = 0) -> CountedFault:
        if cob_id is not None and not 0 <= cob_id <= 0x7FF:
            raise InputError(f"faults.{kind}: cob_id = {cob_id:#x} is outside 0 … 0x7FF; give an 11-bit COB-ID.")
        if count is not None and count < 1:
            raise InputError(f"faults.{kind}: count = {count} hits no frame; give 1 or more, or None for all frames.")
        fault = CountedFault(kind, ANY if cob_id is None else cob_id, ANY if node_id is None else node_id, count,
                             after, when, number)
        self.all.append(fault)
        return fault

    # ---- what the wire asks: virtual_bus.wire.wire.FrameFaults ----

    def ready(self, station: Station, frame: Frame, ready_ns: int) -> int:
        """Return the time from which on the frame takes part in arbitration."""
        for fault in self.all:
            if fault.kind == "delay" and fault.strikes(station, frame, ready_ns):
                ready_ns += fault.number
        return ready_ns

    def heard(self, entry: Waiting, now_ns: int) -> Frame | ErrorKind | None:
        """Return the frame that receivers get, None where none does, or the error that ends it."""
        station, frame, origin = entry[2], entry[3], entry[4]
        heard: Frame | None = frame
        for fault in self.all:
            if fault.kind == "delay" or heard is None or (fault.kind == "duplicate" and origin is COPY):
                continue
            if not fault.strikes(station, frame, now_ns):
                continue
            if fault.kind == "disturb":
                return ErrorKind.CRC
            if fault.kind == "duplicate":
                station.submit(frame, now_ns, COPY)
            elif fault.kind == "drop":
                heard = None
            elif fault.kind == "shorten":
                heard = heard._replace(data=heard.data[:fault.number])
            else:
                heard = _flipped(heard, fault.number)
        return heard

    def quiet_until(self, now_ns: int) -> int:
        """Return the time up to which no fault can act."""
        return NEVER if all(fault.done for fault in self.all) else now_ns


def _flipped(frame: Frame, bit: int) -> Frame:
    data = bytearray(frame.data)
    if bit >> 3 < len(data):
        data[bit >> 3] ^= 1 << (bit & 7)
    return frame._replace(data=bytes(data))
