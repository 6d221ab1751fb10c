"""Figures of a trial whose strides differ: force and phase, stride by stride.

Pure functions over columns.  A stride is judged twice: against the force that was asked for, by the phase that was
felt, which is what control can do; and against the desired force at the true phase of the stride that is played, which
holds the error of the phase as well.  END is true END where it is known, else that of the sensor, low-passed as in
`trial.metrics`.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trial.metrics import IDLE_OUTSIDE_PERCENT, Floats, Mask, between, lowpass, relative_rmse

NEEDED = ("cycle", "stride_percent", "gait_percent", "desired_force_n", "phase_doubt_percent", "phase_share",
          "true_phase_force_n", "tension_end_n")
SHOWN = ("stride", "kind", "period_s", "rmse_percent", "true_phase_rmse_percent", "phase_error_rms_percent", "idle_n",
         "off_phase_ms")
"""Figures of a stride that a table shows."""
OFF_N, APART_PERCENT = 3.0, 10.0
"""END beyond which a force without a phase counts, N; distance of felt and true phase from which on they are apart."""
NO_PHASE_PERCENT = 28.8
"""Standard deviation of a phase that is not known: evenly spread over a gait, 100/√12."""


def columns_of(blocks: Iterable[Mapping[str, Floats]]) -> dict[str, Floats]:
    """Return the columns `NEEDED` of successive blocks of a trial."""
    parts = list(blocks)
    return {name: np.concatenate([part[name] for part in parts] or [np.empty(0)]) for name in NEEDED}


def figures(
    columns: Mapping[str, Floats], *, peak_n: float, rate_hz: float, settle: int,
    true_end_n: Floats | None = None,
) -> dict[str, Any]:
    """Return the figures of a walk, by their `--json` names, and those of each stride, `by_stride`.

    `columns`: `NEEDED`.  The first `settle` strides count in no figure.
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
    return {
        "stride": number, "kind": kind, "period_s": float(rows.sum() / rate_hz),
        "assisted": bool((columns["phase_share"][rows & (true_desired_n > 0.0)] == 1.0).all()),
        "rmse_percent": relative_rmse(end - asked, rows, peak_n),
        "true_phase_rmse_percent": relative_rmse(end - true_desired_n, rows, peak_n),
        "phase_error_rms_percent": float(np.sqrt(np.mean(error[known] ** 2))) if known.any() else None,
        "idle_n": _largest(end[rows & (asked == 0.0) & ~between(felt, *IDLE_OUTSIDE_PERCENT)]),
        "off_phase_ms": 1e3 * _longest(off) / rate_hz,
    }


def _largest(values: Floats) -> float | None:
    return float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else None


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
