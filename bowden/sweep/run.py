"""A sweep: rows that are not in the table yet are run by an executor, and entered as soon as they are done.

It uses `concurrent.futures.Executor` only, whoever runs the tasks. Few rows are submitted at a time, so that an
interruption need not wait for many.
"""

from __future__ import annotations

import importlib
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from bowden.sweep import row_trial
from bowden.sweep.rows import IDENTIFIED, Row, placed
from bowden.sweep.sweep_table import SweepTable
from parameters import InputError

CONNECT_S = 10
ENDED = "the process that ran it ended by itself: out of memory, or a plug-in that ends it"
"""Reason of a row that ended its process when it ran alone."""
TLS_FILES = ("ca.pem", "cert.pem", "key.pem")
"""Files of `--scheduler-tls`: the authority's certificate, this client's own, and its key."""


class Workers(NamedTuple):
    """Executor of the trials, and how many trials it runs at a time.

    `renewed` returns another executor after a process of the first one ended; None if it recovers by itself.
    """

    executor: Executor
    at_once: int
    renewed: Callable[[], Executor] | None = None


@contextmanager
def local(count: int | None = None) -> Iterator[Workers]:
    """Yield processes on this machine, by default as many as it has processors."""
    count = count or os.cpu_count() or 1
    with ExitStack() as pools:
        def pool() -> Executor:
            return pools.enter_context(
                ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_aside))

        yield Workers(pool(), count, pool)


def _aside() -> None:
    """Put this process into another process group: Ctrl-C goes to the sweep alone, which lets a running trial end."""
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)


@contextmanager
def cluster(address: str, tls: Path | None = None) -> Iterator[Workers]:
    """Return the workers of the Dask scheduler at `address`; raises `InputError` where it does not answer.

    `tls`: a folder with `ca.pem`, `cert.pem` and `key.pem`.  With it nothing is sent or taken unencrypted; without it
    whoever reaches the scheduler runs code at its workers, and at this process.
    """
    if address.startswith("tls://") and tls is None:
        raise InputError(f"--scheduler {address} is encrypted; give certificates with --scheduler-tls.")
    try:
        dask = importlib.import_module("distributed")
    except ImportError:
        raise InputError("--scheduler needs dask.distributed; install bowden-bench[sweep].") from None
    try:
        client = dask.Client(
            address if tls is None or "://" in address else f"tls://{address}", timeout=CONNECT_S, set_as_default=False,
            security=None if tls is None else dask.Security(require_encryption=True, **_certificates(tls)))
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {address}: does not answer ({error}); give its address, host:port.") from None
    with client:
        count = sum(client.nthreads().values())
        if not count:
            raise InputError(f"--scheduler {address}: has no workers; start some.")
        yield Workers(client.get_executor(pure=False), count)


def _certificates(folder: Path) -> dict[str, str]:
    """Return what `distributed.Security` takes of a folder; raises `InputError` where a file is missing."""
    for name in TLS_FILES:
        if not (folder / name).is_file():
            raise InputError(f"--scheduler-tls {folder}: has no {name}; expected are {', '.join(TLS_FILES)}.")
    ca, certificate, key = (str(folder / name) for name in TLS_FILES)
    return {"tls_ca_file": ca, "tls_client_cert": certificate, "tls_client_key": key}


def calibrations_beside(table: Path, overwrite: bool) -> Path:
    """Return the folder beside a table that keeps its calibrations; emptied with `overwrite`."""
    folder = table.with_suffix(".calibrations")
    for stale in folder.glob("serial-*.toml") if overwrite else ():
        stale.unlink()
    return folder


def sweep(
    rows: Sequence[Row], table: SweepTable, workers: Workers, calibrations: Path, *, keep: str | None = None,
    update: Callable[[float], None] = lambda share: None,
) -> None:
    """Run the rows that `table` lacks; calibrations that they need are identified once and kept in `calibrations`.

    On `KeyboardInterrupt` running rows are finished and entered in the table before it is raised again.
    """
    run = _Sweep(rows, table, workers, calibrations, keep, update)
    try:
        run.all()
    except KeyboardInterrupt:
        run.wind_up()
        raise
    table.finish(rows)


