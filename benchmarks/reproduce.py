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
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from benchmarks.frame import DOCS, OUT, markdown, number
from bowden.bench import configuration
from bowden.cli import terminal
from bowden.pages.figures import PAPER_RMSE_PERCENT
from bowden.sweep import rows as sweep_rows
from bowden.sweep import run as sweep_run
from bowden.sweep.rows import IDENTIFIED, Row, Value
from bowden.sweep.sweep_table import SweepTable
from bowden.trials import provenance, session
from physics import laws
from physics.converter import SensorParameters
from physics.drive_loops import SERVO_GAINS
from physics.plant.bench_plant import NOMINAL
from virtual_bus.build import GROUPS

TRUE, WINDOW = "true_relative_rmse_percent", "true_relative_rmse_window_percent"
IDLE, JUMP = "true_max_idle_tension_n", "true_peak_jump_n"
FIGURES = ("peak_n", "period_s", "serial", "rate_hz", TRUE, WINDOW, IDLE, JUMP, "outcome", "stop_reason", "commit")
COLUMNS = ("experiment", "case", "controller", *FIGURES)
CONTROLLERS = ("none", "friction", "impedance", "paper", "extended")
PEAKS_N, PERIODS_S = (40.0, 50.0, 60.0), (1.1, 2.0, 4.0)
BENCHES = 20
"""Benches of the own plant that `make reproduce` takes."""
JUMP_BOUND = 1.5
"""The target of the jump at the peak, % of the peak."""


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
        Target("jump at the peak, of the peak", worst(extended, jump), JUMP_BOUND, "%"),
        Target("knee ±5° and ±10 % tempo off the reference, worst",
               worst([r for r in results if r.experiment == "departure"], rmse), 2.0, "%"),
        Target("twice the assumed delay: trials that did not complete",
               sum(r.outcome != "completed" for r in results if r.case == "delay"), 0, "", 0),
    ]


