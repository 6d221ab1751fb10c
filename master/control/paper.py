"""The paper's controllers as one pure function of the inputs.

`step` has no memory, no clock and no END; `PaperState` is its memory, an argument and a result, and `Trace` holds the
intermediate values.

| controller | friction in the feedforward | impedance on the estimated END force |
|---|---|---|
| none       | –          | – |
| friction   | fL + fT    | – |
| impedance  | –          | 1/(B·s + K) |
| paper      | fL + fT    | 1/(B·s + K) |
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from master.control.controller_io import ControllerInput, ControllerOutput, Trace
from master.control.gait_table import GaitTable
from master.settings import Impedance
from physics import laws
from physics.calibration import Calibration


class PaperState(NamedTuple):
    """Memory of a controller: Δx of (15), m."""

    deviation_m: float = 0.0


@dataclass(frozen=True)
class PaperConfig:
    """Constants of `step`, computed once from calibration, gait and impedance."""

    gait: GaitTable
    rope_per_knee: float
    knee_home_rad: float
    cable_exponent: float
    fabric_offset: float
    fabric_slope: float
    cable_compliance: float
    start_offset_n: float
    compensates: bool
    decay: float
    gain_m_n: float


def configure(
    calibration: Calibration, gait: GaitTable, impedance: Impedance, *, compensates: bool, listens: bool
) -> PaperConfig:
    """Fold a controller's constants: whether it `compensates` friction, and `listens` to the estimated END force."""
    decay = math.exp(-impedance.stiffness_n_m / impedance.damping_n_s_m * gait.period_s)
    return PaperConfig(
        gait=gait,
        rope_per_knee=calibration.rope_per_knee,
        knee_home_rad=float(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT)),
        cable_exponent=calibration.cable_exponent,
        fabric_offset=calibration.mu2 * calibration.phi0,
        fabric_slope=calibration.mu2 * calibration.fabric_wrap,
        cable_compliance=calibration.cable_compliance,
        start_offset_n=calibration.start_offset,
        compensates=compensates,
        decay=decay,
        gain_m_n=(1.0 - decay) / impedance.stiffness_n_m if listens else 0.0,
    )


def step(seen: ControllerInput, state: PaperState, config: PaperConfig) -> tuple[ControllerOutput, PaperState, Trace]:
    """Return one control cycle: x = x1(Fd) + (fL + fT)/kc + k2·(θk − θk(13 %)) + Δx − slack.

    Equations (4), (8), (10), (11) feed forward, (3), (7) estimate END from START, (15) turns its error into Δx; kc is
    the stiffness on the START side of the friction. While the rope is slack there is no error to act on.
    """
    gait = config.gait
    i = seen.table_index(gait.samples)
    desired, slack = gait.wanted(i if seen.place is None else seen.place, seen.share)
    rope, strain, knee = gait.rope_direction[i], gait.fabric_direction[i], seen.knee_angle_rad
    fabric = config.fabric_offset + config.fabric_slope * abs(knee)
    ratio = math.exp(config.cable_exponent * rope + fabric * strain)
    estimated = (seen.start_n - config.start_offset_n) / ratio
    error = desired - estimated if slack == 0.0 else 0.0
    deviation = config.decay * state.deviation_m + config.gain_m_n * error
    feedforward = gait.stretch[i] + config.rope_per_knee * (knee - config.knee_home_rad)
    if config.compensates:
        feedforward += config.cable_compliance * gait.loss[i]
    target = feedforward + deviation - slack
    trace = Trace(desired, estimated, feedforward, deviation, ratio, rope, strain)
    return ControllerOutput(target, gait.knee[i]), PaperState(deviation), trace
