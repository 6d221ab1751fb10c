"""Compensation of effects beyond the calibration, around any controller.

Pure functions, by the catalogue's own inverses, no effect by name. A parameter with a scalar in the calibration is
put there, before homing, so that the session is measured against it. Every other effect becomes a table by sample of
the gait cycle: the rope motion that it requires, and the readings of START and the knee on a bench without the
effect.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from master.control.controller_io import ControllerInput, ControllerOutput
from master.control.gait_table import GaitTable, fabric_exponent, stretch
from physics import inverse
from physics.calibration import Calibration, scalars
from physics.conversions import MEASURABLE, from_scalars, to_scalars
from physics.effects.catalogue import CATALOGUE, Trajectory, Values, compensate, complete
from physics.effects.compensation import undone
from physics.laws import Array
from physics.parameters import BY_PLANT
from physics.plant.components import KNEE_AT_FIT
from physics.terms import Term

Effects = Mapping[str, Values]

LAPS: Final = 8
"""Gait cycles after which an effect with a memory is taken to have settled."""
MIDWAY: Final = 0.5
"""Share of the trial at which a drifting effect has its mean: tables compensate that; the feedback corrects the
difference."""
LEAST_EXPONENT: Final = 1e-3
AROUND: Final = frozenset({"load_slope", "viscous", "start_gain"})
"""Quantities that are compensated by tables, although a calibration has a scalar for them: not every controller reads
that scalar."""
SMOOTH_S: Final = 0.02
"""Width of the smoothing of corrections, s: tables have steps, and a step of the target would exceed the drive's speed.
"""


def calibrated(calibration: Calibration, found: Effects) -> tuple[Calibration, dict[str, Values]]:
    """Return the calibration with the effects of `found` that its scalars can hold, and the other effects.

    The parameters that an effect sets in the simulation determine the scalars (`physics.conversions`).
    """
    rest: dict[str, Values] = {}
    for name, given in found.items():
        values = complete(name, given)
        targets = CATALOGUE[name].forward
        if not all(BY_PLANT[target] in MEASURABLE - AROUND for target in targets):
            rest[name] = values
            continue
        before = from_scalars({scalar: getattr(calibration, scalar) for scalar in scalars()})
        moved = {BY_PLANT[target]: law(values) for target, law in targets.items()}
        after = to_scalars({**before, **moved})
        told = to_scalars(before)
        changed: dict[str, Any] = {scalar: value for scalar, value in after.items() if value != told[scalar]}
        calibration = dataclasses.replace(calibration, **changed)
    return calibration, rest


@dataclass(frozen=True)
class Correction:
    """Corrections by sample of the gait cycle: rope motion that the effects require, m; error of the knee's reading,
    rad; START reads gain · tension + more, N.

    `home_gain` is START's gain while homing.
    """

    rope_m: tuple[float, ...]
    knee_rad: tuple[float, ...]
    start_gain: tuple[float, ...]
    start_more_n: tuple[float, ...]
    home_gain: float

    def seen(self, seen: ControllerInput, offset_n: float) -> ControllerInput:
        """Return the inputs of a bench without the effects; `offset_n` is START's reading when slack."""
        i = seen.table_index(len(self.rope_m))
        start_n = (seen.start_n - offset_n - self.start_more_n[i]) / self.start_gain[i] + offset_n
        return seen._replace(servo_position_m=seen.servo_position_m - self.rope_m[i], start_n=start_n,
                             knee_angle_rad=seen.knee_angle_rad - self.knee_rad[i])

    def feed_forward(self, outputs: ControllerOutput, sample: int) -> ControllerOutput:
        """Return the targets with the rope motion that the effects require at `sample`, when they act."""
        return outputs._replace(servo_target_m=outputs.servo_target_m + self.rope_m[sample % len(self.rope_m)])


def correction(calibration: Calibration, gait: GaitTable, rest: Effects, terms: Sequence[Term] = (), *, adapts: bool
               ) -> Correction | None:
    """Tabulate the compensation of the effects `rest` and of `terms` beyond `calibration`; None without either.

    `adapts`: the controller has every scalar of the calibration and measures friction during homing, so only the
    departure from both is tabulated.
    """
    if not rest and not terms:
        return None
    courses = _course(calibration, gait), _homed(calibration)
    known = {"mu2": calibration.mu2, "fabric_wrap": calibration.fabric_wrap}
    own = {effect: {name: getattr(calibration, name) for name in AROUND & values.keys()}
           for effect, values in rest.items() if adapts and AROUND & values.keys()}
    base, homed = (compensate(course, own, known) for course in courses)
    met, home = (undone(compensate(course, rest, known), terms, gait.samples) for course in courses)
    if adapts:
        measured = float(homed.cable_exponent[0] + homed.fabric_exponent[0])
        share = measured / max(float(home.cable_exponent[0] + home.fabric_exponent[0]), LEAST_EXPONENT)
        met = met._replace(cable_exponent=share * met.cable_exponent, fabric_exponent=share * met.fabric_exponent)
    lap = slice(-gait.samples, None)
    exponent, force = _exponent(base)[lap], base.desired_n[lap]
    tension = force * np.exp((met.fabric_exponent * met.fabric_slip)[lap])
    gain = met.start_gain[lap] / base.start_gain[lap] * np.exp(_exponent(met)[lap] - exponent)
    start, base_start = (force * np.exp(_exponent(each)[lap]) + each.start_extra_n[lap] for each in (met, base))
    rope = (calibration.cable_compliance * (start - base_start)
            + calibration.fabric_share * (_fabric(calibration, tension) - _fabric(
                calibration, force * np.exp((base.fabric_exponent * base.fabric_slip)[lap])))
            + (met.stretch_m - base.stretch_m)[lap] + met.rope_extra_m[lap] - home.rope_extra_m[0])
    late = round(met.lead_s / gait.period_s)
    more = (met.start_gain * met.start_extra_n + met.start_offset_n)[lap] + gain * (
        np.roll(base.tension_n[lap], late) - base.tension_n[lap] - (base.start_gain * base.start_extra_n)[lap])
    tables = [_smooth(column, gait.period_s) for column in (rope, met.knee_extra_rad[lap], gain, more)]
    rope_m, knee_rad, start_gain, start_more_n = (tuple(table.tolist()) for table in tables)
    return Correction(rope_m, knee_rad, start_gain, start_more_n, float(home.start_gain[0] / homed.start_gain[0]))


