"""Do the data contradict themselves?  Looked at before anything is fitted.

The rule of this file: each check is one function from a trial to findings, each finding names the column and
the reason, and gives the factor where there is one; a check refuses only where going on would answer wrongly.
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
"""Share of rows that two trials have in common from which one is a part of the other."""
LEAST_ROWS: Final = 100
LEAST_CYCLES: Final = 3
GAP_STEPS: Final = 5.0
MOST_MISSING: Final = 0.2
SHORTEST_REST: Final = 10
RUN_UP: Final = 10
WIDEST: Final = {"m": (2.0, 1e3, "millimetres"), "rad": (8.0, 57.29578, "degrees")}
"""By unit: a span no bench of this kind has, and the unit that was probably written instead."""
KNOWN_FACTORS: Final = {
    1e3: "mm/s", 1e6: "µm/s", 1e-3: "km/s", 1.0 / 60.0: "m/min ⁻¹", 60.0: "m/min", 100.0: "cm/s", 3.6: "km/h"}


@dataclass(frozen=True)
class Finding:
    """One contradiction: `refuses` when nothing can be said in spite of it."""

    text: str
    refuses: bool = False


def signals_in(given: Table) -> Iterator[tuple[str, Array]]:
    """Yield the measured columns, without counters and ages."""
    for name, values in given.columns.items():
        if name not in COUNTERS and not name.endswith(AGE_SUFFIX):
            yield name, values


def stamps(given: Table) -> Iterator[Finding]:
    """Time stamps: present, rising, without long gaps, an even pace."""
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
    """Columns that hold nothing, hold one value, or hold holes."""
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
    """Columns whose span belongs to another unit."""
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
    """Signals cut off at an extreme: they arrive there at speed and then rest on exactly one value."""
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
    """Return the share of samples at `extreme` in runs that a moving signal ran into."""
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
    """The velocity column against the derivative of the position."""
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
    """The clock against the counter of cycles and the gait percent: one must be linear in the other."""
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
    """Return what one trial's columns say against each other; stops at the first that refuses."""
    found: list[Finding] = []
    for check in CHECKS:
        found.extend(check(given))
        if any(f.refuses for f in found):
            break
    return found


def usable(given: Table, motion: Sequence[str] = ()) -> Table:
    """Return `given` without the signals that hold nothing; `motion`: columns that do even where constant, as a locked
    knee's angle does."""
    kept = {}
    for name, values in given.columns.items():
        finite = values[np.isfinite(values)]
        varies = finite.size > 0 and np.ptp(finite) > 0.0
        if name in COUNTERS or varies or (name in motion and finite.size == values.size):
            kept[name] = values
    return replace(given, columns=kept)


def between(trials: Sequence[Table], holdout: Sequence[Table], healthy: Sequence[Table]) -> list[Finding]:
    """Return what the files say against each other: the same data twice, another clock."""
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
    """Return the share of the rows of the shorter trial that the other has, too, whatever the clock says; 0 … 1.

    Rows are alike where all signals are, bit for bit: two recordings of sensors with noise share next to none.
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
