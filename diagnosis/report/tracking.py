"""Comparison of two closed-loop trials of one experiment, without and with the extended controller model.

END is the reading of its sensor, and the figures are those of `trial.metrics`; no simulated true value is used.
"""

from pathlib import Path

import numpy as np

from diagnosis.report.residuals import binned
from parameters import InputError
from physics.laws import Array
from trial import read
from trial.read import Trial
from trial.report.compare_page import judged
from trial.report.overview import setting
from trial.report.page import Page
from trial.report.plot import Plot, Series
from trial.signals import FORCE_FIGURES


def section(page: Page, before: str | Path, after: str | Path, colours: tuple[str, str]) -> None:
    """Add the comparison of two gait trials to the page.

    Raises `InputError` if a trial has no gait cycle, or if peak force, period or controller differ.
    """
    trials = [read.open(path) for path in (before, after)]
    for told in ("peak_n", "period_s", "controller"):
        if trials[0].metadata.get(told) != trials[1].metadata.get(told):
            raise InputError(f"{after}: {told} = {trials[1].metadata.get(told)}, but {trials[0].metadata.get(told)} in "
                             f"{before}; give two trials of bowden verify.")
    found = [_figures(trial) for trial in trials]
    page.section("Closed loop")
    page.text(f"The controller {trials[0].metadata.get('controller', '')}, without and with "
              f"{trials[1].metadata.get('controller_model', 'nothing')}: END by its sensor less the desired force.",
              "note")
    page.table(("figure", "unit", "uncompensated", "compensated"), [
        (one.text, one.unit, found[0][one.name], found[1][one.name]) for one in FORCE_FIGURES])
    _error(page, trials, colours)


def _figures(trial: Trial) -> dict[str, float | None]:
    found = judged(trial)
    if not found:
        raise InputError(f"{trial.path}: holds no gait cycle; give two trials of bowden verify.")
    return found


def _error(page: Page, trials: list[Trial], colours: tuple[str, str]) -> None:
    series = []
    for label, trial, colour in zip(("uncompensated", "compensated"), trials, colours, strict=True):
        centres, mean, spread = _by_phase(trial)
        series += [Series(label, mean - spread, colour, high=mean + spread, width=0.3),
                   Series(label, mean, colour, width=1.8)]
    page.plot(Plot("END less desired, by phase: mean and standard deviation over the gait cycles",
              centres, series, "gait_percent (%)", "N", height=260))


def _by_phase(trial: Trial) -> tuple[Array, Array, Array]:
    """Return bins of gait phase, %, with mean and standard deviation of END less desired, N, in each."""
    columns, settle = trial.columns, setting(trial).settle
    error = columns["tension_end_n"] - columns["desired_force_n"]
    counted = (columns["cycle"] >= settle) & np.isfinite(error)
    centres, mean, square = binned(columns["gait_percent"][counted], error[counted], 200, (0.0, 100.0))
    return centres, mean, np.sqrt(np.maximum(square**2 - mean**2, 0.0))
