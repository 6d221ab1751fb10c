"""Control of benches that nothing was tuned on: the family of tests/plants, and the own plant for comparison.

    python -m benchmarks.family [--set-aside] [--serials 0,1,3] [--own 1,3] [--workers N] [--page]

A bench is identified on day 0 and walked on day 1, over the bus, by the controller as it ships.  Each bench is a row of
docs/unseen.csv, so that an interrupted run goes on where it ended; the tables of docs/unseen.md are made from these
rows (`--page` does only that).  Serials with serial % 3 == 2 are set aside: nothing is tuned on them, and --set-aside
runs them once.
"""

import argparse
import math
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from benchmarks import frame
from benchmarks.frame import DOCS, ROOT, markdown
from bowden.bench import configuration
from bowden.sweep import row_trial
from bowden.sweep import rows as sweep_rows
from bowden.sweep.rows import IDENTIFIED
from bowden.trials import session
from physics import calibration, end_discrepancy
from tests.plants import stack
from tests.plants.draws import draw
from tests.plants.friction import GREASE_N
from trial.read import open as open_trial
from trial.read import open_table

TABLE, PAGE, KEYS = DOCS / "unseen.csv", DOCS / "unseen.md", ("kind", "serial")
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
TRUE = "true_relative_rmse_percent"
WINDOW = "true_relative_rmse_window_percent"
FABRIC = {"fabric exponent, upright": "phi0", "fabric exponent, slope": "fabric_wrap"}
"""Exponents of the fabric: μ2 times this constant."""
COUNTERPARTS: Mapping[str, Callable[[Any], float]] = {
    "cable_exponent": lambda b: b.mu1 * b.theta1 * _at_40(b),
    "fabric exponent, upright": lambda b: b.mu2 * b.wrap * _at_40(b),
    "fabric exponent, slope": lambda b: b.mu2 * b.wrap_slope * _at_40(b),
    "load_slope": lambda b: b.load_slope / _at_40(b),
    "presliding": lambda b: b.presliding, "fabric_presliding": lambda b: b.fabric_presliding,
    "breakaway": lambda b: b.sheath_ratio - 1.0, "fabric_breakaway": lambda b: b.fabric_ratio - 1.0,
    "stribeck_speed": lambda b: b.stribeck_speed, "stribeck_memory": lambda b: b.stribeck_memory,
    "viscous": lambda b: b.viscous, "viscous_tension": lambda b: GREASE_N,
    "rope_per_knee": lambda b: b.moment_arm, "start_gain": lambda b: b.start_gain / b.end_gain,
    "start_offset": lambda b: b.start_offset,
}
"""Constant → its true counterpart on a bench of the family; those of the lumped model without one are not judged."""


def _at_40(bench: Any) -> float:
    return float(1.0 + bench.load_slope * (40.0 - bench.load_reference) / 40.0)


def bench_row(kind: str, serial: int, day: int, **more: Any) -> dict[str, Any]:
    """Return a sweep's row for a bench: the own plant by its serial, the family's by the plant's name."""
    given: dict[str, Any] = {"bench.serial": serial, "bench.day": day, "files.calibration": IDENTIFIED, **more}
    if kind == "family":
        given |= {"bench.serial": 0, "bench.day": 0, "bench.plant": stack.plant_name(serial, day),
                  "servo_drive.position_gain": stack.plant_model(serial)["servo_drive"]["position_gain"]}
    return dict(sweep_rows.rows(configuration.read(None), given, [])[0])


def structure(kind: str, serial: int) -> str:
    """Return friction and stretch equations and knee of a serial, in words."""
    if kind != "family":
        return "own plant"
    made = draw(serial).structure
    return f"{made.implementation}, {made.stretch}, breakaway {made.stribeck}, knee {made.knee}"


