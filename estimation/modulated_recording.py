"""Course of a recorded trial under a forward model, and modulations of constants averaged over the bins of its data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from estimation.forward_model import ForwardModel
from estimation.likelihood_data import GRID_S, Recording
from physics.laws import Array
from physics.terms import Course, Modulation


class ModulatedRecording(NamedTuple):
    """Course of one trial on its simulation grid; `end_n`: the model's END tension."""

    course: Course
    end_n: Array
    trial: Recording

    def of(self, carrier: str) -> Course:
        """Return the course with the tension that a carrier feels: END's if it is a constant of END."""
        return self.course._replace(tension_n=self.end_n) if carrier.startswith("end_") else self.course

    def bins(self, carrier: str, modulation: Modulation, grid: Sequence[Mapping[str, float]]) -> Array:
        """Return the components of a modulation, low-passed and averaged over bins as the data.

        `grid`: sets of its parameters.  Shape (bins, sets · components).
        """
        course = self.of(carrier)
        parts = np.array([part for parameters in grid for part in modulation.function(course, parameters)])
        low = butter(2, self.trial.lowpass_hz, fs=1.0 / GRID_S, output="sos")
        return np.ascontiguousarray(self.trial.binned(np.asarray(sosfiltfilt(low, parts))).T)


def modulated(model: ForwardModel, q: Array, trial: Recording) -> ModulatedRecording:
    """Return the signals of a trial that modulations depend on; the tensions are the model's at coordinates `q`.

    The gait phase is held within a bin.
    """
    time, phase, whole = np.asarray(GRID_S * np.arange(trial.time_s.size)), trial.phase, None
    if phase is not None:
        known, at = np.isfinite(phase), trial.binned(time)
        turned = np.interp(time, at[known], np.unwrap(2.0 * np.pi * phase[known]))
        whole = np.where(np.interp(time, at, known) > 0.5, turned / (2.0 * np.pi) % 1.0, np.nan)
    position, speed, start, end, joint = model.course(q, trial)
    return ModulatedRecording(Course(time, position, speed, start, joint, whole), end, trial)
