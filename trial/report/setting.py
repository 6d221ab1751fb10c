"""Settings of a trial that a report needs for its figures: peak, rate, gait cycles.

Values come from the metadata; missing ones are estimated from the columns, and `read_off` lists them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trial.read import Trial
from trial.signals import SIGNALS

Floats = NDArray[np.float64]
SETTLE = 1  # first gait cycles that no figure counts, where nothing else is stated


@dataclass(frozen=True)
class TrialSetting:
    """Peak of the desired force (N), control rate (Hz; None: unknown), gait cycles, and the values taken from the
    columns."""

    peak_n: float | None
    rate_hz: float | None
    cycles: int
    settle: int
    read_off: tuple[str, ...]

    @property
    def period_ns(self) -> float | None:
        """Length of a control cycle."""
        return None if self.rate_hz is None else 1e9 / self.rate_hz


def setting(trial: Trial) -> TrialSetting:
    """Return the setting of a trial, one's own or an imported one."""
    stated = {name: _figure(trial.metadata.get(name)) for name in ("peak_n", "rate_hz", "cycles", "settle")}
    measured = {"peak_n": _peak(trial), "rate_hz": _rate(trial), "cycles": _cycles(trial), "settle": None}
    found = {name: measured[name] if value is None else value for name, value in stated.items()}
    cycles = int(found["cycles"] or 0)
    settle = int(SETTLE if found["settle"] is None else found["settle"])
    read_off = tuple(name for name, value in stated.items() if value is None and measured[name] is not None)
    return TrialSetting(found["peak_n"], found["rate_hz"], cycles, min(settle, max(cycles - 1, 0)), read_off)


def known(trial: Trial, name: str) -> Floats | None:
    """Return a column that has a known value somewhere, or None."""
    column = trial.columns.get(name)
    return column if column is not None and np.isfinite(column).any() else None


def unknown(trial: Trial) -> list[str]:
    """Return the declared signals that the trial does not have."""
    return [signal.name for signal in SIGNALS if known(trial, signal.name) is None]


def seconds(trial: Trial, time_ns: NDArray[np.int64]) -> Floats:
    """Return times as seconds from the trial's first control cycle, or from its first frame where it has none."""
    first = int(trial.time_ns[0]) if len(trial.time_ns) else int(time_ns.min(initial=0))
    return (time_ns - first) / 1e9


def _figure(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if np.isfinite(value) and value >= 0 else None


def _peak(trial: Trial) -> float | None:
    desired = known(trial, "desired_force_n")
    peak = 0.0 if desired is None else float(np.nanmax(desired))
    return peak or None


def _rate(trial: Trial) -> float | None:
    return 1e9 / float(np.median(np.diff(trial.time_ns))) if len(trial.time_ns) > 1 else None


def _cycles(trial: Trial) -> float | None:
    cycle = known(trial, "cycle")
    return None if cycle is None else max(float(np.nanmax(cycle)) + 1, 0.0)
