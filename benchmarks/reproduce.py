"""The paper's table and every controller of this package on twenty benches: docs/results.csv and docs/results.md.

    python -m benchmarks.reproduce [--benches N] [--workers N] [--page]

Each result is a row of a sweep (`bowden.sweep.run`): an interrupted run goes on where it ended, and Ctrl-C writes the
page of the rows that exist.  Benches are identified on day 0 and tried on day 1.  `--page` only writes the page from
docs/results.csv; `--benches` runs the first so many, and the page states how many.
"""

import argparse
import csv
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from benchmarks.frame import DOCS, OUT, filled, markdown, number
from bowden.bench import configuration
from bowden.cli import terminal
from bowden.pages.figures import PAPER_RMSE_PERCENT
from bowden.sweep import rows as sweep_rows
from bowden.sweep import run as sweep_run
from bowden.sweep.rows import IDENTIFIED, Row, Value
from bowden.sweep.sweep_table import SweepTable
from bowden.trials import provenance
from virtual_bus.build import GROUPS

TABLE, PAGE = DOCS / "results.csv", DOCS / "results.md"
TRUE, WINDOW = "true_relative_rmse_percent", "true_relative_rmse_window_percent"
IDLE, JUMP = "true_max_idle_tension_n", "true_peak_jump_n"
FIGURES = ("peak_n", "period_s", "serial", "rate_hz", TRUE, WINDOW, IDLE, JUMP, "outcome", "stop_reason", "commit")
COLUMNS = ("experiment", "case", "controller", *FIGURES)
CONTROLLERS = ("none", "friction", "impedance", "paper", "extended")
PEAKS_N, PERIODS_S = (40.0, 50.0, 60.0), (1.1, 2.0, 4.0)
BENCHES = 20
"""Benches of the own plant that `make reproduce` takes."""


class Result(NamedTuple):
    """One trial; figures are infinite where it did not complete."""

    experiment: str
    case: str
    controller: str
    peak_n: float
    period_s: float
    serial: int
    rmse: float
    window: float
    idle: float
    jump: float
    outcome: str
    commit: str = ""


class Target(NamedTuple):
    """A figure that is to stay at or below a bound; shown with so many digits."""

    text: str
    found: float
    bound: float
    unit: str
    digits: int = 2

    @property
    def met(self) -> bool:
        """Whether it does; an unknown figure does not."""
        return self.found <= self.bound


def read(path: Path) -> list[Result]:
    """Read the page's table."""
    with path.open(newline="", encoding="utf-8") as file:
        return [_result(row) for row in csv.DictReader(file)]


def _result(row: dict[str, str]) -> Result:
    def figure(name: str) -> float:
        return float(row[name]) if row["outcome"] == "completed" and row[name] else math.inf

    return Result(row["experiment"], row["case"], row["controller"], float(row["peak_n"] or "nan"),
                  float(row["period_s"] or "nan"), int(float(row["serial"] or "0")), figure(TRUE), figure(WINDOW),
                  figure(IDLE), figure(JUMP), row["outcome"], row["commit"])


def grid(results: Iterable[Result], controller: str, peak_n: float, period_s: float) -> list[Result]:
    """The benches of one cell of the table."""
    return [r for r in results if (r.experiment, r.controller, r.peak_n, r.period_s)
            == ("grid", controller, peak_n, period_s)]


def worst(results: Sequence[Result], figure: Callable[[Result], float]) -> float:
    """The largest figure; unknown where there is no result."""
    return max(map(figure, results), default=math.nan)


def middle(results: Sequence[Result], figure: Callable[[Result], float]) -> float:
    """The median figure; unknown where there is no result."""
    return median(map(figure, results)) if results else math.nan


def rmse(result: Result) -> float:
    """Relative RMSE, true END, %."""
    return result.rmse


def jump(result: Result) -> float:
    """Jump at the peak, true END, % of the peak."""
    return 100.0 * result.jump / result.peak_n


