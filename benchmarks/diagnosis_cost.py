"""What a diagnosis costs: by the trial's length, by what is in it, and against the trial it looks at.

    python -m benchmarks.diagnosis_cost [--page]

The rule of this file: processor time of one thread, each case once unmeasured before it is measured; ratios are what
holds on other machines.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
import time
from pathlib import Path
from statistics import median

from benchmarks import marked
from bowden import provenance
from tests.hidden import cases
from tests.hidden.cases import Job

PAGE = Path("docs/diagnosis.md")
LENGTHS = (5, 10, 20, 40)
SINGLE = ("cable_friction", "presliding", "end_gain", "drive_viscous", "moment_arm", "end_delay")
PAIRS = (("end_gain", "presliding"), ("cable_friction", "knee_backlash"))
SEED = 60_000


def spent(job: Job, cycles: int) -> tuple[float, float]:
    """Return (processor seconds of the diagnosis, seconds of gait in its trial); two healthy trials beside it."""
    from diagnosis.data import table
    from diagnosis.finder import diagnose

    case = cases.case(job, cycles=cycles)
    trial = table.table("trial", case.trial)
    healthy = [table.table(f"healthy {i}", columns) for i, columns in enumerate(case.healthy)]
    began = time.process_time()
    diagnose([trial], healthy=healthy)
    return time.process_time() - began, float(trial["time_s"][-1])


def lengths() -> list[str]:
    """Return the table by length of trial and healthy trials."""
    job = Job("one", SEED, ("cable_friction",))
    found = {cycles: spent(job, cycles)[0] for cycles in (LENGTHS[0], *LENGTHS)}
    unit = found[10] / 10
    return ["| gait cycles | CPU (s) | per cycle, against 10 cycles |", "|---|---|---|",
            *(f"| {cycles} | {found[cycles]:.1f} | {found[cycles] / cycles / unit:.2f} |" for cycles in LENGTHS)]


def kinds() -> list[str]:
    """Return the table by what is in the trial, ten gait cycles each."""
    single = [spent(Job("one", SEED + 1 + i, (name,)), 10) for i, name in enumerate(SINGLE)]
    pairs = [spent(Job("two", SEED + 50 + i, names), 10) for i, names in enumerate(PAIRS)]
    healthy = [spent(Job("none", SEED + 90 + i), 10) for i in range(2)]
    rows = [f"| {word} | {len(found)} | {median(cpu for cpu, _ in found):.1f} | {max(found)[0]:.1f} | {bar} "
            f"| {median(cpu / gait for cpu, gait in found):.2f} |" for word, found, bar in (
                ("nothing", healthy, "–"), ("one effect", single, "median ≤ 10 s"), ("two effects", pairs, "≤ 60 s"))]
    return ["| in the trial | trials | CPU, median (s) | most (s) | bar | CPU against the gait's seconds |",
            "|---|---|---|---|---|---|", *rows]


def main(arguments: list[str]) -> None:
    """Print both tables."""
    said = (f"Printed by `python -m benchmarks.diagnosis_cost` at commit {provenance.commit()}: one thread, "
            "a trial beside two healthy ones of the same length.")
    text = "\n".join([said, "", *lengths(), "", "Ten gait cycles:", "", *kinds()])
    print(text)
    if "--page" in arguments:
        marked.put(PAGE, "cost", text)


if __name__ == "__main__":
    main(sys.argv[1:])
