"""Nights of `bowden mend` on benches of the family: how much of the lost error is back, by true END.

    python -m tests.hidden.nights_run [--aside] [--first N] [--most N] [--rows FILE] [--page]

A night: two reference trials of a bench by its calibration of docs/unseen.csv, then one hidden effect, one change that
no catalogue has, or none, and `bowden mend`.  `mend` sees END's sensor alone; true END judges it here.  Each row of
FILE is a night; a run that was broken off goes on from there.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

import bowden
from benchmarks import family
from benchmarks.frame import OUT, ROOT, markdown, put
from bowden.pages.figures import true_end
from tests.plants import effects, stack
from trial import read
from trial.metrics import relative_rmse

PEAK_N, PERIOD_S, CYCLES = 40.0, 1.3, 6
PAGE: Final = ROOT / "docs" / "mend.md"
SINGLES, OUTSIDE, HEALTHY = 40, 10, 10
HIDDEN: Final = (*effects.PATH, *effects.SENSOR, *effects.DRIVE)
SHOWS: Final = 0.1
"""Least loss of true END's relative RMSE, points of percent, whose return is judged: the scatter of repeated trials."""


def nights(aside: bool) -> Iterator[tuple[int, str]]:
    """Serial and hidden effect of each night without end, "" for none; kinds in turns: any part has each."""
    known = family.read(family.TABLE)
    serials = [s for s in (family.SET_ASIDE if aside else family.DEVELOPMENT)
               if "failed" not in known["family", s]]
    step, outside = round(len(HIDDEN) * 0.618), tuple(effects.OUTSIDE)
    kinds = itertools.cycle(["single", "single", "single", "single", "outside", "healthy"])
    singles = 0
    for i, kind in enumerate(kinds):
        hidden = HIDDEN[singles * step % len(HIDDEN)] if kind == "single" else (
            outside[i // 6 % len(outside)] if kind == "outside" else "")
        singles += kind == "single"
        yield serials[(i + i // len(serials)) % len(serials)], hidden  # other benches in a further round


def true_percent(path: Path, settle: int = 1) -> float:
    """Return true END's relative RMSE, % of the peak, of a trial's cycles from `settle` on; inf if it has none."""
    trial = read.open(path)
    error = true_end(path.with_name(f"{path.stem}.truth.mcap"), trial) - trial.columns["desired_force_n"]
    found = relative_rmse(error, trial.columns["cycle"] >= settle, PEAK_N)
    return math.inf if found is None else found


def night(serial: int, hidden: str, folder: Path) -> dict[str, Any]:
    """Run one night; return its row."""
    model = folder / "calibration.toml"
    model.write_text(family.read(family.TABLE)["family", serial]["calibration"], encoding="utf-8")

    def bus(seed: int, *changed: str) -> Any:
        plant = stack.plant_name(serial, 0, effects=changed, draw=serial if changed else None)
        return bowden.simulated(serial=0, day=0, seed=seed, plant=plant, plant_model=stack.plant_model(serial))

    def gait(name: str, peak_n: float, period_s: float, seed: int) -> Path:
        path = folder / f"{name}.mcap"
        bowden.run(bowden.Experiment(peak_n=peak_n, period_s=period_s, cycles=CYCLES, controller="extended",
                                     model=model), bus=bus(seed), output=path)
        return path

    reference = [gait("good1", PEAK_N, PERIOD_S, 11), gait("good2", 0.8 * PEAK_N, 1.2 * PERIOD_S, 12)]
    done = bowden.mend(reference, folder / "night", bus=bus(100, *([hidden] if hidden else [])), cycles=CYCLES)
    trials = {side: [true_percent(folder / "night" / f"{pair}-{side}.mcap") for pair in range(1, len(done.after) + 1)]
              for side in "AB"}
    return {"serial": serial, "hidden": hidden, "healthy": true_percent(reference[0]),
            "changed": true_percent(folder / "night" / "gait.mcap"), **trials, **done.as_json(),
            "steps": [line["result"] for line in done.steps[1:] if "verdict" in line["result"]]}


def share(row: Mapping[str, Any]) -> float | None:
    """Share of the lost error that is back, %; None where the loop shows no loss."""
    before = float(np.mean(row["A"] or [row["changed"]]))
    lost = before - row["healthy"]
    after = float(np.mean(row["B"])) if row["kept"] else before
    return None if not SHOWS <= lost < math.inf else 100.0 * (before - after) / lost


def described(row: Mapping[str, Any]) -> list[str]:
    """Return a row of the table."""
    back = share(row)
    return [str(row["serial"]), row["hidden"].replace("_", " ") or "nothing", row["verdict"] or "–",
            ", ".join([*row["names"], *row["equations"]]).replace("_", " ") or "–",
            f"{row['healthy']:.2f}", f"{np.mean(row['A'] or [row['changed']]):.2f}",
            f"{np.mean(row['B']):.2f}" if row["B"] else "–", "kept" if row["kept"] else "as it was",
            "–" if back is None else f"{back:.0f}"]


def page(rows: Sequence[Mapping[str, Any]], options: str) -> str:
    """Return the text between the marks of docs/mend.md."""
    back = [value for value in map(share, rows) if value is not None]
    worse = [row for row in rows if row["kept"] and np.mean(row["B"]) > np.mean(row["A"]) + 0.05]
    healthy = [row for row in rows if not row["hidden"]]
    named = [row for row in rows if row["names"] and row["hidden"] in effects.EFFECTS]
    stopped = [row for row in rows if "stopped" in row["ending"]]
    figures = [
        ("nights", str(len(rows))),
        (f"nights whose loss the loop shows (≥ {SHOWS:g} points)", str(len(back))),
        ("share of the lost error that is back, median (%)", f"{np.median(back):.0f}" if back else "–"),
        ("wrong mends: true END worse by more than 0.05 points", str(len(worse))),
        ("healthy benches changed", f"{sum(row['kept'] for row in healthy)} of {len(healthy)}"),
        ("of nights with a name, the hidden effect is named",
         f"{sum(row['hidden'] in row['names'] for row in named)} of {len(named)}"),
        ("nights that ended by stopped trials", str(len(stopped)))]
    return "\n\n".join((
        f"`python -m tests.hidden.nights_run {options}`:", markdown(["figure", "value"], figures),
        markdown(["bench", "hidden", "verdict", "named or law", "true END before (%)", "changed", "with the extension",
                  "outcome", "back (%)"], [described(row) for row in rows])))


def main(arguments: Sequence[str]) -> None:
    """Run the nights that FILE lacks, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--aside", action="store_true", help="serials that nothing was tuned on")
    parser.add_argument("--first", type=int, default=0, help="number of the first night")
    parser.add_argument("--most", type=int, default=SINGLES + OUTSIDE + HEALTHY, help="only so many, from the first on")
    parser.add_argument("--rows", type=Path, default=OUT / "nights.jsonl")
    parser.add_argument("--page", action="store_true", help=f"write the table into {PAGE.name}")
    given = parser.parse_args(arguments)
    given.rows.parent.mkdir(exist_ok=True)
    kept = [json.loads(line) for line in given.rows.read_text("utf-8").splitlines()] if given.rows.exists() else []
    done = {(row["serial"], row["hidden"]) for row in kept}
    for serial, hidden in itertools.islice(nights(given.aside), given.first, given.first + given.most):
        if (serial, hidden) in done:
            continue
        with tempfile.TemporaryDirectory() as folder:
            row = night(serial, hidden, Path(folder))
        with given.rows.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        kept.append(row)
        print(*described(row), sep=" | ", flush=True)
    text = page(kept, f"{'--aside ' if given.aside else ''}--first {given.first} --most {len(kept)}")
    print(text)
    if given.page:
        put(PAGE, "nights", text)


if __name__ == "__main__":
    main(sys.argv[1:])
