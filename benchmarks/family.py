"""Controller on benches that nothing was tuned on: the family of tests/plants, beside the own plant.

    python -m benchmarks.family [--set-aside] [--serials 0,1,3] [--own 1,3] [--again] [--workers N] [--page]

The rule of this file: a bench is identified on day 0 and walked on day 1, through the wire, by the controller as it
ships; each bench is a row of docs/unseen.csv, so that what was interrupted goes on, and docs/unseen.md is made from it
alone (`--page` does only that).  Serials with serial % 3 == 2 are set aside: nothing is tuned on them, they are run
once, by --set-aside.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
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

from benchmarks.frame import DOCS, ROOT, markdown
from bowden.bench import configuration
from bowden.sweep import row_trial
from bowden.sweep import rows as sweep_rows
from bowden.sweep.rows import IDENTIFIED
from bowden.trials import session
from physics import calibration, end_discrepancy
from physics.end_discrepancy import EndDiscrepancy
from tests.plants import stack
from tests.plants.draws import draw
from tests.plants.friction import GREASE_N
from trial.read import open as open_trial
from trial.read import open_table

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


def measure(kind: str, serial: int, earlier: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Identify a bench on day 0, walk on it on day 1: everything the tables need, or `failed` with the reason.

    `earlier`: the bench's row of an earlier run, whose scalars and whose walks that use no discrepancy are kept; the
    gait trials of the identification and the walks by the extended controller are made anew.
    """
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


def calibration_of(row: Mapping[str, Any]) -> calibration.Calibration:
    """Return the calibration that a bench's row of the table states, to the table's five digits.

    A scalar was measured if its interval is not a point; homing corrects START's lag only on a calibration without it.
    """
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
    told = end_discrepancy.stated(tomllib.loads(text), "calibration.toml")
    return None if told is None else json.loads(json.dumps(told._asdict()))


def _scalars(text: str) -> dict[str, Any]:
    """Value, interval and R² of every scalar of a calibration's text."""
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
    """RMSE by gait cycle, %, and how far the estimate of END is off, relative, in the first and in the last cycle."""
    trial, truth = open_trial(path), open_table(path.with_name(f"{path.stem}.truth.mcap"), "/truth")
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


LOADED = 0.2
"""Share of the gait cycle in which a force is desired."""
AS_FAR = 2e-3
"""Relative difference of two estimates of END that noise alone makes."""


def spread(values: Iterable[float | None], digits: int = 2) -> str:
    """Return median / worst; "–" without values."""
    known = [v for v in values if v is not None and math.isfinite(v)]
    return f"{median(known):.{digits}f} / {max(known):.{digits}f}" if known else "–"


def walks(benches: Sequence[Mapping[str, Any]], period: float) -> list[dict[str, Any]]:
    """The walks of one period that completed, each with its bench."""
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


def _no_farther(walk: Mapping[str, Any]) -> bool:
    """Whether END by the friction followed in the gait is no farther from the truth than by that of homing."""
    homed, followed = walk["homed_away"], walk["followed_away"]
    return homed is None or followed is None or followed <= homed + AS_FAR


def reached(bench: Mapping[str, Any]) -> bool:
    """Whether the servo can pull as much as the peak takes on this bench."""
    return float(bench["needs_n"]) <= DRIVE_N


def page(benches: Sequence[Mapping[str, Any]]) -> str:
    """The tables of the benches measured so far."""
    family = [b for b in benches if b["kind"] == "family"]
    groups = {"family": family, "development": [b for b in family if b["serial"] % 3 != 2],
              "set aside": [b for b in family if b["serial"] % 3 == 2],
              "own plant": [b for b in benches if b["kind"] == "own"]}
    parts = ["# Benches that the controller was not made on\n",
             "Each bench is identified on day 0 and walked on day 1; 40, 50 or 60 N by serial; true END; two gait "
             "cycles after seven of learning. Median / worst; `python -m benchmarks.family` runs what is lacking and "
             "prints this. The loaded part is what of the RMSE is made at 10…30 %, by the whole cycle: a rope that is "
             "not pushed drags at END when the knee pulls it through its sheath, which no controller can take away; "
             f"what it drags with 20 mm of slack is measured where END at idle is above {IDLE_N:g} N. Serials with "
             "serial % 3 = 2 are set aside: nothing was chosen by them.\n",
             "## Targets\n", _judged(groups)]
    if family:
        parts += ["\n## What is not met, and by which walks\n", _missed(groups["family"])]
    for name, chosen in groups.items():
        if chosen and name != "family":
            parts += [f"\n## {name.capitalize()}: {len(chosen)} benches\n", _group(chosen)]
    if family:
        parts += ["\n## Identification: constants within their own 95 % interval\n", _coverage(family)]
    return "\n".join(parts) + "\n"


