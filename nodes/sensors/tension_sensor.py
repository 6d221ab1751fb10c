"""A tension sensor (CiA 404, one analogue input): counts in, newtons out; a fault is sent as an EMCY.

The rule of this file: a value that cannot be trusted never looks like one that can; it is the least integer (NaN for
REAL32), with its status bit and an EMCY.
"""

import math
from types import MappingProxyType
from typing import Any, Final

from eds.cia301 import SIGNATURE_ZERO, Abort, Emcy
from eds.datatype import Value
from eds.dictionary import key
from nodes.core.application import Application, ProfileHost
from nodes.sensors import channel_law as law
from nodes.sensors.channel_law import (
    INTEGER16,
    INTEGER32,
    NEGATIVE_OVERLOAD,
    NOT_VALID,
    POSITIVE_OVERLOAD,
    integer,
    invalid,
    real32,
    two_point,
)

FIELD_REAL, FIELD = key(0x6100, 1), key(0x9100, 1)
OPERATING_MODE, SAMPLE_RATE = key(0x6112, 1), key(0x6114, 1)
FV_1, PV_1, FV_2, PV_2 = (key(index, 1) for index in range(0x6120, 0x6124))
OFFSET, AUTOZERO, FACTOR, SHIFT = key(0x6124, 1), key(0x6125, 1), key(0x6126, 1), key(0x6127, 1)
PROCESS_REAL, PROCESS_16, PROCESS_32 = key(0x6130, 1), key(0x7130, 1), key(0x9130, 1)
DECIMALS, STATUS, FILTER_TYPE, FILTER_CONSTANT = key(0x6132, 1), key(0x6150, 1), key(0x61A0, 1), key(0x61A1, 1)
SPAN_START, SPAN_END, SPAN_START_32, SPAN_END_32 = key(0x6148, 1), key(0x6149, 1), key(0x9148, 1), key(0x9149, 1)

OVERLOAD: Final = POSITIVE_OVERLOAD | NEGATIVE_OVERLOAD
ON: Final = 1
"""Value of 0x6112 of a measuring channel."""
_OTHER_END: Final = {FV_1: FV_2, FV_2: FV_1, PV_1: PV_2, PV_2: PV_1}
"""Coordinate of the other point of two-point scaling; two equal ones define no line."""
_LINKED: Final = {SPAN_START: SPAN_START_32, SPAN_END: SPAN_END_32}
_REALS: Final = frozenset((*_OTHER_END, OFFSET, *_LINKED))


