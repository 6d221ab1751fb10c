"""Rows of `benchmarks.performance` about whole tools: the plant, a diagnosis, several processes.

The rule of this file: as in `performance_rows`, both sides do the same work.  What several processes save is time on
the wall, taken turn about with one process; a machine that is busy has no second processor to give.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks import diagnosis_cost
from benchmarks.frame import Row, compare, quartiles, repeated
from bowden.sweep import diagnose_each, row_trial, rows
from bowden.sweep import run as sweep_run
from physics.plant.bench_plant import create
from physics.plant.leg import KNEE_AT_FIT
from tests.hidden.cases import Job
from tests.physics.test_physics_plant_accuracy import KNEE_NM, SECONDS, SERVO_NM, Equations

SWEPT, DIAGNOSED, TURNS = 8, 6, 3
"""Trials of a sweep, of a diagnosis of many, and how often each is timed."""
Crew = Callable[[int], AbstractContextManager[sweep_run.Workers]]


def plant() -> Iterator[Row]:
    """Pulling and flexing, by the plant and by SciPy's integrator at a tolerance that is no more exact than needed."""
    times = np.linspace(0.0, SECONDS, 11)
    made = create({"start_knee_rad": KNEE_AT_FIT, "start_slack_m": 0.0}, 0)
    made.reset(0)
    equations = Equations(made)

    def solved(rtol: float) -> np.ndarray:
        solution = solve_ivp(equations, (0.0, SECONDS), equations.start, "LSODA", t_eval=times, rtol=rtol,
                             atol=rtol * 1e-2)
        return np.array(solution.y[0])

    def stepped() -> np.ndarray:
        made.reset(0)
        return np.array([made.advance(round(t * 1e9), SERVO_NM, KNEE_NM).servo_position_m for t in times])

    exact = solved(1e-9)
    error = float(np.abs(stepped() - stepped()[0] - exact + exact[0]).max())
    rtol = next((each for each in (1e-3, 1e-4, 1e-5, 1e-6) if np.abs(solved(each) - exact).max() <= error), 1e-7)

    yield compare("plant alone, a millisecond of it, µs", partial(repeated, unit=stepped, units=4),
                  f"SciPy `solve_ivp`, LSODA, rtol {rtol:g}: both within {error:.0e} m",
                  partial(repeated, unit=lambda: solved(rtol), units=4), units=4 * round(SECONDS * 1e3), turns=20)


def diagnosis() -> Iterator[Row]:
    """A diagnosis of ten gait cycles beside two healthy trials, compiled and warm."""
    single, pair = ("cable_friction",), diagnosis_cost.PAIRS[0]
    diagnosis_cost.spent(Job("one", diagnosis_cost.SEED, single), 5)
    for what, names in (("one effect", single), ("two effects", pair)):
        kind = "one" if len(names) == 1 else "two"
        cpu_s, gait_s = diagnosis_cost.spent(Job(kind, diagnosis_cost.SEED + 1, names), 10)
        yield (f"diagnosis of ten gait cycles, {what}, s of CPU", f"{cpu_s:.1f}", "the trial itself lasted, s",
               f"{gait_s:.1f}", f"{gait_s / cpu_s:.1f}")


def processes() -> Iterator[Row]:
    """A sweep and a diagnosis of many trials on two processes, and on two Dask workers."""
    with tempfile.TemporaryDirectory() as name:
        planned = rows.rows({}, {"files.calibration": rows.NOMINAL}, [("bench.serial", list(range(1, SWEPT + 1)))])
        kept = [row_trial.perform(row, "", "", name)["trial"] for row in planned[:2]]
        trials = [Path(kept[i % 2]) for i in range(DIAGNOSED)]
        given = diagnose_each.DiagnosisSettings(None, (), (), None)

        def sweep(crew: sweep_run.Workers) -> None:
            for each in [crew.executor.submit(row_trial.perform, row, "", "", None) for row in planned]:
                each.result()

        def diagnose(crew: sweep_run.Workers) -> None:
            for each in [crew.executor.submit(diagnose_each.perform, trial, given) for trial in trials]:
                each.result()

        for work, what, count in ((sweep, "sweep", SWEPT), (diagnose, "diagnosis", DIAGNOSED)):
            for crew, who in ((sweep_run.local, "processes"), (_cluster, "Dask workers")):
                yield _in_parallel(crew, work, f"{what} of {count} trials on two {who}, s on the wall")


@contextmanager
def _cluster(count: int) -> Iterator[sweep_run.Workers]:
    from distributed import LocalCluster

    with (LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=":0") as made,
          sweep_run.cluster(made.scheduler_address) as workers):
        yield workers


def _in_parallel(crew: Crew, work: Callable[[sweep_run.Workers], None], name: str) -> Row:
    spent: list[list[float]] = [[], []]
    with crew(1) as one, crew(2) as two:
        for workers in (one, two, two):  # both of two have imported and compiled before it counts
            work(workers)
        for _ in range(TURNS):
            for place, workers in enumerate((two, one)):
                began = time.perf_counter()
                work(workers)
                spent[place].append(time.perf_counter() - began)
    own, peer = spent
    return name, f"{np.median(own):.1f}", "on one", f"{np.median(peer):.1f}", quartiles(own, peer, 2)
