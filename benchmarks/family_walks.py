"""Walks of the family of tests/plants and of the own plant: each bench identified on day 0 and walked on day 1.

The rule of this file: a bench is measured through the wire, by the controller as it ships; its results are one row.
"""

from __future__ import annotations

import csv
import json
import math
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.frame import ROOT

if TYPE_CHECKING:
    from physics.calibration import Calibration

PEAKS_N = (40.0, 50.0, 60.0)
PERIODS_S = (2.0, 1.1)
CYCLES, SETTLE = 9, 7
"""Gait cycles of learning and in all: at most seven are learnt from, two count."""
LOOSE_SLACK_M = 20e-3
"""Slack, m, of a walk with a loose rope, whose END is the drag of its weight and grease."""
DRIVE_N = 88.0
"""START tension that the servo's own watch permits, with a margin: a peak that needs more is out of a bench's reach."""
SERIALS = 42
"""Benches of the family: serials from 0, a third of them set aside."""
DEVELOPMENT = tuple(s for s in range(SERIALS) if s % 3 != 2)
SET_ASIDE = tuple(range(2, SERIALS, 3))
OWN = (1, 3, 5)
IDLE_N = 0.5
"""END at idle, N, above which a walk with a loose rope is added."""
BEFORE = ("true_relative_rmse_percent", "true_relative_rmse_window_percent", "true_max_idle_tension_n",
          "true_peak_jump_n", "by_cycle")
"""Results that a row keeps of its walk by a calibration without a discrepancy."""
TRUE = "true_relative_rmse_percent"
WINDOW = "true_relative_rmse_window_percent"
COUNTERPARTS: Mapping[str, Callable[[Any], float]] = {
    "cable_exponent": lambda b: b.mu1 * b.theta1 * _at_40(b),
    "fabric exponent, upright": lambda b: b.mu2 * b.wrap * _at_40(b),
    "fabric exponent, slope": lambda b: b.mu2 * b.wrap_slope * _at_40(b),
    "load_slope": lambda b: b.load_slope / _at_40(b),
    "presliding": lambda b: b.presliding, "fabric_presliding": lambda b: b.fabric_presliding,
    "breakaway": lambda b: b.sheath_ratio - 1.0, "fabric_breakaway": lambda b: b.fabric_ratio - 1.0,
    "stribeck_speed": lambda b: b.stribeck_speed, "stribeck_memory": lambda b: b.stribeck_memory,
    "viscous": lambda b: b.viscous, "viscous_tension": lambda b: _greased(),
    "rope_per_knee": lambda b: b.moment_arm, "start_gain": lambda b: b.start_gain / b.end_gain,
    "start_offset": lambda b: b.start_offset,
}
"""Constant → its true counterpart on a bench of the family; those of the lumped model without one are not judged."""


def _greased() -> float:
    from tests.plants.friction import GREASE_N

    return GREASE_N


def _at_40(bench: Any) -> float:
    return float(1.0 + bench.load_slope * (40.0 - bench.load_reference) / 40.0)


def bench_row(kind: str, serial: int, day: int, **more: Any) -> dict[str, Any]:
    """Return a sweep's row for a bench: the own plant by its serial, the family's by the plant's name."""
    from bowden.bench import configuration
    from bowden.sweep import rows
    from bowden.sweep.rows import IDENTIFIED

    given: dict[str, Any] = {"bench.serial": serial, "bench.day": day, "files.calibration": IDENTIFIED, **more}
    if kind == "family":
        from tests.plants import stack

        given |= {"bench.serial": 0, "bench.day": 0, "bench.plant": stack.plant_name(serial, day),
                  "servo_drive.position_gain": stack.plant_model(serial)["servo_drive"]["position_gain"]}
    return dict(rows.rows(configuration.read(None), given, [])[0])


