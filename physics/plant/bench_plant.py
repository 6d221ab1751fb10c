"""The plant behind the nodes: outputs for a bench's devices, and the simulated bench that computes them.

Torques in, positions, speeds, knee angle and both tensions out, times in integer nanoseconds; any object with the
protocol `Plant` can run behind the same nodes (entry-point group `bowden.plants`).
"""

from collections.abc import Mapping, Sequence
from math import cos, isfinite
from typing import Final, NamedTuple, Protocol

import numpy as np

from parameters import from_table
from physics.laws import Array
from physics.plant import step
from physics.plant.components import GRAVITY
from physics.plant.derived import derive, settle
from physics.plant.modulated import extend
from physics.plant.state_layout import NODES, SIZE, SLOT, PlantParameters
from physics.plant.step import STEP_NS
from physics.terms import Term

__all__ = ["STEP_NS", "BowdenPlant", "JointState", "Outputs", "Plant", "PlantParameters", "create", "prepare"]


class Outputs(NamedTuple):
    """Outputs of the plant that the bench's devices measure, at one instant."""

    servo_position_m: float
    servo_velocity_m_s: float
    knee_motor_rad: float
    knee_motor_rad_s: float
    knee_angle_rad: float
    start_n: float
    end_n: float


class JointState(NamedTuple):
    """Angle, rad, speed, rad/s, and acceleration, rad/s², of the joint."""

    angle_rad: float
    speed_rad_s: float
    acceleration_rad_s2: float


class Plant(Protocol):
    """Protocol of the plant behind the nodes; made by a factory `(parameters, seed) -> Plant`."""

    def reset(self, time_ns: int) -> Outputs:
        """Return to the state at power-on, at `time_ns`."""
        ...

    def advance(self, until_ns: int, servo_torque_nm: float, knee_torque_nm: float) -> Outputs:
        """Hold both torque demands, N·m (the knee's at the knee), up to `until_ns`, and return the outputs at that
        time."""
        ...

    def truth(self) -> Mapping[str, float]:
        """Return the true signals that no device measures, by name with its unit; for the truth file only."""
        ...


class BowdenPlant:
    """The simulated bench: `physics.plant.step` over one flat array."""

    __slots__ = ("_memory", "_now_ns", "_out", "enabled", "parameters")

    def __init__(self, parameters: PlantParameters) -> None:
        self.parameters = parameters
        self.enabled = True
        self._memory: Array = np.zeros(SIZE)
        self._out = self._memory[SLOT.out_servo_x : SLOT.out_servo_x + len(Outputs._fields)]
        derive(self._memory, parameters)
        self.reset(0)

    def reset(self, time_ns: int) -> Outputs:
        """Return to rest at power-on: knee at `start_knee_rad`, rope slack by `start_slack_m`."""
        self._now_ns = time_ns
        settle(self._memory, self.parameters)
        return self.advance(time_ns, 0.0, 0.0)

    def advance(self, until_ns: int, servo_torque_nm: float, knee_torque_nm: float) -> Outputs:
        """Run to the last whole step of 10 µs not after `until_ns` under held demands, N·m."""
        steps = (until_ns - self._now_ns) // STEP_NS
        if steps < 0:
            raise ValueError(f"the plant is at {self._now_ns} ns and cannot go back to {until_ns} ns")
        if not isfinite(servo_torque_nm + knee_torque_nm):
            raise ValueError(f"torque demands {servo_torque_nm} and {knee_torque_nm} N·m are not finite numbers")
        if not self.enabled:
            servo_torque_nm = knee_torque_nm = 0.0
        self._now_ns += steps * STEP_NS
        step.advance(self._memory, steps, servo_torque_nm, knee_torque_nm)
        return Outputs._make(self._out.tolist())

    def enable(self, closed: bool) -> None:
        """Close or open the enable line (STO) of both stages: open, they give no torque, whatever is demanded."""
        self.enabled = closed

    def second_sensors(self) -> tuple[float, float, float, float]:
        """Return the readings of a second set of sensors: tensions at START and END, N, leg angle, rad, and rope, m."""
        memory = self._memory
        return (float(memory[SLOT.tension]), float(memory[SLOT.tension + NODES]), float(memory[SLOT.leg_q]),
                float(memory[SLOT.servo_x]))

    def extend(self, terms: Sequence[Term], where: str) -> None:
        """Let parameters follow `terms`; raises `InputError`, which names `where`, for one that a plant cannot follow.
        """
        extend(self._memory, terms, where)

    @property
    def joint(self) -> JointState:
        """Return the state of the leg at the knee."""
        memory = self._memory
        return JointState(float(memory[SLOT.leg_q]), float(memory[SLOT.leg_w]), float(memory[SLOT.leg_a]))

    def advance_led(self, until_ns: int, servo_torque_nm: float, joint: JointState) -> Outputs:
        """Run to `until_ns` with a joint that another plant moves; at the end the leg is at the angle of `joint`."""
        self.advance(until_ns, servo_torque_nm, 0.0)
        memory = self._memory
        memory[SLOT.leg_q] = memory[SLOT.motor_q] = memory[SLOT.out_leg_q] = joint.angle_rad
        memory[SLOT.leg_w] = memory[SLOT.motor_w] = joint.speed_rad_s
        carried = GRAVITY * cos(joint.angle_rad) + memory[SLOT.end_mass_arm_m] * joint.acceleration_rad_s2
        memory[SLOT.out_end] = memory[SLOT.tension + NODES] + memory[SLOT.end_mass_kg] * carried
        return Outputs._make(self._out.tolist())

    def truth(self) -> Mapping[str, float]:
        """Return the true tensions, the slip states and other quantities that no device measures."""
        row = np.empty(len(step.TRUTH_NAMES))
        step.truth_row(self._memory, row)
        return dict(zip(step.TRUTH_NAMES, row.tolist(), strict=True))

    def adopt(self, memory: Array) -> None:
        """Move the whole state into this memory of `state_layout.SIZE` numbers."""
        memory[:] = self._memory
        self._memory = memory
        self._out = memory[SLOT.out_servo_x : SLOT.out_servo_x + len(Outputs._fields)]

    @property
    def now_ns(self) -> int:
        """Return the time of the state, ns: that of the last whole step; a caller of `step.advance` sets it."""
        return self._now_ns

    @now_ns.setter
    def now_ns(self, time_ns: int) -> None:
        self._now_ns = time_ns

    @property
    def memory(self) -> Array:
        """Return a copy of the whole state, by `physics.plant.state_layout.SLOT`."""
        return self._memory.copy()


def create(parameters: dict[str, float], seed: int) -> BowdenPlant:
    """Make the simulated bench from a table of `PlantParameters`; raises `InputError` for an invalid entry.

    It draws nothing, so `seed` changes nothing: the scatter from bench to bench is in `parameters`.
    """
    del seed
    return BowdenPlant(from_table(PlantParameters, parameters, where="plant"))


def prepare() -> bool:
    """Compile the step, or load it from numba's cache; return whether it had to be compiled."""
    before = sum(step.advance.stats.cache_misses.values())
    BowdenPlant(PlantParameters())
    return bool(sum(step.advance.stats.cache_misses.values()) > before)


NOMINAL: Final = PlantParameters()
