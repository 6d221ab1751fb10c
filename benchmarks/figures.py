"""The paper's figures, redrawn from trials and an identification on the virtual bench: docs/figures.md.

    python -m benchmarks.figures

The rule of this file: what a figure shows was recorded or is a formula; what is said under it is computed from that.
One bench throughout (serial 3, identified on day 0, tried on day 1); Fig. 15 sets the nominal bench beside it.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import redrawn
from bowden.bench import buses, configuration
from bowden.models import identification
from bowden.pages import loops_picture
from bowden.sweep import rows as sweep_rows
from bowden.sweep import run
from bowden.sweep.row_trial import digest
from bowden.sweep.rows import Row, Value
from bowden.sweep.sweep_table import SweepTable
from bowden.trials import session
from master.identification import identify
from physics.calibration import write
from trial import read

ROOT = Path(__file__).resolve().parent.parent
OUT, DOCS = ROOT / "out" / "figures", ROOT / "docs"
SERIAL = 3
TRIALS: dict[str, dict[str, Value]] = {
    "friction 40": {"gait.controller": "friction"},
    "paper 40": {"gait.controller": "paper"},
    "paper 50": {"gait.controller": "paper", "gait.peak_n": 50.0},
    "paper 60": {"gait.controller": "paper", "gait.peak_n": 60.0},
}
NOMINAL: dict[str, Value] = {"gait.controller": "paper", "bench.serial": 0, "gait.cycles": 2}
Columns = Mapping[str, NDArray[np.float64]]


def identified() -> tuple[Path, Path]:
    """Return the calibration of the bench and the recording that it was measured in, made where they are missing."""
    calibration, recorded = OUT / "calibration.toml", OUT / "identification.mcap"
    if not calibration.exists():
        sections = configuration.read(None)
        chosen = buses.simulated(SERIAL, channel="figures")
        (found,) = identification.perform(
            "all", sections, None, chosen, recorded, date=datetime.date.today().isoformat(), overwrite=True)
        if found.calibration is None:
            raise SystemExit(f"the identification stopped: {found.reason}")
        calibration.write_text(write(found.calibration), encoding="utf-8")
    return calibration, recorded


def recorded_trials(calibration: Path) -> dict[str, Columns]:
    """Return the columns of every trial, run where its recording is missing."""
    base: dict[str, Value] = {"bench.serial": SERIAL, "bench.day": 1, "gait.cycles": 2,
                              "files.calibration": str(calibration.relative_to(ROOT))}
    wanted: dict[str, Row] = {name: _row({**base, **more}) for name, more in TRIALS.items()}
    wanted["nominal"] = _row(NOMINAL)
    rows = list(wanted.values())
    files = {name: OUT / f"{digest(row)}.mcap" for name, row in wanted.items()}
    again = not all(file.exists() for file in files.values())
    with SweepTable(OUT / "trials.csv", list(rows[0]), overwrite=again) as table, run.local() as crew:
        run.sweep(rows, table, crew, OUT, keep=str(OUT))
    return {name: read.open(file).columns for name, file in files.items()}


def _row(given: dict[str, Value]) -> Row:
    return sweep_rows.rows(configuration.read(None), given, [])[0]


def main() -> None:
    """Run the missing trials, draw every figure, write the page."""
    OUT.mkdir(parents=True, exist_ok=True)
    session.compile_laws(simulated=True)
    calibration, recording = identified()
    trials = recorded_trials(calibration)
    segments = identify.recorded(read.open(recording))
    drawn: dict[str, Callable[[Any], str]] = {
        "05": redrawn.knee,
        "06": redrawn.desired,
        "09": lambda axes: loops_picture.stiffness(axes, segments),
        "10": lambda axes: loops_picture.swing(axes, segments),
        "13": lambda axes: redrawn.impedance(axes, trials["friction 40"], trials["paper 40"]),
        "15": lambda axes: redrawn.experiment(axes, trials["nominal"], trials["paper 40"]),
        "16": lambda axes: redrawn.peaks(axes, {50: trials["paper 50"], 60: trials["paper 60"]}),
    }
    said = {number: redrawn.drawn(draw, DOCS / f"fig{number}.png") for number, draw in drawn.items()}
    (DOCS / "figures.md").write_text(redrawn.page(said), encoding="utf-8")


if __name__ == "__main__":
    main()
