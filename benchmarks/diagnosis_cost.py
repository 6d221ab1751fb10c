"""Cost of a diagnosis in CPU and memory: by the trial's length, by its hidden effects, and by part of the code.

    python -m benchmarks.diagnosis_cost [--page]

The rule of this file: processor time of one thread, each length once unmeasured before it is measured; memory is traced
and the profile taken in runs of their own, since both cost time.  Ratios are what holds on other machines.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cProfile
import pstats
import sys
import time
import tracemalloc
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

from benchmarks.frame import put
from bowden.trials import provenance
from diagnosis.finder import Finder
from estimation.data import table
from tests.hidden import cases
from tests.hidden.cases import Job

PAGE = Path("docs/diagnosis_figures.md")
LENGTHS = (5, 10, 20, 40)
SINGLE = ("cable_friction", "presliding", "end_gain", "drive_viscous", "moment_arm", "end_delay")
PAIRS = (("end_gain", "presliding"), ("cable_friction", "knee_backlash"))
SEED = 60_000
REFERENCE_S: Final = 5.0
SINGLE_S: Final = 4.0
PAIR_S: Final = 10.0
MEMORY: Final = 5.0
"""Bars: CPU of ten gait cycles, s, of the reference fit and of a diagnosis beside it; peak of memory in sizes of the
columns."""
PARTS: Final = (
    ("reference trials fitted", "reference_fit.py", "fit_reference"),
    ("null and effects fitted", "hypothesis_search.py", "search"),
    ("pairs fitted", "hypothesis_search.py", "search_pairs"),
    ("held-out errors", "held_out.py", "held_out"),
    ("detection limits", "detection_limits.py", "detection_limits"),
)


class Asked(NamedTuple):
    """One trial and its healthy ones, ready to be asked about."""

    trial: table.Table
    healthy: list[table.Table]

    @property
    def column_bytes(self) -> int:
        return sum(column.nbytes for given in (self.trial, *self.healthy) for column in given.columns.values())

    def diagnosed(self, finder: Finder | None = None) -> float:
        """Diagnose by a new finder, or by one that has the reference fit; return the processor time, s."""
        began = time.process_time()
        (finder or Finder().examine(self.healthy)).diagnose([self.trial])
        return time.process_time() - began

    def peak(self) -> float:
        """Diagnose; return the peak of the allocated memory, relative to the size of the columns."""
        tracemalloc.start()
        self.diagnosed()
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most / self.column_bytes


def asked(job: Job, cycles: int) -> Asked:
    """Record a trial of a case and two healthy ones."""
    case = cases.case(job, cycles=cycles)
    return Asked(table.table("trial", case.trial),
                 [table.table(f"healthy {i}", columns) for i, columns in enumerate(case.healthy)])


def spent(job: Job, cycles: int) -> tuple[float, float]:
    """Return the processor seconds of the reference fit and of the diagnosis beside it; two healthy trials."""
    given = asked(job, cycles)
    finder = Finder().examine(given.healthy)
    whole, beside = given.diagnosed(finder), given.diagnosed(finder)
    return whole - beside, beside


def lengths() -> list[str]:
    """Return the table by length of trial and healthy trials."""
    job = Job("one", SEED, ("cable_friction",))
    given = {cycles: asked(job, cycles) for cycles in LENGTHS}
    given[LENGTHS[0]].diagnosed()
    found = {cycles: one.diagnosed() for cycles, one in given.items()}
    unit = found[10] / 10
    return [f"| gait cycles | CPU (s) | per cycle, against 10 cycles | peak of memory, in columns (bar ≤ {MEMORY:g}) |",
            "|---|---|---|---|",
            *(f"| {cycles} | {found[cycles]:.1f} | {found[cycles] / cycles / unit:.2f} | {given[cycles].peak():.1f} |"
              for cycles in LENGTHS)]


def kinds() -> list[str]:
    """Return the table by number of hidden effects, ten gait cycles each."""
    single = [spent(Job("one", SEED + 1 + i, (name,)), 10) for i, name in enumerate(SINGLE)]
    pairs = [spent(Job("two", SEED + 50 + i, names), 10) for i, names in enumerate(PAIRS)]
    healthy = [spent(Job("none", SEED + 90 + i), 10) for i in range(2)]
    rows = []
    for word, found, bar in (("reference fit", [reference for reference, _ in healthy + single + pairs], REFERENCE_S),
                             ("nothing", [beside for _, beside in healthy], SINGLE_S),
                             ("one effect", [beside for _, beside in single], SINGLE_S),
                             ("two effects", [beside for _, beside in pairs], PAIR_S)):
        rows.append(f"| {word} | {len(found)} | {median(found):.1f} | {max(found):.1f} | ≤ {bar:g} s "
                    f"| {median(found) / bar:.2f} |")
    return ["| in the trial | trials | CPU (s) | most (s) | bar | median over bar |",
            "|---|---|---|---|---|---|", *rows]


def profile() -> list[str]:
    """Return where the CPU of one trial goes, by part of the diagnosis."""
    given = asked(Job("one", SEED + 1, SINGLE[:1]), 10)
    given.diagnosed()
    profiler = cProfile.Profile(time.process_time)
    profiler.runcall(given.diagnosed)
    stats = pstats.Stats(profiler)
    rows = {(Path(file).name, name): times for (file, _, name), times in stats.stats.items()}  # type: ignore[attr-defined]
    whole = stats.total_tt  # type: ignore[attr-defined]
    parts = [(word, rows[file, name][3] / whole) for word, file, name in PARTS if (file, name) in rows]
    parts.append(("the rest", 1.0 - sum(share for _, share in parts)))
    calls, simulated = rows["force_path.py", "simulate"][1], rows["force_path.py", "_run"][2]
    return ["| part | share of a profiled run (%) |", "|---|---|",
            *(f"| {word} | {100.0 * share:.0f} |" for word, share in parts), "",
            f"The compiled simulation of the force path takes {100.0 * simulated / whole:.0f} % of it, in {calls} "
            "batches."]


def main(arguments: list[str]) -> None:
    """Print all tables."""
    said = (f"Printed by `python -m benchmarks.diagnosis_cost` at commit {provenance.commit()}: one thread, "
            "a trial beside two healthy ones of the same length.")
    text = "\n".join([said, "", *lengths(), "",
                      "Ten gait cycles; the reference fit by itself, since it is made once for all trials of a bench:",
                      "", *kinds(), "",
                      f"Where it goes ({SINGLE[0]}, ten cycles):", "", *profile()])
    print(text)
    if "--page" in arguments:
        put(PAGE, "cost", text)


if __name__ == "__main__":
    main(sys.argv[1:])