def structure(kind: str, serial: int) -> str:
    """Return friction and stretch equations and knee of a serial, in words."""
    if kind != "family":
        return "own plant"
    from tests.plants.draws import draw

    made = draw(serial).structure
    return f"{made.implementation}, {made.stretch}, breakaway {made.stribeck}, knee {made.knee}"


def measure(kind: str, serial: int, earlier: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Identify a bench on day 0, walk on it on day 1: everything the tables need, or `failed` with the reason.

    `earlier`: the bench's row of an earlier run, whose scalars and whose walks that use no discrepancy are kept; the
    gait trials of the identification and the walks by the extended controller are made anew.
    """
    from bowden.sweep import row_trial
    from bowden.trials import session

    sys.path.insert(0, str(ROOT))
    session.compile_laws(simulated=True)
    said: dict[str, Any] = {"kind": kind, "serial": serial, "structure": structure(kind, serial)}
    row = bench_row(kind, serial, 0)
    known = () if earlier is None else ("gait", calibration_of(earlier))
    reason, text = row_trial.identify(row_trial.bench_of(row), *known)
    if reason is not None:
        return said | {"failed": reason}
    peak = PEAKS_N[(serial // 3) % 3]
    said |= {"peak_n": peak, "needs_n": _needs(kind, serial, peak),
             "calibration": _scalars(text), "discrepancy": _discrepancy(text)}
    for period in PERIODS_S:
        walk = {"gait.peak_n": peak, "gait.period_s": period}
        learnt = walked(kind, serial, text, "extended", CYCLES, SETTLE, walk)
        if earlier is not None:
            before = earlier[f"{period:g}"]
            said[f"{period:g}"] = {**learnt, **{name: before.get(name) for name in ("blind", "paper", "loose")},
                                   "before": before.get("before", {name: before.get(name) for name in BEFORE})}
            continue
        blind = walked(kind, serial, text, "extended", 1, 0, {**walk, "impedance.stiffness_n_m": 1e6})
        paper = walked(kind, serial, text, "paper", 2, 1, walk)
        loose: Mapping[str, Any] = {}
        if learnt.get("true_max_idle_tension_n", 0.0) > IDLE_N:
            loose = walked(kind, serial, text, "none", 2, 1, {**walk, "gait.idle_slack_m": LOOSE_SLACK_M})
        said[f"{period:g}"] = {**learnt, "blind": blind.get(TRUE), "paper": paper.get(TRUE),
                               "loose": loose.get("true_max_idle_tension_n")}
    return said


def calibration_of(row: Mapping[str, Any]) -> Calibration:
    """Return the calibration that a bench's row of the table states, to the table's five digits.

    A scalar was measured if its interval is not a point; homing corrects START's lag only on a calibration without it.
    """
    import dataclasses

    from physics import calibration
    from physics.end_discrepancy import EndDiscrepancy

    told, scalars = row.get("discrepancy"), row["calibration"]
    beyond = None if told is None else EndDiscrepancy(**{name: _tuples(value) for name, value in told.items()})
    measured = {name: calibration.ScalarEvidence(*each["interval"], r_squared=each["r_squared"] or math.nan)
                for name, each in scalars.items() if each["interval"][0] < each["interval"][1]}
    return dataclasses.replace(calibration.nominal(), discrepancy=beyond, evidence=measured, label="docs/unseen.csv",
                               **{name: each["value"] for name, each in scalars.items()})


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _discrepancy(text: str) -> Any:
    """Return the discrepancy of a calibration's text as the table keeps it, None where it has none."""
    import tomllib

    from physics import end_discrepancy

    told = end_discrepancy.stated(tomllib.loads(text), "calibration.toml")
    return None if told is None else json.loads(json.dumps(told._asdict()))


def _scalars(text: str) -> dict[str, Any]:
    """Value, interval and R² of every scalar of a calibration's text."""
    from physics import calibration

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "calibration.toml")
        path.write_text(text, encoding="utf-8")
        read_back = calibration.read(path)
    told: dict[str, Any] = {}
    for name in calibration.scalars():
        value, proof = getattr(read_back, name), read_back.evidence.get(name)
        low, high = (proof.low, proof.high) if proof is not None and math.isfinite(proof.low) else (value, value)
        told[name] = {"value": value, "interval": [low, high], "r_squared": proof.r_squared if proof else math.nan}
    return told


