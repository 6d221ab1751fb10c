"""Figures of merit of a trial, computed from its columns.

Pure functions over arrays; a figure that the data cannot give equals None, never a guess. Rows are scored in complete
gait cycles, without the first `settle`. END is taken as recorded at the latch that also holds the desired force. In
the idle and jump figures it is low-passed first: Butterworth of second order at 20 Hz, forwards and backwards (no
phase, −6 dB at 20 Hz); true END never is. The filter needs no SciPy, whose import takes longer than a short trial.

A stride that differs is judged twice: against the force that was asked for, by the phase that was felt, which is what
control can do; and against the desired force at the true phase of the stride that is played, which holds the error of
the phase as well.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trial.signals import FORCE_FIGURES

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

END, TRUE_END = "tension_end_n", "true_end_n"
NEEDED = ("gait_percent", "cycle", "desired_force_n", END)
FIGURES = tuple(figure.name for figure in FORCE_FIGURES)
WINDOW_PERCENT = (10.0, 30.0)  # where the paper's force is not zero, formula (2)
IDLE_OUTSIDE_PERCENT = (8.0, 32.0)  # two percent of the gait away from it
PEAK_PERCENT = 2.0  # either side of the peak
JUMP_S = 0.020
LOWPASS_HZ = 20.0
MARGIN_S = 0.5
"""Rows that the low-pass of a block takes from its neighbours, s: the filter forgets its start by e⁻⁴⁴."""
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
    block = {name: columns[name] for name in NEEDED} | ({} if true_end_n is None else {TRUE_END: true_end_n})
    return figures_of_blocks(lambda: [block], peak_n=peak_n, rate_hz=rate_hz, cycles=cycles, settle=settle)


def figures_of_blocks(
    blocks: Callable[[], Iterable[Mapping[str, Floats]]], *, peak_n: float, rate_hz: float, cycles: int, settle: int
) -> dict[str, float | None]:
    """Return the figures of a trial that is read by block; names and arguments as in `figures`.

    `blocks()` begins anew at the first row; each block has the columns `NEEDED`, and `TRUE_END` if it is known.
    """
    peak = _phase_of_peak(blocks(), cycles, settle)
    margin, lag = round(MARGIN_S * rate_hz), max(1, round(JUMP_S * rate_hz))
    sums: dict[str, dict[str, Magnitudes]] = {}
    for columns, own in _with_margins(blocks(), margin):
        scored = (columns["cycle"] >= settle) & (columns["cycle"] < cycles)
        for name in (END, TRUE_END):
            if name in columns:
                found = sums.setdefault(name, {figure: Magnitudes() for figure in FIGURES})
                smooth = lowpass(columns[END], rate_hz) if name == END else columns[name]
                _add(found, columns, columns[name], smooth, scored, own, peak, lag)
    measured = _read(sums.get(END, {}), peak_n)
    return measured | {f"true_{name}": figure for name, figure in _read(sums.get(TRUE_END, {}), peak_n).items()}


@dataclass
class Magnitudes:
    """Square sum and largest magnitude of values that come in parts, and how many of them are unknown."""

    rows: int = 0
    known: int = 0
    squares: float = 0.0
    largest: float = 0.0

    def add(self, values: Floats) -> None:
        """Add values, NaN where unknown."""
        good = values[np.isfinite(values)]
        self.rows, self.known = self.rows + len(values), self.known + len(good)
        self.squares += float(np.sum(good**2))
        self.largest = max(self.largest, float(np.abs(good).max(initial=0.0)))

    @property
    def counts(self) -> bool:
        """Whether there are values, and few enough are unknown."""
        return self.known > 0 and self.rows - self.known <= MISSING_SHARE * self.rows

    def relative_rms(self, peak_n: float) -> float | None:
        """Return the root mean square in percent of the peak, None if too many values are unknown."""
        return 100 * math.sqrt(self.squares / self.known) / peak_n if self.counts else None


def _phase_of_peak(blocks: Iterable[Mapping[str, Floats]], cycles: int, settle: int) -> float | None:
    """Return the phase of the first largest desired force, %; None if too much of it is unknown."""
    desired, highest, phase = Magnitudes(), -math.inf, None
    for columns in blocks:
        rows = np.flatnonzero((columns["cycle"] >= settle) & (columns["cycle"] < cycles))
        values = columns["desired_force_n"][rows]
        desired.add(values)
        if np.isfinite(values).any() and float(np.nanmax(values)) > highest:
            highest, phase = float(np.nanmax(values)), float(columns["gait_percent"][rows[np.nanargmax(values)]])
    return phase if desired.counts else None


def _with_margins(
    blocks: Iterable[Mapping[str, Floats]], margin: int
) -> Iterator[tuple[Mapping[str, Floats], slice]]:
    """Yield each block with up to `margin` rows of its neighbours on both sides, and its own rows among them."""
    before: Mapping[str, Floats] | None = None
    current: Mapping[str, Floats] | None = None
    for following in chain(blocks, [None]):
        if current is not None:
            first, count = (0 if before is None else len(before["cycle"])), len(current["cycle"])
            parts = [before, current, following and {name: one[:margin] for name, one in following.items()}]
            joined = {name: np.concatenate([part[name] for part in parts if part]) for name in current}
            yield joined, slice(first, first + count)
            before = {name: one[:first + count][-margin:] for name, one in joined.items()}
        current = following


def _add(
    found: dict[str, Magnitudes], columns: Mapping[str, Floats], end: Floats, smooth: Floats | None, scored: Mask,
    own: slice, peak: float | None, lag: int,
) -> None:
    """Add the `own` rows of a block with margins to the four figures of one END."""
    phase, error = columns["gait_percent"], end - columns["desired_force_n"]
    inside = np.zeros(len(phase), bool)
    inside[own] = True
    scored_own = scored & inside
    found["relative_rmse_percent"].add(error[scored_own])
    found["relative_rmse_window_percent"].add(error[scored_own & between(phase, *WINDOW_PERCENT)])
    if smooth is None:
        smooth = np.full(len(end), np.nan)
    found["max_idle_tension_n"].add(smooth[scored_own & ~between(phase, *IDLE_OUTSIDE_PERCENT)])
    if peak is not None and lag < len(error):
        change = smooth - columns["desired_force_n"]
        near = scored & between(phase, peak - PEAK_PERCENT, peak + PEAK_PERCENT)
        both = near[lag:] & near[:-lag] & (phase[lag:] > phase[:-lag]) & inside[lag:]
        found["peak_jump_n"].add((change[lag:] - change[:-lag])[both])


def _read(found: Mapping[str, Magnitudes], peak_n: float) -> dict[str, float | None]:
    read = {name: found.get(name, Magnitudes()) for name in FIGURES}
    return {name: read[name].relative_rms(peak_n) if name.endswith("_percent") else
            read[name].largest if read[name].counts else None for name in FIGURES}


def between(phase: Floats, low: float, high: float) -> Mask:
    """Return where `phase` lies in low … high, both included."""
    return (phase >= low) & (phase <= high)


def relative_rmse(error: Floats, rows: Mask, peak_n: float) -> float | None:
    """Return the root mean square of `error` (N) over `rows`, in percent of the peak."""
    found = Magnitudes()
    found.add(error[rows])
    return found.relative_rms(peak_n)


def lowpass(values: Floats, rate_hz: float) -> Floats | None:
    """Return `values` low-passed at 20 Hz without phase; unknown ones are bridged for it and stay unknown."""
    good = np.isfinite(values)
    if rate_hz <= 2 * LOWPASS_HZ or good.sum() < 16:
        return None
    rows = np.arange(len(values))
    bridged = np.interp(rows, rows[good], values[good])
    smooth = zero_phase(bridged, LOWPASS_HZ, rate_hz)
    return np.where(good, smooth, np.nan)


EDGE = 9
"""Samples by which a signal is continued at both ends, point-symmetric: three times the filter's taps."""


