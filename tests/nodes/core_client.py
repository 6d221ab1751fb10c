"""Harness of the device core: the sans-IO device alone, and a client that builds SDO frames octet by octet.

The times of these tests are the device's own, so they use no wire; tests of whole devices use `bowden.testing`. Tests
see frames and times, as a master does; the device's attributes stay its own.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from pathlib import Path

from eds.cia301 import Abort, Frame, NmtCommand
from eds.dictionary import key
from nodes.core.device import Application, Device

EDS = Path(__file__).with_name("core_device.eds")
NODE = 5
MS = 1_000_000
SIZES = {"b": 1, "h": 2, "i": 4, "B": 1, "H": 2, "I": 4, "q": 8}


class Process(Application):
    """A process that counts at every latch, keeps what it was told, and refuses odd values of 0x6205."""

    watched = frozenset({key(0x6200), key(0x6202), key(0x6205), key(0x2006, 1)})

    def __init__(self) -> None:
        self.told: list[tuple] = []
        self.inputs: dict[int, int] = {}

    def attach(self, device: Device) -> None:
        self.device = device

    def check_write(self, at: int, value: object) -> int:
        return Abort.INVALID_VALUE if at == key(0x6205) and value % 2 else 0

    def written(self, at: int, value: object, now_ns: int) -> None:
        self.told.append(("written", at, value, now_ns))

    def latch(self, now_ns: int) -> None:
        values = self.device.values
        values.update(self.inputs)
        values[key(0x6001)] = values[key(0x6001)] + 1

    def refresh(self, now_ns: int) -> None:
        self.device.values.update(self.inputs)

    def nmt_changed(self, state: object, now_ns: int) -> None:
        self.told.append(("nmt", int(state)))

    def communication_lost(self, reason: object, now_ns: int) -> None:
        self.told.append(("lost", int(reason), now_ns))

    def reset(self, now_ns: int) -> None:
        self.told.append(("reset", now_ns))


class AbortedError(Exception):
    """The device aborted; `code` says why, `key` what it was about."""

    def __init__(self, code: int, at: int) -> None:
        super().__init__(f"{code:08X} about {at:06X}")
        self.code, self.key = code, at


class Bus:
    """One device and the time it lives in; `sent` are its frames since the last look, with their times."""

    def __init__(self, device: Device | None = None, *, store: Path | None = None, on: bool = True) -> None:
        self.process = Process()
        self.device = device or Device(EDS, NODE, self.process, store=store)
        self.now_ns = 0
        self.sent: list[tuple[int, Frame]] = []
        if on:
            self.device.power_on(0)
            self._collect()
            self.sent.clear()

    def send(self, can_id: int, data: bytes | str = b"", **flags: object) -> list[Frame]:
        """Put a frame on the bus; return what the device sends at once."""
        payload = bytes.fromhex(data) if isinstance(data, str) else data
        before = len(self.sent)
        self.device.receive(Frame(can_id, payload, **flags), self.now_ns)
        self._collect()
        self._run_due(self.now_ns)
        return [frame for _at, frame in self.sent[before:]]

    def run(self, for_ns: int) -> list[tuple[int, Frame]]:
        """Let time pass; return what the device sends meanwhile, with times relative to now."""
        start_ns, before = self.now_ns, len(self.sent)
        self._collect()
        self._run_due(start_ns + for_ns)
        self.now_ns = start_ns + for_ns
        return [(at - start_ns, frame) for at, frame in self.sent[before:]]

    def _run_due(self, until_ns: int) -> None:
        for _ in range(100_000):
            due_ns = self.device.next_ns()
            if due_ns is None or due_ns > until_ns:
                return
            self.now_ns = max(self.now_ns, due_ns)
            self.device.poll(self.now_ns)
            self._collect()
        raise AssertionError("the device is never done")

    def _collect(self) -> None:
        while self.device.outbox:
            self.sent.append((self.now_ns, self.device.outbox.popleft()))

    # ---- NMT, SYNC ----

    def nmt(self, command: NmtCommand, node_id: int = NODE) -> list[Frame]:
        return self.send(0, bytes((command, node_id)))

    def start(self) -> list[Frame]:
        return self.nmt(NmtCommand.START)

    def sync(self, counter: int | None = None) -> list[Frame]:
        return self.send(0x80, b"" if counter is None else bytes((counter,)))

    # ---- SDO ----

    def request(self, data: bytes | str) -> bytes | None:
        """Send one SDO frame; return the answer's 8 bytes, None for no answer; raise on an abort."""
        answers = [frame.data for frame in self.send(0x600 + NODE, data) if frame.can_id == 0x580 + NODE]
        if not answers:
            return None
        assert len(answers) == 1
        assert len(answers[0]) == 8
        return checked(answers[0])

    def read(self, index: int, subindex: int = 0, code: str = "") -> bytes | int:
        """Read by expedited or segmented upload; `code` is a struct letter."""
        answer = self.request(struct.pack("<BHB4x", 0x40, index, subindex))
        assert answer[1:4] == struct.pack("<HB", index, subindex)
        if answer[0] & 2:
            data = answer[4:8 - (answer[0] >> 2 & 3)]
        else:
            assert answer[0] == 0x41
            data, toggle = b"", 0
            while True:
                segment = self.request(bytes((0x60 | toggle,)) + bytes(7))
                assert segment[0] & 0xF0 == toggle
                data += segment[1:8 - (segment[0] >> 1 & 7)]
                if segment[0] & 1:
                    break
                toggle ^= 0x10
            assert len(data) == int.from_bytes(answer[4:], "little")
        return struct.unpack("<" + code, data)[0] if code else data

    def write(self, index: int, subindex: int, value: bytes | int, code: str = "") -> None:
        """Write by expedited download (up to 4 bytes) or segmented download."""
        data = struct.pack("<" + code, value) if code else value
        at = struct.pack("<HB", index, subindex)
        if 0 < len(data) <= 4:
            answer = self.request(bytes((0x23 | (4 - len(data)) << 2,)) + at + data.ljust(4, b"\0"))
            assert answer == b"\x60" + at + bytes(4)
            return
        assert self.request(b"\x21" + at + struct.pack("<I", len(data))) == b"\x60" + at + bytes(4)
        toggle = 0
        for first in range(0, len(data), 7) or (0,):
            part = data[first:first + 7]
            head = toggle | (7 - len(part)) << 1 | (first + 7 >= len(data))
            assert self.request(bytes((head,)) + part.ljust(7, b"\0")) == bytes((0x20 | toggle,)) + bytes(7)
            toggle ^= 0x10

    def refused(self, index: int, subindex: int, value: bytes | int, code: str = "") -> int:
        """Write, expect a refusal, return its abort code."""
        try:
            self.write(index, subindex, value, code)
        except AbortedError as aborted:
            return aborted.code
        raise AssertionError(f"{index:04X}:{subindex:02X} took {value!r}")

    def remap(self, index: int, words: list[int], cob_id: int | None = None, kind: int | None = None) -> None:
        """Map a PDO in the standard's order; `index` is 0x14xx or 0x18xx."""
        old = self.read(index, 1, "I")
        self.write(index, 1, old | 1 << 31, "I")
        self.write(index + 0x200, 0, 0, "B")
        for sub, word in enumerate(words, 1):
            self.write(index + 0x200, sub, word, "I")
        self.write(index + 0x200, 0, len(words), "B")
        if kind is not None:
            self.write(index, 2, kind, "B")
        self.write(index, 1, (old if cob_id is None else cob_id) & ~(1 << 31), "I")

    def alive(self) -> None:
        """The device answers, whatever happened before: after an abort frame a read works."""
        self.send(0x600 + NODE, bytes((0x80,)) + bytes(7))
        assert self.read(0x1000, 0, "I") == 0x000F0191


def checked(data: bytes) -> bytes:
    if data[0] == 0x80:
        _head, index, subindex, code = struct.unpack("<BHBI", data)
        raise AbortedError(code, key(index, subindex))
    return data


def crc(data: bytes) -> bytes:
    """The block transfer's CRC as it goes onto the wire."""
    return crc_hqx(data, 0).to_bytes(2, "little")
