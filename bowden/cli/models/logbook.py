"""`bowden logbook`: a bench over months: trials, sessions, changes and maintenance in one folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import CommandGroup, app
from bowden.cli.options import argument, keyed, new_file, option
from bowden.cli.terminal import AnswerTable, CommandAnswer, Paragraph, Words
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    from bowden.models import logbook_entries
    from logbook import bench_page, bench_state, database
    from trial import signals
    from trial.report import words

logbook = CommandGroup(help="Track a bench's constants over months.")
app.add_typer(logbook, name="logbook")

Folder = Annotated[Path, argument("DIR", "The logbook's folder.")]
Files = Annotated[list[Path], argument("FILE…", "Trials (.mcap) or tables (CSV, Parquet, …).")]
Name = Annotated[str, option("Name of the bench (default: the folder's).", "TEXT", "--name")]
References = Annotated[int, option(
    "First sessions, by date, that are the reference; a change is stated after them.", "COUNT")]
Most = Annotated[int, option("Newest trials to list.", "COUNT", "--most", min=1)]
Number = Annotated[int | None, option("Show one trial instead of the bench.", "NUMBER", "--trial")]
Limits = Annotated[list[str] | None, option(
    "Forecast when a constant reaches a value, SI; repeatable.", "NAME=VALUE", "--limit")]
NewTable = Annotated[Path, new_file("File to write.", "a table", ".csv", ".parquet")]
Table = Annotated[str, option("trials, sessions, constants, verdicts, notes or models.", "NAME")]
Text = Annotated[str, argument("TEXT", "Maintenance, in words.")]
Part = Annotated[list[str] | None, option(
    "Part (cable, fabric, knee, start, end, drive) or constant that is new; repeatable.", "NAME",
    autocompletion=options.completing(lambda: (*bench_state.PARTS, *bench_state.CONSTANTS)))]
After = Annotated[str | None, option("Session after which it was done (default: the newest by date).", "LABEL")]
Everything = Annotated[bool, option("All constants, in place of the ten that moved most.", None, "--all")]
SHOWN = 10
"""Constants that `show` prints without --all."""


@logbook.command("init", example="bowden logbook init bench1")
def init_logbook(
    folder: Folder, name: Name = "", references: References = 3, path: options.ForcePath = None,
) -> CommandAnswer:
    """Make an empty logbook of one bench; of a bench of several force paths, of the one that --path names."""
    database.create(folder, name, references, path or "")
    return CommandAnswer({"logbook": str(folder), "references": references}, f"Logbook: {folder}")


@logbook.command("add",
    example="bowden logbook init bench1 && bowden logbook add bench1 trial.mcap --session 2026-03-02")
def add_trials(folder: Folder, files: Files, session: options.Session = None) -> CommandAnswer:
    """Enter recorded trials and lab data, and fit them.

    A file that was entered is not entered again and keeps its session; where it was moved, its new place is kept.
    """
    with terminal.fitting(f"fitting {len(files)} trials"):
        entries = logbook_entries.add(folder, dict.fromkeys(files, session))
    added = [entry._asdict() | {"new": new} for entry, new in entries]
    return CommandAnswer({"logbook": str(folder), "added": added}, [
        f"Trial {entry.id}, session {entry.label}: {entry.path}" + ("" if new else "; it was entered before")
        + ("" if new or session in (None, entry.label) else f" and keeps that session; --session {session} is not used")
        + ("" if entry.estimated else f"; not fitted: {entry.remark}") for entry, new in entries])


@logbook.command("list", example="bowden logbook init bench1 && bowden logbook list bench1")
def list_trials(folder: Folder, most: Most = 20) -> CommandAnswer:
    """List the newest trials, and why any has no fit."""
    with database.open_logbook(folder) as book:
        name, counts, entries = book.name, book.counts(), book.trials(most)
    rows = [(str(e.id), e.label, e.experiment, e.outcome or "–", e.figures.get("relative_rmse_percent"),
             e.path.removeprefix(f"{Path.cwd()}/") if e.there else f"{e.path} (not found)") for e in entries]
    return CommandAnswer(
        {"bench": name, **{f"{k}s": v for k, v in counts.items()}, "newest": [entry._asdict() for entry in entries]},
        [AnswerTable(f"{name}: {counts['trial']} trials in {counts['session']} sessions", (
            "trial", "session", "experiment", "outcome", "RMSE (%)", "file"), rows),
         *map(Paragraph, database.unfitted(entries))])


@logbook.command("show", example="bowden logbook init bench1 && bowden logbook show bench1 --limit cable=0.3")
def show_bench(
    folder: Folder, trial: Number = None, limit: Limits = None, everything: Everything = False,
) -> CommandAnswer:
    """Show what changed, the ten constants that moved most and forecasts, or one trial."""
    with database.open_logbook(folder) as book:
        if trial is not None:
            return _of_trial(book, trial)
        state = _diagnosed(book, limit)
        models = book.models()
    return CommandAnswer(state.as_json() | {"models": models},
                         _words(state, len(state.courses) if everything else SHOWN))


@logbook.command("report", example="bowden logbook init bench1 && bowden logbook report bench1 -o bench1.html")
def report_bench(folder: Folder, output: options.Page, limit: Limits = None) -> CommandAnswer:
    """Write the bench as one offline HTML page, alarms first."""
    output_files.refuse_inputs([output], [folder / database.FILE])
    with database.open_logbook(folder) as book:
        state = _diagnosed(book, limit)
        size = bench_page.write(book, state, output)
    return CommandAnswer({"report": str(output), "bytes": size}, f"{output}: {terminal.size(size)}.")


@logbook.command("export",
    example="bowden logbook init bench1 && bowden logbook export bench1 --table constants -o constants.csv")
def export_logbook(folder: Folder, output: NewTable, table: Table = "trials") -> CommandAnswer:
    """Write one table of a logbook as CSV or Parquet."""
    output_files.refuse_inputs([output], [folder / database.FILE])
    with database.open_logbook(folder) as book:
        rows = bench_page.export_table(book, table, output)
    return CommandAnswer({"file": str(output), "rows": rows}, f"{output}: {rows} rows.")


@logbook.command("note",
    example='bowden logbook init bench1 && bowden logbook note bench1 "cable replaced" --part cable')
def note_maintenance(folder: Folder, text: Text, part: Part = None, after: After = None) -> CommandAnswer:
    """Enter maintenance; constants of a --part may jump from the next session on without an alarm."""
    if not text.strip():
        raise InputError("logbook note: the text is empty; write what was done.")
    names = bench_state.constants_of(part or ())
    with database.open_logbook(folder) as book:
        sessions = {session.label: session.id for session in book.sessions()}
        if after is not None and after not in sessions:
            raise InputError(f"--after {after}: is no session of the logbook; bowden logbook list shows their labels.")
        last = next(reversed(sessions.values()), 0) if after is None else sessions[after]
        note = book.enter_note(text, names, last)
    return CommandAnswer({"note": note.id, "text": text, "resets": list(names)},
                         f"Note {note.id}: {text}. Resets: {', '.join(names) or 'nothing; --part names what is new'}.")


def _diagnosed(book: Any, given: list[str] | None) -> bench_state.BenchState:
    """Return the state of the bench with forecasts to the limits NAME=VALUE."""
    limits = dict(keyed("--limit", given, "NAME=VALUE; write for instance --limit cable=0.3",
                        lambda name, value: (name, float(value))))
    with terminal.fitting("diagnosing a change"):
        return logbook_entries.diagnosed_state(book, limits)


def _of_trial(book: Any, number: int) -> CommandAnswer:
    entries = book.trials(1, trial=number)
    if not entries:
        raise InputError(f"--trial {number}: is not in the logbook; bowden logbook list shows the numbers.")
    entry, verdicts = entries[0], book.verdicts(number)
    figures = {f"{one.text} ({one.unit})": terminal.number(entry.figures[one.name]) for one in signals.FORCE_FIGURES
               if entry.figures.get(one.name) is not None}
    about = words.shown(entry.conditions) | {"outcome": entry.outcome} | figures
    return CommandAnswer(entry._asdict() | {"verdicts": verdicts}, [
        f"Trial {entry.id}, session {entry.label}: {entry.path}" + ("" if entry.there else " (not found)"),
        f"  entered {entry.added}; {words.quantity(entry.seconds, 's')} recorded"
        + ("" if entry.estimated else f"; not fitted: {entry.remark}"),
        *(f"  {name}: {value}" for name, value in about.items()),
        *(f"  verdict of {verdict['made']}: {verdict['verdict']}"
          + "".join(f", {words.words(name)}" for name in verdict.get("class", ())) for verdict in verdicts)])


def _words(state: bench_state.BenchState, most: int) -> Words:
    yield from state.sentences()
    for ahead in state.forecasts:
        yield (f"{ahead.constant} is not forecast to reach {ahead.limit:g}." if ahead.sessions is None else
               f"{ahead.constant} reaches {ahead.limit:g} in {ahead.sessions:.0f} sessions "
               f"(95 %: {ahead.low or 0:.0f} … {'no limit' if ahead.high is None else f'{ahead.high:.0f}'}).")
    if not state.courses:
        return
    courses = sorted(state.courses.values(), key=lambda course: -course.departure)[:most]
    yield AnswerTable(f"{state.name}: constants in session {state.labels[state.sessions[-1]]}", (
        "constant", "unit", "first", "now", "95 % interval", "1σ between sessions"), [
        (c.name, unit or "1", first, now, f"{low} … {high}", scatter) for c in courses
        for (now, low, high, scatter, _, first), unit in (c.newest(float(c.value[0])),)])
    if len(courses) < len(state.courses):
        yield f"{len(state.courses) - len(courses)} further constants: --all."
