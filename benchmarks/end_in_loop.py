"""Gain by the discrepancy, and by feedback of true END beside it: docs/end_in_loop.md.

    python -m benchmarks.end_in_loop [--serials 34,39] [--page]

The rule of this file: true END reaches a controller here alone, through a plant and a controller of this file, in one
process; `--end-in-loop` stays refused.  The calibrations are those of docs/unseen.csv.  What was measured is kept in
docs/end_in_loop.csv, so that what was interrupted goes on.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
import math
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from benchmarks import family_page, family_walks
from master.control import extended, learning
from master.control.controller import Conditions
from master.control.controller_io import ControllerInput, ControllerOutput, Trace
from master.control.gait_table import GaitTable
from master.control.packaged import ExtendedController
from physics.calibration import Calibration

TABLE: Final = family_walks.DOCS / "end_in_loop.csv"
PAGE: Final = family_walks.DOCS / "end_in_loop.md"
FASTER_HZ: Final = 15.0
"""Cut-off, Hz, of the learning in the last variant; the drive's own error is learnt up to it as shipped."""
POINTS: Final = 200
"""Points of a gait cycle that a curve of the page has."""
VARIANTS: Final = {
    "without": "extended", "with": "extended", "END": "benchmarks.end_in_loop:EndInLoop",
    "END, faster": "benchmarks.end_in_loop:EndInLoopFaster"}
HEADS: Final = {
    "without": "calibration without discrepancy", "with": "with discrepancy",
    "END": "true END in place of the estimate",
    "END, faster": f"and learning up to {FASTER_HZ:g} Hz"}
SHOWN: Final = {"end_n": 0.0}
"""True END, N, as the plant of this process has it now."""


class ShownEnd:
    """A plant that shows its true END to this process."""

    def __init__(self, plant: Any) -> None:
        self._plant = plant

    def advance(self, until_ns: int, servo_torque_nm: float, knee_torque_nm: float) -> Any:
        """Advance the plant, and show its END."""
        felt = self._plant.advance(until_ns, servo_torque_nm, knee_torque_nm)
        SHOWN["end_n"] = float(self._plant.truth()["true_end_n"])
        return felt

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)


def __getattr__(name: str) -> Callable[[dict[str, float], int], Any]:
    import tests.plants

    create = getattr(tests.plants, name)
    return lambda parameters, seed: ShownEnd(create(parameters, seed))


class EndInLoop(ExtendedController):
    """The extended controller, with a START made up so that its estimate of END is true END."""

    def step(
        self, seen: ControllerInput, state: extended.ExtendedState
    ) -> tuple[ControllerOutput, extended.ExtendedState, Trace]:
        """Return one control cycle on true END."""
        config = self._config
        now = seen.sample % config.gait.samples
        if now == 0 and state.history is not None:
            state = extended.on_cycle_end(state, config)
        departures = (*state.departures, seen.knee_angle_rad - config.gait.knee[now])[-extended.DEPARTURES:]
        paths, *_rest = extended.look_ahead(state, config, now, departures)
        here, after = paths[0], paths[min(1, len(paths) - 1)]
        start = SHOWN["end_n"] * math.exp(here.by_sheath + here.by_knee + here.discrepancy) + here.drag
        start -= config.start_lag * (after.start - here.start)
        made = seen._replace(start_n=start * config.start_gain + config.start_offset_n)
        return extended.step(made, state, config)


class EndInLoopFaster(EndInLoop):
    """`EndInLoop` that learns up to `FASTER_HZ`."""

    def __init__(self, model: Calibration, gait: GaitTable, conditions: Conditions) -> None:
        super().__init__(model, gait, conditions)
        shipped = self._config.filter
        self._config = dataclasses.replace(self._config, filter=learning.design(
            gait.samples, gait.period_s, shipped.lead, FASTER_HZ))


