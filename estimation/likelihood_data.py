"""Data of the likelihood from a trial: signals with one low-pass on one time grid, outputs averaged over bins."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt, sosfreqz

from estimation.data.table import Table
from physics.forward.path_outputs import zero_courses
from physics.laws import Array

LOWPASS_HZ: Final = 40.0
"""Cut-off, Hz, of the low-pass of all signals: the motion of rope and knee has no power above."""
GRID_S: Final = round(1.0 / (2.0 * math.pi * LOWPASS_HZ), 3)
"""Step of the simulation, s: the time constant of the low-pass, in whole milliseconds."""
START_S: Final = 0.4
"""Time left out at the start of a trial, s, since the friction states are unknown there."""
TAUT_N: Final = 3.0
"""START tension, N, up to which the ratio END/START is not computed and is 0.8 instead."""
SIGNALS: Final = ("tension_end_n", "tension_start_n", "servo_force_n")
"""Outputs of the forward model of the bench."""
MOTION: Final = ("servo_position_m", "knee_angle_rad")
"""Inputs of the forward model of the bench."""
NEEDED: Final = (*MOTION, "tension_start_n")
"""Columns that the likelihood of a bench trial needs."""


def lacking(table: Table) -> list[str]:
    """Return the needed columns that a trial does not have."""
    return [name for name in NEEDED if name not in table]


class Recording:
    """Signals of one trial, low-passed alike on one time grid, and its `data`, means over bins of `width` samples.

    A bin is four time constants of the low-pass long, so that the noise of two data is about independent.

    `outputs`: names of the signals in `data`, which holds all bins of one output after the other.  `noise_n`: 1σ of a
    bin's sensor noise by output.  `rows`: numbers of the bins that count, without the start and without gaps.  `along`:
    signals on the time grid against which errors can be plotted.
    """

    data: Array
    along: Mapping[str, Array]

    def __init__(self, table: Table, outputs: Sequence[str], lowpass_hz: float = LOWPASS_HZ,
                 skip_s: float = START_S, motion_hz: float = LOWPASS_HZ) -> None:
        """Sample `outputs` of a trial; `motion_hz`: cut-off of its motion, `skip_s`: time left out at the start."""
        time = table["time_s"]
        self.lowpass_hz, self.width = lowpass_hz, round(4.0 * LOWPASS_HZ / lowpass_hz)
        self.rate = 1.0 / float(np.median(np.diff(time)))
        grid = np.arange(time[0], time[-1], GRID_S)
        self._table, self._grid = table, grid[:grid.size // self.width * self.width]
        self._sos = _lowpass(self.rate, lowpass_hz)
        self.source = table.source
        self.time_s: Array = self._grid - self._grid[0]
        self.progress: Array = self.time_s / self.time_s[-1]
        self._gaps = _gaps(time)
        edge = max(1, round(4.0 * LOWPASS_HZ / motion_hz / self.width))
        self.rows = self._recorded(round(skip_s / GRID_S / self.width), edge)
        self.outputs = tuple(outputs)
        self._signals = {name: self.sampled(name) for name in self.outputs}
        self.noise_n = {name: _noise(table[name], self) for name in self.outputs}

    def _recorded(self, skip: int, edge: int, bridged_s: float = 0.1) -> NDArray[np.intp]:
        """Return the numbers of the bins without `skip` ones at the start, and without those that a gap touches.

        `edge` bins on either side of a gap are left out, too: a low-pass spreads the edge over four of its time
        constants.  Through a gap of up to `bridged_s` the friction states follow a line, since no reversal is as
        short.  After a longer gap they are unknown again, as at the start.
        """
        time, bin_s = self._table["time_s"] - self._table["time_s"][0], self.width * GRID_S
        kept = np.arange(self.time_s.size // self.width) >= skip
        for row in self._gaps:
            first, last = time[row], time[row + 1]
            after = edge + (skip if last - first > bridged_s else 0)
            kept[max(0, int(first / bin_s) - edge):int(last / bin_s) + 1 + after] = False
        return np.flatnonzero(kept)

    def sampled(self, name: str, cutoff_hz: float | None = None) -> Array:
        """Return a column on the time grid after a zero-phase low-pass; `cutoff_hz`: Hz (None: `lowpass_hz`).

        Between two gaps a cubic spline through the time stamps gives even steps, so that no filter and no derivative
        sees an uneven one.  Within a gap the signal is a line.
        """
        sos = self._sos if cutoff_hz is None else _lowpass(self.rate, cutoff_hz)
        time, values = self._table["time_s"], self._table[name]
        at, smooth = [], []
        for rows in np.split(np.arange(time.size), self._gaps + 1):
            even = time[rows[0]] + np.arange(int((time[rows[-1]] - time[rows[0]]) * self.rate + 1e-6) + 1) / self.rate
            part = values[rows] if rows.size < 4 else CubicSpline(time[rows], values[rows])(even)
            at.append(even[:part.size])
            smooth.append(sosfiltfilt(sos, part, padlen=min(3 * (2 * len(sos) + 1), part.size - 1)))
        return np.asarray(np.interp(self._grid, np.concatenate(at), np.concatenate(smooth)))

    def slope(self, values: Array) -> Array:
        """Return the derivative by time of `values` on the time grid, a line within a gap.

        Across a gap's edge the corner of the line would be an acceleration that no row has.
        """
        time, out = self._table["time_s"], np.empty_like(values)
        recorded = np.ones(values.size, bool)
        for row in self._gaps:
            recorded[np.searchsorted(self._grid, time[row], "right"):np.searchsorted(self._grid, time[row + 1])] = False
        edges = np.flatnonzero(np.diff(recorded.astype(int))) + 1
        for part in np.split(np.arange(values.size), edges):
            recorded[part] &= part.size > 1
            if recorded[part[0]]:
                out[part] = np.gradient(values[part], GRID_S)
        return np.asarray(np.interp(self._grid, self._grid[recorded], out[recorded]))

    @cached_property
    def phase(self) -> Array | None:
        """Gait phase of each bin, 0 … 1, NaN outside gait cycles; None if the trial has none."""
        time = self._table["time_s"]
        if "gait_percent" in self._table:
            phase = self._table["gait_percent"] / 100.0 % 1.0
        elif "cycle" in self._table:
            number = np.floor(np.nan_to_num(self._table["cycle"]))
            _, first, count = np.unique(number, return_index=True, return_counts=True)
            phase = np.concatenate([np.arange(n) / n for n in count[np.argsort(first)]])
        else:
            return None
        at = np.searchsorted(time, self.binned(self.time_s) + time[0])
        phase = np.asarray(phase[np.minimum(at, time.size - 1)])
        return phase if np.isfinite(phase).any() else None

    @property
    def bins(self) -> int:
        """Number of data of one output."""
        return self.rows.size

    def binned(self, values: Array) -> Array:
        """Return means over bins, shape (…, bins), of `values`, shape (…, samples), without start and gaps."""
        means = values.reshape(*values.shape[:-1], -1, self.width).mean(axis=-1)
        return np.asarray(means[..., self.rows])

    def part(self, values: Array, output: int) -> Array:
        """Return the rows of output number `output` from `values`, an array over all data."""
        return np.asarray(values[output * self.bins:(output + 1) * self.bins])

    def measured(self, name: str) -> Array:
        """Return a measured output on the time grid, low-passed."""
        return self._signals[name]


class PathRecording(Recording):
    """A trial of the bench: `rope_m`, `knee_rad` and their derivatives, each of shape (samples,).

    Its data are, as far as recorded: END less the measured `ratio` times START; START; servo force, all in N.
    """

    def __init__(self, table: Table) -> None:
        super().__init__(table, [name for name in SIGNALS if name in table])
        self.rope_m, self.knee_rad = self.sampled("servo_position_m"), self.sampled("knee_angle_rad")
        self.rope_m_s = self.slope(self.rope_m)
        self.rope_m_s2 = self.slope(self.rope_m_s)
        self.knee_rad_s2 = self.slope(self.slope(self.knee_rad))
        self.start_n = self.measured("tension_start_n")
        self.ratio = self._ratio()
        if "tension_end_n" in self.noise_n:  # the datum is END less the ratio times START
            self.noise_n["tension_end_n"] = float(np.hypot(
                self.noise_n["tension_end_n"], np.sqrt(np.mean(self.ratio**2)) * self.noise_n["tension_start_n"]))
        slow = sosfiltfilt(butter(2, 15.0, fs=1.0 / GRID_S, output="sos"), self.rope_m_s2)
        self.unresolved_m_s2 = self.rope_m_s2 - slow
        self.along = {"rope_m_s": self.rope_m_s, "servo_position_m": self.rope_m, "knee_angle_rad": self.knee_rad}
        self.data = np.concatenate([self.binned(self.weighed(self._signals, name)) for name in self.outputs])

    @cached_property
    def zero_courses(self) -> Array:
        """Courses of the zero of a sensor over the trial, shape (courses, samples)."""
        return zero_courses(self.progress)

    def weighed(self, signals: dict[str, Array], name: str) -> Array:
        """Return output `name` of measured or predicted `signals`; END less the measured ratio times START for END."""
        if name != "tension_end_n":
            return signals[name]
        return np.asarray(signals[name] - self.ratio * signals["tension_start_n"])

    def _ratio(self) -> Array:
        if "tension_end_n" not in self._signals:
            return np.zeros_like(self.rope_m)
        sos = butter(2, 0.5 * LOWPASS_HZ, fs=1.0 / GRID_S, output="sos")
        start, end = (sosfiltfilt(sos, self._signals[n]) for n in ("tension_start_n", "tension_end_n"))
        return np.asarray(np.clip(np.where(start > TAUT_N, end / np.maximum(start, TAUT_N), 0.8), 0.3, 1.3))


def _gaps(time_s: Array, steps: float = 2.5) -> NDArray[np.intp]:
    """Return the rows before gaps: steps above `steps` usual ones, in which two rows in succession are lost.

    A spline bridges a single row; across more rows it would invent accelerations.
    """
    taken = np.diff(time_s)
    return np.flatnonzero(taken > steps * np.median(taken))


def _noise(values: Array, of: Recording) -> float:
    """Return 1σ of a bin's sensor noise, estimated from third differences, which are about 0 for a smooth signal."""
    sample = float(np.median(np.abs(np.diff(values, 3)))) / 0.6745 / np.sqrt(20.0)
    return float(sample * np.sqrt(_passed(of)))


def _passed(of: Recording) -> float:
    """Return the variance of white noise after low-pass and averaging over a bin, relative to its variance before."""
    frequency = np.linspace(0.0, 0.5 * of.rate, 2001)[1:]
    _, low = sosfreqz(_lowpass(of.rate, of.lowpass_hz), worN=frequency, fs=of.rate)
    mean = np.sin(np.pi * of.width * GRID_S * frequency) / (of.width * np.sin(np.pi * GRID_S * frequency))
    return float(np.mean(np.abs(low) ** 4 * mean**2))


def _lowpass(rate: float, cutoff_hz: float) -> Array:
    return np.asarray(butter(2, min(cutoff_hz, 0.45 * rate), fs=rate, output="sos"))