def page(results: Sequence[Result]) -> str:
    """Return the whole page."""
    wanted, results = len(results), [r for r in results if r.outcome]
    serials = sorted({r.serial for r in results})
    commits = Counter(r.commit for r in results)
    part = "" if len(results) == wanted else f"**Of {wanted} trials {len(results)} have been run so far.** "
    parts = [
        "# Results",
        part +
        f"Benches: serial {serials[0]} to {serials[-1]} of {BENCHES}, identified on day 0 by `bowden identify all`, "
        "tried on day 1. Figures are of true END, which no controller sees. `make reproduce` runs every trial on every "
        "bench and writes this page from [results.csv](results.csv); `python -m benchmarks.reproduce --page` writes it "
        "again from the table. Trials by commit: "
        + ", ".join(f"{commit or 'unknown'} {count}" for commit, count in commits.most_common()) + ".",
        "## Relative RMSE of the output force\n",
        "RMSE over whole gait cycles divided by the peak, in %: median / worst of the benches. The paper states one "
        "experiment, without its gait period. `extended` is judged on the two gait cycles after it has learnt for "
        "at most seven; the others keep nothing from cycle to cycle and are judged on the second.\n\n" + _grid(results),
        "## Targets of the extended controller\n\n" + _targets(results),
        "## The rest of the paper's figures\n\n" + _rest(results),
        "## Knee motion off the reference\n",
        "The knee moves otherwise than the controller expects: by a sine of 5° a gait cycle, or faster or slower so "
        "that it runs out of step. 40 N, 2.0 s, true END, relative RMSE in %.\n\n" + _cases(results, "departure"),
        "## Where the remaining error comes from\n",
        "Each line takes one source away, all else as it is (40 N, 2.0 s); what the error loses is that source's "
        "share. Shares do not add up: errors add as squares, and feedback and learning take up what another source "
        "leaves. For the delay there is no bench without; it is doubled instead, which no calibration tells the "
        "controller.\n\n"
        + _shares(results),
        "## The jump at the peak\n",
        _above(results) + _jumps(results),
        "## The plant that these figures are of\n\n" + plant(),
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


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


def _cases(results: Sequence[Result], experiment: str) -> str:
    found = [r for r in results if r.experiment == experiment]
    rows = []
    for case in dict.fromkeys(r.case for r in found):
        those = [r for r in found if r.case == case]
        rows.append([case, str(len(those)), number(middle(those, rmse)), number(worst(those, rmse))])
    return markdown(["knee", "benches", "median", "worst"], rows)


def _shares(results: Sequence[Result]) -> str:
    found = [r for r in results if r.experiment == "share"]
    serials = {r.serial for r in found}
    all_in = [r for r in grid(results, "extended", 40.0, 2.0) if r.serial in serials]
    base = middle(all_in, rmse)
    rows = [["nothing", number(base), number(worst(all_in, rmse)), "–"]]
    for case in dict.fromkeys(r.case for r in found):
        those = [r for r in found if r.case == case]
        rows.append([REMOVED[case], number(middle(those, rmse)), number(worst(those, rmse)),
                     _signed(base - middle(those, rmse))])
    return markdown([f"taken away (benches: {len(serials)})", "median (%)", "worst (%)", "share, by the median (%)"],
                    rows)


def _above(results: Sequence[Result]) -> str:
    """Return a sentence on the trials of the extended controller whose jump exceeds the target."""
    extended = [r for r in results if r.experiment == "grid" and r.controller == "extended"]
    above = [f"serial {r.serial} at {r.peak_n:g} N and {r.period_s:g} s ({number(jump(r))} %)"
             for r in extended if jump(r) > JUMP_BOUND]
    return f"Above {JUMP_BOUND:g} % are {len(above)} of {len(extended)} trials: {', '.join(above) or 'none'}."


def _jumps(results: Sequence[Result]) -> str:
    found = [r for r in results if r.experiment == "jump"]
    if not found:
        return ""
    serials = sorted({r.serial for r in found})
    base = [r for r in grid(results, "extended", 40.0, 1.1) if r.serial in serials]
    rows = [["nothing", *(number(jump(r)) for r in sorted(base, key=lambda r: r.serial))]]
    for case in dict.fromkeys(r.case for r in found):
        those = sorted((r for r in found if r.case == case), key=lambda r: r.serial)
        rows.append([REMOVED[case], *(number(jump(r)) for r in those)])
    table = markdown(["taken away", *(f"serial {serial}" for serial in serials)], rows)
    return (" Each line takes one source away on four benches, at 40 N and 1.1 s; the jump is in % of the peak."
            f"\n\n{table}\n\n{_decisive(base, found)}")


def _decisive(base: Sequence[Result], found: Sequence[Result]) -> str:
    """The one source without which the jump is least."""
    medians = {case: middle([r for r in found if r.case == case], jump) for case in SOURCES}
    least = min(medians, key=lambda case: medians[case])
    return (f"Of single sources {least} matters most: without it the median falls from {number(middle(base, jump))} to "
            f"{number(medians[least])} %.")


def _signed(share: float) -> str:
    """A share, unknown where a trial stopped; nothing has no sign."""
    if not math.isfinite(share):
        return "–"
    return f"{round(share, 2) + 0.0:+.2f}" if round(share, 2) else "0.00"


REMOVED = {
    "noise of START": "noise of START: no noise",
    "drive": "drive: a position loop twice as fast",
    "delay": "delay: doubled in START by a dead time of 2 ms; what it adds is below zero",
    "friction": "friction: μ1, μ2 and breakaway as identified",
    "stiffness": "stiffness: rope and fabric as identified, no creep",
    "zero": "zero: encoder zero and START's offset as identified",
    "knee backlash": "knee backlash: none",
    "the whole day": "the whole day: tried on the day of the identification",
    "model structure": "all of them: no day, no noise, the faster drive; what is left is model structure",
}
"""Source of error that each share's case removes, in words."""
SOURCES = ("noise of START", "drive", "delay", "friction", "stiffness", "zero", "knee backlash")
"""The cases that take one source away."""


def plant() -> str:
    """The numbers of the nominal bench that decide how hard the task is, from their declarations."""
    knee = float(laws.knee_angle(laws.FORCE_PEAK_PERCENT))
    cable = NOMINAL.mu1 * NOMINAL.theta1_rad
    fabric = NOMINAL.mu2 * (NOMINAL.wrap_rad + NOMINAL.fabric_wrap * abs(knee))
    sensor = SensorParameters()
    return "\n".join([
        f"- friction: μ1θ = {cable:.3f}, μ2φ = {fabric:.3f} at the peak, together {cable + fabric:.3f}; ±25 % by "
        "serial, ±10 % by day, breakaway up to 30 % above sliding friction by day",
        f"- pre-sliding: {NOMINAL.presliding_m * 1e3:g} mm in the sheath, {NOMINAL.fabric_presliding_m * 1e3:g} mm on "
        "the knee, ±30 % by serial",
        f"- drive: position loop {SERVO_GAINS.position_gain:g} 1/s, a bandwidth of 25 Hz ± 25 % by serial; Coulomb "
        f"friction {NOMINAL.servo_coulomb_n:g} N at the rope; {NOMINAL.supply_v:g} V",
        "- delay: inputs latched at SYNC k, targets taken over at k + 1, seen at k + 2: 2 ms at 1 kHz",
        f"- sensors: noise {sensor.noise_n:g} N rms before a low-pass of {sensor.cutoff_hz:g} Hz; gain ± 0.5 % and "
        "offset ± 0.1 N by serial, START's offset ± 0.2 N by day",
        "- stiffness: (10), ± 10 % by serial, ± 3 % by day, and creep; encoder zero ± 0.1 mm by day; 0.3° of backlash "
        "in the knee's reducer by day",
    ])


SERIALS, QUICK_SERIALS = range(1, 1 + BENCHES), range(1, 3)
DEPARTING, SHARED = range(1, 9), range(1, 6)
"""Benches whose knee departs, and those that the shares of the error are taken of: fewer, for the time it takes."""
JUMPING = (1, 5, 14, 16)
"""Benches that the shares of the jump at the peak, at 40 N and 1.1 s, are taken of: those above its target are among
them."""
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
            **{name: _short(found.get(name, "")) for name in FIGURES},
            "commit": found.get("commit", "")[:7]}


def _short(cell: str) -> str:
    try:
        return f"{float(cell):.4g}"
    except ValueError:
        return cell


def write_csv(path: Path, lines: Iterable[Mapping[str, str]]) -> None:
    """Write the page's cells."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
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
    text = page(read(folder / f"{name}.csv"))
    (folder / f"{name}.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
