"""The paper's table, beside every controller here, on twenty benches: docs/results.csv and docs/results.md.

    python -m benchmarks.reproduce [--quick] [--benches N] [--workers N] [--page]

The rule of this file: a result is a row of a sweep (`bowden.sweep.run`), so that what is interrupted goes on and
nothing is run twice; Ctrl-C writes the page of what there is.  The page is made from docs/results.csv alone (`--page`
does only that).  Benches are identified on day 0 and tried on day 1.  `--quick` takes two benches and writes to out/;
`--benches` takes the first so many, and the page says which it is of.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import results_page
from benchmarks.frame import DOCS, OUT
from bowden.bench import configuration
from bowden.cli import terminal
from bowden.sweep import rows as sweep_rows
from bowden.sweep import run as sweep_run
from bowden.sweep.rows import IDENTIFIED, Row, Value
from bowden.sweep.sweep_table import SweepTable
from bowden.trials import provenance, session
from master.control.controller import CONTROLLERS
from virtual_bus.build import GROUPS

SERIALS, QUICK_SERIALS = range(1, 1 + results_page.BENCHES), range(1, 3)
DEPARTING, SHARED = range(1, 9), range(1, 6)
"""Benches whose knee departs, and those that the shares of the error are taken of: fewer, for the time it takes."""
JUMPING = (1, 5, 14, 16)
"""Benches that the shares of the jump at the peak, at 40 N and 1.1 s, are taken of: those above its target are among
them."""
PEAKS_N, PERIODS_S = (40.0, 50.0, 60.0), (1.1, 2.0, 4.0)
WITHOUT_MEMORY = (2, 1)
"""Gait cycles, and how many of them are left out, of the controllers that keep nothing from cycle to cycle."""
LEARNING = {1.1: (9, 7), 2.0: (8, 6), 4.0: (5, 3)}
"""Cycles of the controller that learns, by period: at most seven cycles of learning, then two that count."""
STIFF_N_M = 1e6
"""K at its upper bound: Δx is a micrometre a newton, so that START moves nothing during the walk."""
FIVE_DEGREES = math.radians(5.0)

DEPARTURES: dict[str, dict[str, Value]] = {
    "+5°": {"departure.angle_rad": FIVE_DEGREES}, "−5°": {"departure.angle_rad": -FIVE_DEGREES},
    "+10 % tempo": {"departure.tempo": 1.1}, "−10 % tempo": {"departure.tempo": 0.9},
}
QUIET: dict[str, Value] = {"start_sensor.noise_n": 0.0}
FAST: dict[str, Value] = {"servo_drive.position_gain": 250.0}
SHARES: dict[str, dict[str, Value]] = {
    "noise of START": QUIET,
    "drive": FAST,
    "delay": {"start_sensor.delay_s": 0.002},
    "friction": {"bench.steady": "plant.mu1+plant.mu2+plant.stribeck_ratio"},
    "stiffness": {"bench.steady": "plant.stiffness_scale+plant.creep_compliance"},
    "zero": {"bench.steady": "plant.encoder_zero_m+start_sensor.offset_n"},
    "knee backlash": {"bench.steady": "plant.knee_backlash_rad"},
    "the whole day": {"bench.day": 0},
    "model structure": {"bench.day": 0, **QUIET, **FAST},
}


class Wanted(NamedTuple):
    """One result that is wanted: the experiment and the case it belongs to, and the row that yields it."""

    experiment: str
    case: str
    row: Row


def row(serial: int, controller: str, peak_n: float, period_s: float, **more: Value) -> Row:
    """Return the row of one trial on day 1; `more` by full name, dots as double underscores."""
    cycles, settle = LEARNING[period_s] if controller == "extended" else WITHOUT_MEMORY
    given: dict[str, Value] = {
        "bench.serial": serial, "bench.day": 1, "gait.controller": controller, "gait.peak_n": peak_n,
        "gait.period_s": period_s, "gait.cycles": cycles, "gait.settle": settle, "files.calibration": IDENTIFIED}
    return sweep_rows.rows(configuration.read(None), {**given, **more}, [])[0]


def wanted(serials: Sequence[int]) -> list[Wanted]:
    """Return every result of the page, the benches of each experiment as far as they are in `serials`."""
    grid = [Wanted("grid", "", row(serial, controller, peak, period))
            for controller in CONTROLLERS for period in PERIODS_S for peak in PEAKS_N for serial in serials]
    blind: dict[str, Any] = {"impedance.stiffness_n_m": STIFF_N_M, "gait.cycles": 1, "gait.settle": 0}
    ignored = [Wanted("START ignored", "", row(serial, "extended", peak, period, **blind))
               for period in PERIODS_S[:2] for peak in PEAKS_N for serial in serials]
    departing = [Wanted("departure", case, row(serial, "extended", 40.0, 2.0, **more))
                 for case, more in DEPARTURES.items() for serial in serials if serial in DEPARTING]
    shares = [Wanted("share", case, row(serial, "extended", 40.0, 2.0, **more))
              for case, more in SHARES.items() for serial in serials if serial in SHARED]
    jumps = [Wanted("jump", case, row(serial, "extended", 40.0, 1.1, **more))
             for case, more in SHARES.items() for serial in serials if serial in JUMPING]
    return sorted(grid + ignored + departing + shares + jumps, key=_telling)


def _telling(result: Wanted) -> int:
    """Order by what the page needs first, as a run may be interrupted: the targets, then the paper, then the rest."""
    controller, period_s = result.row["gait.controller"], result.row["gait.period_s"]
    if result.experiment != "grid":
        return {"START ignored": 1, "departure": 3, "share": 4, "jump": 4}[result.experiment]
    return {"extended": 0 if period_s in PERIODS_S[:2] else 5, "paper": 2}.get(str(controller), 6)


def run(results: Sequence[Wanted], path: Path, workers: int | None) -> list[dict[str, str]]:
    """Run the rows that the sweep's table at `path` lacks; return the page's cells of each result."""
    rows = [result.row for result in results]
    columns = list(dict.fromkeys(name for each in rows for name in each))
    filled = [{name: each[name] if name in each else _nominal(name) for name in columns} for each in rows]
    session.compile_laws(simulated=True)
    with SweepTable(path, columns) as table, sweep_run.local(workers) as crew:
        if table.commits - {provenance.commit()}:
            terminal.remark(f"{path} has trials by other commits; remove it to run them again.")
        with terminal.progress("reproduce") as update, suppress(KeyboardInterrupt):
            sweep_run.sweep(filled, table, crew, path.with_suffix(".calibrations"), update=update)
        return [_cells(result, table.found(each) or {}) for result, each in zip(results, filled, strict=True)]


def _nominal(name: str) -> Value:
    """Return the nominal value of a parameter by its full name, for rows that do not vary it."""
    group, _, key = name.partition(".")
    found: Value = getattr(GROUPS[group](), key)
    return found


def _cells(result: Wanted, found: Mapping[str, str]) -> dict[str, str]:
    return {"experiment": result.experiment, "case": result.case, "controller": str(result.row["gait.controller"]),
            **{name: _short(found.get(name, "")) for name in results_page.FIGURES},
            "commit": found.get("commit", "")[:7]}


def _short(cell: str) -> str:
    try:
        return f"{float(cell):.4g}"
    except ValueError:
        return cell


def write_csv(path: Path, lines: Iterable[Mapping[str, str]]) -> None:
    """Write the page's cells."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, results_page.COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, tabulate, write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reproduce")
    parser.add_argument("--quick", action="store_true", help="two benches, into out/")
    parser.add_argument("--benches", type=int, default=len(SERIALS), help="only the first so many")
    parser.add_argument("--page", action="store_true", help="only write docs/results.md from docs/results.csv")
    parser.add_argument("--workers", type=int)
    options = parser.parse_args(arguments)
    folder, name = (OUT, "quick") if options.quick else (DOCS, "results")
    if not options.page:
        OUT.mkdir(exist_ok=True)
        results = wanted(QUICK_SERIALS if options.quick else SERIALS[:options.benches])
        write_csv(folder / f"{name}.csv", run(
            results, OUT / ("reproduce_quick.csv" if options.quick else "reproduce.csv"), options.workers))
    text = results_page.page(results_page.read(folder / f"{name}.csv"))
    (folder / f"{name}.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
