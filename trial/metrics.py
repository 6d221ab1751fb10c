"""Figures of merit of a trial, computed from its columns.

Pure functions over arrays; a figure that the data cannot give equals None, never a guess. Rows are scored in complete
gait cycles, without the first `settle`. END is taken as recorded at the latch that also holds the desired force. In
the idle and jump figures it is low-passed first: Butterworth of second order at 20 Hz, forwards and backwards (no
phase, −6 dB at 20 Hz); true END never is.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trial.low_pass import zero_phase

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

WINDOW_PERCENT = (10.0, 30.0)  # where the paper's force is not zero, formula (2)
IDLE_OUTSIDE_PERCENT = (8.0, 32.0)  # two percent of the gait away from it
PEAK_PERCENT = 2.0  # either side of the peak
JUMP_S = 0.020
LOWPASS_HZ = 20.0
MISSING_SHARE = 0.01  # of the scored rows: with more of them unknown there is no figure


def figures(
    columns: Mapping[str, Floats], *, peak_n: float, rate_hz: float, cycles: int, settle: int,
    true_end_n: Floats | None = None,
) -> dict[str, float | None]:
    """Return the eight force figures of a trial by their `--json` names, in percent of `peak_n` or in N.

    `columns` needs gait_percent, cycle, desired_force_n and tension_end_n, one row a control cycle at `rate_hz`.
    `true_end_n` has their length; it is omitted (None) if the true force is unknown. `settle` < `cycles` are numbers
    of gait cycles.
    """
    scored = (columns["cycle"] >= settle) & (columns["cycle"] < cycles)
    return _both(columns, scored, peak_n, rate_hz, true_end_n)


def per_cycle(
    columns: Mapping[str, Floats], *, peak_n: float, rate_hz: float, cycles: int, true_end_n: Floats | None = None
) -> list[dict[str, float | None]]:
    """Return the figures of each gait cycle, stride by stride, from cycle 0; arguments and names as in `figures`."""
    return [_both(columns, columns["cycle"] == cycle, peak_n, rate_hz, true_end_n) for cycle in range(cycles)]


def _both(
    columns: Mapping[str, Floats], scored: Mask, peak_n: float, rate_hz: float, true_end_n: Floats | None
) -> dict[str, float | None]:
    phase, desired, end = columns["gait_percent"], columns["desired_force_n"], columns["tension_end_n"]
    found = _figures(phase, desired, end, lowpass(end, rate_hz), scored, peak_n, rate_hz)
    if true_end_n is None:
        true: dict[str, float | None] = dict.fromkeys(found)
    else:
        true = _figures(phase, desired, true_end_n, true_end_n, scored, peak_n, rate_hz)
    return found | {f"true_{name}": figure for name, figure in true.items()}


def _figures(
    phase: Floats, desired: Floats, end: Floats, smooth: Floats | None, scored: Mask, peak_n: float, rate_hz: float
) -> dict[str, float | None]:
    window = scored & between(phase, *WINDOW_PERCENT)
    idle = scored & ~between(phase, *IDLE_OUTSIDE_PERCENT)
    return {
        "relative_rmse_percent": relative_rmse(end - desired, scored, peak_n),
        "relative_rmse_window_percent": relative_rmse(end - desired, window, peak_n),
        "max_idle_tension_n": None if smooth is None else largest(smooth, idle),
        "peak_jump_n": None if smooth is None else peak_jump(smooth - desired, phase, desired, scored, rate_hz),
    }


def between(phase: Floats, low: float, high: float) -> Mask:
    """Return where `phase` lies in low … high, both included."""
    return (phase >= low) & (phase <= high)


def known(values: Floats, rows: Mask) -> Floats | None:
    """Return the values in `rows` without unknown ones; None where too many are unknown, or there are none."""
    chosen = values[rows]
    good = chosen[np.isfinite(chosen)]
    if len(good) == 0 or len(chosen) - len(good) > MISSING_SHARE * len(chosen):
        return None
    return good


def relative_rmse(error: Floats, rows: Mask, peak_n: float) -> float | None:
    """Return the root mean square of `error` (N) over `rows`, in percent of the peak."""
    good = known(error, rows)
    return None if good is None else float(100 * np.sqrt(np.mean(good**2)) / peak_n)


def largest(values: Floats, rows: Mask) -> float | None:
    """Return the largest magnitude in `rows`."""
    good = known(values, rows)
    return None if good is None else float(np.abs(good).max())


def peak_jump(error: Floats, phase: Floats, desired: Floats, scored: Mask, rate_hz: float) -> float | None:
    """Return the largest change of `error` over 20 ms, both ends within 2 % of the peak of one gait cycle."""
    if known(desired, scored) is None:
        return None
    peak = phase[np.flatnonzero(scored)[np.nanargmax(desired[scored])]]
    near = scored & between(phase, peak - PEAK_PERCENT, peak + PEAK_PERCENT)
    lag = max(1, round(JUMP_S * rate_hz))
    if lag >= len(error):
        return None
    both = near[lag:] & near[:-lag] & (phase[lag:] > phase[:-lag])
    return largest(error[lag:] - error[:-lag], both)


def lowpass(values: Floats, rate_hz: float) -> Floats | None:
    """Return `values` low-passed at 20 Hz without phase; unknown ones are bridged for it and stay unknown."""
    good = np.isfinite(values)
    if rate_hz <= 2 * LOWPASS_HZ or good.sum() < 16:
        return None
    rows = np.arange(len(values))
    bridged = np.interp(rows, rows[good], values[good])
    smooth = zero_phase(bridged, LOWPASS_HZ, rate_hz)
    return np.where(good, smooth, np.nan)


def missed_cycles(columns: Mapping[str, Floats]) -> int:
    """Return how many control cycles missed the deadline with their inputs or their outputs."""
    return int(np.count_nonzero((columns["missed_inputs"] > 0) | (columns["missed_outputs"] > 0)))


def stale_inputs(columns: Mapping[str, Floats], period_ns: int) -> int:
    """Return how many PDOs that an earlier SYNC had latched reached a step of the controller."""
    stepped = columns["held"] == 0
    ages = [column for name, column in columns.items() if name.endswith("_pdo_age_ns")]
    return int(sum(np.count_nonzero(stepped & (age >= period_ns)) for age in ages))
