"""A sweep: rows that are not in the table yet are run by workers, and entered as soon as they are done."""

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bowden.progress import SILENT, Progress
from bowden.sweep import row_trial
from bowden.sweep.rows import IDENTIFIED, Row, placed
from bowden.sweep.sweep_table import SweepTable
from bowden.trials import session
from bowden.workers import ENDED, Job, Workers, run_all, workers_of
from parameters.files import write_whole


def into_table(
    rows: Sequence[Row], table: SweepTable, *, overwrite: bool = False, scheduler: str | None = None,
    workers: int | None = None, keep: Path | None = None, progress: Progress = SILENT,
) -> list[dict[str, str]]:
    """Run the rows that `table` lacks, as `workers_of` and `sweep` do; return all rows, their cells by column.

    The folder beside the table keeps the calibrations; `overwrite` empties it.
    """
    calibrations = table.path.with_suffix(".calibrations")
    for stale in calibrations.glob("serial-*.toml") if overwrite else ():
        stale.unlink()
    if all(table.found(row) is not None for row in rows):
        table.finish(rows)
    else:
        if scheduler is None:
            session.compile_laws(simulated=True, progress=progress)
        with workers_of(scheduler, workers) as crew, progress.running("sweep") as update:
            sweep(rows, table, crew, calibrations, keep=None if keep is None else str(keep.resolve()), update=update)
    return [table.found(row) or {} for row in rows]


def sweep(
    rows: Sequence[Row], table: SweepTable, workers: Workers, calibrations: Path, *, keep: str | None = None,
    update: Callable[[float], None] = lambda share: None,
) -> None:
    """Run the rows that `table` lacks; calibrations that they need are identified first, once, into `calibrations`.

    On `KeyboardInterrupt` running rows are finished and entered in the table before it is raised again.
    """
    missing = [row for row in rows if table.found(row) is None]
    entered, reasons = itertools.count(1), dict[str, str]()

    def enter(row: Row, figures: dict[str, Any]) -> None:
        table.append(row, figures)
        update(next(entered) / len(missing))

    def identified(name: str, result: tuple[str | None, str]) -> None:
        reason, text = result
        if reason is None:
            calibrations.mkdir(exist_ok=True)
            write_whole(calibrations / name, text, overwrite=True)
        else:
            reasons[name] = reason

    def tried(row: Row, figures: dict[str, Any]) -> None:
        enter(row, {**figures, "controller": figures["controller"] and row["gait.controller"]})

    benches = {_calibration_of(row): row_trial.bench_of(row) for row in missing
               if row["files.calibration"] == IDENTIFIED}
    run_all((Job(name, row_trial.identify, (bench,), (ENDED, "")) for name, bench in benches.items()
             if not (calibrations / name).is_file()), workers, identified)
    for row in missing if reasons else ():
        if (reason := reasons.get(_calibration_of(row))) and row["files.calibration"] == IDENTIFIED:
            enter(row, row_trial.not_run("not identified", reason))
    run_all((_trial(row, calibrations, keep) for row in missing if table.found(row) is None), workers, tried)
    table.finish(rows)


def _calibration_of(row: Row) -> str:
    """Return the name of the file that keeps the calibration of a row's bench."""
    bench = row_trial.bench_of(row)
    return f"serial-{bench['bench.serial']}-{row_trial.digest(bench)}.toml"


def _trial(row: Row, calibrations: Path, keep: str | None) -> Job:
    path = calibrations / _calibration_of(row) if row["files.calibration"] == IDENTIFIED else None
    text, label = ("", "") if path is None else (path.read_text(encoding="utf-8"), str(path))
    return Job(row, row_trial.perform, (placed(row), text, label, keep), row_trial.not_run("failed", ENDED))
