"""What the drives' and sensors' tests hold against a device: its bus, its ticks, and a mass on a rope to move.

The rule of this file: a test sees frames, as a master does; only the plant's own motion is looked at from behind.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable

import nodes
from eds.bench.bench_network import KNEE, SERVO, Network, WireLayout, wire
from eds.cia301 import Frame, NmtCommand
from eds.cia402 import State, next_controlword, state_of
from eds.dictionary import key
from nodes import Drive

MS = 1_000_000
TICK_NS = 250_000
WIRE: WireLayout = wire(Network())


class AbortedError(Exception):
    """The device refused; `code` says why."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:08X}")
        self.code = code


class Mass:
    """A pure inertia, kg at the rope or kg·m² at the knee, that a rope may pull back.

    `stiffness` N/m acts beyond `slack`; `arm` turns torque into force (1 for the knee); steps of 25 µs.
    """

    def __init__(self, inertia: float, arm: float, stiffness: float = 0.0, slack: float = 0.0) -> None:
        self.inertia, self.arm, self.stiffness, self.slack = inertia, arm, stiffness, slack
        self.position = self.velocity = 0.0
        self.load = 0.0

    @property
    def tension(self) -> float:
        return self.stiffness * max(0.0, self.position - self.slack)

    def step(self, torque: float, for_ns: int) -> None:
        for _ in range(for_ns // 25_000):
            force = torque / self.arm - self.tension - self.load
            self.velocity += 25e-6 * force / self.inertia
            self.position += 25e-6 * self.velocity


def servo_mass(stiffness: float = 0.0, slack: float = 0.0) -> Mass:
    return Mass(2.5, 0.02, stiffness, slack)


def knee_mass() -> Mass:
    return Mass(0.04, 1.0)


class NodeBus:
    """One device of the bench and the time it lives in; `sent` holds its frames with their times."""

    def __init__(self, node_id: int, on: bool = True, wire: WireLayout = WIRE) -> None:
        self.node_id, self.wire = node_id, wire
        self.device, self.application = nodes.build(node_id, wire)
        self.entries = wire.nodes[node_id].dictionary.entries
        self.now_ns = 0
        self.sent: list[tuple[int, Frame]] = []
        if on:
            self.device.power_on(0)
            self.settle()

    def settle(self) -> None:
        """Collect what the device sends, and run what it has due now."""
        for _ in range(1000):
            while self.device.outbox:
                self.sent.append((self.now_ns, self.device.outbox.popleft()))
            due_ns = self.device.next_ns()
            if due_ns is None or due_ns > self.now_ns:
                return
            self.device.poll(self.now_ns)
        raise AssertionError("the device is never done")

    def send(self, can_id: int, data: bytes = b"") -> list[Frame]:
        """Put a frame on the bus; return the answers."""
        before = len(self.sent)
        self.device.receive(Frame(can_id, data), self.now_ns)
        self.settle()
        return [frame for _at, frame in self.sent[before:]]

    def nmt(self, command: NmtCommand) -> None:
        self.send(0, bytes((command, self.node_id)))

    def sync(self) -> list[Frame]:
        return self.send(0x80)

    def emergencies(self) -> list[int]:
        """Give the EMCY codes sent so far, and forget them."""
        codes = [struct.unpack_from("<H", f.data)[0] for _at, f in self.sent if f.can_id == 0x80 + self.node_id]
        self.sent = [(at, f) for at, f in self.sent if f.can_id != 0x80 + self.node_id]
        return codes

    def _request(self, data: bytes) -> bytes:
        answers = [f.data for f in self.send(0x600 + self.node_id, data) if f.can_id == 0x580 + self.node_id]
        assert len(answers) == 1
        if answers[0][0] == 0x80:
            raise AbortedError(int.from_bytes(answers[0][4:], "little"))
        return answers[0]

    def write(self, index: int, subindex: int, value: float) -> None:
        code = self.entries[key(index, subindex)].data_type.code
        data = struct.pack("<" + code, value)
        head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex)
        self._request(head + data.ljust(4, b"\0"))

    def read(self, index: int, subindex: int = 0) -> float:
        answer = self._request(struct.pack("<BHB4x", 0x40, index, subindex))
        size = 4 - (answer[0] >> 2 & 3)
        return struct.unpack("<" + self.entries[key(index, subindex)].data_type.code, answer[4:4 + size])[0]

    def refused(self, index: int, subindex: int, value: float) -> int:
        try:
            self.write(index, subindex, value)
        except AbortedError as aborted:
            return aborted.code
        raise AssertionError(f"{index:04X}:{subindex:02X} took {value!r}")

    def setup(self, but: Iterable[tuple[int, int]] = ()) -> None:
        """Configure the device as the bench's bring-up does, and start it; `but` leaves writes out."""
        left_out = set(but)
        for index, subindex, value in self.wire.setup(self.node_id):
            if (index, subindex) not in left_out:
                self.write(index, subindex, value)
        self.nmt(NmtCommand.START)


