"""Trials of an unattended repair: their time, the reasons for which they end, and END's error in them.

END's reading decides, by its departure from the reference trial: an error of the sensor itself is in both.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bowden.bench import configuration
from bowden.bench.buses import BusSettings
from bowden.mending.journal import Journal
from bowden.model_files import BenchModel
from bowden.progress import Progress
from bowden.trials import recorded, session
from bowden.trials.experiment import GAIT, Experiment
from bowden.trials.recorded_trial import Trial
from bowden.trials.session import PreparedTrial
from estimation.data.table import NOMINAL
from parameters import InputError
from physics import bench_model
from trial import read

Floats = NDArray[np.float64]

STOPS: Final = 2
"""Number of stopped trials at which the run ends: one may be chance, two are the bench."""
BINS: Final = 100
"""Parts of the gait over which END is averaged from cycle to cycle: 1 % each, the step of the paper's tables."""
INTERRUPTED: Final = "interrupted"
"""Beginning of the stop reason of a trial that the operator stopped."""


class EndedNightError(Exception):
    """The run ends here; the text is the reason."""


def end_error(trial: Trial) -> Floats:
    """Return END less the desired force, N, by part of the gait, mean of the cycles after the first; NaN: unknown."""
    error = trial.columns["tension_end_n"] - trial.columns["desired_force_n"]
    kept = np.isfinite(error) & (trial.columns["cycle"] >= 1)
    part = np.minimum(BINS * trial.columns["gait_percent"][kept] / 100.0, BINS - 1).astype(int)
    count = np.bincount(part, minlength=BINS)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(part, error[kept], BINS) / count)


class NightTrials:
    """Trials of a run in `folder`, each a step of its `journal`, within `hours` of bench time.

    `asked`: configuration, cycles and bit rate of every trial.  `gait`: the reference gait of the greatest peak, in the
    trial `walked`.  `plain`: the calibration of the reference trials, None for the packaged nominal one.
    """

    def __init__(self, reference: Sequence[Path], folder: Path, bus: BusSettings, hours: float, asked: Experiment,
                 progress: Progress) -> None:
        self.folder, self.bus, self.progress = folder, bus, progress
        trials = [_reference_trial(path) for path in reference]
        _refuse_other_bench(reference, None if asked.configuration is None else Path(asked.configuration))
        self.plain = _calibration(trials[0])
        gaits = [trial for trial in trials if trial.metadata.get("experiment", GAIT) == GAIT]
        if not gaits:
            raise InputError("mend: no reference trial is a gait; record one with bowden trial.")
        walked = max(gaits, key=lambda trial: float(trial.metadata["peak_n"]))
        self.walked = Path(walked.path)
        self.gait = replace(asked, peak_n=float(walked.metadata["peak_n"]), model=self.plain,
                            period_s=float(walked.metadata["period_s"]), controller=walked.metadata["controller"])
        # another controller leaves a larger error than an extension mends: END is then compared with the desired force
        alike = walked.metadata["controller"] == "extended" and self.plain is not None
        self.restored = end_error(walked) if alike else np.zeros(BINS)
        self.budget_s, self.used_s, self.stops = 3600.0 * hours, 0.0, 0

    def completed(self, journal: Journal, step: str, experiment: Experiment | PreparedTrial) -> dict[str, Any]:
        """Return the journal's result of a trial; a stopped one is recorded once more."""
        result = self.recorded(journal, step, experiment)
        return result if result["outcome"] == "completed" else self.recorded(journal, f"{step} again", experiment)

    def recorded(self, journal: Journal, step: str, experiment: Experiment | PreparedTrial) -> dict[str, Any]:
        """Return the result of a trial from the journal; a trial that the journal lacks is run first.

        Ends the run by time and at the second stopped trial.
        """
        path = self.folder / f"{step}.mcap"

        def record() -> dict[str, Any]:
            bus = self.bus
            if "seed" in bus.arguments:  # the noise of a simulated bench is new in each trial, as on a real one
                seed = int(bus.arguments["seed"]) + len(journal.lines)
                bus = replace(bus, arguments={**bus.arguments, "seed": seed})
            prepared = experiment.prepared(bus, self.progress) if isinstance(experiment, Experiment) else replace(
                experiment, chosen=bus)
            figures = session.perform(prepared, path, overwrite=True, progress=self.progress)
            trial = Trial(figures["trial"] or path, figures)
            if (trial.figures.get("stop_reason") or "").startswith(INTERRUPTED):
                raise KeyboardInterrupt  # not in the journal: the trial is recorded again when the run goes on
            seconds = 1e-9 * float(trial.time_ns[-1] - trial.time_ns[0]) if len(trial) else 0.0
            return {"file": trial.path.name, "seconds": seconds, "outcome": trial.outcome or "",
                    "stop_reason": trial.figures.get("stop_reason"), "percent": self._error_percent(trial)}

        if self.used_s > self.budget_s:
            raise EndedNightError(f"time is up: {self.used_s:.0f} s of the bench were used")
        result = journal.step(step, record)
        self.used_s += result["seconds"]
        if result["outcome"] != "completed":
            self.stops += 1
            if self.stops >= STOPS:
                raise EndedNightError(f"{self.stops} trials were stopped, the last one: {result['stop_reason']}")
        return result

    def _error_percent(self, trial: Trial) -> float | None:
        """Return the RMS of END's mean cycle from that of the reference trial, % of the peak; None where not measured.
        """
        if "tension_end_n" not in trial.columns or not len(trial):
            return None
        apart = self.apart(trial)
        return float(100.0 * np.sqrt(np.mean(apart**2)) / self.gait.peak_n) if apart.any() else None

    def apart(self, trial: Trial | dict[str, Any]) -> Floats:
        """Return END's mean cycle less that of the reference trial, N, by part of the gait; 0 where it is unknown."""
        of = trial if isinstance(trial, Trial) else Trial(self.folder / trial["file"])
        return np.nan_to_num(end_error(of) - self.restored)


