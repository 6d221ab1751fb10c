"""Sweeps: many trials of simulated benches, run by several processes, collected in one table.

    rows = bowden.sweep.over({"peak": [40, 50], "serial": range(1, 6)}, "table.csv")

`over` is the public name of this package; its imports wait until the call.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

from bowden.progress import SILENT, Progress

__all__ = ["over"]


def over(
    grid: Mapping[str, Iterable[object]], output: str | Path, *, identify: bool = False,
    config: str | Path | None = None, workers: int | None = None, overwrite: bool = False, progress: Progress = SILENT,
) -> list[dict[str, str]]:
    """Run a trial at every point of a grid and return the rows of its table, cells as text by column.

    `grid`: values by name, an option of `bowden trial` or a key of bench.toml or of the plant, such as "peak",
    "serial", "gait.period_s".  `output`: the table, .csv or .parquet; one that is there is continued.  `identify`: each
    bench is identified on its day 0 first.  `workers`: processes (None: one a processor).  Trials run in processes of
    their own: a script calls it under `if __name__ == "__main__":`.  Raises `InputError`.
    """
    from bowden.bench import configuration
    from bowden.sweep import rows, run
    from bowden.sweep.sweep_table import SweepTable

    axes = [rows.axis(f"{name}={','.join(str(value) for value in values)}") for name, values in grid.items()]
    fixed = {"files.calibration": rows.IDENTIFIED} if identify else {}
    wanted = rows.rows(configuration.read(None if config is None else Path(config)), fixed, axes)
    with SweepTable(Path(output), list(wanted[0]), overwrite=overwrite) as table:
        return run.into_table(wanted, table, overwrite=overwrite, workers=workers, progress=progress)