class DriveRig(NodeBus):
    """A drive that moves a mass; `tension` is what START says of it to the servo, every millisecond."""

    application: Drive

    def __init__(self, node_id: int, plant: Mass | None = None, on: bool = True) -> None:
        super().__init__(node_id, on)
        assert isinstance(self.application, Drive)
        self.plant = plant or (servo_mass() if node_id == SERVO else knee_mass())
        self.torque = 0.0
        self.torques: list[float] = []
        self.word = 0
        self.target: int | None = None
        self.feeds_tension = node_id == SERVO
        self.master_lives = True
        self.velocity_share = 1.0

    # ---- time ----

    def run(self, for_ms: float) -> None:
        """Let time pass: drive ticks and plant every 250 µs, START, SYNC and heartbeats as the bench sends them."""
        for _ in range(round(for_ms * MS / TICK_NS)):
            self.plant.step(self.torque, TICK_NS)
            self.now_ns += TICK_NS
            self.torque = self.application.tick(
                self.now_ns, self.plant.position, self.velocity_share * self.plant.velocity)
            self.torques.append(self.torque)
            self.settle()
            if self.now_ns % MS == 0:
                self._cycle()

    def _cycle(self) -> None:
        self.sync()
        if self.master_lives:
            if self.now_ns % (100 * MS) == 0:
                self.send(0x77F, b"\x05")
            if self.target is not None:
                pad = struct.pack("<ii", *((self.target, 0) if self.node_id == SERVO else (0, self.target)))
                self.send(0x201, pad)
        if self.feeds_tension:
            self.send(0x183, struct.pack("<h", round(100 * self.plant.tension)))

    # ---- what a master does ----

    def control(self, word: int) -> None:
        """Write the controlword by SDO."""
        self.word = word
        self.write(0x6040, 0, word)

    def statusword(self) -> int:
        return int(self.read(0x6041))

    def state(self) -> State | None:
        return state_of(self.statusword())

    def to(self, goal: State, within_ms: int = 500) -> None:
        """Command the drive into a state by controlwords, as a master does."""
        for _ in range(within_ms):
            state = self.state()
            assert state is not None
            if state is goal:
                return
            word = next_controlword(state, goal)
            if word & 0x80:
                self.control(0x0000)
            self.control(word)
            self.run(1)
        raise AssertionError(f"{self.state()} instead of {goal}")

    def enabled(self) -> DriveRig:
        """Bring the drive up as the bench does, enabled in CSP, with START and the master alive."""
        self.setup()
        self.run(5)
        self.to(State.OPERATION_ENABLED)
        return self


def lag_of(positions: list[float], targets: list[float], dt_s: float, frequency_hz: float) -> tuple[float, float]:
    """Return gain and phase, rad, of `positions` over `targets` at a frequency, by correlation over whole periods."""
    def phasor(values: list[float]) -> complex:
        return sum(v * complex(math.cos(w), -math.sin(w))
                   for n, v in enumerate(values) if (w := 2 * math.pi * frequency_hz * n * dt_s) is not None)

    ratio = phasor(positions) / phasor(targets)
    return abs(ratio), math.atan2(ratio.imag, ratio.real)


__all__ = ["KNEE", "MS", "SERVO", "AbortedError", "DriveRig", "Mass", "NodeBus", "lag_of", "servo_mass"]