def zero_phase(values: Floats, cutoff_hz: float, rate_hz: float) -> Floats:
    """Return a signal filtered forward and backward by a second-order Butterworth low-pass.

    The signal has more than `EDGE` samples; the bilinear transform keeps the cut-off exact.
    """
    k = math.tan(math.pi * cutoff_hz / rate_hz)
    norm = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    b0, a1, a2 = k * k * norm, 2.0 * (k * k - 1.0) * norm, (1.0 - math.sqrt(2.0) * k + k * k) * norm
    longer = np.concatenate([2.0 * values[0] - values[EDGE:0:-1], values,
                             2.0 * values[-1] - values[-2:-EDGE - 2:-1]])
    return _filtered(_filtered(longer, b0, a1, a2)[::-1].copy(), b0, a1, a2)[::-1][EDGE:-EDGE].copy()


@njit(cache=True)
def _filtered(values: Floats, b0: float, a1: float, a2: float) -> Floats:
    """Return the output of the filter b0·(1 + z⁻¹)²/(1 + a1·z⁻¹ + a2·z⁻²) that was at rest at the first value."""
    first, second = (1.0 - b0) * values[0], (b0 - a2) * values[0]
    made = np.empty_like(values)
    for i in range(values.size):
        x = values[i]
        y = b0 * x + first
        first = 2.0 * b0 * x - a1 * y + second
        second = b0 * x - a2 * y
        made[i] = y
    return made