def _needs(kind: str, serial: int, peak: float) -> float:
    """START tension, N, that the peak takes on the day of the walk; 0 where the truth is not the family's."""
    if kind != "family":
        return 0.0
    from tests.plants.draws import draw

    b = draw(serial, 1)
    force, parts = peak, 8
    for share in [b.mu2 * (b.wrap + 0.53 * b.wrap_slope) / parts] * parts + [b.mu1 * b.theta1 / parts] * parts:
        force *= math.exp(share * (1.0 + b.load_slope * (force - b.load_reference) / 40.0))
    return force


def walked(kind: str, serial: int, text: str, controller: str, cycles: int, settle: int,
           more: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results of a walk on day 1 by the calibration `text`; `more`: further settings of the row."""
    from bowden.sweep import row_trial

    row = bench_row(kind, serial, 1, **{
        "gait.controller": controller, "gait.cycles": cycles, "gait.settle": settle, **more})
    with tempfile.TemporaryDirectory() as folder:
        found = row_trial.perform(row, text, "", folder)
        if found["outcome"] != "completed":
            return {"outcome": found["outcome"], "stop_reason": found["stop_reason"]}
        told = {name: found[name] for name in (TRUE, WINDOW, "true_max_idle_tension_n", "true_peak_jump_n", "outcome")}
        if controller == "extended" and cycles > 1:
            told |= _by_cycle(Path(found["trial"]), cycles, float(row["gait.peak_n"]))
    return told


def _by_cycle(path: Path, cycles: int, peak_n: float) -> dict[str, Any]:
    """RMSE by gait cycle, %, and how far the estimate of END is off, relative, in the first and in the last cycle."""
    from trial import read

    trial, truth = read.open(path), read.open_table(path.with_name(f"{path.stem}.truth.mcap"), "/truth")
    end = np.interp(trial.time_ns, truth.time_ns, truth.columns["true_end_n"])
    cycle, desired = trial.columns["cycle"], trial.columns["desired_force_n"]
    error = end - desired
    rmse = [100.0 * math.sqrt(float(np.mean(error[cycle == k] ** 2))) / peak_n for k in range(cycles)]
    slides = np.abs(trial.columns["rope_direction"]) > 0.9
    told = slides & (np.abs(trial.columns["strain_direction"]) > 0.9) & (desired > 0.3 * peak_n)
    estimated = trial.columns["estimated_end_force_n"]
    apart = np.abs(np.log(np.maximum(estimated, 0.1) / np.maximum(end, 0.1)))
    away = [float(np.median(apart[told & (cycle == k)])) if np.any(told & (cycle == k)) else math.nan
            for k in (0, cycles - 1)]
    return {"by_cycle": rmse, "homed_away": away[0], "followed_away": away[1]}


def read(path: Path) -> dict[tuple[str, int], dict[str, Any]]:
    """The benches in a table: one JSON object a line, after kind and serial; of two lines the later one counts."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        return {(kind, int(serial)): json.loads(text) for kind, serial, text in csv.reader(file)}


def append(path: Path, bench: Mapping[str, Any]) -> None:
    """Enter the walks of one bench in a table."""
    with path.open("a", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerow([bench["kind"], bench["serial"], json.dumps(bench)])


def compact(path: Path) -> dict[tuple[str, int], dict[str, Any]]:
    """Remove all but the last line of each bench from a table; return the benches."""
    done = read(path)
    if done:
        fresh = path.with_suffix(".new")
        for bench in done.values():
            append(fresh, bench)
        fresh.replace(path)
    return done
