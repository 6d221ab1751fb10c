"""Workers of many independent jobs: processes of this machine, or a Dask cluster, behind one executor interface.

`workers_of` opens an executor (`concurrent.futures.Executor`). `run_all` gives it jobs, which may end their process;
it does not depend on where they run.
"""

from __future__ import annotations

import importlib
import itertools
import logging
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, NamedTuple

from bowden.child_processes import unsignalled
from parameters import InputError

CONNECT_S = 10
"""Time limit for the answer of a Dask scheduler, s."""
ENDED = "the process that ran it ended by itself: out of memory, or a plug-in that ends it"
"""Reason of a job that ended its process when it ran alone."""


class Job(NamedTuple):
    """A call that a worker makes, the key of its result, and the result in its place if the call ends its process."""

    key: Any
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    lost: Any


@dataclass
class Workers:
    """Executor of jobs, and how many jobs it runs at a time; `lost`: exceptions of a job that ended its process.

    A plug-in that calls `sys.exit` raises SystemExit here, and one that raises KeyboardInterrupt is no Ctrl-C.
    """

    executor: Executor
    at_once: int
    lost: tuple[type[BaseException], ...] = (BrokenExecutor, SystemExit, KeyboardInterrupt)


class Processes(Executor):
    """Processes of this machine, all replaced when one of them ends by itself.

    Ctrl-C reaches the parent process alone, which lets running jobs end.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool = self._opened()

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """Hand a call to a process."""
        with unsignalled():
            try:
                return self._pool.submit(function, *arguments, **named)
            except BrokenExecutor:
                self._pool = self._opened()
                return self._pool.submit(function, *arguments, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, after the running jobs."""
        self._pool.shutdown(wait, cancel_futures=cancel_futures)

    def _opened(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self._count, mp_context=get_context("spawn"))


def workers_of(scheduler: str | None, count: int | None = None) -> AbstractContextManager[Workers]:
    """Open `count` processes of this machine (None: one a processor), or the workers of a Dask scheduler."""
    return local(count) if scheduler is None else cluster(scheduler)


@contextmanager
def local(count: int | None = None) -> Iterator[Workers]:
    """Yield processes on this machine, by default as many as it has processors."""
    count = count or os.cpu_count() or 1
    with Processes(count) as executor:
        yield Workers(executor, count)


@contextmanager
def cluster(address: str) -> Iterator[Workers]:
    """Yield the workers of the Dask scheduler at `address`; raises `InputError` if it does not answer, or is lost.

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
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # a lost scheduler is one sentence, below
    with client:
        count = sum(client.nthreads().values())
        if not count:
            raise InputError(f"--scheduler {address}: has no workers; start some.")
        killed = importlib.import_module("distributed.scheduler").KilledWorker
        try:
            yield Workers(client.get_executor(pure=False), count, lost=(killed,))
        except Exception:
            if client.status == "running":
                raise
            raise InputError(f"--scheduler {address}: was lost while it ran jobs; start it and its workers again, and "
                             "repeat the command.") from None


def run_all(jobs: Iterable[Job], workers: Workers, finished: Callable[[Any, Any], None]) -> None:
    """Run jobs, little more than one a worker at a time; `finished` receives the key and the result of each.

    A process that ends loses every job under way: they run again last, each alone. A job that is lost alone has its
    result `lost`. On `KeyboardInterrupt` running jobs are finished before it is raised again.
    """
    for job in _run(jobs, workers, workers.at_once + 1, finished):
        if _run([job], workers, 1, finished):
            finished(job.key, job.lost)


def _run(jobs: Iterable[Job], workers: Workers, most: int, finished: Callable[[Any, Any], None]) -> list[Job]:
    """Run jobs, at most `most` at a time; return those that were under way when a process ended."""
    waiting, lost = iter(jobs), list[Job]()
    under_way: dict[Future[Any], Job] = {}

    def take(future: Future[Any], job: Job) -> None:
        if isinstance(future.exception(), workers.lost):
            lost.append(job)
        else:
            finished(job.key, future.result())

    try:
        while True:
            for job in itertools.islice(waiting, most - len(under_way)):
                under_way[workers.executor.submit(job.function, *job.arguments)] = job
            if not under_way:
                return lost
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                take(future, under_way.pop(future))
    except KeyboardInterrupt:
        for future, job in [item for item in under_way.items() if not item[0].cancel()]:
            take(future, job)
        raise