def targets(results: Sequence[Result]) -> list[Target]:
    """Judge every target; medians are over the benches at the peak that is worst."""
    extended = [r for r in results if r.experiment == "grid" and r.controller == "extended"]
    walking = [r for r in extended if r.period_s <= 2.0]
    blind = [r for r in results if r.experiment == "START ignored"]

    def medians(period_s: float) -> float:
        return max(middle(grid(results, "extended", peak, period_s), rmse) for peak in PEAKS_N)

    return [
        Target("median over the benches at 2.0 s, worst of three peaks", medians(2.0), 0.5, "%"),
        Target("median over the benches at 1.1 s, worst of three peaks", medians(1.1), 0.6, "%"),
        Target("worst bench and peak at 1.1 s and 2.0 s", worst(walking, rmse), 1.0, "%"),
        Target("worst bench, against the worst with START ignored", worst(walking, rmse) / worst(blind, rmse), 0.75,
               "×"),
        Target("largest END at idle, all peaks and periods", worst(extended, lambda r: r.idle), 0.5, "N"),
        Target("jump at the peak, of the peak", worst(extended, jump), 1.5, "%"),
        Target("knee ±5° and ±10 % tempo off the reference, worst",
               worst([r for r in results if r.experiment == "departure"], rmse), 2.0, "%"),
        Target("twice the assumed delay: trials that did not complete",
               sum(r.outcome != "completed" for r in results if r.case.startswith("delay")), 0, "", 0),
    ]


def tables(results: Sequence[Result]) -> dict[str, str]:
    """Return the tables of docs/results.md by their marks."""
    wanted, results = len(results), [r for r in results if r.outcome]
    serials = sorted({r.serial for r in results})
    commits = ", ".join(f"{commit or 'unknown'} {count}" for commit, count in
                        Counter(r.commit for r in results).most_common())
    part = "" if len(results) == wanted else f"**Of {wanted} trials {len(results)} have been run so far.** "
    return {"trials": f"{part}Benches: serial {serials[0]} to {serials[-1]} of {BENCHES}. Trials by commit: {commits}.",
            "grid": _grid(results), "targets": _targets(results), "paper": _rest(results),
            "departures": _departures(results), "shares": _shares(results)}


def _pair(results: Sequence[Result], figure: Callable[[Result], float]) -> str:
    return f"{number(middle(results, figure))} / {number(worst(results, figure))}" if results else "–"


def _grid(results: Sequence[Result]) -> str:
    rows = [
        [f"{period:g}", f"{peak:g}", f"{PAPER_RMSE_PERCENT[peak]:.2f}",
         *(_pair(grid(results, controller, peak, period), rmse) for controller in CONTROLLERS)]
        for period in PERIODS_S for peak in PEAKS_N]
    return markdown(["period (s)", "peak (N)", "the paper's experiment", *(f"`{name}`" for name in CONTROLLERS)], rows)


def _targets(results: Sequence[Result]) -> str:
    return markdown(["target", "at most", "found", ""], [
        [target.text, f"{target.bound:g} {target.unit}".strip(),
         f"{number(target.found, target.digits)} {target.unit}".strip(), "met" if target.met else "**not met**"]
        for target in targets(results)])


def _rest(results: Sequence[Result]) -> str:
    rows = []
    for controller in CONTROLLERS:
        found = [r for r in results if r.experiment == "grid" and r.controller == controller]
        rows.append([f"`{controller}`", _pair(found, lambda r: r.window), _pair(found, lambda r: r.idle),
                     _pair(found, jump)])
    rows.append(["the paper's experiment", "–", "< 1", "–"])
    return markdown(["controller, all peaks and periods", "RMSE within 10…30 % (%)", "largest END at idle (N)",
                     "jump at the peak (% of it)"], rows)


def _departures(results: Sequence[Result]) -> str:
    return markdown(["knee", "benches", "median", "worst"], [
        [case, str(len(those)), number(middle(those, rmse)), number(worst(those, rmse))]
        for case, those in _by_case(results, "departure").items()])


def _by_case(results: Sequence[Result], experiment: str) -> dict[str, list[Result]]:
    cases: dict[str, list[Result]] = {}
    for one in results:
        if one.experiment == experiment:
            cases.setdefault(one.case, []).append(one)
    return cases


def _shares(results: Sequence[Result]) -> str:
    cases = _by_case(results, "share")
    serials = {r.serial for those in cases.values() for r in those}
    all_in = [r for r in grid(results, "extended", 40.0, 2.0) if r.serial in serials]
    base = middle(all_in, rmse)
    rows = [["nothing", number(base), number(worst(all_in, rmse)), "–"]]
    rows += [[case, number(middle(those, rmse)), number(worst(those, rmse)),
              _signed(base - middle(those, rmse))] for case, those in cases.items()]
    return markdown([f"removed (benches: {len(serials)})", "median (%)", "worst (%)", "share, by the median (%)"], rows)


