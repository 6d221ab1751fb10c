"""Bench and master as two processes of one computer, as the command line starts them.

The rule of this file: each process is forked with everything imported and runs one command line; the only thing
waited for is what comes over the bus or how a process ends.
"""

from __future__ import annotations

import faulthandler
import functools
import gc
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import can

from bowden.cli.app import run
from master.network.socketcan import KernelBus
from trial import read

wall_clock = time.time_ns
PATIENCE_S = 600
"""After this long, of the kernel's own time, a trial tells where it hangs and ends; a bench serves until told."""

PATIENT = """
[network]
rate_hz = 20
heartbeat_timeout_ms = 20000
targets_deadline_ms = 8000
start_deadline_cycles = 100
[limits]
stale_cycles = 100
[homing]
rope_m_s = 0.002
"""
"""A configuration for tests of function: a guest with a tenth of a processor keeps its cycle and its deadlines."""


def patient(folder: Path) -> tuple[str, Path]:
    """Return the option of a configuration under which a loaded machine delays nothing that is looked at."""
    path = folder / "patient.toml"
    path.write_text(PATIENT, encoding="utf-8")
    return "--config", path


class Told(NamedTuple):
    """What a command line said."""

    status: int
    result: dict[str, Any]
    stderr: str


class Process:
    """A forked process that runs `job` and ends; its standard streams go to files in `folder`."""

    def __init__(self, folder: Path, name: str, job: Callable[[], int], *, serves: bool = False) -> None:
        self._out, self._err = folder / f"{name}.out", folder / f"{name}.err"
        self.pid = os.fork()
        if not self.pid:
            self._become(job, serves)

    def _become(self, job: Callable[[], int], serves: bool) -> None:
        with self._err.open("w") as hung:  # closed by the end of the process
            if not serves:
                faulthandler.dump_traceback_later(PATIENCE_S, exit=True, file=hung)
            self._run(job)

    def _run(self, job: Callable[[], int]) -> None:
        status = 70
        try:
            out, err = io.StringIO(), io.StringIO()
            try:
                with redirect_stdout(out), redirect_stderr(err):
                    status = job()
            except BaseException:
                err.write(traceback.format_exc())
            self._out.write_text(out.getvalue())
            self._err.write_text(err.getvalue())
        finally:
            os._exit(status)

    def wait(self) -> Told:
        """How it ended, and its JSON object; a killed one said nothing."""
        _, code = os.waitpid(self.pid, 0)
        self.pid = 0
        out, err = (path.read_text() if path.exists() else "" for path in (self._out, self._err))
        return Told(os.waitstatus_to_exitcode(code), json.loads(out) if out.strip() else {}, err)

    def end(self) -> Told:
        """Ask it to end, as a terminal or a service manager would."""
        os.kill(self.pid, signal.SIGTERM)
        return self.wait()


@functools.cache
def rehearse() -> None:
    """Import, compile and read whatever the command lines will, once, before any process is forked.

    That takes most of a short run: a bench that is served for no time, and a trial that finds no nodes.
    """
    on = ["--interface", "socketcan", "--channel", "vcan1", "--json"]
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()) as out, redirect_stderr(out):
        run(["bench", *on, "--for", "0"])
        told = run(["trial", *on, "--dry-run", "-o", str(Path(folder, "trial.mcap"))])
    assert told == 1, out.getvalue()
    gc.collect()
    gc.freeze()  # no fork goes through all that again


def bowden(folder: Path, *arguments: object) -> Process:
    """Start one command line of `bowden`."""
    rehearse()
    name = f"{arguments[0]}-{len(list(folder.iterdir()))}"
    return Process(folder, name, lambda: run([*map(str, arguments), "--json"]), serves=arguments[0] == "bench")


@contextmanager
def bench(
    folder: Path, channel: str, *arguments: object, nodes: Sequence[int] = (1, 2, 3, 4)
) -> Iterator[Process]:
    """`bowden bench` on a channel, its `nodes` booted."""
    with KernelBus(channel) as watching:
        process = bowden(folder, "bench", "--interface", "socketcan", "--channel", channel, *arguments)
        booting = {0x700 + node for node in nodes}
        while booting:
            heard = watching.recv(60.0)
            assert heard is not None, "the bench did not boot"
            booting.discard(heard.arbitration_id)
    try:
        yield process
    finally:
        if process.pid:
            told = process.end()
            print("bench:", told)


def trial(folder: Path, channel: str, *arguments: object) -> Process:
    """`bowden trial` on a channel into trial.mcap."""
    return bowden(folder, "trial", "--interface", "socketcan", "--channel", channel, "-o", folder / "trial.mcap",
                  *arguments)


def heard(bus: can.BusABC, can_id: int, count: int = 1) -> can.Message:
    """The `count`-th frame with an identifier from now on."""
    while True:
        message = bus.recv(30.0)
        assert message is not None, f"no {can_id:03X}h came"
        count -= message.arbitration_id == can_id
        if not count:
            return message


def recorded(folder: Path) -> read.Trial:
    """The trial that `trial` recorded."""
    return read.open(folder / "trial.mcap")


def shell(command: str) -> None:
    """Run ip or tc."""
    subprocess.run(command, shell=True, check=True, stdout=sys.stdout, stderr=sys.stdout)
