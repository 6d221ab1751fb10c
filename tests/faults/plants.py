"""The simulated bench with things that break: a plug-in plant whose stage, path and sensors a row changes.

The rule of this file: until a row breaks something it is the bench's own plant, bit by bit; what breaks is physics
(torque, stiffness, friction, a slack element) or what a device feels, never a number on the wire.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from parameters import from_table
from physics.plant.bench_plant import BowdenPlant, JointState, Outputs, PlantParameters
from physics.plant.derived import derive
from physics.plant.state_layout import NODES, SLOT
from virtual_bus import build

Torques = tuple[float, float]
Stage = Callable[[int, float, float], Torques]
Sense = Callable[[int, Outputs], Outputs]

DRUM_M = 0.020
made: list[Breakable] = []
"""The plants made in this process, the last one last: a row finds its plant here."""


class Breakable(BowdenPlant):
    """The bench's own plant; `stage` alters torques (ns, N·m, N·m), `sense` what is felt.

    `true` has a row for every millisecond: time, ns, both tensions, N, knee angle, rad, and the torques of servo and
    knee drive, N·m.  `led`: another plant moves the joint.
    """

    __slots__ = ("led", "sense", "stage", "true")

    def __init__(self, parameters: PlantParameters) -> None:
        self.stage: Stage | None = None
        self.sense: Sense | None = None
        self.led = False
        self.true: list[tuple[int, float, float, float, float, float]] = []
        super().__init__(parameters)

    def advance(self, until_ns: int, servo_torque_nm: float, knee_torque_nm: float) -> Outputs:
        """As the bench's own plant, with what a row has broken."""
        if self.stage is not None:
            servo_torque_nm, knee_torque_nm = self.stage(until_ns, servo_torque_nm, knee_torque_nm)
        if not self.enabled:
            servo_torque_nm = knee_torque_nm = 0.0
        felt = super().advance(until_ns, servo_torque_nm, knee_torque_nm)
        if until_ns % 1_000_000 == 0 and (not self.true or self.true[-1][0] < until_ns):
            m = self._memory
            self.true.append((until_ns, float(m[SLOT.tension]), float(m[SLOT.tension + NODES]), felt.knee_angle_rad,
                              servo_torque_nm, knee_torque_nm))
        return felt if self.sense is None else self.sense(until_ns, felt)

    def advance_led(self, until_ns: int, servo_torque_nm: float, joint: JointState) -> Outputs:
        """As the bench's own plant, with the joint moved by another plant, and what a row has broken."""
        self.led = True
        felt = super().advance_led(until_ns, servo_torque_nm, joint)
        return felt if self.sense is None else self.sense(until_ns, felt)

    def snap(self, element: int, by_m: float = 1.0) -> None:
        """Make an element of the rope longer: by more than it ever stretches, it has snapped."""
        self._memory[SLOT.free + element] += by_m

    def change(self, **numbers: float) -> None:
        """Give the plant other parameters from now on; its state stays."""
        self.parameters = dataclasses.replace(self.parameters, **numbers)
        before = self._memory[SLOT.free:SLOT.free + NODES + 1].copy()
        derive(self._memory, self.parameters)
        self._memory[SLOT.free:SLOT.free + NODES + 1] = before


def breakable(parameters: dict[str, float], seed: int) -> Breakable:
    """A factory as `bowden.plants` has them: `--plant tests.faults.plants:breakable`."""
    del seed
    made.append(Breakable(from_table(PlantParameters, parameters, where="plant")))
    return made[-1]


@contextmanager
def in_place() -> Iterator[None]:
    """Make breakable plants in place of the bench's own: an antagonist's plant can be no plug-in."""
    own = build.OWN["bowden"]
    build.OWN["bowden"] = "tests.faults.plants:breakable"
    try:
        yield
    finally:
        build.OWN["bowden"] = own


# ---- stages: what becomes of the torques that the drives ask for ----


def dead(_now_ns: int, _servo: float, knee: float) -> Torques:
    """The servo's stage gives nothing."""
    return 0.0, knee


def reversed_servo(_now_ns: int, servo: float, knee: float) -> Torques:
    """Two motor phases are swapped."""
    return -servo, knee


def shorted(_now_ns: int, _servo: float, knee: float) -> Torques:
    """The servo's stage conducts: 4 N·m towards the rope, whatever the drive asks for."""
    return 4.0, knee


def weak(_now_ns: int, servo: float, knee: float) -> Torques:
    """A quarter of the torque that is asked for."""
    return 0.25 * servo, knee


def knee_dead(_now_ns: int, servo: float, _knee: float) -> Torques:
    """The knee's stage gives nothing."""
    return servo, 0.0


def knee_runaway(_now_ns: int, servo: float, _knee: float) -> Torques:
    """The knee's stage conducts: it extends the leg."""
    return servo, 12.0


def knee_reversed(_now_ns: int, servo: float, knee: float) -> Torques:
    """Two phases of the knee's motor are swapped."""
    return servo, -knee


# ---- senses: what a device feels in place of what is there ----


def lying(**lies: Callable[[float, float], float]) -> Callable[[int], Sense]:
    """A sense by fields of `Outputs`: each lie is told the true value and the seconds since it began."""
    def begin(start_ns: int) -> Sense:
        def sense(now_ns: int, felt: Outputs) -> Outputs:
            told: Mapping[str, Any] = {
                name: lie(getattr(felt, name), (now_ns - start_ns) * 1e-9) for name, lie in lies.items()}
            return felt._replace(**told)
        return sense
    return begin


def stuck() -> Callable[[float, float], float]:
    """A lie that repeats the first value it saw."""
    kept: list[float] = []

    def lie(value: float, _for_s: float) -> float:
        if not kept:
            kept.append(value)
        return kept[0]

    return lie
