"""Commands on recorded files: `bowden info`, `report`, `cut`, `merge`, `recover`, `import`, `export`, `compare`."""

from __future__ import annotations

import datetime
import sys
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Annotated

from bowden import output_files
from bowden.bench import configuration
from bowden.cli import options, terminal
from bowden.cli.app import NothingGivenError, app
from bowden.cli.options import NewRecording, argument, below, new_file, option, parsed
from bowden.cli.terminal import AnswerTable, CommandAnswer, Words
from bowden.deferred import on_first_use
from bowden.trials import force_paths
from parameters import InputError
from parameters.files import write_whole

with on_first_use():
    from bowden.models import logbook_entries
    from bowden.pages import figures
    from bowden.sweep import summary
    from eds.bench.bench_network import wire
    from trial import compare as comparing
    from trial import edit, read
    from trial.convert import contents as file_contents
    from trial.convert import csv_file, csv_table, imports
    from trial.convert.export import export as exported
    from trial.recover import recover as recovered
    from trial.report import compare_page, trial_page, words

Recording = Annotated[Path, argument("FILE", "MCAP.")]
Several = Annotated[list[Path], argument("FILE…", "MCAP, two or more.")]
From = Annotated[float | None, option("Begin, s after the first control cycle.", "S", "--from")]
To = Annotated[float | None, option("End, s after the first control cycle; excluded.", "S", "--to")]
Torn = Annotated[Path, argument("FILE", "A torn recording.")]
Recovered = Annotated[Path, option("File to write.", "FILE", "-o", "--output")]  # checked by `trial.recover`
Gait = Annotated[str | None, option("Gait cycles A to B in place of times.", "A-B")]


@app.command(example="bowden info trial.mcap")
def info(file: Annotated[Path, argument("FILE", "A trial, CAN log, table or MCAP file.")]) -> CommandAnswer:
    """List the contents of a file of any format.

    Streams with rates and gaps, columns with units and ranges, who recorded it.
    """
    with terminal.waiting(f"reading {file}"):
        found = file_contents.contents(file)
    return CommandAnswer(found.as_json(), _words_of_contents(found))