STRIDE_COLUMNS = ("cycle", "stride_percent", "gait_percent", "desired_force_n", "phase_doubt_percent", "phase_share",
                  "true_phase_force_n", END)
STRIDE_TABLE = ("stride", "kind", "period_s", "rmse_percent", "true_phase_rmse_percent", "phase_error_rms_percent",
                "idle_n", "off_phase_ms")
"""Figures of a stride that a table shows."""
OFF_N, APART_PERCENT = 3.0, 10.0
"""Error of END, N, and of the felt phase, % of the gait, beyond which a force counts as off phase."""
NO_PHASE_PERCENT = 28.8
"""Standard deviation of a phase that is not known: evenly spread over a gait, 100/√12."""


def stride_columns(blocks: Iterable[Mapping[str, Floats]]) -> dict[str, Floats]:
    """Return the columns `STRIDE_COLUMNS` of successive blocks of a trial."""
    parts = list(blocks)
    return {name: np.concatenate([part[name] for part in parts] or [np.empty(0)]) for name in STRIDE_COLUMNS}


def stride_figures(
    columns: Mapping[str, Floats], *, peak_n: float, rate_hz: float, settle: int,
    true_end_n: Floats | None = None,
) -> dict[str, Any]:
    """Return the figures of a walk, by their `--json` names, and those of each stride, `by_stride`.

    `columns`: `STRIDE_COLUMNS`.  The first `settle` strides count in no figure.
    """
    end = lowpass(columns["tension_end_n"], rate_hz) if true_end_n is None else true_end_n
    if end is None:
        end = columns["tension_end_n"]
    numbers = np.unique(columns["cycle"][columns["cycle"] >= 0]).astype(int)
    strides = [_stride(columns, columns["cycle"] == k, int(k), end, peak_n, rate_hz) for k in numbers]
    counted = [one for one in strides if one["stride"] >= settle]
    walked = [one for one in counted if one["kind"] == "walk"]
    assisted = [one for one in walked if one["assisted"]]
    errors = [one["phase_error_rms_percent"] for one in walked if one["phase_error_rms_percent"] is not None]
    return {
        "strides": len(walked), "assisted": len(assisted),
        "rmse_percent": _spread([one["rmse_percent"] for one in walked]),
        "true_phase_rmse_percent": _spread([one["true_phase_rmse_percent"] for one in assisted]),
        "idle_n": max((one["idle_n"] for one in counted if one["idle_n"] is not None), default=None),
        "phase_error_rms_percent": float(np.sqrt(np.mean(np.square(errors)))) if errors else None,
        "off_phase_ms": max((one["off_phase_ms"] for one in counted), default=None),
        "interrupted": sum(one["kind"] != "walk" for one in counted),
        "judged_by": "END sensor" if true_end_n is None else "true END",
        "by_stride": strides,
    }


def _stride(
    columns: Mapping[str, Floats], rows: Mask, number: int, end: Floats, peak_n: float, rate_hz: float,
) -> dict[str, Any]:
    true, felt, asked, true_desired_n = (columns[name] for name in (
        "stride_percent", "gait_percent", "desired_force_n", "true_phase_force_n"))
    unknown = np.isnan(true)
    error = np.mod(felt - true + 50.0, 100.0) - 50.0
    known = rows & ~unknown & (columns["phase_doubt_percent"] < NO_PHASE_PERCENT)
    kind = "rest" if unknown[rows].all() else "stumble" if unknown[rows].any() else "walk"
    off = rows & (unknown | (known & (np.abs(error) > APART_PERCENT))) & (end - true_desired_n > OFF_N)
    idle = end[rows & (asked == 0.0) & ~between(felt, *IDLE_OUTSIDE_PERCENT)]
    return {
        "stride": number, "kind": kind, "period_s": float(rows.sum() / rate_hz),
        "assisted": bool((columns["phase_share"][rows & (true_desired_n > 0.0)] == 1.0).all()),
        "rmse_percent": relative_rmse(end - asked, rows, peak_n),
        "true_phase_rmse_percent": relative_rmse(end - true_desired_n, rows, peak_n),
        "phase_error_rms_percent": float(np.sqrt(np.mean(error[known] ** 2))) if known.any() else None,
        "idle_n": float(np.nanmax(np.abs(idle))) if np.isfinite(idle).any() else None,
        "off_phase_ms": 1e3 * _longest(off) / rate_hz,
    }


def _longest(rows: Mask) -> int:
    """Return the length of the longest run of true rows."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], rows.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0


def _spread(values: Sequence[float | None]) -> dict[str, float | None]:
    known = [value for value in values if value is not None]
    if not known:
        return {"median": None, "percentile_95": None, "worst": None}
    return {"median": float(np.median(known)), "percentile_95": float(np.percentile(known, 95)),
            "worst": float(max(known))}
