"""Checks of recorded data for contradictions, made before any fit.

Each check is a function from a trial to findings; a finding names the column and the reason, and the factor of a wrong
unit.  A finding refuses the trial only if a diagnosis of it would be wrong.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimation.data.table import AGE_SUFFIX, COUNTERS, TURNING, Table
from physics.laws import Array
from physics.parameters import ESTIMATED
from trial.convert.lab_table import TO_SI

WIDEST: Final = {"m": (ESTIMATED["rope_zero"].high - ESTIMATED["rope_zero"].low, "mm"),
                 "rad": (math.tau, "deg")}
"""By unit of a column: span that no bench exceeds, and the unit of `TO_SI` that was probably recorded.

Spans: of the rope's zero by its bounds, and one turn of a joint."""


POSITIONS: Final = ("servo_position_m", "knee_angle_rad")
MEASURED: Final = (*POSITIONS, "servo_force_n", "tension_start_n", "tension_end_n")
"""Signals of the forward models: a row without one of them counts as lost."""


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


def stamps(given: Table, gap_steps: float = 5.0, least_rows: int = 100, slow_s: float = 0.5) -> Iterator[Finding]:
    """Yield findings on time stamps that are too few, missing, not rising, above `slow_s` apart, or uneven.

    A gap is above `gap_steps` steps.
    """
    time = given["time_s"]
    if len(time) < least_rows:
        count = "1 row" if len(time) == 1 else f"{len(time)} rows"
        yield Finding(f"{given.source}: {count}; expected at least {least_rows}.", True)
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
    if usual > slow_s:
        yield Finding(f"{given.source}: time_s advances {usual:.4g} s a row, in which a bench moves unseen; if it is "
                      "in milliseconds, divide it by 1000, else record 100 rows a second or more.", True)
        return
    step[np.asarray(given.seams, np.intp) - 1] = usual
    gaps = step > gap_steps * usual
    if gaps.any():
        count = "a gap" if gaps.sum() == 1 else f"{int(gaps.sum())} gaps, the longest"
        yield Finding(f"{given.source}: time_s has {count} of {step.max():.3g} s at {time[np.argmax(step)]:.3f} s.")
    uneven = np.abs(step[~gaps] - usual) > 0.25 * usual
    if uneven.mean() > 0.01:
        yield Finding(f"{given.source}: time_s steps unevenly, {100.0 * uneven.mean():.0f} % of the steps differ by "
                      f"more than a quarter from {usual:.4g} s.")


def presence(given: Table, most_missing: float = 0.2) -> Iterator[Finding]:
    """Yield findings on columns that are empty, constant or incomplete.

    The trial is refused if more than `most_missing` of a column is missing while the axis moves.
    """
    for name, values in signals_in(given):
        finite = np.isfinite(values)
        if not finite.any():
            yield Finding(f"{given.source}: {name} is empty (no finite value); it is not used.")
        elif np.ptp(values[finite]) == 0.0 and "." not in name:
            yield Finding(f"{given.source}: {name} is constant at {values[finite][0]:g}; it is not used.")
        elif not finite.all():
            moving = float(np.mean(~finite & ~_at_rest(given, finite)))
            yield Finding(f"{given.source}: {name} lacks {np.count_nonzero(~finite)} of {finite.size} values, first at "
                          f"row {int(np.argmin(finite)) + 2}.", moving > most_missing)


def _at_rest(given: Table, recorded: NDArray[np.bool_], slow: float = 0.1) -> NDArray[np.bool_]:
    """Return a mask of the rows between two `recorded` ones with a mean speed below `slow` of the RMS speed."""
    position, time = given.columns.get("servo_position_m", np.full(len(given), np.nan)), given["time_s"]
    rows = np.flatnonzero(recorded & np.isfinite(position))
    if rows.size < 2:
        return np.zeros(len(given), np.bool_)
    speed = np.diff(position[rows]) / np.diff(time[rows])
    after = np.clip(np.searchsorted(rows, np.arange(len(given))), 1, rows.size - 1)
    return np.abs(speed[after - 1]) < slow * float(np.sqrt(np.mean(speed**2)))


def wraps(given: Table, jump: float = 0.5, usual: float = 0.05) -> Iterator[Finding]:
    """Yield findings on positions that wrap round.

    Nine steps of ten are below the share `usual` of the span, and some are above `jump`.
    """
    step = np.diff(given["time_s"])
    near = step < 2.5 * np.median(step)
    for name, values in signals_in(given):
        if name.partition(".")[2] not in POSITIONS and name not in POSITIONS:
            continue
        moved, span = np.abs(np.diff(values)), np.nanmax(values, initial=-np.inf) - np.nanmin(values, initial=np.inf)
        far = np.flatnonzero(near & (moved > jump * span))
        if far.size and np.nanquantile(moved, 0.9) < usual * span:
            yield Finding(f"{given.source}: {written(given, name)} wraps round {far.size} times, first at row "
                          f"{far[0] + 3} by {moved[far[0]]:.4g}: unwrap the column, so that it goes on.", True)


