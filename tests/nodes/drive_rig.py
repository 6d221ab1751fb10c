"""What the drives' and sensors' tests hold against a device: its bus, its ticks, and a mass on a rope to move.

The rule of this file: a test sees frames, as a master does; only the plant's own motion is looked at from behind.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable

import nodes
from bowden.testing import BusFrame, CanBus
from bowden.testing.canopen_node import DriveLoad
from eds.bench.bench_network import KNEE, SERVO, Network, WireLayout, wire
from eds.cia301 import NmtCommand
from eds.cia402 import State, next_controlword, state_of
from eds.dictionary import key
from nodes import Drive

MS = 1_000_000
TICK_NS = 250_000
ANSWER_S = 6e-4
"""Bus time for a frame and its answer behind the frames of a cycle: five of at most 0.13 ms."""
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
    """One device of the bench on the virtual bus of `bowden.testing`, and a master's station that speaks to it."""

    def __init__(self, node_id: int, wire: WireLayout = WIRE, mechanics: DriveLoad | None = None) -> None:
        self.node_id, self.wire = node_id, wire
        (declared,) = [device for device in wire.network.bench.devices if device.node_id == node_id]
        self.application = nodes.APPLICATIONS[declared.type.name]()
        self.bus = CanBus()
        self.node = self.bus.add_node(wire.nodes[node_id].dictionary, node_id, profile=self.application,
                                      mechanics=mechanics)
        self.device, self.entries = self.node.device, wire.nodes[node_id].dictionary.entries
        self.bus.run(1e-3)
        self.forget()

    @property
    def now_ns(self) -> int:
        return self.bus.now_ns

    def pass_time(self, for_ns: int) -> None:
        self.bus.kernel.run(self.now_ns + for_ns)

    def forget(self) -> None:
        """Look only at frames from now on."""
        self.bus.run(ANSWER_S)
        self.since_ns = self.now_ns + 1

    def frames(self, can_id: int) -> list[bytes]:
        """Data of the frames of one COB-ID since the last look, those under way included."""
        self.bus.run(ANSWER_S)
        return [frame.data for frame in self.bus.frames(can_id, since_ns=self.since_ns)]

    def send(self, can_id: int, data: bytes = b"") -> list[BusFrame]:
        """Put a frame on the bus; return the frames of the next 0.6 ms, answers among them."""
        began_ns = self.now_ns
        self.bus.send(can_id, data)
        self.bus.run(ANSWER_S)
        return [frame for frame in self.bus.frames(since_ns=began_ns + 1) if frame.cob_id != can_id]

    def settle(self) -> None:
        """Let the device send what a call of the application made, and the frames reach the master."""
        self.node.station.settle(self.now_ns)
        self.bus.run(ANSWER_S)

    def nmt(self, command: NmtCommand) -> None:
        self.send(0, bytes((command, self.node_id)))

    def sync(self) -> list[BusFrame]:
        return self.send(0x80)

    def emergencies(self) -> list[int]:
        """Give the EMCY codes sent so far, and forget them."""
        codes = [struct.unpack_from("<H", data)[0] for data in self.frames(0x80 + self.node_id)]
        self.forget()
        return codes

    def _request(self, data: bytes) -> bytes:
        began_ns, answers = self.now_ns, []
        self.bus.send(0x600 + self.node_id, data)
        while not answers:
            assert self.now_ns < began_ns + 10 * MS
            self.pass_time(TICK_NS)
            answers = self.bus.frames(0x580 + self.node_id, since_ns=began_ns + 1)
        answer = answers[0].data
        if answer[0] == 0x80:
            raise AbortedError(int.from_bytes(answer[4:], "little"))
        return answer

    def write(self, index: int, subindex: int, value: float) -> None:
        data = struct.pack("<" + self.entries[key(index, subindex)].data_type.code, value)
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

    def __init__(self, node_id: int, plant: Mass | None = None) -> None:
        self.plant = plant or (servo_mass() if node_id == SERVO else knee_mass())
        self.torque = 0.0
        self.torques: list[float] = []
        self.word = 0
        self.target: int | None = None
        self.feeds_tension = node_id == SERVO
        self.master_lives = True
        self.velocity_share = self.torque_share = 1.0
        self.lag_s = self.acting = 0.0
        self.cyclic = False
        super().__init__(node_id, mechanics=self)

    # ---- time ----

    def step(self, torque: float, for_ns: int) -> tuple[float, float]:
        """Move the plant under the drive's torque; the mechanics of `CanopenNode`."""
        self.torque = torque
        self.torques.append(torque)
        asked = self.torque_share * torque
        self.acting += (asked - self.acting) * (1.0 - math.exp(-1e-9 * for_ns / self.lag_s) if self.lag_s else 1.0)
        self.plant.step(self.acting, for_ns)
        return self.plant.position, self.velocity_share * self.plant.velocity

    def run(self, for_ms: float) -> None:
        """Let time pass; from the first call on, the frames of the bench are sent every millisecond."""
        self.cyclic = True
        self.pass_time(round(for_ms * MS))

    def pass_time(self, for_ns: int) -> None:
        until_ns = self.now_ns + for_ns
        while self.now_ns < until_ns:
            super().pass_time(min(until_ns - self.now_ns, MS - self.now_ns % MS))
            if self.cyclic and self.now_ns % MS == 0:
                self._cycle()

    def _cycle(self) -> None:
        self.bus.send(0x80)
        if self.master_lives:
            if self.now_ns % (100 * MS) == 0:
                self.bus.send(0x77F, b"\x05")
            if self.target is not None:
                pad = struct.pack("<ii", *((self.target, 0) if self.node_id == SERVO else (0, self.target)))
                self.bus.send(0x201, pad)
        if self.feeds_tension:
            self.bus.send(0x183, struct.pack("<h", round(100 * self.plant.tension)))

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
