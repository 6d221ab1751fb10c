"""The gait itself: step after step of the controller, with a run-in from rest and a run-out to rest.

The rule of this file: a cycle whose needed inputs are not all of this SYNC makes no step; it holds its targets.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from master.control.controller import Config, ControllerInput, initial, step
from master.control.gait_table import GaitTable, tabulate
from master.cycle.exchange import NEEDED, CycleAnnotations, Exchange, Inputs
from master.motion import moves
from master.settings import Homing
from physics.calibration import Calibration
from physics.reference import Reference

HURRY = 5.0
"""The approach to the run-in runs slack, this much faster than homing."""


class Cycle(Protocol):
    """What a walk needs of the running cycle: `cycle.Exchange` has it, and so has a recording (`replay_controller`)."""

    inputs: Inputs
    targets: tuple[float, float]

    def advance(self, servo_m: float, knee_rad: float, annotations: CycleAnnotations = ...) -> Inputs:
        """Send the targets that answer `inputs`, and return the inputs of the next SYNC."""


def sampled(reference: Reference, samples: int) -> tuple[np.ndarray[tuple[int], np.dtype[np.float64]], ...]:
    """Knee angle (rad) and desired force (N) of one gait cycle, by sample."""
    wanted = [reference.at(i / samples) for i in range(samples)]
    return np.array([w.knee_angle_rad for w in wanted]), np.array([w.force_n for w in wanted])


def resting_sample(gait: GaitTable, first: int, last: int) -> int:
    """The sample in [first, last) at which the knee is slowest: where a run from rest may begin or end."""
    knee = np.array(gait.knee)
    speed = np.abs(np.roll(knee, -1) - np.roll(knee, 1))
    return first + int(np.argmin(speed[first:last]))


def run_in_sample(gait: GaitTable) -> int:
    """Where the run-in begins, in the idle time that ends the cycle (anywhere, where there is none)."""
    loaded = np.flatnonzero(np.array(gait.desired) > 0.0)
    idle = int(loaded[-1]) + gait.samples // 10 if loaded.size else 0
    return resting_sample(gait, min(idle, gait.samples - 2), gait.samples)


def approach(exchange: Exchange, gait: GaitTable, sample: int, homing: Homing) -> None:
    """Move to the place that the tables have at `sample`, the rope slack all the way."""
    servo = gait.stretch[sample] + gait.swing[sample] - gait.slack[sample]
    moves.move(exchange, servo, gait.knee[sample], HURRY * homing.rope_m_s, homing.knee_rad_s)


def run(
    exchange: Cycle, config: Config, first: int, last: int, number: Callable[[int], float],
    led: Callable[[int], float] | None = None,
) -> None:
    """Run samples `first` … `last` − 1 (0: start of gait cycle 0); `number` gives a row's gait-cycle number.

    `led` gives the knee's target by sample where somebody else leads it: the controller expects its own reference.
    """
    samples, advance = config.gait.samples, exchange.advance
    state, inputs = initial(config), exchange.inputs
    for sample in range(first, last):
        i = sample % samples
        if inputs.missing & NEEDED:
            inputs = advance(*exchange.targets, CycleAnnotations(
                100.0 * i / samples, config.gait.desired[i], cycle=number(sample), held=1.0))
            continue
        seen = ControllerInput(
            sample, inputs.servo_position_m, inputs.servo_force_n, inputs.knee_angle_rad, inputs.start_n)
        (servo, knee), state, trace = step(seen, state, config)
        inputs = advance(servo, knee if led is None else led(sample), CycleAnnotations(
            100.0 * i / samples, trace[0], trace[1], number(sample), 0.0, trace[2:]))


def idle_table(gait: GaitTable, calibration: Calibration) -> GaitTable:
    """The same motion with no force desired: slack all the way."""
    slack = max(gait.slack)
    return tabulate(calibration, np.array(gait.knee), np.zeros(gait.samples), gait.period_s, slack)
