"""Comparison of homing's result with the calibration, and of the sensors with each other.

The rule of this file: it looks once, at the slack rope after homing's pull and release, before anything faster moves;
what disagrees is refused with both numbers.
"""

from __future__ import annotations

from typing import Final

from master.cycle.exchange import Exchange
from master.cycle.plausibility import HomingBaseline
from master.network.bringup import BringUpError
from physics.calibration import NOMINAL, Calibration, nominal

STRETCH: Final = 1.6
"""Greatest ratio between homing's stretch and an identified bench's: day and creep change it by a tenth."""
STRETCH_NOMINAL: Final = 2.5
"""Largest ratio of stretches for the packaged calibration, which belongs to no bench."""
STRETCH_GUESSED: Final = 5.0
"""Largest ratio of stretches for a bench about to be identified: 5 to 25 mm at 60 N are usual benches, a unit that is
wrong by a factor of ten is outside."""
CENTRE: Final = 0.45
"""|mean of ln(START/END)| of pull and release, zero by friction alone; ln 2 is a gain of two."""
FORCE_RMS_N: Final = 6.0
PACKAGED_ROPE_PER_KNEE: Final = nominal().rope_per_knee
"""Rope per knee angle, m/rad, of a human-sized knee: the packaged calibration's rope_per_knee."""
SWING_UNLIKE: Final = 0.25
"""Relative departure from `PACKAGED_ROPE_PER_KNEE` beyond which homing measures it; usual benches stay within 0.15."""
SWING: Final = 0.2
"""Greatest relative difference between homing's rope_per_knee and a calibration's."""


def unlike_packaged(calibration: Calibration) -> bool:
    """Return whether the calibration's lever is so unusual that homing must measure it first."""
    return abs(calibration.rope_per_knee / PACKAGED_ROPE_PER_KNEE - 1.0) > SWING_UNLIKE


def refuse_swing(calibration: Calibration, found: float) -> None:
    """Raise `BringUpError`, with both numbers, if homing `found` a rope_per_knee, m/rad, unlike the calibration's."""
    if abs(found / calibration.rope_per_knee - 1.0) > SWING:
        raise BringUpError(
            f"calibration {calibration.label}: its rope_per_knee is {calibration.rope_per_knee:.4f} m/rad, homing "
            f"found {found:.4f} m/rad; identify this bench (bowden identify all) and start again.")


def begin(exchange: Exchange, calibration: Calibration, knee_home_rad: float) -> None:
    """Begin the identification of stretch, friction and inertia from the homing motion that follows."""
    exchange.plausibility.begin_learning(calibration.rope_per_knee, knee_home_rad, calibration.cable_compliance)


def refuse_disagreement(exchange: Exchange, calibration: Calibration, *, guessed: bool = False) -> None:
    """Take over the results of homing; raises `BringUpError` if they disagree with the calibration.

    A `guessed` calibration is about to be measured: its stretch may be another bench's.
    """
    learned = exchange.plausibility.learn(calibration.stiffness_a, calibration.stiffness_b)
    sentence = disagreement(learned, calibration, guessed=guessed) or among_sensors(learned)
    if sentence is not None:
        raise BringUpError(sentence)


def disagreement(learned: HomingBaseline, calibration: Calibration, *, guessed: bool = False) -> str | None:
    """Return a sentence if homing's stretch differs from the calibration's, with both numbers; None if it agrees."""
    known = STRETCH_NOMINAL if calibration.label == NOMINAL else STRETCH
    ratio, most = learned.stretch_ratio, STRETCH_GUESSED if guessed else known
    if ratio < 1.0 / most or ratio > most:
        top = learned.top_n
        declared = 1e3 * (calibration.stiffness_b * 0.75 * top + calibration.stiffness_a * 0.9375 * top**2)
        return (f"calibration {calibration.label}: its rope and fabric stretch by {declared:.2f} mm from "
                f"{0.25 * top:.3g} to {top:.3g} N, homing found {ratio * declared:.2f} mm; identify this bench (bowden "
                "identify all) and start again.")
    return None


def among_sensors(learned: HomingBaseline) -> str | None:
    """Return a sentence if the sensors contradict each other beyond friction, with both numbers; None otherwise."""
    centre = 0.5 * (learned.low + learned.high)
    if learned.low and learned.high and abs(centre) > CENTRE:
        return (f"homing: pulled and released, START is {100.0 * 2.718281828 ** centre:.0f} % of END in the middle, "
                "where friction leaves 100 %; check the scaling of both sensors (0x6126) and tare them.")
    if learned.force_rms_n > FORCE_RMS_N:
        return (f"homing: the servo's force and START disagree by {learned.force_rms_n:.1f} N rms beyond friction and "
                f"inertia, expected below {FORCE_RMS_N:g} N; check START's scaling (0x6126) and the servo's torque.")
    return None
