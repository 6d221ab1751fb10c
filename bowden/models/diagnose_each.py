"""Diagnoses of many recorded trials, each by itself, on several workers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from bowden.models.diagnosing import Diagnosis
from bowden.workers import ENDED, Job, Workers, run_all
from diagnosis.findings import Findings
from parameters import InputError


class ReferenceCondition(NamedTuple):
    """Reference condition of several diagnoses: calibration, reference trials, and cut-off of a low-pass, Hz."""

    calibration: Path | None
    trials: tuple[Path, ...]
    lowpass_hz: float | None

    def state(self) -> tuple[tuple[int, int], ...]:
        """Return size and modification time of the files: a change requires another fit."""
        files = [path for path in (self.calibration, *self.trials) if path is not None and path.exists()]
        return tuple((status.st_size, status.st_mtime_ns) for status in (path.stat() for path in files))


def diagnose_each(trials: Sequence[Path], holdout: Sequence[Path], reference: ReferenceCondition, workers: Workers,
                  update: Callable[[float], None]) -> dict[str, Mapping[str, Any]]:
    """Diagnose every trial for itself; the order is that of `trials`. `update` receives the share done.

    A trial that cannot be diagnosed, or that ends its process, has the verdict "refused", with the reason as a warning.
    """
    results: dict[Path, Mapping[str, Any]] = {}

    def finished(trial: Path, result: Any) -> None:
        results[trial] = result
        update(len(results) / len(trials))

    run_all((Job(trial, diagnose, (trial, holdout, reference), _refused(
        reference, f"{trial}: {ENDED}; give fewer --workers, or shorter trials.")) for trial in trials),
            workers, finished)
    return {str(trial): results[trial] for trial in trials}


def diagnose(trial: Path, holdout: Sequence[Path], reference: ReferenceCondition) -> dict[str, Any]:
    """Return one trial's diagnosis as `bowden diagnose --json` gives it."""
    try:
        found = _fitted(reference, reference.state()).diagnose(trial, holdout)
        return found.as_json() | {"seconds": found.seconds}
    except InputError as error:
        return _refused(reference, str(error))


def _refused(reference: ReferenceCondition, reason: str) -> dict[str, Any]:
    return Findings("refused", warnings=[reason], lowpass_hz=reference.lowpass_hz).as_json() | {"seconds": 0.0}


@lru_cache(maxsize=1)
def _fitted(reference: ReferenceCondition, state: tuple[tuple[int, int], ...]) -> Diagnosis:
    """Return the fitted diagnosis: its reference trials are read and fitted once in a process."""
    return Diagnosis(reference.calibration, lowpass_hz=reference.lowpass_hz).fit(reference.trials)
