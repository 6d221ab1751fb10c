"""Bounds of a person's file that are the bench's: tension at START, its rise, and the speed of the rope.

They follow from healthy trials of the bench without a limb, by the quantities of the safety monitor's own checks.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

import safety_monitor
from bowden.deferred import on_first_use
from parameters import InputError
from safety_monitor.checks import LOOSE_N, LOOSE_SHARE, MS, ROPE_AHEAD, ROPE_SPAN, STEP_NS, WINDOW
from safety_monitor.person import RANGES, PersonError, checked

with on_first_use():
    from trial import read
    from trial.read import TrialFile

BENCH_MARGIN: Final = 1.25
"""Bounds that are the bench's, relative to the largest values of its trials.

Chosen: sessions differ by 10 % of friction and by stiffness, homing and pace.  If it is too small, healthy trials are
stopped; if it is too large, a fault is stopped later."""
SLOWEST_HZ: Final = 1e9 / (WINDOW * STEP_NS)
"""Least rate of a recording, Hz: the rise of a tension is taken over 3 ms."""
NAMES: Final = MappingProxyType({
    "start_n": "tension at START", "force_rate_n_s": "rise of a tension", "rope_m_s": "speed of the rope"})
"""Bounds in a person's file that depend on the bench alone: key, and quantity in words."""
PHASE: Final = "gait_percent"
"""Column that is known from the first control cycle after homing on."""
LIMB: Final = re.compile(r'(?m)^limb = "[^"]')


class BenchBound(NamedTuple):
    """One bound: its key, the largest value of the trials, and the numbers in the person's file and in the new one.

    All in the unit of the key (`safety_monitor.person.RANGES`).
    """

    key: str
    largest: float
    before: float
    after: float


def of_trials(trials: Sequence[Path], person: Path) -> tuple[list[BenchBound], str]:
    """Return the bounds that are the bench's, and the text of the person's file with them.

    A bound of the person's file that the bench needs larger becomes `BENCH_MARGIN` of the largest value, rounded up to
    three digits; no bound becomes smaller.  Raises `InputError` for a person's file that cannot be used, and for a
    bound beyond its range.  So it does for a trial that was stopped, had its drives off, moved a limb, has no gait or
    is slower than `SLOWEST_HZ`.
    """
    try:
        bounds, text = safety_monitor.read(person), person.read_text(encoding="utf-8")
    except PersonError as error:
        raise InputError(str(error)) from None
    largest = dict.fromkeys(NAMES, 0.0)
    for file in trials:
        for values in map(_values, _paths(file)):
            largest = {key: max(most, values[key]) for key, most in largest.items()}
    found = []
    for key, most in largest.items():
        before, (unit, _, greatest) = getattr(bounds, key), RANGES[key]
        after = max(before, _rounded_up(BENCH_MARGIN * most))
        if after > greatest:
            raise InputError(f"{trials[0]}: {key} would be {after:g} {unit} ({BENCH_MARGIN} times {most:.3g}), a "
                             f"person's file may have {greatest:g}; run the bench with less force or more slowly.")
        found.append(BenchBound(key, most, before, after))
        if after > before:
            text = re.sub(rf"(?m)^(\s*{key}\s*=\s*)[^\s#]+", rf"\g<1>{after:g}", text)
    written = checked(tomllib.loads(text), str(person), bounds.sha256)
    for bound in found:
        if getattr(written, bound.key) != bound.after:  # a key in quotes, or two on a line
            raise InputError(f"{person}: the line of {bound.key} cannot be rewritten; write it as "
                             f"{bound.key} = {bound.before:g}, on a line of its own.")
    return found, text


def _paths(file: Path) -> list[TrialFile]:
    trial = read.open_file(file)
    reason = (trial.result or {}).get("stop_reason")
    if trial.result is None or reason:
        raise InputError(f"{file}: {f'was stopped ({reason})' if reason else 'has no end'}, so that its largest values "
                         "are not those of a healthy trial; name one that was completed.")
    if trial.metadata.get("dry_run") == "true":
        raise InputError(f"{file}: is a dry run, in which the drives were off; name a trial that moved the bench.")
    if LIMB.search(trial.attachments.get("bench.toml", b"").decode("utf-8", "replace")):
        raise InputError(f"{file}: moved a limb ([record] limb); record a trial of the bench with a leg model.")
    return [read.one_path(trial, name) for name in read.path_names(trial)] or [trial]


def _values(trial: TrialFile) -> dict[str, float]:
    """Return the largest value of each quantity in the gait of one force path, as the safety monitor takes it."""
    names = ("servo_position_m", "tension_start_n", "tension_end_n", PHASE)
    if missing := [name for name in names if name not in trial.units]:
        raise InputError(f"{trial.path}: has no column {missing[0]}; name a gait trial of `bowden trial`.")
    blocks = list(trial.blocks(names))
    phase = np.concatenate([block.columns[PHASE] for block in blocks])
    gait = slice(int(np.argmax(np.isfinite(phase))), None)  # homing before it sets a zero: a step of the position
    at_ns = np.concatenate([block.time_ns for block in blocks])[gait]
    period_ns = float(np.median(np.diff(at_ns))) if np.isfinite(phase).any() and len(at_ns) > WINDOW else np.inf
    if period_ns > WINDOW * STEP_NS:
        raise InputError(f"{trial.path}: has no gait at {SLOWEST_HZ:.0f} control cycles a second or more, from which a "
                         f"tension's rise over {WINDOW * STEP_NS / MS:g} ms follows; name a gait trial at that --rate.")
    rope, *tensions = (np.concatenate([block.columns[name] for block in blocks])[gait] for name in names[:3])
    tensions = [tension for tension in tensions if np.isfinite(tension).any()]  # a force path may have START alone
    speed = np.diff(rope) * 1e9 / np.diff(at_ns)
    ahead = speed[1:] + np.diff(speed) / period_ns * (ROPE_AHEAD * ROPE_SPAN * STEP_NS)
    ahead[tensions[0][2:] < LOOSE_N] /= LOOSE_SHARE
    steps_ns = np.arange(at_ns[0], at_ns[-1], STEP_NS)
    courses = [np.interp(steps_ns, at_ns[known], tension[known])
               for tension in tensions for known in [np.isfinite(tension)]]
    rises = [float(np.max(course[WINDOW:] - course[:-WINDOW])) * 1e9 / (WINDOW * STEP_NS) for course in courses]
    return {"start_n": float(np.max(np.abs(courses[0]))), "force_rate_n_s": max(rises),
            "rope_m_s": float(np.nanmax(ahead))}


def _rounded_up(value: float) -> float:
    """Return a positive number rounded up to three digits."""
    digit = 10.0 ** (np.floor(np.log10(value)) - 2) if value > 0.0 else 1.0
    return float(f"{np.ceil(value / digit) * digit:.3g}")


__all__ = ["BENCH_MARGIN", "NAMES", "SLOWEST_HZ", "BenchBound", "of_trials"]
