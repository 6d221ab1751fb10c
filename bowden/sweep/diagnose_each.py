"""Many trials, each diagnosed for itself, spread over processes or a Dask cluster as a sweep is.

The rule of this file: what goes out and comes back can be sent to another process or machine; files are read where the
work is done; a trial that cannot be read is refused like one that contradicts itself, and the others go on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bowden.sweep import run
from parameters import InputError


@dataclass(frozen=True)
class Given:
    """What every trial is diagnosed with."""

    calibration: Path | None
    healthy: Sequence[Path]
    holdout: Sequence[Path]
    lowpass: float | None


def crew(scheduler: str | None, workers: int | None) -> AbstractContextManager[run.Workers]:
    """Return processes of this machine, or the workers of a Dask cluster; raises `InputError` where none answers."""
    return run.local(workers) if scheduler is None else run.cluster(scheduler)


def perform(trial: Path, given: Given) -> dict[str, Any]:
    """Return one trial's diagnosis as `bowden diagnose --json` gives it."""
    from diagnosis.finder import Diagnosis, diagnose

    began = time.perf_counter()
    try:
        told = diagnose([trial], given.calibration, given.healthy, given.holdout, given.lowpass)
    except InputError as error:
        told = Diagnosis("refused", warnings=[str(error)], lowpass_hz=given.lowpass)
    return told.as_json() | {"seconds": time.perf_counter() - began}


def each(trials: Sequence[Path], given: Given, workers: run.Workers, update: Callable[[float], None]
         ) -> dict[str, Mapping[str, Any]]:
    """Diagnose every trial for itself; the order is that of `trials`.  `update` is told the share done."""
    asked = {workers.executor.submit(perform, trial, given): trial for trial in trials}
    told: dict[Path, Mapping[str, Any]] = {}
    for future in as_completed(asked):
        told[asked[future]] = future.result()
        update(len(told) / len(asked))
    return {str(trial): told[trial] for trial in trials}