def unsigned(given: Table, share: float = 0.1, alike: float = 1.5, pulled: float = 0.8) -> Iterator[Finding]:
    """Yield a finding on a drive force without sign: never negative, near 0 at times, alike in both directions.

    Each direction has the `share` of the rows or more, and the means of both differ by less than a factor `alike`.
    A correlation with the travel above `pulled` is a spring that is pulled, whose force has one sign; so has that of a
    rope, whose tension is recorded.
    """
    if not {"servo_force_n", "servo_position_m"} <= set(given.columns) or "tension_start_n" in given:
        return
    force, speed = given["servo_force_n"], np.gradient(given["servo_position_m"], given["time_s"])
    fast = 0.2 * np.nanquantile(np.abs(speed), 0.9)
    ways = [force[mask & np.isfinite(force)] for mask in (speed > fast, speed < -fast)]
    if min(way.size for way in ways) < share * force.size or np.nanmin(force) < 0.0:
        return
    means = sorted(float(way.mean()) for way in ways)
    there = np.isfinite(force) & np.isfinite(given["servo_position_m"])
    apart = abs(np.corrcoef(force[there], given["servo_position_m"][there])[0, 1]) < pulled
    if apart and means[1] < alike * means[0] and np.nanquantile(force, 0.01) < 0.2 * means[0]:
        yield Finding(f"{given.source}: {written(given, 'servo_force_n')} has no sign: it is never negative, and as "
                      "large in one direction as in the other; record it with its sign.", True)


def written(given: Table, name: str) -> str:
    """Return the header under which a column was recorded, which differs on a turning axis."""
    before, dot, own = name.rpartition(".")
    as_read = {known: column for column, (known, unit) in TURNING.items()
               if given.turning and (unit == "V") == (given.volts and known == "servo_force_n")}
    return before + dot + as_read.get(own, own)


def spans(given: Table) -> Iterator[Finding]:
    """Yield findings on columns whose span shows that they are in another unit."""
    for name, values in signals_in(given):
        unit = next((u for u in WIDEST if name.endswith(f"_{u}")), None)
        finite = values[np.isfinite(values)]
        if unit is None or not finite.size or (given.turning and "servo_" in name):
            continue
        widest, written = WIDEST[unit]
        if np.ptp(finite) > widest:
            yield Finding(f"{given.source}: {name} spans {np.ptp(finite):.4g} {unit}, which no such bench has; "
                          f"probably {written}: divide it by {1.0 / TO_SI[written][1]:g}.", True)


def saturation(given: Table) -> Iterator[Finding]:
    """Yield findings on saturated signals, which reach an extreme at speed and then stay at exactly that value."""
    for name, values in signals_in(given):
        finite = values[np.isfinite(values)]
        if not finite.size or np.ptp(finite) == 0.0 or name.startswith("desired"):
            continue
        for extreme in (finite.max(), finite.min()):
            share = _cut_off(finite, extreme)
            if share > 0.01:
                yield Finding(f"{given.source}: {name} rests at {extreme:g} for {100.0 * share:.1f} % of the trial; "
                              "a limit of the sensor or the drive was reached.")


def _cut_off(values: Array, extreme: float, samples: int = 10) -> float:
    """Return the share of samples in which a signal stays at `extreme` after it reached that value at speed.

    It stays for `samples` or more, and moved faster than its RMS rate over as many before.
    """
    at = values == extreme
    first = np.flatnonzero(at & ~np.concatenate(([False], at[:-1])))
    last = np.flatnonzero(at & ~np.concatenate((at[1:], [False])))
    usual = float(np.sqrt(np.mean(np.diff(values) ** 2)))
    total = 0
    for a, b in zip(first, last, strict=True):
        if b - a + 1 >= samples <= a and abs(values[a] - values[a - samples]) > samples * usual:
            total += int(b - a + 1)
    return total / len(values)


def velocity(given: Table) -> Iterator[Finding]:
    """Yield findings on a servo velocity that is not the derivative of the servo position."""
    if not {"servo_velocity_m_s", "servo_position_m"} <= set(given.columns):
        return
    derived, said, step = _smooth_rates(given)
    usable = np.isfinite(derived) & np.isfinite(said)
    derived, said = derived[usable], said[usable]
    if not (derived.size and derived.std() and said.std()):
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
    unit = length_unit(factor)
    return f"it is in {unit}/s, or scaled" if unit else (
        f"another unit, or the clock of time_s runs {factor:.3g} times too slow")