def _signed(share: float) -> str:
    """Return a share with its sign, "0.00" if it is zero and "–" if a trial was stopped."""
    if not math.isfinite(share):
        return "–"
    return f"{round(share, 2) + 0.0:+.2f}" if round(share, 2) else "0.00"


SERIALS = range(1, 1 + BENCHES)
DEPARTING, SHARED = range(1, 9), range(1, 6)
"""Benches whose knee departs, and those that the shares of the error are taken of: fewer, for the time it takes."""
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
    "noise of START: no noise": QUIET,
    "drive: a position loop twice as fast": FAST,
    "delay: doubled in START by a dead time of 2 ms; what it adds is below zero": {"start_sensor.delay_s": 0.002},
    "friction: μ1, μ2 and breakaway as identified": {"bench.steady": "plant.mu1+plant.mu2+plant.stribeck_ratio"},
    "stiffness: rope and fabric as identified, no creep": {
        "bench.steady": "plant.stiffness_scale+plant.creep_compliance"},
    "zero: encoder zero and START's offset as identified": {
        "bench.steady": "plant.encoder_zero_m+start_sensor.offset_n"},
    "knee backlash: none": {"bench.steady": "plant.knee_backlash_rad"},
    "the whole day: tried on the day of the identification": {"bench.day": 0},
    "all of them: no day, no noise, the faster drive; the residual is model structure": {
        "bench.day": 0, **QUIET, **FAST},
}
"""Settings that remove a source of error, by its name."""


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
            for controller in CONTROLLERS[::-1] for period in PERIODS_S for peak in PEAKS_N for serial in serials]
    blind: dict[str, Any] = {"impedance.stiffness_n_m": STIFF_N_M, "gait.cycles": 1, "gait.settle": 0}
    ignored = [Wanted("START ignored", "", row(serial, "extended", peak, period, **blind))
               for period in PERIODS_S[:2] for peak in PEAKS_N for serial in serials]
    departing = [Wanted("departure", case, row(serial, "extended", 40.0, 2.0, **more))
                 for case, more in DEPARTURES.items() for serial in serials if serial in DEPARTING]
    shares = [Wanted("share", case, row(serial, "extended", 40.0, 2.0, **more))
              for case, more in SHARES.items() for serial in serials if serial in SHARED]
    return grid + ignored + departing + shares


def run(results: Sequence[Wanted], path: Path, workers: int | None) -> list[dict[str, str]]:
    """Run the rows that the sweep's table at `path` lacks; return the page's cells of each result."""
    rows = [result.row for result in results]
    columns = list(dict.fromkeys(name for each in rows for name in each))
    nominal = {name: getattr(GROUPS[group](), key) for name in columns for group, _, key in [name.partition(".")]
               if not all(name in each for each in rows)}
    filled = [{name: each.get(name, nominal.get(name)) for name in columns} for each in rows]
    with SweepTable(path, columns) as table:
        if table.commits - {provenance.commit()}:
            terminal.remark(f"{path} has trials by other commits; remove it to run them again.")
        with suppress(KeyboardInterrupt):
            sweep_run.into_table(filled, table, workers=workers, progress=terminal.Terminal())
        return [_cells(result, table.found(each) or {}) for result, each in zip(results, filled, strict=True)]


def _cells(result: Wanted, found: Mapping[str, str]) -> dict[str, str]:
    return {"experiment": result.experiment, "case": result.case, "controller": str(result.row["gait.controller"]),
            **{name: _short(found.get(name, "")) for name in FIGURES},
            "commit": found.get("commit", "")[:7]}


def _short(cell: str) -> str:
    try:
        return f"{float(cell):.4g}"
    except ValueError:
        return cell


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the trials, write the table and the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reproduce")
    parser.add_argument("--benches", type=int, default=BENCHES, help="only the first so many")
    parser.add_argument("--page", action="store_true", help="only write docs/results.md from docs/results.csv")
    parser.add_argument("--workers", type=int)
    options = parser.parse_args(arguments)
    if not options.page:
        OUT.mkdir(exist_ok=True)
        lines = run(wanted(SERIALS[:options.benches]), OUT / "reproduce.csv", options.workers)
        with TABLE.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(lines)
    text = filled(PAGE, tables(read(TABLE)))
    PAGE.write_text(text, encoding="utf-8")
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
