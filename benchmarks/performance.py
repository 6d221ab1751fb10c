"""Table of docs/performance.md: processor time of an operation here and of the usual library, and their ratio.

    python -m benchmarks.performance                     # `make bench`: prints the table and writes it into the page
    python -m benchmarks.performance --rows cycle pdo    # these rows alone, printed

The two are measured in turns, in two processes (`benchmarks.frame`), so that a busy machine slows both alike.  Rows
without a library to compare with have one figure.  No figure fails a build.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from benchmarks import performance_rows
from benchmarks.frame import DOCS, ROOT, Row, put, quartiles

PAGE = DOCS / "performance.md"
HEAD = ("what", "here", "peer", "peer's", "ratio (quartiles)")


IMPORTS = ("from bowden.bench import light_imports; light_imports.load(); "
           "import can, canopen, mcap, numba, numpy, typer; numba.njit('int64(int64)')(lambda a: a)")
"""Import of the libraries that a simulated trial needs, as it imports them, and one function compiled by numba."""


def start() -> Iterator[Row]:
    """`bowden --help`, a short trial beside the imports that it cannot do without, and the first compilation."""
    bare = "import typer; a = typer.Typer(); a.command('a')(lambda: None); a.command('b')(lambda: None); a()"
    commands = [str(Path(sys.executable).with_name("bowden")), "--help"], [sys.executable, "-c", bare, "--help"]
    own, peer = np.array([[_used(command) for command in commands] for _ in range(15)]).T
    yield ("`bowden --help`, s of CPU", f"{np.median(own):.2f}", "a bare Typer program of two commands",
           f"{np.median(peer):.2f}", quartiles(own, peer, 2))
    with tempfile.TemporaryDirectory() as folder:
        commands = ([str(Path(sys.executable).with_name("bowden")), "trial", "--cycles", "1", "--settle", "0",
                     "--overwrite", "-o", f"{folder}/1.mcap"], [sys.executable, "-c", IMPORTS])
        own, peer = np.array([[_used(command) for command in commands] for _ in range(5)]).T
        yield ("`bowden trial --cycles 1 --settle 0`, s of CPU", f"{np.median(own):.1f}",
               "import of its libraries, and one function compiled by numba", f"{np.median(peer):.1f}",
               quartiles(own, peer, 2))
        code = "from bowden.trials.session import compile_laws; compile_laws(simulated=True)"
        first, later = (_used([sys.executable, "-c", code], NUMBA_CACHE_DIR=folder) for _ in range(2))
    yield ("laws compiled on a new machine, s of CPU", f"{first:.1f}", "loaded from the cache", f"{later:.1f}", "–")


MEMORY = {
    "bowden trial": "trial --period 2 --cycles {cycles} -o {at}.mcap", "bowden info": "info {at}.mcap",
    "bowden report": "report {at}.mcap -o {at}.html", "bowden export, CSV": "export {at}.mcap -o {at}.csv",
    "bowden export, Parquet": "export {at}.mcap -o {at}.parquet", "bowden export, BLF": "export {at}.mcap -o {at}.blf",
}
"""Commands whose memory does not depend on the length of a trial, in the order in which they run."""
HEALTHY = "trial --period 2 --cycles 10 --peak 45 --seed 1 -o {at}.healthy.mcap"
BOUNDED = {"bowden diagnose": "diagnose {at}.mcap --healthy {at}.healthy.mcap",
           "bowden watch": "watch {at}.mcap --healthy {at}.healthy.mcap"}
"""Commands that read windows of a long trial."""
HOUR_CYCLES = 1800
"""Gait cycles of 2 s in an hour."""


def memory() -> Iterator[Row]:
    """Peak memory of commands with a trial of 240 s, beside one of 30 s; of those that read windows with an hour."""
    command = str(Path(sys.executable).with_name("bowden"))
    with tempfile.TemporaryDirectory() as folder:
        peak_mb([command, *MEMORY["bowden trial"].format(at=f"{folder}/compiles", cycles=2).split()])
        for name, line in MEMORY.items():
            short, long = (peak_mb([command, *line.format(at=f"{folder}/{cycles}", cycles=cycles).split()])
                           for cycles in (15, 120))
            yield (f"peak memory of `{name}`, a trial of 240 s, MB", f"{long:.0f}", "one of 30 s", f"{short:.0f}",
                   f"{short / long:.2f}")
        hour = f"{folder}/hour"
        for line in (MEMORY["bowden trial"], HEALTHY):
            peak_mb([command, *line.format(at=hour, cycles=HOUR_CYCLES).split()])
        for name, line in BOUNDED.items():
            peak = peak_mb([command, *line.format(at=hour).split()])
            yield f"peak memory of `{name}`, a trial of an hour at 1 kHz, MB", f"{peak:.0f}", "–", "–", "–"


ROWS: dict[str, Callable[[], Iterator[Row]]] = {
    "cycle": performance_rows.whole_cycle, "events": performance_rows.event_by_event,
    "nodes": performance_rows.by_nodes, "pdo": performance_rows.pdos, "load": performance_rows.wire_load,
    "record": performance_rows.record, "read": performance_rows.read,
    "size": performance_rows.size, "plant": performance_rows.plant, "diagnosis": performance_rows.diagnosis,
    "processes": performance_rows.processes, "start": start, "memory": memory,
}


def _used(command: list[str], **environment: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, **environment}, cwd=ROOT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def peak_mb(command: list[str]) -> float:
    """Return the largest resident memory of a command, MB."""
    code = "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stdout=2); " \
           "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    done = subprocess.run([sys.executable, "-c", code, *command], check=True, capture_output=True, text=True, cwd=ROOT)
    return int(done.stdout) / 1024


def main() -> None:
    """Print the rows; all of them go into the page too."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="*", choices=list(ROWS), default=list(ROWS))
    chosen = parser.parse_args().rows
    lines = [f"| {' | '.join(HEAD)} |", "|---|---|---|---|---|"]
    print("\n".join(lines), flush=True)
    for name in chosen:
        for row in ROWS[name]():
            lines.append(f"| {' | '.join(row)} |")
            print(lines[-1], flush=True)
    if chosen == list(ROWS):
        put(PAGE, "table", "\n".join(lines))


if __name__ == "__main__":
    main()
