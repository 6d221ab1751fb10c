"""Own code beside the library that could take its place, for docs/decisions/0032-own-code-beside-libraries.md.

    python -m benchmarks.own_or_library

Times are processor time, the least of several repetitions.  `benchmarks.performance` has the rows of MCAP.
"""

from __future__ import annotations

import io
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

from diagnosis.data.table import table
from diagnosis.problem.fit import Space, solve
from diagnosis.problem.healthy_trials import HealthyTrials
from diagnosis.problem.problem import build_problem
from diagnosis.problem.zero_phase import ORDER, SHARE, thinning
from tests.hidden.bench import Bench
from tests.hidden.walk import trial
from trial.convert import csv_file

Row = tuple[str, str, str, str]

TABLES = {
    "comma, point": "time,force\n0.0,1.5\n0.1,2.5\n0.2,3.5\n",
    "semicolon, decimal comma": "time;force\n0,0;1,5\n0,1;2,5\n0,2;3,5\n",
    "tab, row of units": "time\tforce\ns\tN\n0.0\t1.5\n0.1\t2.5\n0.2\t3.5\n",
    "comment lines before the header": "# bench 3\n# 2024-05-01\ntime,force\n0.0,1.5\n0.1,2.5\n0.2,3.5\n",
    "CP1252 with a µ": "time;dehnung [µm]\n0,0;1,5\n0,1;2,5\n0,2;3,5\n",
    "blanks of any width": "time   force\n0.0    1.5\n0.1   2.5\n0.2 3.5\n",
}
"""One small table for each dialect: two columns, three rows, 0 … 0.2 and 1.5 … 3.5."""


def least_s(work: Callable[[], object], times: int) -> float:
    """Return the least processor time of some repetitions, in s."""
    taken = []
    for _ in range(times):
        before = time.process_time()
        work()
        taken.append(time.process_time() - before)
    return min(taken)


def filtering() -> Iterator[Row]:
    """Yield the time of a zero-phase low-pass, thinned to every eighth sample."""
    for size in (2_000, 20_000):
        values = np.random.default_rng(0).normal(size=size)
        own, sections = thinning(8), butter(ORDER, SHARE / 8, output="sos")
        apart = np.abs(own(values) - sosfiltfilt(sections, values)[::8]).max()
        mine = least_s(lambda: own(values), 200)  # noqa: B023
        theirs = least_s(lambda: sosfiltfilt(sections, values)[::8], 200)  # noqa: B023
        yield (f"zero-phase low-pass of {size} samples, µs", f"{1e6 * mine:.0f}", f"{1e6 * theirs:.0f}",
               f"scipy.signal.sosfiltfilt; largest difference {apart:.1g}")


def fitting() -> Iterator[Row]:
    """Yield the time of the reference fit of one bench, by its relations, and the cost that it reaches."""
    healthy = HealthyTrials([table("good.csv", trial(Bench(), seed=2, cycles=4))])
    setting = build_problem([table("walk.csv", trial(Bench(end_offset=2.0), seed=1, cycles=4))], healthy, None)
    problem, free, start = setting.problem, setting.reference.nuisance, setting.reference.values
    space = Space(free, problem.prior)
    root = np.linalg.cholesky(space.precision + 1e-12 * np.eye(len(free))).T
    first = np.clip(space.of(start), space.low, space.high)

    def residuals(at: np.ndarray) -> np.ndarray:
        return np.concatenate([*problem.residuals(space.put(start, at)), root @ (at - space.mean)])

    def theirs() -> float:
        found = least_squares(residuals, first, bounds=(space.low, space.high), x_scale=space.scale, method="trf",
                              diff_step=1e-3, ftol=1e-3)
        return float(found.cost)

    own, peer = solve(problem, start, free).cost, theirs()
    yield (f"fit of {len(free)} bounded parameters, ms", f"{1e3 * least_s(lambda: solve(problem, start, free), 3):.0f}",
           f"{1e3 * least_s(theirs, 3):.0f}",
           f"scipy.optimize.least_squares, trf; cost {own:.6g} here, {peer:.6g} there")


def _right(values: list[np.ndarray]) -> bool:
    wanted = np.array([0.0, 0.1, 0.2]), np.array([1.5, 2.5, 3.5])
    return len(values) == 2 and all(
        one.shape == right.shape and np.allclose(one, right) for one, right in zip(values, wanted, strict=True))


def _by_pandas(data: bytes) -> bool:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = pandas.read_csv(io.BytesIO(data), sep=None, engine="python")
            return _right([found[name].to_numpy(dtype=np.float64) for name in found])
    except (ValueError, pandas.errors.ParserError):
        return False


def reading() -> Iterator[Row]:
    """Yield how many dialects are read right without being told."""
    own = theirs = 0
    for name, text in TABLES.items():
        data = text.encode("cp1252" if "CP1252" in name else "utf-8")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "table.csv")
            path.write_bytes(data)
            own += _right([np.asarray(column, dtype=np.float64) for column in csv_file.read(path).values])
        theirs += _by_pandas(data)
    yield f"CSV dialects of {len(TABLES)} read right", str(own), str(theirs), "pandas.read_csv(sep=None)"


def main() -> None:
    """Print the table."""
    print("| what | here | library | which |\n|---|---|---|---|")
    for rows in (filtering, fitting, reading):
        for row in rows():
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
