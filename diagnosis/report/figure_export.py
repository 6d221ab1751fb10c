"""Export of a diagnosis to a folder: plots as PNG and tables as CSV, for a paper or a spreadsheet.

The numbers are those of the page.  Each file is written under another name and then renamed, so that no incomplete file
is ever visible.
"""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from diagnosis.findings import Findings
from diagnosis.report import figure_tables, residual_picture
from diagnosis.report.headline import headline, healthy_value
from parameters import InputError
from trial.report.page import NamedText
from trial.report.plot import Plot, picture, save

RELATION_COLUMNS: Final = ("signal", "unit", "floor", "rmse_before", "rmse_session", "rmse_after", "gain_percent",
                           "gain_low_percent", "gain_high_percent", "holdout_before", "holdout_session",
                           "holdout_after")
CAUSE_COLUMNS: Final = ("effect", "site", "parameter", "old", "new", "low", "high", "unit", "gain_percent")
NAMES: Final = ("relations.csv", "causes.csv", "detection_limit.csv", "residual.csv", "residual.png", "loop.csv",
                "loop.png", "headline.txt")
"""Names of the exported files; a plot and its CSV are omitted if the diagnosis has no such data."""


def write(found: Findings, folder: str | Path, *, overwrite: bool = False) -> list[Path]:
    """Write plots and tables of a diagnosis into `folder` and return the paths of the files.

    Raises `InputError` if the folder cannot be written, or has such files and `overwrite` is false.
    """
    folder = Path(folder)
    refuse(folder, overwrite=overwrite)
    made: dict[str, bytes] = {
        "headline.txt": "".join(f"{line}\n" for line in headline(found)).encode(),
        "relations.csv": _csv(RELATION_COLUMNS, [
            (name, f.unit, f.floor, f.rmse_before, f.rmse_session, f.rmse_after, f.gain_percent, f.low, f.high,
             f.holdout_before, f.holdout_session, f.holdout_after) for name, f in found.relations.items()]),
        "causes.csv": _csv(CAUSE_COLUMNS, [
            (c["effect"], c["site"], name, healthy_value(c, name), one["value"], one["low"], one["high"],
             one["unit"], c["gain_percent"]) for c in found.causes for name, one in c["parameters"].items()]),
        "detection_limit.csv": _csv([name.replace(" ", "_") for name in figure_tables.LIMIT_COLUMNS],
                                    figure_tables.limit_rows(found))}
    made |= _residual(found) | _loop(found)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in made.items():
            part = folder / f".part-{name}"
            part.write_bytes(content)
            part.replace(folder / name)
    except OSError as error:
        raise InputError(f"--figures {folder}: cannot be written ({error.strerror}); give a writable folder.") from None
    return [folder / name for name in made]


def refuse(folder: Path, *, overwrite: bool) -> None:
    """Raise `InputError` if `folder` is a file, or has a file of `NAMES` and `overwrite` is false."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--figures {folder}: is a file; give a folder.")
    there = [name for name in NAMES if (folder / name).exists()]
    if there and not overwrite:
        raise InputError(f"--figures {folder}: {', '.join(there)} exist; give another folder or --overwrite.")


def _csv(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([["" if _unknown(value) else value.tip if isinstance(value, NamedText) else value for value in row]
                      for row in rows])
    return text.getvalue().encode()


def _unknown(value: Any) -> bool:
    return value is None or (isinstance(value, float) and not math.isfinite(value))


def _columns(columns: Mapping[str, Any]) -> bytes:
    return _csv(list(columns), [[float(value) for value in row] for row in zip(*columns.values(), strict=True)])


def _residual(found: Findings) -> dict[str, bytes]:
    one = residual_picture.residual(found)
    if one is None:
        return {}
    along, unit = one.axis.split(" (")[0], one.unit
    columns = {along: one.centres, f"mean_before_{unit}": one.before[0], f"rms_before_{unit}": one.before[1],
               f"mean_after_{unit}": one.after[0], f"rms_after_{unit}": one.after[1]}
    return {"residual.csv": _columns(columns),
            "residual.png": _png(residual_picture.residual_plot(one, named=bool(found.causes)))}


def _loop(found: Findings) -> dict[str, bytes]:
    plot, branches = residual_picture.loop_plot(found), residual_picture.loops(found.traces)
    if plot is None or not branches:
        return {}
    columns = {"end_n": branches[0].end_n}
    for one in branches:
        for model, values in (("measured", one.measured), ("before", one.before), ("after", one.after)):
            columns[f"start_{model}_{one.direction.replace(' ', '_')}_n"] = values
    return {"loop.csv": _columns(columns), "loop.png": _png(plot)}


def _png(plot: Plot) -> bytes:
    content = io.BytesIO()
    save(picture([plot], (7.0, 4.2)), content, dpi=160)
    return content.getvalue()
