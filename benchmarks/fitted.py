"""END by a calibration of `bowden fit` against END by one of `bowden identify`, on benches of the family.

    python -m benchmarks.fitted [--serials 0,1,3] [--workers N]

A bench walks three gait trials on day 0 by the paper's controller on the packaged calibration; these are fitted.  On
day 1 it walks by the extended controller on the fitted calibration.  The walks on the identified one are the rows of
docs/unseen.csv (`python -m benchmarks.family`), with as many gait cycles.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.family_walks import CYCLES, DEVELOPMENT, DOCS, PERIODS_S, ROOT, SETTLE, TRUE, bench_row, read, walked

GAITS = ((40.0, 2.0), (50.0, 1.5), (60.0, 1.2))
"""Peak, N, and period, s, of the fitted gait trials."""
FITTED_CYCLES = 3


def main(arguments: Sequence[str] | None = None) -> None:
    """Print END's error by both calibrations for each bench and period, and the median of their ratio."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fitted")
    parser.add_argument("--serials", help="serials of the family, with commas (default: the first ten developed on)")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(arguments)
    serials = DEVELOPMENT[:10] if options.serials is None else [int(s) for s in options.serials.split(",")]
    identified = read(DOCS / "unseen.csv")
    print("| serial | period (s) | END by identify (%) | END by fit (%) | ratio |\n|---|---|---|---|---|")
    ratios = []
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as crew:
        for serial, found in zip(serials, crew.map(measure, serials), strict=True):
            row = identified["family", serial]
            for period in PERIODS_S:
                before, after = row[f"{period:g}"][TRUE], found.get(f"{period:g}")
                if after is None:
                    print(f"| {serial} | {period:g} | {before:.2f} | {found['failed']} | – |")
                    continue
                ratios.append(after / before)
                print(f"| {serial} | {period:g} | {before:.2f} | {after:.2f} | {after / before:.2f} |", flush=True)
    if ratios:
        print(f"\nRatio: median {statistics.median(ratios):.2f}, worst {max(ratios):.2f} of {len(ratios)} walks.")


def measure(serial: int) -> dict[str, Any]:
    """Return END's error, % of the peak, by period, or `failed` with the reason."""
    from bowden.sweep import row_trial
    from bowden.trials import session
    from estimation import bench_fit
    from estimation.data import table
    from physics.calibration import write

    sys.path.insert(0, str(ROOT))
    session.compile_laws(simulated=True)
    peak = read(DOCS / "unseen.csv")["family", serial]["peak_n"]
    with tempfile.TemporaryDirectory() as folder:
        made = [row_trial.perform(bench_row("family", serial, 0, **{
            "files.calibration": "nominal", "gait.controller": "paper", "gait.peak_n": force, "gait.period_s": period,
            "gait.cycles": FITTED_CYCLES}), "", "", folder) for force, period in GAITS]
        whole = [table.read(Path(each["trial"])) for each in made if each["outcome"] == "completed"]
        if not whole:
            return {"failed": made[0]["stop_reason"]}
        text = write(bench_fit.calibrated(whole))
    found = {f"{period:g}": walked("family", serial, text, "extended", CYCLES, SETTLE, {
        "gait.peak_n": peak, "gait.period_s": period}) for period in PERIODS_S}
    stopped = [walk["stop_reason"] for walk in found.values() if TRUE not in walk]
    return {"failed": stopped[0]} if stopped else {key: walk[TRUE] for key, walk in found.items()}


if __name__ == "__main__":
    main()
