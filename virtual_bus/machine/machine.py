"""The machine behind the devices: the plant, the drives' ticks, the converters' samples.

At each instant the plant first advances under the torques demanded so far, then devices receive its outputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol, cast

from eds.declaration import MIRROR_RAD
from nodes import Drive, TensionSensor
from physics.converter import Converter
from physics.drive_loops import DRIVE_TICK_NS
from physics.plant.bench_plant import BowdenPlant, JointState, Outputs, Plant
from virtual_bus.kernel import TICK, Kernel
from virtual_bus.machine.hand import CheckingHand, Hand
from virtual_bus.machine.truth import Truth
from virtual_bus.wire.faults import Fault
from virtual_bus.wire.node_station import NodeStation


class MountedDrive(NamedTuple):
    """Drive of the simulated bench, with its CAN controller."""

    station: NodeStation
    drive: Drive


class Gauge(NamedTuple):
    """A tension sensor on the bench: `feels` is the place in `Outputs` of its force."""

    station: NodeStation
    sensor: TensionSensor
    converter: Converter
    feels: int


class Feeling(Protocol):
    """Protocol of the application of an observer's simulated device."""

    def feel(self, now_ns: int, felt: Outputs) -> None:
        """Receive the plant's outputs, at every drive tick."""


class Observer(NamedTuple):
    """A device on the bench that only measures."""

    station: NodeStation
    application: Feeling


class KneeEncoder(NamedTuple):
    """Scale of the knee drive's encoder, and its reading, rad, at the true angle 0."""

    scale: float = 1.0
    zero_rad: float = 0.0


TRUE_ENCODER: Final = KneeEncoder()


class MachineState(NamedTuple):
    """State of a machine between two instants: next drive tick, next samples of the sensors, torques held, N·m."""

    tick_ns: int
    sample_ns: tuple[int, ...]
    torques_nm: tuple[float, float]


BRIDGES = {"broken_wire": (0, 1), "overload": ((1 << 23) - 1, 0)}
"""Counts and status (bit 0: broken wire) of the converter by fault of a load cell's bridge."""


class SwitchedPlant(Plant, Protocol):
    """Protocol of a plant with an enable line and a second set of sensors; `BowdenPlant` and `PluggedPlant` have it."""

    def enable(self, closed: bool) -> None:
        """Close or open the enable line (STO) of both stages."""

    def second_sensors(self) -> tuple[float, float, float, float]:
        """Return tension at START and END, N, joint angle, rad, and rope wound in, m, by sensors that no device has."""


START_FEELS = Outputs._fields.index("start_n")
END_FEELS = Outputs._fields.index("end_n")
assert END_FEELS == START_FEELS + 1


