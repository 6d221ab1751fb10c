"""Settings of a trial that a report needs for its figures: peak, rate, gait cycles.

Values come from the metadata; missing ones are estimated from the columns, and `read_off` lists them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trial.read import Trial, TrialFile
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


def setting(trial: TrialFile) -> TrialSetting:
    """Return the setting of a trial, one's own or an imported one."""
    stated = {name: _figure(trial.metadata.get(name)) for name in ("peak_n", "rate_hz", "cycles", "settle")}
    readers = {"peak_n": lambda trial: _greatest(trial, "desired_force_n") or None, "rate_hz": _rate, "cycles": _cycles}
    measured = {name: readers[name](trial) if value is None and name in readers else None
                for name, value in stated.items()}
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


def seconds(trial: TrialFile, time_ns: NDArray[np.int64]) -> Floats:
    """Return times as seconds from the trial's first control cycle, or from the first of them where it has none."""
    first = trial.extent.first_ns if trial.extent.rows else int(time_ns.min(initial=np.iinfo(np.int64).max))
    return (time_ns - first) / 1e9


def _figure(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if np.isfinite(value) and value >= 0 else None


def _rate(trial: TrialFile) -> float | None:
    block = next(trial.blocks([]), None)
    return None if block is None or len(block.time_ns) < 2 else 1e9 / float(np.median(np.diff(block.time_ns)))


def _cycles(trial: TrialFile) -> float | None:
    greatest = _greatest(trial, "cycle")
    return None if greatest is None else max(greatest + 1, 0.0)


def _greatest(trial: TrialFile, name: str) -> float | None:
    """Return the greatest value of a column, None without any."""
    found = [float(np.nanmax(columns[name])) for _, columns in trial.blocks([name] if name in trial.units else [])
             if name in columns and np.isfinite(columns[name]).any()]
    return max(found, default=None)
