"""One row of a sweep, done: an identification, or a trial and its figures.

The rule of this file: what comes in and goes out can be sent to another process or machine, and no bench is shared
with another trial, whichever thread it runs in; a trial's files are gone with it unless they are to be kept.
"""

import dataclasses
import datetime
import hashlib
import json
import math
import tempfile
import traceback
from pathlib import Path
from typing import Any

from bowden.bench import buses, configuration
from bowden.models import identification
from bowden.sweep.rows import IDENTIFIED, NOMINAL, Row, motion, plant_model, table
from bowden.trials import provenance, session
from parameters import InputError
from physics.calibration import write
from trial.signals import FORCE_FIGURES

FIGURES = (
    "trial", "peak_n", "period_s", "cycles", "rate_hz", "serial", "controller", "calibration",
    *(one.name for one in FORCE_FIGURES), *(f"true_{one.name}" for one in FORCE_FIGURES),
    "missed_cycles", "stale_inputs", "bus_load_percent", "bus_load_bound_percent", "simulated_s", "wall_s", "outcome",
    "stop_reason",
)
"""Figures of a row: the keys of `bowden trial --json`, in their order."""
COMMIT = "commit"
"""Column of the commit that made a row."""
BENCH_TABLES = ("bench", "network", "limits", "homing", "plant", "start_sensor", "end_sensor", "servo_drive")
CHANGING = ("bench.day", "bench.seed", "bench.steady")


def digest(row: Row) -> str:
    """Return the sixteen hex digits that name a row."""
    return hashlib.sha256(json.dumps(row, sort_keys=True).encode()).hexdigest()[:16]


def bench_of(row: Row) -> Row:
    """Return the parameters that a calibration belongs to: the bench of a row on day 0, and its treatment by the
    master."""
    kept = {name: value for name, value in row.items()
            if name.partition(".")[0] in BENCH_TABLES and name not in CHANGING}
    return {**kept, "bench.day": 0, "bench.seed": 0, "bench.steady": ""}


def identify(bench: Row) -> tuple[str | None, str]:
    """Identify a bench; return the reason for a missing calibration, or None and its text."""
    sections = {name: table(bench, name) for name in ("network", "limits", "homing")}
    with tempfile.TemporaryDirectory() as folder:
        try:
            found, *_ = identification.perform(
                "all", sections, None, chosen(bench), Path(folder, "identification.mcap"),
                date=datetime.date.today().isoformat())
        except Exception as error:  # a plug-in's, too: it ends this bench's rows, not the sweep
            return reason_of(error), ""
    return (found.reason, "") if found.calibration is None else (None, write(found.calibration))


def perform(row: Row, calibration: str, label: str, keep: str | None) -> dict[str, Any]:
    """Run a row's trial; `calibration` is the text of an identified one and `label` its name, else both are "".

    Returns `FIGURES` and the commit; `keep` is the directory for its recording, None where it is not kept.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder if keep is None else keep, f"{digest(row)}.mcap")
        try:
            found = _figures(row, calibration, place, Path(folder))
        except InputError as error:
            return not_run("refused", str(error))
        except Exception as error:  # a plug-in's, or a fault of this program: it ends this row, not the sweep
            return not_run("failed", reason_of(error))
    found["trial"] = "" if keep is None else found["trial"]
    if label:
        found["calibration"] = label
    defined = {name: None if isinstance(value, float) and not math.isfinite(value) else value
               for name, value in found.items()}
    return defined | {COMMIT: provenance.commit()}


def reason_of(error: Exception) -> str:
    """Return an exception as one sentence: an `InputError` as it is, any other with its kind and place."""
    if isinstance(error, InputError):
        return str(error)
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} in {last.filename}, line {last.lineno}: {' '.join(str(error).split())[:300]}"


def not_run(outcome: str, reason: str) -> dict[str, Any]:
    """Return the figures of a trial that did not take place."""
    return dict.fromkeys(FIGURES) | {
        "trial": "", "outcome": outcome, "stop_reason": reason, COMMIT: provenance.commit()}


def _figures(row: Row, calibration: str, place: Path, folder: Path) -> dict[str, Any]:
    given = str(row["files.calibration"])
    path = None if given == NOMINAL else Path(given)
    if given == IDENTIFIED:
        path = folder / "calibration.toml"
        path.write_text(calibration, encoding="utf-8")
    files = {part: Path(name) if name else None for part, name in vars(table(row, "files")).items()}
    prepared = session.prepare_gait(
        {name: table(row, name) for name in configuration.SECTIONS}, path, chosen(row), peak_given=False,
        period_given=True, knee=files["knee"], desired=files["desired"])
    experiment = prepared.experiment
    departing = dataclasses.replace(experiment, motion=motion(experiment.reference, table(row, "departure")))
    return session.perform(dataclasses.replace(prepared, experiment=departing), place, overwrite=True)


def chosen(row: Row) -> buses.BusSettings:
    """Return the virtual bus of a row, on a separate channel."""
    bench = table(row, "bench")
    return buses.simulated(
        bench.serial, bench.day, bench.seed, plant=bench.plant, plant_model=plant_model(row) or None,
        channel=digest(row), steady=bench.steady.replace("+", ","))
