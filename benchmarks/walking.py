"""Recorded walking on the virtual bench and on benches of the family, stride by stride: docs/walking.md.

    python -m benchmarks.walking [DIRECTORY] [--workers N]

The rule of this file: every file of the directory (../shared/data/gait unless told) is walked as `--knee` walks it,
and every gait cycle has its own figure (`trial.metrics.per_cycle`), true END.  What has been walked is not again.
"""

from __future__ import annotations

import argparse
import datetime
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks import family_walks
from benchmarks.frame import OUT, ROOT, markdown, number, put
from benchmarks.results_page import TRUE
from bowden.bench import buses, configuration
from bowden.models import identification
from bowden.pages.figures import true_end
from bowden.sweep import rows as sweep_rows
from bowden.sweep import run
from bowden.sweep.row_trial import digest
from bowden.sweep.rows import Row, Value
from bowden.sweep.sweep_table import SweepTable
from bowden.trials import session
from physics.calibration import write
from physics.reference import recorded_angle
from trial import read
from trial.curves import Curve, read_curve
from trial.metrics import per_cycle

SERIAL = 3
"""Bench of the own plant."""
STRIDES = 8
PERIOD_S = 1.2
"""Period of a stride, s, for files without a time column: a brisk walk, as the treadmill's."""
PEAK_N = 40.0
FAMILY = (16, 24, 25)
"""Benches of the family, developed with, none like another: a chain of masses, slip cells behind a play, fronts."""


def identified() -> Path:
    """Return the calibration of the own bench, identified where it is missing."""
    calibration, recorded = OUT / "calibration.toml", OUT / "identification.mcap"
    if not calibration.exists():
        sections = configuration.read(None)
        chosen = buses.simulated(SERIAL, channel="figures")
        (result,) = identification.perform(
            "all", sections, None, chosen, recorded, date=datetime.date.today().isoformat(), overwrite=True)
        if result.calibration is None:
            raise SystemExit(f"the identification stopped: {result.reason}")
        calibration.write_text(write(result.calibration), encoding="utf-8")
    return calibration


def row(file: Path, timed: bool, calibration: Path) -> Row:
    """Return the trial of one file on the own plant."""
    given: dict[str, Value] = {
        "bench.serial": SERIAL, "bench.day": 1, "files.calibration": str(calibration.relative_to(ROOT))}
    return _whole(sweep_rows.rows(configuration.read(None), {**given, **_walk(file, timed)}, [])[0])


def family_row(serial: int, file: Path, timed: bool) -> Row:
    """Return the trial of one file on a bench of the family."""
    return _whole(family_walks.bench_row("family", serial, 1, **_walk(file, timed)))


def _walk(file: Path, timed: bool) -> dict[str, Value]:
    period: dict[str, Value] = {} if timed else {"gait.period_s": PERIOD_S}
    return {"gait.controller": "extended", "gait.cycles": STRIDES, "files.knee": str(file), **period}


def _whole(found: Row) -> Row:
    return {**found, "gait.period_s": round(float(found["gait.period_s"]), 2)}


def walked(name: str, rows: Sequence[Row], workers: int | None) -> list[list[float]]:
    """Run the rows whose recording is missing; returns the strides of each."""
    kept = [OUT / f"{digest(each)}.mcap" for each in rows]
    again = not all(file.exists() for file in kept)
    with SweepTable(OUT / f"{name}.csv", list(rows[0]), overwrite=again) as table, run.local(workers) as crew:
        run.sweep(rows, table, crew, OUT, keep=str(OUT))
    return [strides(file) for file in kept]


def strides(recording: Path) -> list[float]:
    """Return the relative RMSE, %, of each gait cycle of a kept trial."""
    recorded = read.open(recording)
    found = per_cycle(recorded.columns, peak_n=PEAK_N, rate_hz=1000, cycles=STRIDES,
                      true_end_n=true_end(recording.with_suffix(".truth.mcap"), recorded))
    return [float("nan") if figures[TRUE] is None else figures[TRUE] or 0.0 for figures in found]


