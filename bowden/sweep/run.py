"""A sweep: rows that are not in the table yet are run by an executor, and entered as soon as they are done.

Interface: `workers_of` opens an executor (`concurrent.futures.Executor`: processes of this machine, or a Dask cluster);
`run_all` gives it jobs, which may end their process, and knows nothing of where they run.  Jobs are trials of a sweep
(`sweep`, `into_table`), or diagnoses of recorded trials, each by itself (`diagnose_each`).
"""

from __future__ import annotations

import importlib
import itertools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from bowden.child_processes import unsignalled
from bowden.deferred import on_first_use
from bowden.progress import SILENT, Progress
from bowden.sweep import row_trial
from bowden.sweep.rows import IDENTIFIED, Row, placed
from bowden.sweep.sweep_table import SweepTable
from bowden.trials import session
from parameters import InputError
from parameters.files import write_whole

with on_first_use():
    from bowden.models.diagnosing import Diagnosis
    from diagnosis.findings import Findings

CONNECT_S = 10
ENDED = "the process that ran it ended by itself: out of memory, or a plug-in that ends it"
"""Reason of a row that ended its process when it ran alone."""


class Job(NamedTuple):
    """A call that a worker makes, and the key that its result is reported with."""

    key: Any
    function: Callable[..., Any]
    arguments: tuple[Any, ...]


@dataclass
class Workers:
    """Executor of jobs, and how many jobs it runs at a time.

    `renewed` returns another executor in place of one that lost a process; None if it recovers by itself. `lost` are
    the exceptions of a job whose process ended.
    """

    executor: Executor
    at_once: int
    renewed: Callable[[], Executor] | None = None
    lost: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def submit(self, job: Job) -> Future[Any]:
        """Hand a job to the executor, or to another one if it lost a process.

        Ctrl-C goes to the sweep alone, which lets a running trial end.
        """
        with unsignalled():
            try:
                return self.executor.submit(job.function, *job.arguments)
            except BrokenExecutor:
                if self.renewed is None:
                    raise
            self.executor = self.renewed()
            return self.executor.submit(job.function, *job.arguments)


def workers_of(scheduler: str | None, count: int | None = None) -> AbstractContextManager[Workers]:
    """Open `count` processes of this machine (None: one a processor), or the workers of a Dask scheduler."""
    return local(count) if scheduler is None else cluster(scheduler)


@contextmanager
def local(count: int | None = None) -> Iterator[Workers]:
    """Yield processes on this machine, by default as many as it has processors."""
    count = count or os.cpu_count() or 1
    opened = partial(ProcessPoolExecutor, count, mp_context=get_context("spawn"))
    with ExitStack() as pools:
        yield Workers(pools.enter_context(opened()), count, lambda: pools.enter_context(opened()))


@contextmanager
def cluster(address: str) -> Iterator[Workers]:
    """Yield the workers of the Dask scheduler at `address`; raises `InputError` if it does not answer.

    Certificates of a `tls://` address are those of Dask's own configuration.
    """
    try:
        dask = importlib.import_module("distributed")
    except ImportError:
        raise InputError("--scheduler needs dask.distributed; install bowden-bench[sweep].") from None
    try:
        client = dask.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        hint = ("set Dask's own distributed.comm.tls, docs/sweep.md" if address.startswith("tls://")
                else "give its address, host:port")
        raise InputError(f"--scheduler {address}: does not answer ({error}); {hint}.") from None
    with client:
        count = sum(client.nthreads().values())
        if not count:
            raise InputError(f"--scheduler {address}: has no workers; start some.")
        killed = importlib.import_module("distributed.scheduler").KilledWorker
        yield Workers(client.get_executor(pure=False), count, lost=(killed,))


def run_all(jobs: Iterable[Job], workers: Workers, finished: Callable[[Any, Any], None]) -> None:
    """Run jobs, little more than one a worker at a time; `finished` receives the key and the result of each.

    A process that ends loses every job under way: they run again last, each alone. The result of a job that is lost
    alone is a `BrokenExecutor`. On `KeyboardInterrupt` running jobs are finished before it is raised again.
    """
    for lost in _run(jobs, workers, workers.at_once + 1, finished):
        if _run([lost], workers, 1, finished):
            finished(lost.key, BrokenExecutor())


def _run(jobs: Iterable[Job], workers: Workers, most: int, finished: Callable[[Any, Any], None]) -> list[Job]:
    """Run jobs, at most `most` at a time; return those that were under way when a process ended."""
    waiting, lost = iter(jobs), list[Job]()
    under_way: dict[Future[Any], Job] = {}
    try:
        while True:
            for job in itertools.islice(waiting, most - len(under_way)):
                under_way[workers.submit(job)] = job
            if not under_way:
                return lost
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                job = under_way.pop(future)
                if isinstance(future.exception(), workers.lost):
                    lost.append(job)
                else:
                    finished(job.key, future.result())
    except KeyboardInterrupt:
        for future, job in [item for item in under_way.items() if not item[0].cancel()]:
            if not isinstance(future.exception(), workers.lost):
                finished(job.key, future.result())
        raise