def percent(result: dict[str, Any]) -> float:
    """Return END's error, % of the peak, of a trial's result; ends the run where END was not measured."""
    if result["percent"] is None:
        raise EndedNightError(f"{result['file']}: END was not measured")
    return float(result["percent"])


def _reference_trial(path: Path) -> Trial:
    if path.suffix.lower() != ".mcap":
        raise InputError(f"{path}: a reference trial of mend is one of bowden trial, .mcap; give one.")
    trial = Trial(path)
    missing = [name for name in ("peak_n", "period_s", "controller") if name not in trial.metadata]
    if missing:
        raise InputError(f"{path}: has no {', '.join(missing)}; give a trial that bowden trial recorded.")
    return trial


def _refuse_other_bench(reference: Sequence[Path], file: Path | None) -> None:
    """Raise `InputError` for a configuration whose bench no run can repair, or is not that of the reference trials."""
    bench, named = configuration.read(file)["network"].bench, file or "the packaged bench"
    if len(bench.force_paths) > 1:
        raise InputError(f"mend: {named} has the force paths {', '.join(bench.path_prefixes)}; mend repairs a bench of "
                         "one. Use bowden diagnose --path and bowden verify --path.")
    if not bench.measures_end:
        raise InputError(f"mend: {named} has no END load cell, so that no trial proves an extension. Use bowden "
                         "diagnose.")
    for path in reference:
        if recorded.sections(read.open(path))["network"].bench.shape != bench.shape:
            raise InputError(f"{path}: was recorded on a bench with other devices than {named}; give its "
                             "bench.toml with --config.")


def _calibration(trial: Trial) -> BenchModel | None:
    """Return the calibration that a reference trial ran on; None for the packaged nominal one."""
    text = trial.attachments.get("calibration.toml")
    if text is None or trial.metadata.get("calibration") == NOMINAL:
        return None
    return bench_model.from_tables(tomllib.loads(bytes(text).decode("utf-8")), f"{trial.path}: calibration.toml")