def measure(bench: Mapping[str, Any], period_s: float, variant: str) -> dict[str, Any]:
    """Walk one bench of the table once: figures, and the last gait cycle's forces by percent."""
    from bowden.sweep import row_trial
    from physics.calibration import write
    from trial import read

    kind, serial, peak = bench["kind"], int(bench["serial"]), float(bench["peak_n"])
    calibration = family_walks.calibration_of(bench if variant != "without" else {**bench, "discrepancy": None})
    row = family_walks.bench_row(kind, serial, 1, **{
        "gait.controller": VARIANTS[variant], "gait.cycles": family_walks.CYCLES, "gait.settle": family_walks.SETTLE,
        "gait.peak_n": peak, "gait.period_s": period_s})
    if VARIANTS[variant] != "extended":
        row = {**row, "bench.plant": str(row["bench.plant"]).replace("tests.plants:", "benchmarks.end_in_loop:")}
    with tempfile.TemporaryDirectory() as folder:
        found = row_trial.perform(row, write(calibration), "", folder)
        if found["outcome"] != "completed":
            return {"stopped": found["stop_reason"]}
        path = Path(found["trial"])
        trial, truth = read.open(path), read.open_table(path.with_name(f"{path.stem}.truth.mcap"), "/truth")
    last = trial.columns["cycle"] == family_walks.CYCLES - 1
    percent, at = trial.columns["gait_percent"][last], np.linspace(0.0, 100.0, POINTS, endpoint=False)
    signals = {"desired": trial.columns["desired_force_n"], **{
        name: np.interp(trial.time_ns, truth.time_ns, truth.columns[f"true_{name}_n"]) for name in ("start", "end")}}
    curves = {name: [round(float(v), 2) for v in np.interp(at, percent, signal[last])]
              for name, signal in signals.items()}
    return {"rmse": found[family_walks.TRUE], "loaded": family_page.loaded(found),
            "jump": 100.0 * found["true_peak_jump_n"] / peak, "curves": curves}


def chosen(benches: Mapping[tuple[str, int], Mapping[str, Any]], more: Sequence[int]) -> dict[str, tuple[int, float]]:
    """Return the walks of the page by name: best, median and worst loaded part, the largest jumps, and `more`."""
    told = family_page.within([b for (kind, _), b in benches.items() if kind == "family" and b.get("discrepancy")])
    walks = [(family_page.loaded(walk), family_page.jump(walk), int(walk["bench"]["serial"]), period)
             for period in family_walks.PERIODS_S for walk in family_page.walks(told, period)]
    if not walks:
        raise SystemExit("docs/unseen.csv has no discrepancy; run python -m benchmarks.family --again first.")
    by_loaded, by_jump = sorted(walks), sorted(walks, key=lambda walk: -walk[1])
    middle = min(by_loaded, key=lambda walk: abs(walk[0] - median(each[0] for each in by_loaded)))
    named = {"best": by_loaded[0], "median": middle, "worst": by_loaded[-1], "largest jump": by_jump[0],
             "second largest jump": by_jump[1]}
    return {**{name: walk[2:] for name, walk in named.items()}, **{f"serial {s}": (s, 1.1) for s in more}}


