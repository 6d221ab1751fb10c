"""Force and phase in walks whose strides differ, on benches of the own plant and of the family: docs/strides.md.

    python -m benchmarks.strides [DIRECTORY] [--minutes 7] [--kind own]

A walk of `WALKS` plays the recorded strides of DIRECTORY (default ../shared/data/gait) in random order, with stumbles,
stops and a seat, while the rope's zero moves.  A bench is walked on day 1 by the calibration of day 0 that
docs/unseen.csv has.  Walks that docs/strides.csv lacks are run until the minutes are over; then the table of the page
is written.
"""

import argparse
import math
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import family, frame
from benchmarks.frame import DOCS, OUT, ROOT, markdown
from trial.curves import read_curve

TABLE, PAGE, KNEE = DOCS / "strides.csv", DOCS / "strides.md", OUT / "strides.csv"
KEYS = ("kind", "serial", "seed")
PEAK_N, PERIOD_S = 40.0, 1.2
STRIDES = 60
INTERRUPTED = {"stumbles": 2, "stops": 2, "sits": 1}
MIGRATION_MM, WALK_S = 5.0, 85.0
"""Shift of the rope's zero during a walk, mm, and duration of a walk, s."""
WALKS: tuple[dict[str, Any], ...] = tuple(
    {"kind": kind, "serial": serial, "seed": 1000 + i, "migration_mm": MIGRATION_MM if i % 4 < 2 else -MIGRATION_MM}
    for i, (kind, serial) in enumerate([
        bench for k in range(20) for bench in (("own", family.OWN[k % 3]), ("family", 2 * k))]))
"""Walks of the page: kind and serial of a bench, seed of the walk and of the noise, migration, mm."""
MOVES_HZ = 0.001
"""Frequency of the sine of the own plant's moving zero, Hz: over the 85 s of a walk it is nearly a straight line."""
RMSE, TRUE_RMSE = "rmse_percent", "true_phase_rmse_percent"
BARS = (
    ("walks", ""), ("strides that count", ""), ("with the whole force", ""),
    *((f"RMSE {against}, {part} (%)", bar)
      for against in ("against the force asked for", "against the desired force at the true phase")
      for part, bar in (("median", "0.6"), ("95 %", "1.2"), ("worst", "5"))),
    ("phase, rms over strides (% of the gait)", "1.5"), ("longest time with more than 3 N off phase (ms)", "100"),
    ("walks stopped", "0"))
"""Figures of the page and their bars."""


def number(value: float | None) -> str:
    """Return a figure as text; a missing one as "–"."""
    return frame.number(math.nan if value is None else value)


def strides_of(directory: Path, path: Path) -> Path:
    """Write the recorded strides of a directory, one a file, into one numbered file."""
    rows = ["stride,gait_percent,knee_angle_rad"]
    for i, file in enumerate(sorted(directory.glob("cycle_*.csv"))):
        curve = read_curve(file, "knee_angle_rad")
        rows += [f"{i},{at:g},{angle!r}" for at, angle in zip(
            curve.percent.tolist(), curve.values.tolist(), strict=True)]
    if len(rows) == 1:
        raise SystemExit(f"{directory}: no cycle_*.csv there; give the directory of the recorded strides.")
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def calibration(kind: str, serial: int) -> Path:
    """Return the file of a bench's calibration, which docs/unseen.csv has of day 0."""
    kept = OUT / f"strides-{kind}-{serial}.toml"
    kept.write_text(family.read(family.TABLE)[kind, serial]["calibration"], encoding="utf-8")
    return kept


def moving_zero(mm: float) -> dict[str, Any]:
    """Return the plant model of an own bench whose rope's zero moves by `mm` in a walk."""
    size = 1e-3 * mm / (2.0 * math.pi * MOVES_HZ * WALK_S)
    return {"terms": [{
        "carrier": "zero", "modulation": "time_sine", "parameters": {"hz": MOVES_HZ}, "coefficients": [size, 0.0],
        "intervals": [[size, size], [0.0, 0.0]], "unit": "m", "part": "rope", "words": "zero of the rope"}]}