def homed_stretch(calibration: Calibration, rest: Effects, start_n: Array, period_s: float) -> Array:
    """Return the stretch, m, by the effects `rest` in homing's pull and release, from its START tensions, N.

    Homing would else take it for friction and softness: a creep of 0.25 s for 35 % more friction.
    """
    still, knee = np.zeros(start_n.size), np.full(start_n.size, KNEE_AT_FIT)
    fabric = np.asarray(fabric_exponent(calibration, knee))
    way = np.where(np.arange(start_n.size) <= np.argmax(start_n), 1.0, -1.0)
    force = np.maximum(start_n, 0.0) * np.exp(-way * (calibration.cable_exponent + fabric))
    path = np.asarray(stretch(calibration, force))
    course = Trajectory(
        progress=still, desired_n=force, tension_n=start_n, knee_rad=knee, knee_rad_s=still, rope_m=path,
        rope_m_s=np.gradient(path, period_s), time_s=np.arange(start_n.size, dtype=np.float64) * period_s,
        rope_slip=way, fabric_slip=way, cable_exponent=still + calibration.cable_exponent, fabric_exponent=fabric,
        start_extra_n=still, stretch_m=path, rope_extra_m=still, knee_extra_rad=still, start_gain=still + 1.0,
        start_offset_n=still, lead_s=0.0)
    known = {"mu2": calibration.mu2, "fabric_wrap": calibration.fabric_wrap}
    return np.asarray(compensate(course, rest, known).stretch_m - path)


def _exponent(course: Trajectory) -> Array:
    return course.cable_exponent * course.rope_slip + course.fabric_exponent * course.fabric_slip


def _fabric(calibration: Calibration, force: Array) -> Array:
    """Stretch of the fabric alone, m."""
    whole = stretch(calibration, force) - calibration.rope_zero
    return np.asarray(whole - calibration.cable_compliance * force)


def _course(calibration: Calibration, gait: GaitTable) -> Trajectory:
    """The gait under the identified calibration, over `LAPS` gait cycles."""
    desired, knee = np.tile(gait.desired, LAPS), np.tile(gait.knee, LAPS)
    path = inverse.path(inverse.law(calibration, gait.period_s), desired, knee, laps=1)
    still = np.zeros(desired.size)
    return Trajectory(
        progress=still + MIDWAY, desired_n=desired, tension_n=path.start, knee_rad=knee,
        knee_rad_s=np.gradient(knee, gait.period_s), rope_m=path.position,
        rope_m_s=np.gradient(path.position, gait.period_s),
        time_s=np.arange(desired.size, dtype=np.float64) * gait.period_s,
        rope_slip=path.rope_slip, fabric_slip=path.fabric_slip, cable_exponent=still + calibration.cable_exponent,
        fabric_exponent=np.asarray(fabric_exponent(calibration, knee)), start_extra_n=still,
        stretch_m=np.asarray(stretch(calibration, desired)), rope_extra_m=still, knee_extra_rad=still,
        start_gain=still + 1.0, start_offset_n=still, lead_s=0.0)


def _homed(calibration: Calibration) -> Trajectory:
    """The bench after homing: the encoder's zero includes the rope motion that an effect requires there."""
    one, still = np.ones(1), np.zeros(1)
    force, knee = calibration.home_preload * one, KNEE_AT_FIT * one
    return Trajectory(
        progress=still, desired_n=force, tension_n=force, knee_rad=knee, knee_rad_s=still,
        rope_m=np.asarray(stretch(calibration, force)), rope_m_s=still, time_s=still, rope_slip=still,
        fabric_slip=still, cable_exponent=calibration.cable_exponent * one,
        fabric_exponent=np.asarray(fabric_exponent(calibration, knee)), start_extra_n=still,
        stretch_m=np.asarray(stretch(calibration, force)), rope_extra_m=still, knee_extra_rad=still, start_gain=one,
        start_offset_n=still, lead_s=0.0)


def _smooth(column: Array, period_s: float) -> Array:
    """A periodic column, averaged with a Hann window of `SMOOTH_S` about each sample."""
    half = min(max(1, round(0.5 * SMOOTH_S / period_s)), column.size // 2 - 1)
    window = np.hanning(2 * half + 3)[1:-1]
    around = np.concatenate([column[-half:], column, column[:half]])
    return np.asarray(np.convolve(around, window / window.sum(), "valid"))
