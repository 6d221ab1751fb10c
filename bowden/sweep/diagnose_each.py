"""Many trials, each diagnosed for itself, spread over processes or a Dask cluster as a sweep is.

The rule of this file: what goes out and comes back can be sent to another process or machine; files are read where the
work is done; a trial that cannot be read is refused like one that contradicts itself, and the others go on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bowden.sweep import run
from parameters import InputError

if TYPE_CHECKING:
    from diagnosis.finder import Finder


@dataclass(frozen=True)
class DiagnosisSettings:
    """Settings common to the diagnoses of all trials."""

    calibration: Path | None
    healthy: tuple[Path, ...]
    holdout: tuple[Path, ...]
    lowpass: float | None


def perform(trial: Path, settings: DiagnosisSettings) -> dict[str, Any]:
    """Return one trial's diagnosis as `bowden diagnose --json` gives it."""
    from bowden.models.diagnosing import on_its_footing
    from diagnosis.findings import Findings

    began = time.perf_counter()
    try:
        told = on_its_footing(_finder(settings, _state(settings)).diagnose([trial], settings.holdout), [trial], None,
                              measured=bool(settings.calibration or settings.healthy))
    except InputError as error:
        told = Findings("refused", warnings=[str(error)], lowpass_hz=settings.lowpass)
    return told.as_json() | {"seconds": time.perf_counter() - began}


@lru_cache(maxsize=1)
def _finder(settings: DiagnosisSettings, state: tuple[tuple[int, int], ...]) -> Finder:
    """Return the fitted diagnosis: its reference trials are read and fitted once in a process."""
    from diagnosis.finder import Finder

    return Finder(settings.calibration, settings.lowpass).examine(settings.healthy)


def _state(settings: DiagnosisSettings) -> tuple[tuple[int, int], ...]:
    """Return size and modification time of the files of a finder: a change requires a new finder."""
    files = [*settings.healthy, *([] if settings.calibration is None else [settings.calibration])]
    return tuple((told.st_size, told.st_mtime_ns) for told in (path.stat() for path in files if path.exists()))


def each(trials: Sequence[Path], settings: DiagnosisSettings, workers: run.Workers, update: Callable[[float], None]
         ) -> dict[str, Mapping[str, Any]]:
    """Diagnose every trial for itself; the order is that of `trials`. `update` receives the share done."""
    results: dict[Path, Mapping[str, Any]] = {}

    def finished(trial: Path, result: Any) -> None:
        if isinstance(result, BrokenExecutor):
            raise InputError(f"{trial}: {run.ENDED}; give fewer --workers, or shorter trials.") from None
        results[trial] = result
        update(len(results) / len(trials))

    run.run_all((run.Job(trial, perform, (trial, settings)) for trial in trials), workers, finished)
    return {str(trial): results[trial] for trial in trials}