class TensionSensor(Application):
    """CiA 404 sensor of one channel: `sample` is called every `interval_ns` with the converter's counts."""

    def attach(self, device: ProfileHost) -> None:
        """Register for the channel's settings."""
        super().attach(device)
        self.watched = frozenset(k for k, e in device.objects.entries.items() if k >= key(0x6000) and e.writable)
        self.unstored = frozenset({AUTOZERO})
        self._changed = False
        self.channel: Any = law.channel(1, False)
        self._verdict: int | None = None
        self._reported: set[Emcy] = set()
        self._take_spans()
        self._configure(restart=True)

    # ---- what the device core asks ----

    def check_write(self, key: int, value: Value) -> int:
        """Refuse settings without a valid line, span or zero."""
        number = value if not isinstance(value, bytes) else math.nan
        if key in _REALS and not math.isfinite(number):
            return Abort.INVALID_VALUE
        if key == AUTOZERO and number != SIGNATURE_ZERO:
            return Abort.INVALID_VALUE
        if key == AUTOZERO and self._status() & NOT_VALID:
            return Abort.DEVICE_STATE
        if key in _OTHER_END and number == self._real(_OTHER_END[key]):
            return Abort.INVALID_VALUE
        return self._check_span(key, number)

    def _check_span(self, at: int, number: float) -> int:
        start, end = self._real(SPAN_START), self._real(SPAN_END)
        scale = 1.0 if at in _LINKED else 10.0 ** -self._decimals
        if at in (SPAN_START, SPAN_START_32) and number * scale >= end:
            return Abort.MAX_BELOW_MIN
        if at in (SPAN_END, SPAN_END_32) and number * scale <= start:
            return Abort.MAX_BELOW_MIN
        return 0

    def written(self, key: int, value: Value, now_ns: int) -> None:
        """Apply a setting; a write to 0x6125 zeroes the present value."""
        if key == AUTOZERO:
            self.values[OFFSET] = real32(
                self._real(OFFSET) - float(self._mean * self.channel[law.FACTOR] + self.channel[law.SHIFT]))
        elif key in _LINKED.values():
            self._take_spans()
        elif key in _LINKED or key == DECIMALS:
            self._tell_spans()
        self._configure(key in (OPERATING_MODE, FILTER_TYPE, FILTER_CONSTANT))
        self.latch(now_ns)

    def reset(self, now_ns: int) -> None:
        """Reset to stored or default settings with an empty filter; a broken wire stays broken."""
        self._reported.clear()
        self._take_spans()
        self._configure(restart=True)
        self.latch(now_ns)

    def latch(self, now_ns: int) -> None:
        """Copy field value, process value and status into the objects."""
        law.process(self.channel)
        self.show_latched()

    refresh = latch

    def show_latched(self) -> None:
        """Copy the results of `law.process` into the objects."""
        values, channel = self.values, self.channel
        values[STATUS] = status = self._status()
        if status & NOT_VALID:
            values[PROCESS_16], values[PROCESS_32] = invalid(INTEGER16), invalid(INTEGER32)
            values[PROCESS_REAL] = math.nan
            return
        values[PROCESS_16], values[PROCESS_32] = int(channel[law.PROCESS_16]), int(channel[law.PROCESS_32])
        values[PROCESS_REAL] = real32(float(channel[law.TENSION]))
        values[FIELD_REAL] = mean = float(channel[law.FIELD])
        values[FIELD] = round(mean)

    def poll(self, now_ns: int) -> None:
        """Send a change of the status."""
        if self._changed:
            self._changed = False
            self.latch(now_ns)

    def next_ns(self) -> int | None:
        """Return the present time after a sample that changed the status, else None."""
        return self.device.now_ns if self._changed else None

    # ---- what the converter tells ----

    def sample(self, now_ns: int, counts: int, status: int = 0) -> None:
        """Take the converter's counts, −2²³ … 2²³ − 1, and its status: 0, or bits of 0x6150 (bit 0: wire broken)."""
        if not self._measuring:
            return
        if status & NOT_VALID:
            mean = self._mean
            law.restart(self.channel, *law.filter_settings(*self._kind))
            self.channel[law.MEAN] = mean
            self._judge(NOT_VALID, now_ns)
            return
        verdict = law.sample(self.channel, counts, status)
        if verdict != self._verdict:
            self._judge(verdict, now_ns)

    def _status(self) -> int:
        """Return 0x6150: not valid before the first sample, and while the channel is off."""
        return NOT_VALID if self._verdict is None else self._verdict

    def _judge(self, verdict: int, now_ns: int) -> None:
        """Process a new status: each fault sends one EMCY when it begins and one when it ends."""
        if verdict == self._verdict:
            return
        self._verdict = verdict
        self.channel[law.VERDICT] = verdict
        self._changed = True
        self.device.now_ns = now_ns
        self._tell(Emcy.SENSOR_BROKEN, bool(verdict & NOT_VALID))
        self._tell(Emcy.OVER_RANGE, bool(verdict & OVERLOAD))

    def _tell(self, trouble: Emcy, there: bool) -> None:
        if there and trouble not in self._reported:
            self._reported.add(trouble)
            self.device.emergency(trouble, trouble.register)
        elif not there and trouble in self._reported:
            self._reported.remove(trouble)
            self.device.recover(trouble)

    # ---- settings ----

    def _configure(self, restart: bool) -> None:
        """Take over all settings; `restart` begins a new filter, and the value is not valid until its first sample."""
        values = self.values
        line = two_point(*(self._real(at) for at in (FV_1, PV_1, FV_2, PV_2)))
        values[FACTOR], values[SHIFT] = map(real32, line)
        shift = line.offset + self._real(OFFSET)
        self._decimals = int(self._real(DECIMALS))
        channel = self.channel
        channel[law.FACTOR], channel[law.SHIFT], channel[law.COUNTS_PER_N] = line.factor, shift, 10.0 ** self._decimals
        channel[law.LOW], channel[law.HIGH] = sorted((self._real(at) - shift) / line.factor for at in _LINKED)
        channel[law.MIDDLE] = 0.5 * (self._real(SPAN_START) + self._real(SPAN_END))
        self._measuring = self._real(OPERATING_MODE) == ON
        self.interval_ns = int(self._real(SAMPLE_RATE)) * 1000
        if restart:
            self._kind = int(self._real(FILTER_TYPE)), int(self._real(FILTER_CONSTANT))
            law.restart(self.channel, *law.filter_settings(*self._kind))
            self._verdict = None
            if not self._measuring:
                self._tell(Emcy.SENSOR_BROKEN, False)
                self._tell(Emcy.OVER_RANGE, False)

    def _take_spans(self) -> None:
        """Copy 0x9148 and 0x9149 into 0x6148 and 0x6149."""
        for newton, counts in _LINKED.items():
            self.values[newton] = self._real(counts) / 10.0 ** self._real(DECIMALS)

    def _tell_spans(self) -> None:
        """Copy 0x6148 and 0x6149 into 0x9148 and 0x9149, in the present decimals."""
        for newton, counts in _LINKED.items():
            self.values[counts] = integer(self._real(newton) * 10.0 ** self._real(DECIMALS), INTEGER32)

    def _real(self, at: int) -> float:
        value = self.values.get(at, 0.0)
        return 0.0 if isinstance(value, bytes) else float(value)

    @property
    def _mean(self) -> float:
        return float(self.channel[law.MEAN])

    # ---- what a steady cycle needs ----

    steady_sources = MappingProxyType({PROCESS_16: law.PROCESS_16, PROCESS_32: law.PROCESS_32})
    """Objects that a TPDO may carry, each with its place in the channel's array."""

    @property
    def steady(self) -> bool:
        """Return whether only values change from sample to sample: measuring, value valid, status already reported."""
        return self._measuring and not self._changed and self._verdict in (0, POSITIVE_OVERLOAD, NEGATIVE_OVERLOAD)

    def adopt(self, channel: Any) -> None:
        """Move the channel's numbers into this memory."""
        channel[:] = self.channel
        self.channel = channel