def name(walk: Mapping[str, Any]) -> str:
    """Return the name of a walk."""
    return f"{walk['kind']} {walk['serial']}, seed {walk['seed']}"


def recording(walk: Mapping[str, Any]) -> Path:
    """Return the path of a walk's recording."""
    return OUT / f"strides-{walk['kind']}-{walk['serial']}-{walk['seed']}.mcap"


def walked(walk: Mapping[str, Any], knee: Path) -> dict[str, Any]:
    """Run one walk of `WALKS` and return its row of docs/strides.csv."""
    import bowden
    from bowden.bench import buses
    from bowden.sweep.rows import plant_model

    kind, serial, mm = walk["kind"], walk["serial"], walk["migration_mm"]
    row = family.bench_row(kind, serial, 1)
    model, plant = plant_model(row), str(row["bench.plant"])
    if kind == "family":
        plant += f"_{'up' if mm > 0.0 else 'down'}_{round(1e3 * abs(mm) / WALK_S)}"
    else:
        model = {**model, **moving_zero(mm)}
    bus = buses.simulated(int(row["bench.serial"]), int(row["bench.day"]), walk["seed"], plant=plant,
                          plant_model=model)
    asked = bowden.Experiment(knee=knee, peak_n=PEAK_N, period_s=PERIOD_S, strides=STRIDES, controller="extended",
                              model=calibration(kind, serial), **INTERRUPTED)
    found = bowden.run(asked, bus=bus, output=recording(walk), overwrite=True).figures
    return {**walk, "outcome": found["outcome"], "stop_reason": found["stop_reason"], "walk": found["walk"]}


def counted(rows: Sequence[Mapping[str, Any]], key: str) -> list[float]:
    """Return a figure of each uninterrupted stride but the first.

    Figures at the true phase are those of strides in which the whole force was asked for.
    """
    return [one[key] for row in rows if row["walk"] for one in row["walk"]["by_stride"]
            if one["kind"] == "walk" and one["stride"] >= 1 and one[key] is not None
            and (one["assisted"] or key != TRUE_RMSE)]


def summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the figures of walks that have a bar (a limit that they should keep), in the order of `BARS`."""
    if not rows:
        return ["–"] * 12
    asked, true, phase = (counted(rows, key) for key in (RMSE, TRUE_RMSE, "phase_error_rms_percent"))
    spread = [float(value) for each in (asked, true) for value in np.percentile(each, (50, 95, 100))]
    off = max(row["walk"]["off_phase_ms"] for row in rows if row["walk"])
    return [str(len(rows)), str(len(asked)), str(len(true)), *map(number, spread),
            number(math.sqrt(float(np.mean(np.square(phase))))), number(off),
            str(sum(row["outcome"] != "completed" for row in rows))]


def figures(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of docs/strides.md."""
    columns = [summary([row for row in rows if row["kind"] in kinds])
               for kinds in (("own", "family"), ("own",), ("family",))]
    return markdown(["figure", "bar", "all", "own benches", "family"],
                    [(*row, *cells) for row, *cells in zip(BARS, *columns, strict=True)])


def main(arguments: Sequence[str]) -> None:
    """Run the walks that the table lacks, and write the table of the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.strides")
    parser.add_argument("directory", nargs="?", type=Path, default=ROOT.parent / "shared" / "data" / "gait")
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--kind", choices=("own", "family"))
    options = parser.parse_args(arguments)
    OUT.mkdir(parents=True, exist_ok=True)
    sys.path.insert(0, str(ROOT))  # the family is a plug-in of the tests
    strides, until = strides_of(options.directory, KNEE), time.monotonic() + 60.0 * options.minutes
    known = {name(row) for row in frame.rows(TABLE)}
    for walk in WALKS:
        if name(walk) in known or options.kind not in (None, walk["kind"]) or time.monotonic() > until:
            continue
        frame.write_rows(TABLE, KEYS, [row := walked(walk, strides)], "a")
        print(f"{name(row)}: {row['outcome']} {row['stop_reason'] or ''}", flush=True)
    frame.put(PAGE, "figures", figures(frame.rows(TABLE)))


if __name__ == "__main__":
    main(sys.argv[1:])