def described(curve: Curve, period_s: float) -> list[str]:
    """Return a row on a file's preparation: name, samples, bridged and left out, largest closing correction, stride."""
    closed = recorded_angle(curve.percent, curve.values)[0][:-1]
    moved = np.abs(np.interp(curve.percent, np.arange(0.0, 100.0, 0.1), closed, period=100.0) - curve.values).max()
    return [curve.path.name, str(len(curve.values)), str(curve.bridged), str(curve.trimmed),
            f"{np.degrees(abs(curve.values[0] - curve.values[-1])):.1f}", f"{np.degrees(moved):.1f}", f"{period_s:g}"]


def page(
    curves: Sequence[Curve], periods: Sequence[float], own: Sequence[Sequence[float]],
    others: Mapping[int, tuple[Sequence[str], Sequence[Sequence[float]]]],
) -> str:
    """Return the measured part of docs/walking.md.

    `own`: strides by file; `others`, by serial of the family: files' names, strides.
    """
    header = ["file", "samples", "bridged", "left out", "did not close by (°)", "closing moved it by (°)", "stride (s)",
              *(str(i) for i in range(1, STRIDES + 1))]
    parts = [
        "`python -m benchmarks.walking` writes this part: eleven recorded gait cycles, which do not close, and a "
        "treadmill recording with lost markers, each as `bowden trial --knee FILE --controller extended` runs it, on "
        f"the bench of serial {SERIAL}, identified on day 0 and tried on day 1. The last columns are the relative RMSE "
        "of true END, %, in each stride, which the controller learns from.",
        markdown(header, [[*described(curve, period), *map(number, rmse)]
                          for curve, period, rmse in zip(curves, periods, own, strict=True)]),
        "A gap is bridged by a straight line up to 0.1 s, or 5 % of the gait, and counted; a longer one is refused.",
        "### On benches of the family",
        f"Every file at {PEAK_N:g} N on three benches that share no code with the controller's model "
        "([the family](family.md)), identified on day 0 and walked on day 1. RMSE holds a loose rope's drag at END, "
        "which no controller can take away.",
    ]
    for serial, (names, found) in others.items():
        parts += [f"#### Serial {serial}: {family_walks.structure('family', serial)}", markdown(
            ["bench", "file", *(str(i) for i in range(1, STRIDES + 1))],
            [[f"serial {serial}", name, *map(number, rmse)] for name, rmse in zip(names, found, strict=True)]
            + [[f"serial {serial}", "median", *(number(median(stride)) for stride in zip(*found, strict=True))]])]
    return "\n\n".join(parts) + "\n"


def main(arguments: Sequence[str]) -> None:
    """Walk every file on every bench, write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.walking")
    parser.add_argument("directory", nargs="?", type=Path, default=ROOT.parent / "shared" / "data" / "gait")
    parser.add_argument("--workers", type=int)
    options = parser.parse_args(arguments)
    files = sorted(options.directory.glob("*.csv"))
    if not files:
        raise SystemExit(f"{options.directory}: no recorded knee motion there; give its directory.")
    OUT.mkdir(parents=True, exist_ok=True)
    session.compile_laws(simulated=True)
    calibration = identified()
    curves = [read_curve(file, "knee_angle_rad") for file in files]
    timed = [bool(np.isfinite(curve.stride_s)) for curve in curves]
    rows = [row(curve.path, own, calibration) for curve, own in zip(curves, timed, strict=True)]
    own = walked("walking", rows, options.workers)
    both = list(zip(curves, timed, strict=True))
    others = {serial: (tuple(curve.path.name for curve, _ in both), walked(f"walking_{serial}", [
        family_row(serial, curve.path, each) for curve, each in both], options.workers)) for serial in FAMILY}
    periods = [float(each["gait.period_s"]) for each in rows]
    put(ROOT / "docs" / "walking.md", "walking", page(curves, periods, own, others))


if __name__ == "__main__":
    main(sys.argv[1:])