def measure(kind: str, serial: int) -> dict[str, Any]:
    """Identify a bench on day 0 and walk on it on day 1; return its row, or `failed` with the reason."""
    sys.path.insert(0, str(ROOT))
    session.compile_laws(simulated=True)
    row: dict[str, Any] = {"kind": kind, "serial": serial, "structure": structure(kind, serial)}
    reason, text = row_trial.identify(row_trial.bench_of(bench_row(kind, serial, 0)))
    if reason is not None:
        return row | {"failed": reason}
    peak = PEAKS_N[(serial // 3) % 3]
    row |= {"peak_n": peak, "needs_n": _needs(kind, serial, peak), "calibration": calibration.write(parsed(text))}
    for period in PERIODS_S:
        walk = {"gait.peak_n": peak, "gait.period_s": period}
        learnt = walked(kind, serial, text, "extended", CYCLES, SETTLE, walk)
        blind = walked(kind, serial, text, "extended", 1, 0, {**walk, "impedance.stiffness_n_m": 1e6})
        paper = walked(kind, serial, text, "paper", 2, 1, walk)
        loose: Mapping[str, Any] = {}
        if learnt.get("true_max_idle_tension_n", 0.0) > IDLE_N:
            loose = walked(kind, serial, text, "none", 2, 1, {**walk, "gait.idle_slack_m": LOOSE_SLACK_M})
        row[f"{period:g}"] = {**learnt, "blind": blind.get(TRUE), "paper": paper.get(TRUE),
                              "loose": loose.get("true_max_idle_tension_n")}
    return row


def parsed(text: str) -> calibration.Calibration:
    """Return the calibration that a text states, without the name of its bench: the walks' bus is another day's."""
    tables, where = tomllib.loads(text), TABLE.name
    values, evidence = calibration.stated(tables, where)
    return calibration.of_values(values, evidence, label=where, bench="", beyond=end_discrepancy.stated(tables, where),
                                 together=calibration.stated_correlation(tables, where))


def _needs(kind: str, serial: int, peak: float) -> float:
    """START tension, N, that the peak takes on the day of the walk; 0 where the truth is not the family's."""
    if kind != "family":
        return 0.0
    b = draw(serial, 1)
    force, parts = peak, 8
    for share in [b.mu2 * (b.wrap + 0.53 * b.wrap_slope) / parts] * parts + [b.mu1 * b.theta1 / parts] * parts:
        force *= math.exp(share * (1.0 + b.load_slope * (force - b.load_reference) / 40.0))
    return force


def walked(kind: str, serial: int, text: str, controller: str, cycles: int, settle: int,
           more: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results of a walk on day 1 by the calibration `text`; `more`: further settings of the row."""
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
    """Return the RMSE of true END in each gait cycle, %."""
    trial, truth = open_trial(path), open_table(path.with_name(f"{path.stem}.truth.mcap"), "/truth")
    end = np.interp(trial.time_ns, truth.time_ns, truth.columns["true_end_n"])
    cycle, desired = trial.columns["cycle"], trial.columns["desired_force_n"]
    error = end - desired
    rmse = [100.0 * math.sqrt(float(np.mean(error[cycle == k] ** 2))) / peak_n for k in range(cycles)]
    return {"by_cycle": rmse}


def read(path: Path) -> dict[tuple[str, int], dict[str, Any]]:
    """Return the benches of a table by kind and serial; of two rows of a bench the later one counts."""
    return {(row["kind"], row["serial"]): row for row in frame.rows(path)}


LOADED = 0.2
"""Share of the gait cycle in which a force is desired."""


def spread(values: Iterable[float | None], digits: int = 2) -> str:
    """Return median / worst; "–" without values."""
    known = [v for v in values if v is not None and math.isfinite(v)]
    return f"{median(known):.{digits}f} / {max(known):.{digits}f}" if known else "–"


def walks(benches: Sequence[Mapping[str, Any]], period: float) -> list[dict[str, Any]]:
    """Return the completed walks of one gait period, each with its bench."""
    return [{**bench[f"{period:g}"], "bench": bench} for bench in benches
            if f"{period:g}" in bench and bench[f"{period:g}"].get("outcome") == "completed"]


def loaded(walk: Mapping[str, Any], of: str = TRUE) -> float:
    """Return the RMSE while a force is desired, %, relative to the whole cycle: without the loose rope's drag.

    Another controller's is its own RMSE less what END is at idle, which the rope makes and no controller.
    """
    own = walk[WINDOW] * math.sqrt(LOADED)
    if of == TRUE:
        return float(own)
    idle = max(walk[TRUE] ** 2 - own**2, 0.0)
    return math.sqrt(max(walk[of] ** 2 - idle, 0.0))


def reached(bench: Mapping[str, Any]) -> bool:
    """Whether the servo can pull as much as the peak takes on this bench."""
    return float(bench["needs_n"]) <= DRIVE_N


def tables(benches: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the tables of docs/unseen.md by their marks."""
    family = [b for b in benches if b["kind"] == "family"]
    groups = {"family": family, "development": [b for b in family if b["serial"] % 3 != 2],
              "set aside": [b for b in family if b["serial"] % 3 == 2],
              "own plant": [b for b in benches if b["kind"] == "own"]}
    return {"targets": _judged(groups), "missed": _missed(family), "coverage": _coverage(family),
            **{name: _group(chosen) for name, chosen in groups.items() if name != "family"}}


def within(benches: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The benches that were identified and whose peak the servo can pull."""
    return [b for b in benches if "failed" not in b and reached(b)]


def _group(chosen: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for period in PERIODS_S:
        all_ = walks(within(chosen), period)
        rows.append([
            f"{period:g} s", str(len(all_)), spread(w[TRUE] for w in all_), spread(map(loaded, all_)),
            spread(loaded(w, "paper") for w in all_), spread(loaded(w, "blind") for w in all_),
            spread(w["true_max_idle_tension_n"] for w in all_), spread(w["loose"] for w in all_),
            spread(map(jump, all_)), spread(map(_rise, all_))])
    text = markdown(("period", "walks", "RMSE (%)", "loaded part (%)", "paper, loaded part (%)",
                  "START ignored, loaded part (%)", "END at idle (N)", "of a loose rope (N)", "jump (% of peak)",
                  "RMSE above cycle 0's (points)"), rows)
    for bench in chosen:
        name = f"\n\nSerial {bench['serial']}"
        if "failed" in bench:
            text += f"{name} was not identified: {bench['failed']}"
        elif not reached(bench):
            text += (f"{name}: {bench['peak_n']:g} N takes {bench['needs_n']:.0f} N at START, beyond the servo's "
                     f"{DRIVE_N:g} N; left out of the table.")
        text += "".join(f"{name} at {period:g} s was stopped: {walk['stop_reason']}." for period in PERIODS_S
                        if (walk := bench.get(f"{period:g}", {})).get("outcome", "completed") != "completed")
    return text


def jump(walk: Mapping[str, Any]) -> float:
    return float(100.0 * walk["true_peak_jump_n"] / walk["bench"]["peak_n"])


def _rise(walk: Mapping[str, Any]) -> float:
    return float(max(walk["by_cycle"]) - walk["by_cycle"][0])


def _idle(walk: Mapping[str, Any]) -> float:
    """Return END at idle over that of a loose rope, which is taken as at least a third of a newton."""
    return float(walk["true_max_idle_tension_n"] / max(walk["loose"] or 0.0, IDLE_N / 1.5))


def _plays(walk: Mapping[str, Any]) -> bool:
    return str(walk["bench"]["structure"]).endswith("knee play")


class Target(NamedTuple):
    """Bound on a figure of the walks that are `counted`: on its median (`share` 0.5), its 95 % or its largest value."""

    what: str
    bound: float
    figure: Callable[[dict[str, Any]], float]
    share: float = 1.0
    counted: Callable[[dict[str, Any]], bool] = lambda _: True

    def reached(self, walks: Sequence[dict[str, Any]]) -> float:
        """Return the figure of several walks; NaN of none."""
        figures = [self.figure(walk) for walk in walks if self.counted(walk)]
        return float(np.quantile(figures, self.share, method="linear" if self.share == 0.5 else "inverted_cdf")
                     ) if figures else math.nan


TARGETS = (
    *(Target(f"median {what} at {period:.1f} s (%)", bound, figure, 0.5,
             lambda walk, period=period: bool(walk["period"] == period))
      for what, figure in (("RMSE", lambda walk: walk[TRUE]), ("of the loaded part", loaded))
      for period, bound in ((2.0, 0.22), (1.1, 0.32))),
    Target("worst loaded part, knees without play (%)", 0.8, loaded, counted=lambda w: not _plays(w)),
    Target("worst loaded part, knees with play (%)", 0.8, loaded, counted=_plays),
    Target("END at idle by that of a loose rope, at least a third of 1 N, worst", 1.5, _idle),
    Target("jump at the peak, 95 % of the walks (% of peak)", 1.5, jump, 0.95),
    Target("jump at the peak, worst (% of peak)", 2.5, jump),
    Target("RMSE above that of cycle 0, worst (points)", 0.05, _rise),
    Target("loaded part by that with START ignored, median", 1.0 / 1.5, lambda w: loaded(w) / loaded(w, "blind"), 0.5),
)
"""On benches within reach."""


def _all(benches: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Every walk that completed on a bench within reach, with its period."""
    return [{**walk, "period": period} for period in PERIODS_S for walk in walks(within(benches), period)]


def _judged(groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Return the table of targets: whether each is met on the family, and its figure by group of benches."""
    told = {name: _all(chosen) for name, chosen in groups.items()}
    rows = []
    for target in TARGETS:
        found = {name: target.reached(all_) for name, all_ in told.items()}
        whole = found["family"]
        said = "–" if not math.isfinite(whole) else "met" if whole <= target.bound else "**not met**"
        rows.append([target.what, f"{target.bound:.3g}", said,
                     *("–" if not math.isfinite(value) else f"{value:.2f}" for value in found.values())])
    stopped = {name: len(PERIODS_S) * len(within(chosen)) - len(told[name]) for name, chosen in groups.items()}
    rows.append(["walks that were stopped", "0", "met" if not stopped["family"] else "**not met**",
                 *map(str, stopped.values())])
    heads = ("target", "at most", "on the family", *(f"{name}: {len(all_)} walks" for name, all_ in told.items()))
    return markdown(heads, rows)


def _missed(family: Sequence[Mapping[str, Any]]) -> str:
    """Return the walks that break a bound which is not met, worst first, with the structure of each bench."""
    all_, rows = _all(family), []
    for target in TARGETS:
        if target.share > 0.5 and target.reached(all_) > target.bound:
            counted = sorted(filter(target.counted, all_), key=target.figure, reverse=True)
            breaking = [f"serial {w['bench']['serial']} at {w['period']:g} s ({target.figure(w):.2f}; "
                        f"{w['bench']['structure']})" for w in counted if target.figure(w) > target.bound]
            rows.append([target.what, f"{len(breaking)} of {len(counted)}", "; ".join(breaking)])
    return markdown(("target", "walks", "which"), rows)


def _coverage(family: Sequence[Mapping[str, Any]]) -> str:
    identified = [(draw(int(b["serial"])), parsed(b["calibration"])) for b in family if "failed" not in b]
    rows = []
    for name, true_of in COUNTERPARTS.items():
        inside, apart, wide = 0, [], []
        for bench, found in identified:
            value, half = _interval(found, name)
            true = true_of(bench)
            inside += abs(value - true) <= half if name in FABRIC else (
                found.evidence[name].low <= true <= found.evidence[name].high)
            if abs(true) > 1e-6:
                apart.append(abs(value - true) / abs(true))
                wide.append(half / abs(true))
        met = "met" if inside >= 0.9 * len(identified) else "**not met**"
        rows.append([name, f"{inside} of {len(identified)}", f"{100.0 * median(apart):.1f} %" if apart else "–",
                     f"± {100.0 * median(wide):.1f} %" if wide else "–", met])
    squares = {name: [found.evidence[name].r_squared for _, found in identified]
               for name in ("stiffness_b", "rope_per_knee")}
    heads = ("constant", "within", "median error", "median half of the interval", "90 % of the benches")
    return markdown(heads, rows) + "\n\nR² as measured, median and least: " + " and ".join(
        f"{equation} {median(squares[name]):.{digits}f}, {min(squares[name]):.{digits}f}"
        for equation, name, digits in (("(10)", "stiffness_b", 3), ("(11)", "rope_per_knee", 4))) + "."


def _interval(found: calibration.Calibration, name: str) -> tuple[float, float]:
    """Return a constant and half of its 95 % interval; the fabric's exponents are products of two, whose errors add."""
    parts = ("mu2", FABRIC[name]) if name in FABRIC else (name,)
    values, halves = [getattr(found, part) for part in parts], []
    for part in parts:
        proof = found.evidence[part]
        halves.append(0.5 * (proof.high - proof.low) if math.isfinite(proof.low) else 0.0)
    if len(parts) == 1:
        return values[0], halves[0]
    relative = [half / max(abs(value), 1e-9) for half, value in zip(halves, values, strict=True)]
    return math.prod(values), abs(math.prod(values)) * math.hypot(*relative)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the benches that the table lacks, and write and print the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.family")
    parser.add_argument("--set-aside", action="store_true", help="the serials that nothing was tuned on, once")
    parser.add_argument("--serials", help="serials of the family, with commas")
    parser.add_argument("--own", help="serials of the own plant, with commas")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--page", action="store_true", help="only print the tables of what has been run")
    options = parser.parse_args(arguments)
    done = read(TABLE)
    if not options.page:
        chosen = _serials(options.serials, SET_ASIDE if options.set_aside else DEVELOPMENT)
        wanted = [("family", s) for s in chosen] + [("own", s) for s in _serials(options.own, OWN)]
        _run([each for each in wanted if each not in done], options.workers)
        done = read(TABLE)
        frame.write_rows(TABLE, KEYS, done.values())
    text = frame.filled(PAGE, tables(list(done.values())))
    PAGE.write_text(text, encoding="utf-8")
    sys.stdout.write(text)


def _short(value: Any) -> Any:
    """Return a figure, or each figure of a dict or list, with five digits; None if it is not finite."""
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _short(each) for key, each in value.items()}
    return [_short(each) for each in value] if isinstance(value, list) else value


def _serials(given: str | None, otherwise: Sequence[int]) -> list[int]:
    return list(otherwise) if given is None else [int(text) for text in given.split(",") if text]


def _run(wanted: Sequence[tuple[str, int]], workers: int) -> None:
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as crew:
        for future in as_completed([crew.submit(measure, *each) for each in wanted]):
            found = future.result()
            frame.write_rows(TABLE, KEYS, [_short(found)], "a")
            sys.stderr.write(f"{found['kind']} {found['serial']}: {found.get('failed', 'done')}\n")


if __name__ == "__main__":
    main()
