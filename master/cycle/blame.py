"""Fault isolation: the sensor or part that explains the pattern of all violated relations, in one sentence.

Each suspect is declared by the relations that it alone disturbs. The suspect whose pattern is nearest to the present
residuals is named, with its reading and the value expected from the others.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from eds.declaration import PathNodes
from master.cycle.inputs import END, SERVO, START
from master.cycle.plausibility import (
    BY_END,
    BY_START,
    FORCE,
    KNEE_TRACK,
    RATIO,
    SERVO_TRACK,
    STILL_END,
    STILL_KNEE,
    STILL_SERVO,
    STILL_START,
    Implausibility,
)
from master.cycle.safety import NOBODY, Condition, StopError

_TENSIONS: Final = (RATIO, FORCE, BY_START, BY_END)


class Suspect(NamedTuple):
    """Suspected part of the bench, in words, and the tension relations (of four) that a fault of that part disturbs."""

    place: int
    words: str
    disturbed: frozenset[int]


SUSPECTS: Final = (
    Suspect(START, "START", frozenset({RATIO, FORCE, BY_START})),
    Suspect(END, "END, or a rope that slipped or snapped", frozenset({RATIO, BY_END})),
    Suspect(SERVO, "the servo's torque, or START with its path", frozenset({FORCE})),
    Suspect(NOBODY, "servo position, knee angle, a rope that slipped or snapped, or the calibration's rope_per_knee",
            frozenset({BY_START, BY_END})),
    Suspect(NOBODY, "START or END, or a path between them that is jammed", frozenset({RATIO})),
    Suspect(START, "START, or a path that is jammed", frozenset({RATIO, BY_START})),
    Suspect(START, "START, servo position, knee angle, or the calibration's rope_per_knee", frozenset({BY_START})),
    Suspect(END, "END, servo position, knee angle, or the calibration's rope_per_knee", frozenset({BY_END})),
)
"""Suspects, in the order in which they are named if patterns are equally near."""
_TEXTS: Final[Mapping[int, tuple[str, float, str]]] = MappingProxyType({
    RATIO: ("START against END by friction", 1.0, "N"),
    FORCE: ("servo force beyond START", 1.0, "N"),
    BY_START: ("stretch of the path for START", 1e3, "mm"),
    BY_END: ("stretch of the path for END", 1e3, "mm"),
})
_TOGETHER: Final = 0.37
"""Normalised residual of both axes from which on they count as off their targets together.

In the fault matrix the other axis is at 0.30 at most where one alone is off, and at 0.44 at least where targets are
lost to both.  Smaller: one axis' fault is called lost targets.  Larger: lost targets are called the knee's fault."""
_AGED: Final = 0.75
"""Normalised residual from which on a relation counts as disturbed while another one is broken."""


def blamed(finding: Implausibility, path: PathNodes) -> StopError:
    """Return the stop for a finding on a force path, with the suspect, its reading and the expected value."""
    seen, expected, relation = finding.seen, finding.expected, finding.relation
    if relation in _TENSIONS and finding.frozen:
        return StopError(Condition.OFF_TARGET, "servo position repeats one value to the last bit while its target and "
                                               f"{_TEXTS[relation][0]} change", path.servo)
    both_off = min(abs(finding.ratios[SERVO_TRACK]), abs(finding.ratios[KNEE_TRACK])) > _TOGETHER
    both = "targets that do not reach the drives, or both drives: " if both_off else ""
    if relation == SERVO_TRACK:
        return StopError(Condition.OFF_TARGET, f"{both}servo position is {1e3 * seen:.2f} mm, by its targets it "
                                               f"would be {1e3 * expected:.2f} mm", path.servo)
    if relation == KNEE_TRACK:
        return StopError(Condition.OFF_TARGET, f"{both}knee angle is {_degrees(seen):.1f}°, by its targets it would be "
                                               f"{_degrees(expected):.1f}°", path.knee)
    if relation in (STILL_START, STILL_END):
        name, node, other = ("START", path.start, "END") if relation == STILL_START else ("END", path.end, "START")
        return StopError(Condition.IMPLAUSIBLE, f"{name} repeats one value while {other} went from {expected:.1f} to "
                                                f"{seen:.1f} N", node)
    if relation == STILL_SERVO:
        return StopError(Condition.OFF_TARGET, f"servo position repeats one value while its target went from "
                                               f"{1e3 * expected:.2f} to {1e3 * seen:.2f} mm", path.servo)
    if relation == STILL_KNEE:
        return StopError(Condition.OFF_TARGET, f"knee angle repeats one value while its target went from "
                                               f"{_degrees(expected):.1f}° to {_degrees(seen):.1f}°", path.knee)
    suspect = suspected(finding)
    what, scale, unit = _TEXTS[relation]
    swing = finding.rope_per_knee_fits - finding.rope_per_knee
    fits = (f" (rope_per_knee = {finding.rope_per_knee:.4f} m/rad, {finding.rope_per_knee_fits:.4f} would fit)"
            if abs(swing) > 0.1 * finding.rope_per_knee else "")
    return StopError(Condition.IMPLAUSIBLE, f"{suspect.words}: {what} is {scale * seen:.1f} {unit}, "
                                            f"expected about {scale * expected:.1f} {unit}{fits}",
                     0 if suspect.place == NOBODY else path[suspect.place])


def suspected(finding: Implausibility) -> Suspect:
    """Return the suspect whose pattern of disturbed relations is nearest to the residuals over their tolerances."""
    def distance(suspect: Suspect) -> float:
        told = 0.0
        for relation in _TENSIONS:
            size = min(1.0, abs(finding.ratios[relation]) / _AGED)
            told += (1.0 - size if relation in suspect.disturbed else size) ** 2
        return told

    possible = [suspect for suspect in SUSPECTS if finding.relation in suspect.disturbed]
    return min(possible, key=distance)


def _degrees(angle: float) -> float:
    return angle * 57.29577951308232
