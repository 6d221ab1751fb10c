"""The gait itself: step after step of the controller, with a run-in from rest and a run-out to rest.

The rule of this file: a cycle whose needed inputs are not all of this SYNC makes no step; it holds its targets.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Any, Final, Protocol

import numpy as np

from master.control import gait_phase
from master.control.controller import Controller, ControllerInput
from master.control.controller_io import Trace
from master.control.gait_phase import PhaseConfig
from master.control.gait_table import GaitTable, tabulate
from master.cycle.exchange import NEEDED, Exchange
from master.cycle.inputs import NOTHING, CycleAnnotations, Inputs
from master.cycle.safety import Condition, StopError
from master.cycle.shared_exchange import Answer, Work
from master.motion import moves
from master.settings import Homing
from physics.calibration import Calibration
from physics.reference import ForceSurface, Reference

ENDS_A_STEP: Final = (Exception, SystemExit)
"""Exceptions of a controller that end in the safe stop; Ctrl-C is handled elsewhere."""
NAN: Final = math.nan
COMPARED_S: Final = 2.0 * gait_phase.RAMP_S
"""Time after which a force that follows a phase again is compared with earlier gait cycles, s: learnt corrections have
faded in by then (`extended.FADED_S`), and the drive has followed."""
HURRY = 5.0
"""Speed of the slack approach to the run-in, relative to homing."""


class Cycle(Protocol):
    """Interface of the running cycle that a gait needs: `cycle.Exchange` implements it, and so does a recording
    (`replay_controller`)."""

    inputs: Inputs
    targets: tuple[float, float]

    def advance(self, servo_m: float, knee_rad: float, annotations: CycleAnnotations = ...) -> Inputs:
        """Send the targets that answer `inputs`, and return the inputs of the next SYNC."""


def sampled(reference: Reference, samples: int) -> tuple[np.ndarray[tuple[int], np.dtype[np.float64]], ...]:
    """Return knee angle (rad) and desired force (N) of one gait cycle, by sample."""
    wanted = [reference.at(i / samples) for i in range(samples)]
    return np.array([w.knee_angle_rad for w in wanted]), np.array([w.force_n for w in wanted])


def sampled_by_knee(surface: ForceSurface | None, samples: int) -> ForceSurface | None:
    """Return a desired force by phase and knee angle, by sample; None where it depends on no angle."""
    percent = 100.0 * np.arange(samples) / samples
    return surface and surface._replace(force_n=np.stack(
        [surface.at(percent, np.full(samples, angle)) for angle in surface.knee_rad], axis=1))


def resting_sample(gait: GaitTable, first: int, last: int) -> int:
    """Return the sample in [first, last) at which the knee is slowest: a run from rest may begin or end there."""
    knee = np.array(gait.knee)
    speed = np.abs(np.roll(knee, -1) - np.roll(knee, 1))
    return first + int(np.argmin(speed[first:last]))


def run_in_sample(gait: GaitTable) -> int:
    """Return the sample at which the run-in begins: the knee's slowest one after the force has ended.

    If the force lasts to the end of the cycle, it is the slower of the last two samples.
    """
    loaded = np.flatnonzero(np.array(gait.desired) > 0.0)
    idle = int(loaded[-1]) + gait.samples // 10 if loaded.size else 0
    return resting_sample(gait, min(idle, gait.samples - 2), gait.samples)


def approach(exchange: Exchange, gait: GaitTable, sample: int, homing: Homing, rope_per_knee: float) -> None:
    """Move to the place that the tables have at `sample`, the rope slack all the way.

    `rope_per_knee`: rope by knee angle, m/rad.
    """
    if not exchange.knee_driven:
        moves.follow_joint(exchange, gait.knee[sample], rope_per_knee, homing.knee_rad_s)
    servo = gait.stretch[sample] + gait.swing[sample] - gait.slack[sample]
    moves.move(exchange, servo, gait.knee[sample], HURRY * homing.rope_m_s, homing.knee_rad_s)


def raised(error: BaseException) -> str:
    """Return the text of an error, in half a sentence."""
    text = " ".join(str(error).split())
    return f"raised {type(error).__name__}" + (f" ({text})" if text else "")


@contextmanager
def naming(name: str) -> Iterator[None]:
    """Turn an exception of a controller into a safe stop that names it."""
    try:
        yield
    except ENDS_A_STEP as error:
        raise StopError(Condition.CONTROLLER, f"{name} {raised(error)}") from error


def run(exchange: Cycle, work: Work[None]) -> None:
    """Run the steps of one path in the cycles of its exchange."""
    for answer in work:
        exchange.advance(answer.servo_m, answer.knee_rad, answer.annotations or NOTHING)


def steps(
    exchange: Cycle, control: Controller[Any], table: GaitTable, first: int, last: int,
    number: Callable[[int], float], knee_at: Callable[[int], float] | None = None, *, name: str = "", own: int = 0,
    felt: PhaseConfig | None = None, true_percent: Callable[[int], float] | None = None, until: float = math.inf,
    rising: int = 0,
) -> Work[None]:
    """Yield the controller's answer in each control cycle, for the gait's samples `first` … `last` − 1.

    Sample 0 is the start of gait cycle 0; `number` returns the gait-cycle number of a sample for its row in the trial.
    `knee_at` gives the knee's target by sample if it does not follow the reference that the controller expects. `own`
    is the number of further columns of the controller `name`. A controller that raises, or whose targets are not
    finite, raises `StopError`. With `felt` the controller follows the phase of the knee angle, without a clock;
    `true_percent` gives the true phase, %, for the record of a trial whose strides differ. From the sample `until` on
    no force is asked for, and in the `rising` gait cycles before sample 0 a share of it that rises.
    """
    samples, desired = table.samples, table.desired
    with naming(name):
        step, state = control.step, control.initial()
    inputs = exchange.inputs
    memory, share, place, doubt, asked = gait_phase.initial(), 1.0 if felt is None else -1.0, 0.0, 0.0, 1.0
    more: tuple[float, ...] = ()
    followed_s = math.inf if felt is None else 0.0
    for sample in range(first, last):
        i = sample % samples
        if felt is not None:
            lost = inputs.missing & NEEDED
            reading, memory = gait_phase.step(felt, memory, NAN if lost else inputs.knee_angle_rad)
            share = gait_phase.follow(share, reading._replace(known=reading.known and sample < until), table)
            asked = share if not rising or sample >= 0 else min(
                share, max(0.0, rising + 1.0 + sample // samples) / (rising + 1.0))
            followed_s = followed_s + table.period_s if asked == 1.0 else 0.0
            place = reading.phase * samples
            i = int(place) % samples
            doubt = 100.0 * reading.doubt
        if true_percent is not None:
            true = true_percent(sample)
            force = table.wanted(0.01 * true * samples, 1.0, inputs.knee_angle_rad)[0] if true == true else 0.0
            more = (true, doubt, asked, force)
        if inputs.missing & NEEDED:
            yield Answer(*exchange.targets, CycleAnnotations(
                100.0 * i / samples, desired[i] * max(asked, 0.0), cycle=number(sample),
                held=1.0))
            inputs = exchange.inputs
            continue
        seen = ControllerInput(
            sample, inputs.servo_position_m, inputs.servo_force_n, inputs.knee_angle_rad, inputs.start_n)
        if felt is not None:
            seen = seen._replace(place=place, rate=reading.rate * table.period_s * samples, share=asked)
        try:
            (servo, knee), state, trace = step(seen, state)
            whole = isfinite(servo) and isfinite(knee) and len(trace.own) == own
            isfinite(sum(trace.numbers))  # what is no number must not reach the recorder
        except ENDS_A_STEP as error:
            raise StopError(Condition.CONTROLLER, f"{name} {raised(error)}, {_place(i, samples, number(sample))}"
                            ) from error
        if not whole:
            raise StopError(Condition.CONTROLLER, f"{name} {_wrong(servo, knee, trace, own)}, "
                                                  f"{_place(i, samples, number(sample))}")
        yield Answer(servo, knee if knee_at is None else knee_at(sample), CycleAnnotations(
            gait_percent=100.0 * (i if felt is None else place) / samples, cycle=number(sample),
            desired_force_n=desired[i] if felt is None and table.by_knee is None else trace.desired_force_n,
            estimated_end_force_n=trace.estimated_end_force_n, estimated_end_half_n=trace.estimated_end_half_n,
            feedforward_m=trace.feedforward_m, impedance_dx_m=trace.impedance_dx_m,
            friction_ratio=trace.friction_ratio, rope_direction=trace.rope_direction,
            strain_direction=trace.strain_direction, own=(*trace.own, *more, trace.zero_m) if more else trace.own,
            follows_phase=followed_s >= COMPARED_S, zero_m=trace.zero_m))
        inputs = exchange.inputs


def _wrong(servo: float, knee: float, trace: Trace, own: int) -> str:
    for signal, value in (("servo target", servo), ("knee target", knee)):
        if not isfinite(value):
            return f"gave a {signal} of {value}"
    return f"gave {len(trace.own)} values for its {own} own columns"


def _place(i: int, samples: int, cycle: float) -> str:
    return f"{f'gait cycle {cycle:g}' if cycle >= 0.0 else 'outside the gait cycles'} at {100.0 * i / samples:.1f} %"


def idle_table(gait: GaitTable, calibration: Calibration) -> GaitTable:
    """Return the same motion with no force desired: slack all the way."""
    slack = max(gait.slack)
    return tabulate(calibration, np.array(gait.knee), np.zeros(gait.samples), gait.period_s, slack)