def length_unit(factor: float) -> str:
    """Return the unit of length in which a column is `factor` times as large as in metres, to 10 %; "" for none."""
    return next((unit for unit, (si, size) in TO_SI.items() if si == "m" and abs(factor * size - 1.0) < 0.1
                 and size != 1.0), "")


def _smooth_rates(given: Table) -> tuple[Array, Array, float]:
    time, width = given["time_s"], 25
    kernel = np.ones(width) / width
    derived = np.gradient(given["servo_position_m"], time)
    return (np.convolve(derived, kernel, "valid"), np.convolve(given["servo_velocity_m_s"], kernel, "valid"),
            float(np.median(np.diff(time))))


CHECKS: Final[tuple[Callable[[Table], Iterator[Finding]], ...]] = (
    stamps, presence, wraps, spans, saturation, velocity, unsigned)


def examine(given: Table) -> list[Finding]:
    """Return the contradictions between the columns of one trial, up to the first check that refuses the trial."""
    found: list[Finding] = []
    for check in CHECKS:
        found.extend(check(given))
        if any(f.refuses for f in found):
            break
    return found


def usable(given: Table, motion: Sequence[str] = ()) -> Table:
    """Return `given` without constant or empty signals, and without rows in which a measured signal has no value.

    `motion`: columns that are kept if constant and complete, such as the angle of a locked knee; the angles of an
    arm's other joints are.
    """
    kept = {}
    for name, values in given.columns.items():
        finite = values[np.isfinite(values)]
        varies = finite.size > 0 and np.ptp(finite) > 0.0
        if name in COUNTERS or varies or ((name in motion or "." in name) and finite.size == values.size):
            kept[name] = values
    known = np.all([np.isfinite(kept[n]) for n in kept if n.rpartition(".")[2] in MEASURED], axis=0)
    return replace(given, columns={n: v[known] for n, v in kept.items()} if known.any() and not known.all() else kept)


def between(trials: Sequence[Table], holdout: Sequence[Table], healthy: Sequence[Table]) -> list[Finding]:
    """Return the contradictions between files: data that two of them share, and different sampling rates.

    Two files with most of their rows in common are parts of one recording.
    """
    found = []
    groups = (("", trials), ("holdout", holdout), ("healthy", healthy))
    pairs = [(a, b, role) for role, group in groups[1:] for a in trials for b in group]
    pairs += [(a, b, "") for _, group in groups for a, b in itertools.combinations(group, 2)]
    for first, second, role in pairs:
        if first.digest == second.digest:
            rest = f"a {role} trial must be another one." if role else "it counts once."
            found.append(Finding(f"{second.source} holds the same data as {first.source}; {rest}", bool(role)))
        elif (share := shared_rows(first, second)) > 0.5:
            small, large = (first, second) if role else (second, first)
            rest = f"a {role} trial must be another recording." if role else "two names tell no more than one."
            found.append(Finding(f"{100.0 * share:.0f} % of the rows of {small.source} are in {large.source}, too; "
                                 f"{rest}", bool(role)))
    found.extend(_paces([*trials, *holdout, *healthy]))
    return found


def shared_rows(first: Table, second: Table) -> float:
    """Return the share, 0 … 1, of the rows of the shorter trial that are also in the other one, at any time stamp.

    Two rows are equal if all their signals are equal bit for bit; two recordings of noisy sensors have almost none in
    common.
    """
    names = [name for name, _ in signals_in(first) if name in second and name not in ("time_s", "servo_target_m")]
    names = [n for n in names if not n.startswith("desired")]
    if not any(name.endswith(("_n", "_nm", "_v")) for name in names):  # a motion repeats without noise
        return 0.0
    one, other = (np.unique(np.ascontiguousarray(np.column_stack([t[n] for n in names])).view(
        f"V{8 * len(names)}").ravel()) for t in (first, second))
    return np.intersect1d(one, other, assume_unique=True).size / max(1, min(one.size, other.size))


def _paces(tables: Sequence[Table]) -> Iterator[Finding]:
    """Yield a finding on each trial whose sampling interval is not the median one of the others; one of two trials."""
    steps = [float(np.median(np.diff(t["time_s"]))) for t in tables]
    for k, (given, step) in enumerate(zip(tables[:len(tables) - (len(tables) <= 2)], steps, strict=False)):
        usual = float(np.median([*steps[:k], *steps[k + 1:]]))
        if abs(step / usual - 1.0) > 0.02:
            yield Finding(f"{given.source}: sampled every {step:.4g} s, the others every {usual:.4g} s: another rate, "
                          f"or its clock is off by a factor of {step / usual:.3g}.")