def _words_of_contents(found: file_contents.Contents) -> Words:
    when = ""
    if found.begins_ns is not None and found.begins_ns > 10**17:  # an epoch, no trial's clock
        begins = datetime.datetime.fromtimestamp(found.begins_ns // 10**9, datetime.UTC)
        when = f", from {begins:%Y-%m-%d %H:%M:%S} UTC"
    lasts = "" if found.seconds is None else f", {found.seconds:.3f} s"
    yield f"{found.path}: {found.format}{when}{lasts}"
    yield from (f"  {remark}" for remark in found.remarks)
    if found.streams:
        yield AnswerTable("streams", ("stream", "kind", "count", "rate (Hz)", "gaps", "longest gap (s)"), [
            (one.name, one.kind, one.messages, one.rate_hz, one.gaps, terminal.number(one.longest_gap_s, ".4f"))
            for one in found.streams])
    if found.columns:
        yield AnswerTable("columns", ("column", "unit", "least", "greatest", "unknown"), [
            (one.name, one.unit, one.least, one.greatest, one.unknown) for one in found.columns], ".6g")
    yield from (f"  {name}: {value}" for name, value in words.shown(found.about).items())
    yield from (f"  {name.replace('_', ' ')}: {count}" for name, count in found.counts.items() if count)
    if found.attachments:
        yield "  attached: " + ", ".join(f"{name} ({size} bytes)" for name, size in found.attachments.items())
    rest = words.folded(found.about)
    if rest:
        yield f"  not shown: {', '.join(rest)}; --json has them."


@app.command(example="bowden cut trial.mcap --from 2 --to 6 -o part.mcap")
def cut(file: Recording, output: NewRecording, from_: From = None, to: To = None, gait: Gait = None) -> CommandAnswer:
    """Write a part of a recording.

    By time or by gait cycles; what explains it is carried along.
    """
    if from_ is None and to is None and gait is None:
        raise InputError("cut: nothing says what to keep; give --from, --to or --gait.")
    if gait is not None and (from_ is not None or to is not None):
        raise InputError("cut: --gait counts gait cycles, --from and --to seconds; give one kind.")
    cycles = (gait and parsed("--gait", gait, "expected a gait cycle or two, such as 3 or 2-5", _span)) or None
    with terminal.waiting(f"cutting {file}"):
        found = edit.cut(file, output, from_s=from_ or 0.0, to_s=to, gait=cycles, overwrite=True)
    return _written(output, found)


def _span(gait: str) -> tuple[int, int]:
    first, _, last = gait.partition("-")
    return int(first), int(first) + below(sys.maxsize, int(last or first) - int(first))


@app.command(
    example="bowden cut trial.mcap --to 2 -o a.mcap && bowden cut trial.mcap --from 2 -o b.mcap && bowden merge "
            "a.mcap b.mcap -o whole.mcap")
def merge(files: Several, output: NewRecording) -> CommandAnswer:
    """Write several recordings as one, by time.

    Parts of one recording, or recordings of different topics.
    """
    with terminal.waiting("merging"):
        found = edit.merge(files, output, overwrite=True)
    return _written(output, found)


def _written(output: Path, found: edit.EditSummary) -> CommandAnswer:
    counts = ", ".join(f"{count} of {topic}" for topic, count in found.messages.items())
    return CommandAnswer({"file": str(output), "messages": found.messages, "seconds": found.seconds},
                         f"{output}: {found.seconds:.3f} s; {counts}.")


@app.command(example="bowden recover torn.mcap -o whole.mcap")
def recover(torn: Torn, output: Recovered, overwrite: options.Overwrite = False) -> CommandAnswer:
    """Repair a torn recording.

    Every message that survived is written, indexed again.
    """
    output_files.refuse_ending(output, ".mcap", what="a recording")
    with terminal.progress(f"recovering {torn}") as update:
        found = recovered(torn, output, overwrite=overwrite, progress=update)
    return CommandAnswer({"trial": str(output), **asdict(found)}, (
        f"{output}: {found.messages} messages from {found.chunks} chunks; {found.damaged} chunks damaged, "
        f"{found.bytes_skipped} bytes left out."))


@app.command(example="bowden report trial.mcap -o report.html")
def report(trial: options.Trial, output: options.Page, path: options.ForcePath = None) -> CommandAnswer:
    """Write a trial as one offline HTML page.

    Figures, plots that zoom together, timing, bus load and events; of several force paths all, or one with --path.
    """
    with terminal.waiting(f"reading {trial}"):
        recorded = force_paths.opened(trial, path, whole=True)
    size = figures.write_trial_page(recorded, output, overwrite=True, progress=terminal.TERMINAL)
    return CommandAnswer({"report": str(output), "bytes": size}, f"{output}: {terminal.size(size)}.")


Source = Annotated[Path, argument(
    "FILE", "csv, tsv, xlsx, tdms, parquet, mat, mf4; candump log, asc, blf, trc, db; mcap.")]
A = Annotated[Path, argument("A", "A recorded trial.")]
B = Annotated[Path | None, argument("B", "Another trial.")]
History = Annotated[Path | None, option("In place of B: the bench's own history.", "DIR", "--logbook")]
Map = Annotated[Path | None, option("map.toml: names, units, offsets of columns.", "FILE", "--map")]
Sheet = Annotated[str | None, option("Sheet of a workbook (default: the first with a table).", "NAME")]
Guess = Annotated[bool, option("Write a commented map to -o, guessed from the table, to check.")]
Mat73 = Annotated[bool, option("With .mat: MATLAB v7.3, which is HDF5, in place of v5.")]
Controllers = Annotated[bool, option("A is the table of a sweep: rank its controllers.")]
Picture = Annotated[Path | None, new_file("With --controllers: PNG, SVG or PDF.", *options.PICTURE, name="--picture")]
Everything = Annotated[bool, option("Every value and signal that differs, in tables.", None, "--all")]
Page = Annotated[Path | None, new_file("Both trials in one HTML page.", *options.PAGE, name="--report")]


@app.command("import", example="bowden import candump.log -o trial.mcap")
def import_(
    source: Source, output: options.Output, columns: Map = None, guess: Guess = False, sheet: Sheet = None,
    config: options.Config = None,
) -> CommandAnswer:
    """Make a trial of a table or a CAN log.

    Foreign MCAP files, too; every change is counted. The format of a table (encoding, delimiter, decimal sign, units,
    kind of time) is detected and printed.
    """
    if guess:
        if columns is not None:
            raise InputError("--guess writes a map and --map reads one; leave one of them out.")
        return _guess(source, output, sheet or "")
    output_files.refuse_ending(output, ".mcap", what="a trial")
    mapped = None if columns is None else csv_table.read_map(columns)
    if sheet:
        mapped = mapped or csv_table.Map()
        mapped.dialect = csv_file.Dialect(sheet=sheet)
    with terminal.progress(f"importing {source}") as update:
        bench = wire(configuration.read(config, any_shape=True)["network"])
        report = imports.import_file(source, output, mapped=mapped, wire=bench, overwrite=True, progress=update)
    table = columns is None and bool(report.left_out) and "rows" in report.counts
    return CommandAnswer({"trial": str(output), **report.as_json()}, [
        f"{source}: read with {', '.join(report.read_as)}." if report.read_as else "", f"Trial: {output}",
        *(f"  {name.replace('_', ' ')}: {count}" for name, count in report.counts.items() if count),
        *(f"  left out: {name}" for name in report.left_out),
        *(f"  {place}" for place in report.damage),
        *(f"Check {signal}: it {question}" for signal, question in report.questions.items()),
        f"To use what was left out: bowden import {source} --guess -o map.toml." if table else ""])


def _guess(source: Path, output: Path, sheet_name: str) -> CommandAnswer:
    output_files.refuse_ending(output, ".toml", what="a map")
    sheet = imports.table_of(source, sheet_name)
    write_whole(output, csv_table.text(sheet, str(output)), overwrite=True)
    found = csv_table.guesses(sheet)
    others = csv_table.unassigned(sheet, found)
    columns = [one.column for one in others if one.column in sheet]
    return CommandAnswer({"map": str(output), "read_as": sheet.remarks, "signals": {
        one.signal: {"column": one.column, "unit": one.unit, "scale": one.scale, "question": one.question}
        for one in found}, "not_assigned": {one.column: one.why for one in others}}, [
        f"{source}: read with {', '.join(sheet.remarks)}." if sheet.remarks else "",
        AnswerTable(f"Map: {output}; check it, it is a guess", ("signal", "column", "unit", "scale"), [
            (one.signal, one.column, one.unit, one.scale) for one in found], "g"),
        *(f"Check {one.signal}: {one.column!r} {one.question}" for one in found if one.question),
        "" if "time_s" in {one.signal for one in found} else
        f"No column looks like time, which a trial needs: add [time_s] and its column to {output}; "
        "a column that counts rows will do, with the seconds of a row as its scale.",
        "Not assigned:" if others else "", *(f"  {one.column!r}: {one.why}" for one in others),
        f"To use one of them, add to {output}: [SIGNAL], column = {columns[0]!r} and unit; signals without a column "
        "are listed there." if columns else ""])


@app.command(example="bowden export trial.mcap -o trial.csv")
def export(trial: options.Trial, output: options.Output, mat73: Mat73 = False) -> CommandAnswer:
    """Write a trial as a table or a CAN log.

    csv, csv.gz, xlsx, tdms, parquet, mf4 and mat hold its cycles; log, asc, blf and trc its frames.
    """
    with terminal.progress(f"exporting {trial}") as update:
        rows = exported(read.open_file(trial), output, mat73=mat73, overwrite=True, progress=update)
    return CommandAnswer({"file": str(output), "rows": rows}, f"{output}: {rows} rows.")


@app.command(example="bowden compare a.mcap b.mcap --report compared.html")
def compare(
    a: A, b: B = None, logbook: History = None, report: Page = None, everything: Everything = False,
    controllers: Controllers = False, picture: Picture = None,
) -> CommandAnswer:
    """Compare two trials: their four figures, and the differences in five lines.

    Exit status 1 if any channel differs.  With --controllers: a sweep's controllers, the best first.  With --logbook:
    the bench's constants in A against their scatter between sessions; exit status 1 if fewer than 1 in 1,000 healthy
    sessions depart as far.
    """
    if picture is not None and not controllers:
        raise InputError("--picture shows ranked controllers; give --controllers and the table of a sweep.")
    if controllers:
        return _rank_controllers(a, b or logbook or report, picture)
    if (b is None) == (logbook is None):
        raise NothingGivenError("A B | A --logbook DIR", "compare: expected a second trial or --logbook; give one.")
    if b is None:
        return _against_history(a, logbook, report)
    with terminal.waiting("comparing"):
        one, other = read.open(a), read.open(b)
        found = comparing.compare(one, other)
        if report is not None:
            compare_page.write(one, other, found, report, overwrite=True)
    return CommandAnswer(found.as_json(), chain(
        _figures(one, other), _words_of_everything(found) if everything else compare_page.sentences(found),
        [f"Page: {report}" if report else ""]), 0 if found.same else 1)


def _figures(*trials: read.Trial) -> Words:
    judged = [compare_page.judged(trial) for trial in trials]
    rows = [(f"{text} ({unit})", *(values.get(name) for values in judged))
            for name, unit, text in trial_page.FIGURES if any(values.get(name) is not None for values in judged)]
    if rows:
        yield AnswerTable("figures", ("figure", "A", "B"), rows)


def _rank_controllers(table: Path, other: Path | None, picture: Path | None) -> CommandAnswer:
    """Return the controllers of a sweep, the best first; status 1 where trials of one did not complete."""
    if other is not None:
        raise InputError(f"--controllers ranks those of one table; leave {other} out.")
    rows = summary.ranked_rows(table)
    found = summary.ranked(rows)
    if picture is not None:
        summary.draw_ranking(rows, picture)
    return CommandAnswer({"table": str(table), "controllers": [one._asdict() for one in found]}, [
        AnswerTable("controllers, by the median of END's error over their trials", (
            "controller", "completed", "error (%)", "least … worst", "idle (N)", "jump (N)"), [
            (one.controller, f"{one.completed} of {one.trials}", one.error_percent,
             f"{terminal.number(one.least)} … {terminal.number(one.worst)}", one.idle_n, one.jump_n) for one in found]),
        *(f"{one.controller}: {count} not completed: {reason}"
          for one in found for reason, count in one.stopped.items()),
        f"Picture: {picture}" if picture else ""],
        1 if any(one.completed < one.trials for one in found) else 0)


RARE = 1e-3
"""Share of sessions without a change that depart as far as one that is marked: one session in a thousand."""


def _against_history(trial: Path, logbook: Path | None, report: Path | None) -> CommandAnswer:
    """Compare one trial with its bench's history; status 1 if the trial departs from the history."""
    assert logbook is not None
    if report is not None:
        raise InputError("--report shows two trials; leave it out with --logbook, or say bowden logbook report.")
    with terminal.waiting("fitting"):
        found = logbook_entries.against_history(logbook, trial)
    rows = sorted(found["constants"].items(), key=lambda row: -abs(row[1]["scatters"]))
    return CommandAnswer(found, [
        AnswerTable(f"{trial} against {found['sessions']} sessions, farthest first", (
            "constant", "departure", "over 1σ of sessions"), [
            (name, f"{row['departure']:.3g}" + (" (ln)" if row["form"] == "log" else f" {row['unit']}"),
             row["scatters"]) for name, row in rows[:10]]),
        f"Probability that a healthy session departs as far: {found['probability']:.2g}."],
        1 if found["probability"] < RARE else 0)


def _words_of_everything(found: comparing.TrialComparison) -> Words:
    if found.same:
        yield "The same, in every channel."
    attached = [(f"{name}: {row.key}", row) for name, rows in found.attachments.items() for row in rows]
    rows = [(row.key, row) for row in (*found.metadata, *found.result)] + attached
    if rows:
        yield AnswerTable("figures and what differs", ("key", "A", "B"), [
            (key, *("–" if value is None else str(words.plain(row.key, value)) for value in (row.a, row.b)))
            for key, row in rows])
    if found.signals:
        yield AnswerTable(f"signals, A − B, matched {found.matched}", ("signal", "unit", "RMS", "mean", "largest"), [
            (row.name, row.unit, row.rms, row.mean, row.largest) for row in found.signals], ".3g")
