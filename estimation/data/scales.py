"""Checks that the columns of a trial have the sign, unit and content of their names.

Each column is compared with another one, with the reference trials or with the calibration.  Each finding refuses the
trial and names column, figure and remedy, so that a wrong column is never diagnosed as a fault of the bench.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from estimation.data.integrity import Finding, length_unit, written
from estimation.data.table import TURNING, Table
from physics import bench_model
from physics.parameters import PARAMETERS

TENSIONS: Final = ("tension_start_n", "tension_end_n")
RANGED: Final = ("servo_force_n", *TENSIONS)


def contradictions(given: Table, loaded_n: float = 10.0, still: float = 0.02, copied: float = 0.99
                   ) -> Iterator[Finding]:
    """Yield a finding if one tension of a trial is dead, or a copy of the other one.

    It is dead if its span is below the share `still` of the other's, which is above `loaded_n`.  The noise of two
    sensors differs, so that a share above `copied` of equal samples is of one sensor.
    """
    held = [n for n in TENSIONS if n in given and np.isfinite(given[n]).any()]
    if len(held) < 2:
        return
    start, end = (given[n] for n in held)
    known = np.isfinite(start) & np.isfinite(end)
    spans = [float(np.ptp(v[known])) for v in (start, end)] if known.any() else [0.0, 0.0]
    for name, mine, other, beside in ((held[0], spans[0], spans[1], held[1]), (held[1], spans[1], spans[0], held[0])):
        if other > loaded_n and mine < still * other:
            yield Finding(f"{given.source}: {name} stays within {mine:.3g} N while {beside} spans {other:.3g} N: "
                          "one of them reads nothing, or has a wrong value or unit; leave that column out, or record "
                          "the trial again.", True)
            return
    equal = float(np.mean(start[known] == end[known])) if known.any() else 0.0
    if min(spans) > 0.0 and equal > copied:
        yield Finding(f"{given.source}: tension_end_n equals tension_start_n in {100.0 * equal:.1f} % of the rows: one "
                      "is a copy of the other; leave tension_end_n out, or record it.", True)


def rope_per_knee(given: Table) -> float | None:
    """Return the rope per knee angle of a trial, m/rad, by regression; None unless half the variance is explained."""
    if "servo_position_m" not in given or "knee_angle_rad" not in given:
        return None
    angle, rope = given["knee_angle_rad"], given["servo_position_m"]
    known = np.isfinite(angle) & np.isfinite(rope)
    if not known.any() or np.std(angle[known]) == 0.0 or np.std(rope[known]) == 0.0:
        return None
    if float(np.corrcoef(angle[known], rope[known])[0, 1]) ** 2 < 0.5:
        return None
    return float(np.polyfit(angle[known], rope[known], 1)[0])


def against_range(trials: Sequence[Table], healthy: Sequence[Table]) -> Iterator[Finding]:
    """Yield findings on forces whose largest value is a decade above that of the reference trials, or two below.

    Neighbouring units differ by that much; wear, or another seal, changes forces about threefold.  A gait of a low
    peak may be a decade below.
    """
    for name in RANGED:
        usual = max((float(np.nanmax(np.abs(t[name]))) for t in healthy if _has_force(t, name)), default=0.0)
        for given in trials:
            most = float(np.nanmax(np.abs(given[name]))) if usual and _has_force(given, name) else 0.0
            column = written(given, name)
            unit = TURNING[column][1] if column in TURNING else "N"
            if 0.0 < most < 0.01 * usual:
                yield Finding(f"{given.source}: {column} reaches only {most:.3g} {unit}, in the healthy trials "
                              f"{usual:.3g}: is it in k{unit}? State forces in {unit}, or leave out a column that "
                              "reads nothing.", True)
            if most > 10.0 * usual:
                yield Finding(f"{given.source}: {column} reaches {most:.3g} {unit}, in the healthy trials at most "
                              f"{usual:.3g}: a signed number read as unsigned, another unit, or another motion; mend "
                              "the column, or give healthy trials of this range.", True)


def _has_force(given: Table, name: str) -> bool:
    return name in given and bool(np.isfinite(given[name]).any())


def against_bench(
    trials: Sequence[Table], healthy: Sequence[Table], calibration: Mapping[str, Any] | None,
) -> Iterator[Finding]:
    """Yield findings on trials in which rope or knee has another sign or unit than on the bench.

    The bench is that of the reference trials, else of the calibration, else, for a gait, the nominal one.  The unit is
    checked against reference trials only.
    """
    told = [r for r in map(rope_per_knee, healthy) if r is not None]
    if told:
        known, where = float(np.median(told)), "in the healthy trials"
    elif calibration is not None and "rope_per_knee" in (
            stated := bench_model.from_tables(calibration, "calibration").values):
        known, where = stated["rope_per_knee"], "in the calibration"
    elif any("gait_percent" in t for t in trials):
        known, where = PARAMETERS["rope_per_knee"].nominal, "on a bench of this kind"
    else:
        return
    for given in trials:
        mine = rope_per_knee(given)
        if mine is None:
            continue
        factor = abs(mine / known)
        alike = abs(math.log10(factor)) < 0.5
        if mine * known < 0.0 and alike:
            yield Finding(f"{given.source}: knee_angle_rad has the other sign than {where} ({mine:.4g} m of rope per "
                          f"rad, expected about {known:.4g}); flexion is negative: turn the column's sign.", True)
        elif told and not alike:
            unit = length_unit(factor)
            yield Finding(f"{given.source}: servo_position_m moves {factor:.3g} times as far per knee angle as "
                          f"{where}{f', probably in {unit}' if unit else ''}; positions are in metres: divide the "
                          f"column by {factor:.3g}.", True)
