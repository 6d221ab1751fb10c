"""Checks of recorded data for contradictions, made before any fit.

Each check is a function from a trial to findings; a finding names the column and the reason, and the factor of a wrong
unit.  A finding refuses the trial only if a diagnosis of it would be wrong.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from diagnosis.data.table import AGE_SUFFIX, COUNTERS, Table
from physics.laws import Array

COPIED: Final = 0.5
"""Share of common rows above which two trials count as parts of one recording."""
LEAST_ROWS: Final = 100
"""Fewest samples of a trial, and of a comparison of two columns."""
LEAST_CYCLES: Final = 3
"""Fewest cycles of the trials, so that some of them can be held out."""
GAP_STEPS: Final = 5.0
"""Median steps of `time_s` above which a step is a gap."""
MOST_MISSING: Final = 0.2
"""Share of missing values of a column above which the trial is refused."""
SHORTEST_REST: Final = 10
"""Least number of samples that a saturated signal stays at its extreme."""
RUN_UP: Final = 10
"""Samples before the rest over which a saturated signal moves faster than its RMS rate."""
WIDEST: Final = {"m": (2.0, 1e3, "millimetres"), "rad": (8.0, 57.29578, "degrees")}
"""By unit of a column: the largest span of such a bench, and factor and name of the unit that was probably recorded."""
KNOWN_FACTORS: Final = {
    1e3: "mm/s", 1e6: "µm/s", 1e-3: "km/s", 1.0 / 60.0: "m/min ⁻¹", 60.0: "m/min", 100.0: "cm/s", 3.6: "km/h"}


@dataclass(frozen=True)
class Finding:
    """One contradiction in the data, as a sentence; `refuses`: it makes a diagnosis impossible."""

    text: str
    refuses: bool = False


def signals_in(given: Table) -> Iterator[tuple[str, Array]]:
    """Yield the measured columns, without counters and ages."""
    for name, values in given.columns.items():
        if name not in COUNTERS and not name.endswith(AGE_SUFFIX):
            yield name, values


def stamps(given: Table) -> Iterator[Finding]:
    """Yield findings on time stamps that are too few, missing, not rising, uneven or interrupted by gaps."""
    time = given["time_s"]
    if len(time) < LEAST_ROWS:
        yield Finding(f"{given.source}: {len(time)} rows; expected at least {LEAST_ROWS}.", True)
        return
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        yield Finding(f"{given.source}: time_s is not a number at row {bad[0] + 2}; give every row a time.", True)
        return
    step = np.diff(time)
    back = np.flatnonzero(step <= 0.0)
    if back.size:
        yield Finding(f"{given.source}: time_s does not rise at row {back[0] + 3} ({time[back[0] + 1]:g} after "
                      f"{time[back[0]]:g}), {back.size} times in all.", True)
        return
    usual = float(np.median(step))
    gaps = step > GAP_STEPS * usual
    if gaps.any():
        yield Finding(f"{given.source}: time_s has {int(gaps.sum())} gaps, the longest {step.max():.3g} s "
                      f"at {time[int(np.argmax(step))]:.3f} s.")
    uneven = np.abs(step[~gaps] - usual) > 0.25 * usual
    if uneven.mean() > 0.01:
        yield Finding(f"{given.source}: time_s steps unevenly, {100.0 * uneven.mean():.0f} % of the steps differ by "
                      f"more than a quarter from {usual:.4g} s.")


def presence(given: Table) -> Iterator[Finding]:
    """Yield findings on columns that are empty, constant or incomplete."""
    for name, values in signals_in(given):
        finite = np.isfinite(values)
        if not finite.any():
            yield Finding(f"{given.source}: {name} is empty (no finite value); it is not used.")
        elif np.ptp(values[finite]) == 0.0:
            yield Finding(f"{given.source}: {name} is constant at {values[finite][0]:g}; it is not used.")
        elif not finite.all():
            share = 100.0 * (1.0 - finite.mean())
            yield Finding(f"{given.source}: {name} lacks {share:.1f} % of its values, first at row "
                          f"{int(np.argmin(finite)) + 2}.", share > 100.0 * MOST_MISSING)


def spans(given: Table) -> Iterator[Finding]:
    """Yield findings on columns whose span shows that they are in another unit."""
    for name, values in signals_in(given):
        unit = next((u for u in WIDEST if name.endswith(f"_{u}")), None)
        finite = values[np.isfinite(values)]
        if unit is None or not finite.size or (given.turning and name.startswith("servo_")):
            continue
        widest, factor, written = WIDEST[unit]
        if np.ptp(finite) > widest:
            yield Finding(f"{given.source}: {name} spans {np.ptp(finite):.4g} {unit}, which no such bench has; "
                          f"probably {written}: divide it by {factor:g}.", True)


def saturation(given: Table) -> Iterator[Finding]:
    """Yield findings on saturated signals, which reach an extreme at speed and then stay at exactly that value."""
    for name, values in signals_in(given):
        finite = values[np.isfinite(values)]
        if finite.size < LEAST_ROWS or np.ptp(finite) == 0.0 or name.startswith("desired"):
            continue
        for extreme in (finite.max(), finite.min()):
            share = _cut_off(finite, extreme)
            if share > 0.01:
                yield Finding(f"{given.source}: {name} rests at {extreme:g} for {100.0 * share:.1f} % of the trial; "
                              "a limit of the sensor or the drive was reached.")


def _cut_off(values: Array, extreme: float) -> float:
    """Return the share of samples in which a signal stays at `extreme` after it reached that value at speed."""
    at = values == extreme
    first = np.flatnonzero(at & ~np.concatenate(([False], at[:-1])))
    last = np.flatnonzero(at & ~np.concatenate((at[1:], [False])))
    usual = float(np.sqrt(np.mean(np.diff(values) ** 2)))
    total = 0
    for a, b in zip(first, last, strict=True):
        if b - a + 1 >= SHORTEST_REST and a >= RUN_UP and abs(values[a] - values[a - RUN_UP]) > RUN_UP * usual:
            total += int(b - a + 1)
    return total / len(values)


def velocity(given: Table) -> Iterator[Finding]:
    """Yield findings on a servo velocity that is not the derivative of the servo position."""
    if not {"servo_velocity_m_s", "servo_position_m"} <= set(given.columns):
        return
    derived, said, step = _smooth_rates(given)
    usable = np.isfinite(derived) & np.isfinite(said)
    derived, said = derived[usable], said[usable]
    if derived.size < LEAST_ROWS or not derived.std() or not said.std():
        return
    likeness = float(np.corrcoef(derived, said)[0, 1])
    factor = float(said @ derived) / float(derived @ derived)
    if likeness < 0.7:
        yield Finding(f"{given.source}: servo_velocity_m_s is no derivative of servo_position_m (correlation "
                      f"{likeness:.2f}, sampled every {step:.4g} s); one of the two columns or time_s is wrong.", True)
    elif abs(factor - 1.0) > 0.05:
        yield Finding(f"{given.source}: servo_velocity_m_s is {factor:.4g} times the derivative of servo_position_m: "
                      f"{_reading(factor)}; the derivative is used.")


def _reading(factor: float) -> str:
    for known, unit in KNOWN_FACTORS.items():
        if abs(factor / known - 1.0) < 0.1:
            return f"it is in {unit}, or scaled"
    return f"another unit, or the clock of time_s runs {factor:.3g} times too slow"


def _smooth_rates(given: Table) -> tuple[Array, Array, float]:
    time, width = given["time_s"], 25
    kernel = np.ones(width) / width
    derived = np.gradient(given["servo_position_m"], time)
    return (np.convolve(derived, kernel, "valid"), np.convolve(given["servo_velocity_m_s"], kernel, "valid"),
            float(np.median(np.diff(time))))


def clocks(given: Table) -> Iterator[Finding]:
    """Yield a finding if the gait percent does not advance evenly with time."""
    if "gait_percent" not in given.columns:
        return
    percent, time = given["gait_percent"], given["time_s"]
    rate = np.gradient(percent, time)
    inside = np.isfinite(rate) & (rate > 0.0)
    if inside.sum() < LEAST_ROWS:
        return
    usual = float(np.median(rate[inside]))
    far = np.abs(rate[inside] / usual - 1.0) > 0.5
    if far.mean() > 0.05:
        yield Finding(f"{given.source}: gait_percent does not advance evenly with time_s "
                      f"({100.0 * far.mean():.0f} % of the samples).")


CHECKS: Final[tuple[Callable[[Table], Iterator[Finding]], ...]] = (
    stamps, presence, spans, saturation, velocity, clocks)


def examine(given: Table) -> list[Finding]:
    """Return the contradictions between the columns of one trial, up to the first check that refuses the trial."""
    found: list[Finding] = []
    for check in CHECKS:
        found.extend(check(given))
        if any(f.refuses for f in found):
            break
    return found


def usable(given: Table, motion: Sequence[str] = ()) -> Table:
    """Return `given` without constant or empty signals.

    `motion`: columns that are kept if constant and complete, such as the angle of a locked knee.
    """
    kept = {}
    for name, values in given.columns.items():
        finite = values[np.isfinite(values)]
        varies = finite.size > 0 and np.ptp(finite) > 0.0
        if name in COUNTERS or varies or (name in motion and finite.size == values.size):
            kept[name] = values
    return replace(given, columns=kept)


def between(trials: Sequence[Table], holdout: Sequence[Table], healthy: Sequence[Table]) -> list[Finding]:
    """Return the contradictions between files: data that two of them share, and different sampling rates."""
    found = []
    for given in trials:
        for other, role in [(h, "holdout") for h in holdout] + [(h, "healthy") for h in healthy]:
            if given.digest == other.digest:
                found.append(Finding(f"{other.source} holds the same data as {given.source}; "
                                     f"a {role} trial must be another one.", True))
            elif (share := shared_rows(given, other)) > COPIED:
                found.append(Finding(f"{100.0 * share:.0f} % of the rows of {given.source} are in {other.source}, too; "
                                     f"a {role} trial must be another recording.", True))
    for first, second in itertools.chain(*(itertools.combinations(group, 2) for group in (trials, holdout, healthy))):
        if first.digest == second.digest:
            found.append(Finding(f"{second.source} holds the same data as {first.source}; it counts once."))
        elif (share := shared_rows(first, second)) > COPIED:
            found.append(Finding(f"{100.0 * share:.0f} % of the rows of {second.source} are in {first.source}, too: "
                                 "one recording under two names tells no more than one."))
    found.extend(_paces([*trials, *holdout, *healthy]))
    return found


def shared_rows(first: Table, second: Table) -> float:
    """Return the share, 0 … 1, of the rows of the shorter trial that are also in the other one, at any time stamp.

    Two rows are equal if all their signals are equal bit for bit; two recordings of noisy sensors have almost none in
    common.
    """
    names = [name for name, _ in signals_in(first) if name in second and name not in ("time_s", "servo_target_m")]
    names = [n for n in names if not n.startswith("desired")]
    if not names:
        return 0.0
    one, other = (np.unique(np.ascontiguousarray(np.column_stack([t[n] for n in names])).view(
        f"V{8 * len(names)}").ravel()) for t in (first, second))
    return np.intersect1d(one, other, assume_unique=True).size / max(1, min(one.size, other.size))


def _paces(tables: Sequence[Table]) -> Iterator[Finding]:
    steps = [float(np.median(np.diff(t["time_s"]))) for t in tables]
    usual = float(np.median(steps))
    for given, step in zip(tables, steps, strict=True):
        if abs(step / usual - 1.0) > 0.02:
            yield Finding(f"{given.source}: sampled every {step:.4g} s, the others every {usual:.4g} s: another rate, "
                          f"or its clock is off by a factor of {step / usual:.3g}.")