class _Sweep:
    """The state of a sweep: jobs that wait, futures under way, rows that wait for their calibration."""

    def __init__(self, rows: Sequence[Row], table: SweepTable, workers: Workers, calibrations: Path, keep: str | None,
                 update: Callable[[float], None]) -> None:
        self.table, self.workers, self.folder, self.keep, self.update = table, workers, calibrations, keep, update
        self.executor, self.suspects = workers.executor, deque[tuple[str, Row]]()
        self.texts: dict[str, str] = {}
        self.waiting: dict[str, list[Row]] = {}
        self.jobs: deque[tuple[str, Row]] = deque()
        self.under_way: dict[Future[Any], tuple[str, Row]] = {}
        missing = [row for row in rows if table.found(row) is None]
        self.total, self.done = max(len(missing), 1), 0
        for row in missing:
            self._plan(row)

    def _plan(self, row: Row) -> None:
        if row["files.calibration"] != IDENTIFIED:
            self.jobs.append(("", row))
            return
        bench = row_trial.bench_of(row)
        name = self._name(bench)
        if name not in self.texts and name not in self.waiting and (self.folder / name).is_file():
            self.texts[name] = (self.folder / name).read_text(encoding="utf-8")
        if name in self.texts:
            self.jobs.append((name, row))
            return
        if name not in self.waiting:
            self.jobs.append((name, bench))
        self.waiting.setdefault(name, []).append(row)

    @staticmethod
    def _name(bench: Row) -> str:
        return f"serial-{bench['bench.serial']}-{row_trial.digest(bench)}.toml"

    def all(self) -> None:
        """Run all pending rows."""
        while self.jobs or self.suspects or self.under_way:
            if self.suspects and not self.under_way:
                self._submit(*self.suspects.popleft())
            while self.jobs and not self.suspects and len(self.under_way) <= self.workers.at_once:
                self._submit(*self.jobs.popleft())
            for future in wait(self.under_way, return_when=FIRST_COMPLETED).done:
                if future in self.under_way:  # not if a broken process has put it back
                    self._take(future)

    def wind_up(self) -> None:
        """Cancel rows that have not begun, and enter running ones when they are done."""
        for future in list(self.under_way):
            if future.cancel():
                del self.under_way[future]
        for future in wait(self.under_way).done:
            if not isinstance(future.exception(), BrokenExecutor):
                self._take(future)

    def _submit(self, name: str, row: Row) -> None:
        submit = self.executor.submit
        if "files.calibration" in row:
            label = str(self.folder / name) if name else ""
            future: Future[Any] = submit(
                row_trial.perform, placed(row), self.texts.get(name, ""), label, self.keep)
        else:
            future = submit(row_trial.identify, row)
        self.under_way[future] = name, row

    def _take(self, future: Future[Any]) -> None:
        name, row = self.under_way.pop(future)
        try:
            result = future.result()
        except BrokenExecutor:
            result = self._broken(name, row)
            if result is None:
                return
        if "files.calibration" in row:
            self._finished(row, {**result, "controller": result["controller"] and row["gait.controller"]})
            return
        reason, text = result
        rows = self.waiting.pop(name)
        if reason is None:
            self._keep_calibration(name, text)
            self.jobs.extendleft((name, each) for each in reversed(rows))
        for each in rows if reason is not None else ():
            self._finished(each, row_trial.not_run("not identified", reason))

    def _broken(self, name: str, row: Row) -> Any:
        """Return the result of a job that ended its process, None to run it once more.

        A process that ends breaks every job under way: they run again, one at a time, and the one that is alone when it
        happens again is the cause.
        """
        jobs = [(name, row), *self.under_way.values()]
        alone = len(jobs) == 1
        self.under_way.clear()
        if self.workers.renewed is None:
            raise InputError(f"the sweep stopped: {ENDED}; the same command goes on from the rows that are done.")
        self.executor = self.workers.renewed()
        if not alone:
            self.suspects.extend(jobs)
            return None
        return row_trial.not_run("failed", ENDED) if "files.calibration" in row else (ENDED, "")

    def _keep_calibration(self, name: str, text: str) -> None:
        self.texts[name] = text
        self.folder.mkdir(exist_ok=True)
        beside = self.folder / f"{name}.new"
        beside.write_text(text, encoding="utf-8")
        beside.replace(self.folder / name)

    def _finished(self, row: Row, figures: dict[str, Any]) -> None:
        self.table.append(row, figures)
        self.done += 1
        self.update(self.done / self.total)