def within(benches: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The benches that were identified and whose peak the servo can pull."""
    return [b for b in benches if "failed" not in b and reached(b)]


def _group(chosen: Sequence[Mapping[str, Any]]) -> str:
    reachable = within(chosen)
    beyond = [b for b in chosen if "failed" not in b and not reached(b)]
    rows = []
    for period in PERIODS_S:
        all_ = walks(reachable, period)
        rows.append([
            f"{period:g} s", str(len(all_)), spread(w[TRUE] for w in all_), spread(map(loaded, all_)),
            spread(loaded(w, "paper") for w in all_), spread(loaded(w, "blind") for w in all_),
            spread(w["true_max_idle_tension_n"] for w in all_), spread(w["loose"] for w in all_),
            spread(map(jump, all_)), spread(map(_rise, all_)),
            f"{sum(_no_farther(w) for w in all_)} of {len(all_)}"])
    text = markdown(("period", "walks", "RMSE (%)", "loaded part (%)", "paper, loaded part (%)",
                  "START ignored, loaded part (%)", "END at idle (N)", "of a loose rope (N)", "jump (% of peak)",
                  "RMSE above cycle 0's (points)", "friction no farther from truth than homing's"), rows)
    for bench in beyond:
        text += (f"\n\nSerial {bench['serial']}: {bench['peak_n']:g} N takes {bench['needs_n']:.0f} N at START, beyond "
                 f"the servo's {DRIVE_N:g} N; left out of the table.")
    for bench in chosen:
        if "failed" in bench:
            text += f"\n\nSerial {bench['serial']} was not identified: {bench['failed']}"
        for period in PERIODS_S:
            walk = bench.get(f"{period:g}", {})
            if walk.get("outcome", "completed") != "completed":
                reason = walk.get("stop_reason") or "the reason was not kept"
                text += f"\n\nSerial {bench['serial']} at {period:g} s was stopped: {reason}."
    return text + "\n"


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
    """Bound on a figure of several walks.

    `of` gives the figure of several walks, NaN of none; `one` that of a walk, by which those that break the bound are
    named (None: it is a median, and no walk breaks it); `why`: the cause where it is missed, as the trials show it.
    """

    what: str
    bound: float
    of: Callable[[Sequence[dict[str, Any]]], float]
    one: Callable[[dict[str, Any]], float] | None = None
    counted: Callable[[dict[str, Any]], bool] = lambda _: True
    why: str = ""


def _middle(values: Iterable[float]) -> float:
    known = list(values)
    return median(known) if known else math.nan


def _worst(one: Callable[[dict[str, Any]], float]) -> Callable[[Sequence[dict[str, Any]]], float]:
    return lambda all_: max(map(one, all_), default=math.nan)


def _at(period: float) -> Callable[[dict[str, Any]], bool]:
    return lambda walk: bool(walk["period"] == period)


def _ninety_five(all_: Sequence[dict[str, Any]]) -> float:
    jumps = sorted(map(jump, all_))
    return jumps[math.ceil(0.95 * len(jumps)) - 1] if jumps else math.nan


MODEL = ("The lumped model's friction and stretch are not the bench's: after learning END is off by as much as START, "
         "its friction undone, tells it wrongly.")
REVERSAL = (
    "Friction turns over at the peak. Play crosses with it, and breakaway follows the reversal where the rope is slow: "
    "START tells least of END just there, and neither feedback nor evidence hears it. On serial 34 START comes within "
    "1 % of the servo's 88 N: the drive's tension bound slows the rope before the peak. The play of serial 40's knee "
    "is estimated as none. Homing scales the friction of sheath and fabric alike, and a session changes each by its "
    "own factor.")
TARGETS = (
    Target("median RMSE at 2.0 s (%)", 0.22, lambda all_: _middle(w[TRUE] for w in all_), None, _at(2.0)),
    Target("median RMSE at 1.1 s (%)", 0.32, lambda all_: _middle(w[TRUE] for w in all_), None, _at(1.1)),
    Target("median of the loaded part at 2.0 s (%)", 0.22, lambda all_: _middle(map(loaded, all_)), None, _at(2.0)),
    Target("median of the loaded part at 1.1 s (%)", 0.32, lambda all_: _middle(map(loaded, all_)), None, _at(1.1)),
    Target("worst loaded part, knees without play (%)", 0.8, _worst(loaded), loaded, lambda w: not _plays(w), MODEL),
    Target("worst loaded part, knees with play (%)", 0.8, _worst(loaded), loaded, _plays, MODEL),
    Target("END at idle by that of a loose rope, at least a third of 1 N, worst", 1.5, _worst(_idle), _idle, why=(
        "END at idle is largest where the knee flexes fastest, at 2 to 4 % of the gait: the leg pulls the loose rope "
        "through its sheath. Where the walk with a loose rope was stopped, a third of a newton is taken for it.")),
    Target("jump at the peak, 95 % of the walks (% of peak)", 1.5, _ninety_five, jump, why=REVERSAL),
    Target("jump at the peak, worst (% of peak)", 2.5, _worst(jump), jump, why=REVERSAL),
    Target("RMSE above that of cycle 0, worst (points)", 0.05, _worst(_rise), _rise, why=(
        "Learning goes to where START, its friction undone, says that END is as desired. Where that is off by the "
        "share that the table by structure shows and the model alone came nearer, the error rises to it.")),
    Target("walks whose followed friction is farther from the truth", 0.0,
           lambda all_: float(sum(not _no_farther(w) for w in all_)) if all_ else math.nan,
           lambda walk: 0.0 if _no_farther(walk) else 1.0, why="The cause was not traced."),
    Target("loaded part by that with START ignored, median", 1.0 / 1.5,
           lambda all_: _middle(loaded(w) / loaded(w, "blind") for w in all_)),
)
"""On benches within reach, in the order of the issue that set them."""


def _all(benches: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Every walk that completed on a bench within reach, with its period."""
    return [{**walk, "period": period} for period in PERIODS_S for walk in walks(within(benches), period)]


def _judged(groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Every target, on the family and its parts and on the own plant."""
    told = {name: _all(chosen) for name, chosen in groups.items()}
    rows = []
    for target in TARGETS:
        found = {name: target.of([w for w in all_ if target.counted(w)]) for name, all_ in told.items()}
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
    """The walks that break a bound which is not met, the worst first, with what kind of bench they are of."""
    all_, rows = _all(family), []
    for target in TARGETS:
        counted = [w for w in all_ if target.counted(w)]
        if target.one is None or not counted or target.of(counted) <= target.bound:
            continue
        breaking = sorted((w for w in counted if target.one(w) > target.bound), key=target.one, reverse=True)
        rows.append([target.what, f"{len(breaking)} of {len(counted)}", "; ".join(
            f"serial {w['bench']['serial']} at {w['period']:g} s ({target.one(w):.2f}; {w['bench']['structure']})"
            for w in breaking), target.why or "–"])
    if not rows:
        return "Every bound that a single walk can break is kept."
    return markdown(("target", "walks", "which", "cause"), rows)


PRODUCTS = ("The fabric's exponents are products of two scalars whose errors are taken as if they had nothing to do "
            "with each other, which makes them wide. What breakaway remembers is told to about 10 ms, where there is "
            "no breakaway not at all: its interval is then as wide as what was assumed of it.")
"""Note under the table of intervals."""


def _coverage(family: Sequence[Mapping[str, Any]]) -> str:
    identified = [b for b in family if "failed" not in b]
    rows = []
    for name, true_of in COUNTERPARTS.items():
        inside, apart, wide = 0, [], []
        for bench in identified:
            value, low, high = _interval(bench["calibration"], name)
            true = true_of(draw(int(bench["serial"])))
            inside += low <= true <= high
            apart += [abs(value - true) / abs(true)] if abs(true) > 1e-6 else []
            wide += [(high - low) / 2.0 / abs(true)] if abs(true) > 1e-6 else []
        met = "met" if inside >= 0.9 * len(identified) else "**not met**"
        rows.append([name, f"{inside} of {len(identified)}", f"{100.0 * median(apart):.1f} %" if apart else "–",
                     f"± {100.0 * median(wide):.1f} %" if wide else "–", met])
    squares = {name: [b["calibration"][name]["r_squared"] for b in identified]
               for name in ("stiffness_b", "rope_per_knee")}
    heads = ("constant", "within", "median error", "median half of the interval", "90 % of the benches")
    return markdown(heads, rows) + (
        f"\n\n{PRODUCTS}\n\nR² as measured, median and least: (10) {median(squares['stiffness_b']):.3f} and "
        f"{min(squares['stiffness_b']):.3f}, (11) {median(squares['rope_per_knee']):.4f} and "
        f"{min(squares['rope_per_knee']):.4f}.")


def _interval(scalars: Mapping[str, Any], name: str) -> tuple[float, float, float]:
    """Value and interval of a constant; the fabric's exponents are products of two, whose errors add."""
    factor = {"fabric exponent, upright": "phi0", "fabric exponent, slope": "fabric_wrap"}.get(name)
    if factor is None:
        row = scalars[name]
        low, high = row.get("interval", (row["value"], row["value"]))
        return row["value"], low, high
    values, relative = 1.0, 0.0
    for part in ("mu2", factor):
        row = scalars[part]
        low, high = row.get("interval", (row["value"], row["value"]))
        values *= row["value"]
        relative += ((high - low) / 2.0 / max(abs(row["value"]), 1e-9)) ** 2
    half = abs(values) * math.sqrt(relative)
    return values, values - half, values + half


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the benches that the table lacks, and write and print the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.family")
    parser.add_argument("--set-aside", action="store_true", help="the serials that nothing was tuned on, once")
    parser.add_argument("--serials", help="serials of the family, with commas")
    parser.add_argument("--own", help="serials of the own plant, with commas")
    parser.add_argument("--count", type=int, help="only so many of them")
    parser.add_argument("--again", action="store_true", help=(
        "walk benches of the table again: gait trials anew, scalars as they were identified"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--page", action="store_true", help="only print the tables of what has been run")
    options = parser.parse_args(arguments)
    path = DOCS / "unseen.csv"
    done = read(path)
    if not options.page:
        chosen = _serials(options.serials, SET_ASIDE if options.set_aside else DEVELOPMENT)[:options.count]
        wanted = [("family", s) for s in chosen] + [("own", s) for s in _serials(options.own, OWN)]
        lacking = [each for each in wanted if options.again or each not in done]
        _run([(*each, done.get(each)) for each in lacking], path, options.workers)
        done = compact(path)
    text = page(list(done.values()))
    (DOCS / "unseen.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)


def _short(value: Any) -> Any:
    """Return a figure, or each figure of a dict or list, with five digits; None if it is not finite."""
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _short(each) for key, each in value.items() if key not in ("date", "trial", "unit")}
    return [_short(each) for each in value] if isinstance(value, list) else value


def _serials(given: str | None, otherwise: Sequence[int]) -> list[int]:
    return list(otherwise) if given is None else [int(text) for text in given.split(",") if text]


def _run(wanted: Sequence[tuple[str, int, Mapping[str, Any] | None]], path: Path, workers: int) -> None:
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as crew:
        for future in as_completed([crew.submit(measure, *each) for each in wanted]):
            found = future.result()
            append(path, _short(found))
            sys.stderr.write(f"{found['kind']} {found['serial']}: {found.get('failed', 'done')}\n")


if __name__ == "__main__":
    main()
