"""Recorded walking on the virtual bench, stride by stride: docs/walking.md.

    python -m benchmarks.walking [DIRECTORY]

The rule of this file: every file of the directory (../shared/data/gait unless told) is walked as `--knee` walks it,
and every gait cycle has its own figure (`trial.metrics.per_cycle`), true END.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.figures import OUT, ROOT, SERIAL, identified
from benchmarks.results_page import TRUE, markdown, number
from bowden import configuration, session
from bowden.figures import true_end
from bowden.sweep import rows as sweep_rows
from bowden.sweep import run
from bowden.sweep.row_trial import digest
from bowden.sweep.rows import Row, Value
from bowden.sweep.table import Table
from physics.reference import close_cycle
from trial import read
from trial.curves import Curve, read_curve
from trial.metrics import per_cycle

STRIDES = 8
PERIOD_S = 1.2
"""For files that know no time: a brisk walk, as the treadmill's."""
PEAK_N = 40.0


def row(file: Path, timed: bool, calibration: Path) -> Row:
    """Return the trial of one file."""
    given: dict[str, Value] = {
        "bench.serial": SERIAL, "bench.day": 1, "gait.controller": "extended", "gait.cycles": STRIDES,
        "files.knee": str(file), "files.calibration": str(calibration.relative_to(ROOT))}
    period: dict[str, Value] = {} if timed else {"gait.period_s": PERIOD_S}
    found = sweep_rows.rows(configuration.read(None), {**given, **period}, [])[0]
    return {**found, "gait.period_s": round(float(found["gait.period_s"]), 2)}


def strides(recording: Path) -> list[float]:
    """Return the relative RMSE, %, of each gait cycle of a kept trial."""
    recorded = read.open(recording)
    found = per_cycle(recorded.columns, peak_n=PEAK_N, rate_hz=1000, cycles=STRIDES,
                      true_end_n=true_end(recording.with_suffix(".truth.mcap"), recorded))
    return [float("nan") if figures[TRUE] is None else figures[TRUE] or 0.0 for figures in found]


def described(curve: Curve, period_s: float) -> list[str]:
    """Return what was done to a file: name, samples, bridged and left out, what did not close, the stride."""
    closed = close_cycle(curve.percent, curve.values)
    moved = np.abs(np.interp(curve.percent, np.arange(0.0, 100.0, 0.1), closed, period=100.0) - curve.values).max()
    return [curve.path.name, str(len(curve.values)), str(curve.bridged), str(curve.trimmed),
            f"{np.degrees(abs(curve.values[0] - curve.values[-1])):.1f}", f"{np.degrees(moved):.1f}", f"{period_s:g}"]


def page(found: Sequence[tuple[Curve, float, Sequence[float]]]) -> str:
    """Return docs/walking.md."""
    header = ["file", "samples", "bridged", "left out", "did not close by (°)", "closing moved it by (°)", "stride (s)",
              *(str(i) for i in range(1, STRIDES + 1))]
    return "\n\n".join([
        "# Recorded walking, stride by stride",
        "`python -m benchmarks.walking` writes this page: eleven recorded gait cycles, which do not close, and a "
        "treadmill recording with lost markers, each as `bowden trial --knee FILE --controller extended` runs it, on "
        f"the bench of serial {SERIAL}, identified on day 0 and tried on day 1. The last columns are the relative RMSE "
        "of true END, %, in each stride, which the controller learns from.",
        markdown(header, [[*described(curve, period), *(number(value) for value in rmse)]
                          for curve, period, rmse in found]),
        "A gap is bridged by a straight line up to 0.1 s, or 5 % of the gait, and counted; a longer one is refused.",
    ]) + "\n"


def main(arguments: Sequence[str]) -> None:
    """Walk every file, write the page."""
    folder = Path(arguments[0]) if arguments else ROOT.parent / "shared" / "data" / "gait"
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise SystemExit(f"{folder}: no recorded knee motion there; give its directory.")
    OUT.mkdir(parents=True, exist_ok=True)
    session.compile_laws(simulated=True)
    calibration, _ = identified()
    curves = [read_curve(file, "knee_angle_rad") for file in files]
    rows = [row(curve.path, bool(np.isfinite(curve.stride_s)), calibration) for curve in curves]
    kept: Mapping[int, Path] = {i: OUT / f"{digest(each)}.mcap" for i, each in enumerate(rows)}
    again = not all(file.exists() for file in kept.values())
    with Table(OUT / "walking.csv", list(rows[0]), overwrite=again) as table, run.local() as crew:
        run.sweep(rows, table, crew, OUT, keep=str(OUT))
    found = [(curve, float(each["gait.period_s"]), strides(kept[i]))
             for i, (curve, each) in enumerate(zip(curves, rows, strict=True))]
    (ROOT / "docs" / "walking.md").write_text(page(found), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