class Machine:
    """Plant, servo, knee and sensors; drives tick every `DRIVE_TICK_NS`, sensors at their own interval.

    A knee without a drive is moved by a hand; that of an antagonist by the machine whose joint it is, mirrored.
    """

    def __init__(self, kernel: Kernel, plant: Plant, servo: MountedDrive, knee: MountedDrive | Hand | Machine,
                 gauges: Sequence[Gauge], observers: Sequence[Observer] = (),
                 encoder: KneeEncoder = TRUE_ENCODER, hand: CheckingHand | None = None) -> None:
        self.plant = plant
        self._kernel = kernel
        self._servo = servo
        self._knee = knee
        self._leader = knee if isinstance(knee, Machine) else None
        self.gauges, self._observers = tuple(gauges), tuple(observers)
        self._encoder, self._hand = encoder, hand
        self._servo_nm = 0.0
        self._knee_nm = 0.0
        self._tick_ns = 0
        self._sample_ns: list[int] = []
        self._bridges: dict[int | None, tuple[int, int]] = {}
        plant.reset(0)
        self.truth: Truth | None = None

    def start(self) -> None:
        """Schedule the first tick and the first samples now."""
        self._tick_ns = self._kernel.now_ns
        self._sample_ns = [self._kernel.now_ns] * len(self.gauges)
        self._kernel.at(self._tick_ns, TICK, self._act)

    def trouble(self, fault: Fault, there: bool) -> None:
        """Begin or end a fault of a sensor's bridge, or press or release a drive's emergency stop."""
        if fault.kind in BRIDGES:
            if there:
                self._bridges[fault.node] = BRIDGES[fault.kind]
            else:
                self._bridges.pop(fault.node, None)
            return
        station, drive = next(axis for axis in self.axes if axis.station.node == fault.node)
        drive.emergency_stop(there, self._kernel.now_ns)
        if station.on:
            station.settle(self._kernel.now_ns)

    def enable(self, closed: bool) -> None:
        """Close or open the enable line (STO) of every drive: open, there is no torque, and the drives report it."""
        cast(SwitchedPlant, self.plant).enable(closed)
        for station, drive in self.axes:
            drive.emergency_stop(not closed, self._kernel.now_ns)
            if station.on:
                station.settle(self._kernel.now_ns)

    @property
    def steady(self) -> bool:
        """Return whether the machine runs without a fault: no hand, every bridge and encoder intact."""
        return (bool(self._sample_ns) and not self._bridges and self._hand is None
                and self._encoder == TRUE_ENCODER)

    @property
    def state(self) -> MachineState:
        """Return the times of the next tick and samples, and the torques held."""
        return MachineState(self._tick_ns, tuple(self._sample_ns), (self._servo_nm, self._knee_nm))

    def go_on(self, state: MachineState) -> None:
        """Continue event by event from `state`, which a compiled cycle left."""
        self._tick_ns, self._sample_ns = state.tick_ns, list(state.sample_ns)
        self._servo_nm, self._knee_nm = state.torques_nm
        self._kernel.at(min(self._tick_ns, *self._sample_ns), TICK, self._act)

    @property
    def axes(self) -> tuple[MountedDrive, ...]:
        """Return servo and knee axis, or the servo axis alone."""
        return (self._servo, self._knee) if isinstance(self._knee, MountedDrive) else (self._servo,)

    @property
    def felt(self) -> frozenset[int | None]:
        """Return the node ids of the devices that act on this machine or measure it."""
        stations = [*(axis.station for axis in self.axes), *(gauge.station for gauge in self.gauges),
                    *(observer.station for observer in self._observers)]
        return frozenset(station.node for station in stations)

    def close(self) -> None:
        """Finish the truth file."""
        if self.truth is not None:
            self.truth.close()

    def _act(self) -> None:
        now_ns = self._kernel.now_ns
        felt = self._felt(now_ns)
        if self._tick_ns == now_ns:
            self._tick(now_ns, felt)
            self._tick_ns = now_ns + DRIVE_TICK_NS
        next_ns = self._tick_ns
        for place, due_ns in enumerate(self._sample_ns):
            if due_ns == now_ns:
                due_ns = self._sample_ns[place] = now_ns + self._sample(self.gauges[place], now_ns, felt)
            if due_ns < next_ns:
                next_ns = due_ns
        self._kernel.at(next_ns, TICK, self._act)

    def _felt(self, now_ns: int) -> Outputs:
        """Advance the plant to the present; return the quantities that devices measure."""
        if self._leader is None:
            return self.plant.advance(now_ns, self._servo_nm, self._knee_nm)
        angle, speed, acceleration = self._leader.joint_at(now_ns)
        plant = cast(BowdenPlant, self.plant)
        return plant.advance_led(now_ns, self._servo_nm, JointState(MIRROR_RAD - angle, -speed, -acceleration))

    def joint_at(self, now_ns: int) -> JointState:
        """Return the state of the joint now."""
        plant = cast(BowdenPlant, self.plant)
        plant.advance(now_ns, self._servo_nm, self._knee_nm)
        return plant.joint

    def _tick(self, now_ns: int, felt: Outputs) -> None:
        servo_m, servo_m_s, knee_rad, knee_rad_s, _, _, _ = felt
        station, drive = self._servo
        self._servo_nm = drive.tick(now_ns, servo_m, servo_m_s) if station.on else 0.0
        station.settle(now_ns)
        if isinstance(self._knee, Hand):
            led = self._hand is not None and self._hand.leads
            self._knee_nm = 0.0 if led else self._knee.push(knee_rad, knee_rad_s)
        elif isinstance(self._knee, MountedDrive):
            station, drive = self._knee
            scale, zero_rad = self._encoder
            read_rad = scale * knee_rad + zero_rad
            self._knee_nm = drive.tick(now_ns, read_rad, scale * knee_rad_s) if station.on else 0.0
            station.settle(now_ns)
        if self._hand is not None:
            self._knee_nm += self._hand.push(knee_rad, knee_rad_s)
        for observer in self._observers:
            if observer.station.on:
                observer.application.feel(now_ns, felt)
                observer.station.settle(now_ns)

    def _sample(self, gauge: Gauge, now_ns: int, felt: Outputs) -> int:
        station, sensor, converter, feels = gauge
        if not station.on:
            return DRIVE_TICK_NS
        weight_n = 0.0 if self._hand is None else self._hand.weights[feels - START_FEELS]
        counts = converter.sample(now_ns, felt[feels] + weight_n)
        if station.node in self._bridges:
            sensor.sample(now_ns, *self._bridges[station.node])
        else:
            sensor.sample(now_ns, counts)
        station.settle(now_ns)
        return sensor.interval_ns


class Machines:
    """Machines of the force paths of one bench, and their truth; each acts at its own times."""

    def __init__(self, machines: Sequence[Machine], truth: Truth | None) -> None:
        self.machines, self._truth = tuple(machines), truth

    def start(self) -> None:
        """Schedule the first tick of every machine."""
        for machine in self.machines:
            machine.start()

    def close(self) -> None:
        """Finish the truth file."""
        if self._truth is not None:
            self._truth.close()