def into_table(
    rows: Sequence[Row], table: SweepTable, *, overwrite: bool = False, scheduler: str | None = None,
    workers: int | None = None, keep: Path | None = None, progress: Progress = SILENT,
) -> list[dict[str, str]]:
    """Run the rows that `table` lacks, as `workers_of` and `sweep` do; return all rows, their cells by column.

    The folder beside the table keeps the calibrations; `overwrite` empties it.
    """
    calibrations = table.path.with_suffix(".calibrations")
    for stale in calibrations.glob("serial-*.toml") if overwrite else ():
        stale.unlink()
    if all(table.found(row) is not None for row in rows):
        table.finish(rows)
    else:
        if scheduler is None:
            session.compile_laws(simulated=True, progress=progress)
        with workers_of(scheduler, workers) as crew, progress.running("sweep") as update:
            sweep(rows, table, crew, calibrations, keep=None if keep is None else str(keep.resolve()), update=update)
    return [table.found(row) or {} for row in rows]


def sweep(
    rows: Sequence[Row], table: SweepTable, workers: Workers, calibrations: Path, *, keep: str | None = None,
    update: Callable[[float], None] = lambda share: None,
) -> None:
    """Run the rows that `table` lacks; calibrations that they need are identified first, once, into `calibrations`.

    On `KeyboardInterrupt` running rows are finished and entered in the table before it is raised again.
    """
    missing = [row for row in rows if table.found(row) is None]
    entered, reasons = itertools.count(1), dict[str, str]()

    def enter(row: Row, figures: dict[str, Any]) -> None:
        table.append(row, figures)
        update(next(entered) / len(missing))

    def identified(name: str, result: Any) -> None:
        reason, text = (ENDED, "") if isinstance(result, BrokenExecutor) else result
        if reason is None:
            calibrations.mkdir(exist_ok=True)
            write_whole(calibrations / name, text, overwrite=True)
        else:
            reasons[name] = reason

    def tried(row: Row, result: Any) -> None:
        figures = row_trial.not_run("failed", ENDED) if isinstance(result, BrokenExecutor) else result
        enter(row, {**figures, "controller": figures["controller"] and row["gait.controller"]})

    benches = {_calibration_of(row): row_trial.bench_of(row) for row in missing
               if row["files.calibration"] == IDENTIFIED}
    run_all((Job(name, row_trial.identify, (bench,)) for name, bench in benches.items()
             if not (calibrations / name).is_file()), workers, identified)
    for row in missing if reasons else ():
        if (reason := reasons.get(_calibration_of(row))) and row["files.calibration"] == IDENTIFIED:
            enter(row, row_trial.not_run("not identified", reason))
    run_all((_trial(row, calibrations, keep) for row in missing if table.found(row) is None), workers, tried)
    table.finish(rows)


def _calibration_of(row: Row) -> str:
    """Return the name of the file that keeps the calibration of a row's bench."""
    bench = row_trial.bench_of(row)
    return f"serial-{bench['bench.serial']}-{row_trial.digest(bench)}.toml"


def _trial(row: Row, calibrations: Path, keep: str | None) -> Job:
    path = calibrations / _calibration_of(row) if row["files.calibration"] == IDENTIFIED else None
    text, label = ("", "") if path is None else (path.read_text(encoding="utf-8"), str(path))
    return Job(row, row_trial.perform, (placed(row), text, label, keep))


Reference = tuple[Path | None, tuple[Path, ...], float | None]
"""Reference condition of several diagnoses: calibration, reference trials, and cut-off of a low-pass, Hz."""


def diagnose(trial: Path, holdout: Sequence[Path], reference: Reference) -> dict[str, Any]:
    """Return one trial's diagnosis as `bowden diagnose --json` gives it."""
    try:
        found = _fitted(reference, _state(reference)).diagnose(trial, holdout)
        return found.as_json() | {"seconds": found.seconds}
    except InputError as error:
        return Findings("refused", warnings=[str(error)], lowpass_hz=reference[-1]).as_json() | {"seconds": 0.0}


@lru_cache(maxsize=1)
def _fitted(reference: Reference, state: tuple[tuple[int, int], ...]) -> Diagnosis:
    """Return the fitted diagnosis: its reference trials are read and fitted once in a process."""
    calibration, healthy, lowpass = reference
    return Diagnosis(calibration, lowpass_hz=lowpass).fit(healthy)


def _state(reference: Reference) -> tuple[tuple[int, int], ...]:
    """Return size and modification time of the files of a reference condition: a change requires another fit."""
    files = [path for path in (reference[0], *reference[1]) if path is not None and path.exists()]
    return tuple((status.st_size, status.st_mtime_ns) for status in (path.stat() for path in files))


def diagnose_each(trials: Sequence[Path], holdout: Sequence[Path], reference: Reference, workers: Workers,
                  update: Callable[[float], None]) -> dict[str, Mapping[str, Any]]:
    """Diagnose every trial for itself; the order is that of `trials`. `update` receives the share done."""
    results: dict[Path, Mapping[str, Any]] = {}

    def finished(trial: Path, result: Any) -> None:
        if isinstance(result, BrokenExecutor):
            raise InputError(f"{trial}: {ENDED}; give fewer --workers, or shorter trials.") from None
        results[trial] = result
        update(len(results) / len(trials))

    run_all((Job(trial, diagnose, (trial, holdout, reference)) for trial in trials), workers, finished)
    return {str(trial): results[trial] for trial in trials}