def _picture(name: str, serial: int, period_s: float, found: Mapping[str, Any]) -> str:
    """Draw START, END and desired END of one gait cycle, before and after; returns the file's name."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.subplots(1, 2, sharey=True)
    at = np.linspace(0.0, 100.0, POINTS, endpoint=False)
    for ax, variant in zip(axes, ("without", "with"), strict=True):
        curves = found[variant]["curves"]
        ax.plot(at, curves["start"], color="0.65", label="START")
        ax.plot(at, curves["desired"], "k--", lw=1.0, label="desired END")
        ax.plot(at, curves["end"], color="tab:blue", lw=1.2, label="END")
        ax.set_xlim(5.0, 40.0)
        ax.set_title(f"{HEADS[variant]}: {found[variant]['loaded']:.2f} %", fontsize=9)
        ax.set_xlabel("gait (%)")
    axes[0].set_ylabel("force (N)")
    axes[0].legend(fontsize=8)
    figure.suptitle(f"{name}: serial {serial} at {period_s:g} s, loaded part of the RMSE", fontsize=10)
    file = f"end_in_loop_{name.replace(' ', '_')}.svg"
    with rc_context({"svg.hashsalt": file}):
        figure.savefig(family_walks.DOCS / file, metadata={"Date": None})
    return file


def page(walks: Mapping[str, tuple[int, float]], found: Mapping[tuple[int, float], Mapping[str, Any]]) -> str:
    """Return the page of the walks that were measured, and draw its pictures."""
    more = ",".join(str(serial) for name, (serial, _) in walks.items() if name.startswith("serial "))
    parts = ["# What identification told of END, and what END feedback would gain\n",
             f"`python -m benchmarks.end_in_loop{f' --serials {more}' if more else ''}` writes this page: "
             "benches of [the family](unseen.md), identified on "
             "day 0 and walked on day 1, two gait cycles after seven of learning, true END. In the last two columns "
             "the estimate of END is true END, without noise or delay, in simulation only: `--end-in-loop` stays "
             "refused, and this is what the open-END design costs. Every column is of the present controller; the "
             "walks without a discrepancy in [unseen.md](unseen.md) are of the commit that identified the bench.\n"]
    rows = []
    for name, walk in walks.items():
        told = found.get(walk, {})
        cells = ["–" if v not in told else "stopped" if "stopped" in told[v]
                 else f"{told[v]['loaded']:.2f} / {told[v]['jump']:.2f}" for v in VARIANTS]
        rows.append([name, str(walk[0]), f"{walk[1]:g}", *cells])
    parts += ["Loaded part of the RMSE (%) / jump at the peak (% of it):\n",
              family_page.table(("walk", "serial", "period (s)", *HEADS.values()), rows), "\n"]
    reached = [(told["without"]["jump"] - told["with"]["jump"]) / (told["without"]["jump"] - best)
               for told in found.values() if all(v in told and "stopped" not in told[v] for v in VARIANTS)
               and (best := min(told["END"]["jump"], told["END, faster"]["jump"])) < told["without"]["jump"] - 0.1]
    if reached:
        parts.append(f"Of what true END takes off the jump, the discrepancy takes off {100.0 * median(reached):.0f} % "
                     f"in the median of {len(reached)} walks.\n")
    for name in ("best", "median", "worst"):
        told = found.get(walks[name], {})
        if all(v in told and "stopped" not in told[v] for v in ("without", "with")):
            file = _picture(name, *walks[name], told)
            parts.append(f"![START, END and desired END, {name}]({file})\n")
    return "\n".join(parts)


def read_table() -> dict[tuple[int, float], dict[str, Any]]:
    """Return the measured figures of each variant, by serial and period."""
    found: dict[tuple[int, float], dict[str, Any]] = {}
    if TABLE.exists():
        with TABLE.open(newline="", encoding="utf-8") as file:
            for serial, period, variant, text in csv.reader(file):
                found.setdefault((int(serial), float(period)), {})[variant] = json.loads(text)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the walks that the table lacks, and write the page."""
    from bowden.trials import session

    parser = argparse.ArgumentParser(prog="python -m benchmarks.end_in_loop")
    parser.add_argument("--serials", default="", help="further serials, at 1.1 s, with commas")
    parser.add_argument("--page", action="store_true", help="only write the page of what was measured")
    options = parser.parse_args(arguments)
    sys.path.insert(0, str(family_walks.ROOT))
    csv.field_size_limit(2**24)
    benches = family_walks.read(family_walks.DOCS / "unseen.csv")
    walks = chosen(benches, [int(text) for text in options.serials.split(",") if text])
    found = read_table()
    if not options.page:
        session.compile_laws(simulated=True)
        for variant in VARIANTS:
            for serial, period in dict.fromkeys(walks.values()):
                if variant in found.get((serial, period), {}):
                    continue
                told = measure(benches["family", serial], period, variant)
                found.setdefault((serial, period), {})[variant] = told
                with TABLE.open("a", newline="", encoding="utf-8") as file:
                    csv.writer(file, lineterminator="\n").writerow([serial, period, variant, json.dumps(told)])
                sys.stderr.write(f"serial {serial} at {period:g} s, {variant}: "
                                 f"{told.get('stopped', told.get('jump'))}\n")
    PAGE.write_text(page(walks, found), encoding="utf-8")


if __name__ == "__main__":
    main()
