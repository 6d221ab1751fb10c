"""`bowden logbook`: a bench over months: trials, sessions, changes and maintenance in one folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.command import CommandGroup

if TYPE_CHECKING:
    from logbook.bench_state import BenchState

logbook = CommandGroup(help="Track a bench's constants over months.", rich_markup_mode=None)
app.add_typer(logbook, name="logbook")

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The logbook's folder.", show_default=False)]
Files = Annotated[list[Path], typer.Argument(
    metavar="FILE…", help="Trials (.mcap) or tables (CSV, Parquet, …).", show_default=False)]
Name = Annotated[str, typer.Option("--name", metavar="TEXT", help="Name of the bench (default: the folder's).")]
References = Annotated[int, typer.Option(
    metavar="COUNT", help="First sessions that the scatter between sessions is measured from.")]
Most = Annotated[int, typer.Option("--most", metavar="COUNT", min=1, help="Newest trials to list.")]
Number = Annotated[int | None, typer.Option("--trial", metavar="NUMBER", help="One trial in place of the bench.")]
Limits = Annotated[list[str] | None, typer.Option(
    "--limit", metavar="NAME=VALUE", help="Forecast when a constant reaches a value, SI; repeatable.")]
Table = Annotated[str, typer.Option(
    metavar="NAME", help="trials, sessions, constants, verdicts, notes or models.")]
Text = Annotated[str, typer.Argument(metavar="TEXT", help="What was done.", show_default=False)]
Resets = Annotated[list[str] | None, typer.Option(
    "--resets", metavar="NAME", help="Part (cable, fabric, knee, start, end, drive) or constant that it changed; "
    "repeatable (default: those that TEXT names).")]


@logbook.command("init")
def init_logbook(folder: Folder, name: Name = "", references: References = 10, json: options.Json = False) -> int:
    """Make an empty logbook of one bench.

    Example: bowden logbook init bench1
    """
    from logbook import database

    database.create(folder, name, references)
    terminal.emit({"logbook": str(folder), "references": references}) if json else print(f"Logbook: {folder}")
    return 0


@logbook.command("add")
def add_trials(folder: Folder, files: Files, session: options.Session = None, json: options.Json = False) -> int:
    """Enter recorded trials and lab data, and fit them.

    A file that was entered is not entered again; where it was moved, its new place is kept.

    Example: bowden logbook init bench1 && bowden logbook add bench1 trial.mcap --session 2026-03-02
    """
    from bowden.models import logbook_entries

    entries = []
    for file in files:
        with terminal.waiting(f"fitting {file}", shown=not json):
            entries.append(logbook_entries.add(folder, file, session))
    if json:
        terminal.emit({"logbook": str(folder), "added": [_row(entry) for entry in entries]})
        return 0
    for entry in entries:
        print(f"Trial {entry.id}, session {entry.label}: {entry.path}" + (
            "" if entry.estimated else f"; not fitted: {entry.remark}"))
    return 0


@logbook.command("list")
def list_trials(folder: Folder, most: Most = 20, json: options.Json = False) -> int:
    """List the newest trials.

    Example: bowden logbook init bench1 && bowden logbook list bench1
    """
    from logbook.database import open_logbook

    with open_logbook(folder) as book:
        counts, entries = book.counts(), book.trials(most)
        if json:
            terminal.emit({"bench": book.name, **{f"{k}s": v for k, v in counts.items()},
                           "newest": [_row(entry) for entry in entries]})
            return 0
        terminal.table(f"{book.name}: {counts['trial']} trials in {counts['session']} sessions", (
            "trial", "session", "experiment", "outcome", "RMSE (%)", "file"), [
            (str(e.id), e.label, e.experiment, e.outcome or "–", _rmse(e.figures),
             e.path if e.there else f"{e.path} (not found)") for e in entries])
    return 0


@logbook.command("show")
def show_bench(folder: Folder, trial: Number = None, limit: Limits = None, json: options.Json = False) -> int:
    """Show the bench's constants, changes and forecasts, or one trial.

    Example: bowden logbook init bench1 && bowden logbook show bench1 --limit cable=0.3
    """
    from bowden.models.change_diagnosis import diagnosed_state
    from logbook.database import open_logbook

    with open_logbook(folder) as book:
        if trial is not None:
            return _show_trial(book, trial, json)
        with terminal.waiting("diagnosing a change", shown=not json):
            state = diagnosed_state(book, _limits(limit))
        if json:
            terminal.emit(state.as_json() | {"models": book.models()})
        else:
            _tell(state)
    return 0


@logbook.command("report")
def report_bench(folder: Folder, output: options.Output, limit: Limits = None, overwrite: options.Overwrite = False,
                 json: options.Json = False) -> int:
    """Write the bench as one offline HTML page, alarms first.

    Example: bowden logbook init bench1 && bowden logbook report bench1 -o bench1.html
    """
    from bowden import output_files
    from bowden.models.change_diagnosis import diagnosed_state
    from logbook import bench_page
    from logbook.database import FILE, open_logbook

    output_files.refuse([output], overwrite=overwrite, inputs=[folder / FILE])
    output_files.refuse_ending(output, ".html", ".htm", what="a page")
    with open_logbook(folder) as book:
        with terminal.waiting("diagnosing a change", shown=not json):
            state = diagnosed_state(book, _limits(limit))
        size = bench_page.write(book, state, output)
    terminal.emit({"report": str(output), "bytes": size}) if json else print(f"{output}: {size / 1e6:.1f} MB.")
    return 0


@logbook.command("export")
def export_logbook(folder: Folder, output: options.Output, table: Table = "trials",
                   overwrite: options.Overwrite = False, json: options.Json = False) -> int:
    """Write one table of a logbook as CSV or Parquet.

    Example: bowden logbook init bench1 && bowden logbook export bench1 --table constants -o constants.csv
    """
    from bowden import output_files
    from logbook.database import FILE, open_logbook
    from logbook.logbook_tables import export_table

    output_files.refuse([output], overwrite=overwrite, inputs=[folder / FILE])
    output_files.refuse_ending(output, ".csv", ".parquet", what="a table")
    with open_logbook(folder) as book:
        rows = export_table(book, table, output)
    terminal.emit({"file": str(output), "rows": rows}) if json else print(f"{output}: {rows} rows.")
    return 0


@logbook.command("note")
def note_maintenance(folder: Folder, text: Text, resets: Resets = None, json: options.Json = False) -> int:
    """Enter maintenance; a part that it names is new from the next session on.

    Example: bowden logbook init bench1 && bowden logbook note bench1 "cable replaced"
    """
    from logbook.database import open_logbook

    names = _resets(text, resets)
    with open_logbook(folder) as book:
        note = book.enter_note(text, names)
    if json:
        terminal.emit({"note": note.id, "text": text, "resets": list(names)})
    else:
        print(f"Note {note.id}: {text}. Resets: {', '.join(names) or 'nothing'}.")
    return 0


def _resets(text: str, given: Sequence[str] | None) -> tuple[str, ...]:
    from logbook.session_model import CONSTANTS, PARTS, resets_named
    from parameters import InputError

    if not text.strip():
        raise InputError("logbook note: the text is empty; say what was done.")
    for name in given or ():
        if name not in PARTS and name not in CONSTANTS:
            raise InputError(f"--resets {name}: is neither a part ({', '.join(PARTS)}) nor a constant; "
                             "bowden logbook show lists the constants.")
    return resets_named(" ".join(name.upper() if name in PARTS else name for name in given) if given else text)


def _limits(given: Sequence[str] | None) -> dict[str, float]:
    from parameters import InputError

    found = {}
    for one in given or ():
        name, _, value = one.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise InputError(f"--limit {one}: expected NAME=VALUE; write for instance --limit cable=0.3.") from None
    return found


def _row(entry: Any) -> dict[str, Any]:
    return dict(entry._asdict())


def _rmse(figures: dict[str, Any]) -> str:
    return terminal.number(figures.get("relative_rmse_percent"))


def _show_trial(book: Any, number: int, json: bool) -> int:
    from parameters import InputError

    entries = book.trials(1, trial=number)
    if not entries:
        raise InputError(f"--trial {number}: is not in the logbook; bowden logbook list shows the numbers.")
    shown = _row(entries[0]) | {"verdicts": book.verdicts(number)}
    if json:
        terminal.emit(shown)
    else:
        terminal.table(f"trial {number}", ("key", "value"), [(k, str(v)) for k, v in shown.items()])
    return 0


def _tell(state: BenchState) -> None:
    if not state.courses:
        print(f"{state.name}: no session is fitted yet; bowden logbook add enters trials.")
        return
    terminal.table(f"{state.name}: constants in session {state.labels[state.sessions[-1]]}", (
        "constant", "unit", "value", "95 % interval", "1σ between sessions"), [
        (c.name, c.unit or "1", f"{c.value[-1]:.4g}", f"{c.low[-1]:.4g} … {c.high[-1]:.4g}", f"{c.scatter:.2g}")
        for c in state.courses.values()])
    if state.alarms:
        best = state.dated(state.alarms[0])
        first, last = best["since_interval"]
        print(f"Changed, as a {best['course']}, since session {best['since']} (95 %: {first} … {last}); "
              f"{best['nats']:.1f} nats.")
        print(state.cause_told())
    else:
        print("No alarm: no change beyond the scatter between sessions.")
    for ahead in state.forecasts:
        print(f"{ahead.constant} is not forecast to reach {ahead.limit:g}." if ahead.sessions is None else
              f"{ahead.constant} reaches {ahead.limit:g} in {ahead.sessions:.0f} sessions "
              f"(95 %: {ahead.low or 0:.0f} … {'no limit' if ahead.high is None else f'{ahead.high:.0f}'}).")
