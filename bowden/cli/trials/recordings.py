"""`bowden info`, `report`, `cut`, `merge`, `recover`: recordings listed, shown, cut, joined and mended."""

from __future__ import annotations

import datetime
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.options import argument, new_file, option
from bowden.cli.terminal import AnswerTable, CommandAnswer, Words
from bowden.deferred import on_first_use
from bowden.trials import force_paths
from parameters import InputError

with on_first_use():
    from bowden.pages import figures
    from trial import edit
    from trial.convert.contents import Contents, contents
    from trial.edit import EditSummary
    from trial.recover import recover as recovered
    from trial.report import words

Any_ = Annotated[Path, argument("FILE", "A trial, CAN log, table or MCAP file.")]
Recording = Annotated[Path, argument("FILE", "MCAP.")]
NewRecording = Annotated[Path, new_file("File to write.", *options.RECORDING)]
Several = Annotated[list[Path], argument("FILE…", "MCAP, two or more.")]
From = Annotated[float | None, option("Begin, s after the first control cycle.", "--from", metavar="S")]
To = Annotated[float | None, option("End, s after the first control cycle; excluded.", "--to", metavar="S")]
Torn = Annotated[Path, argument("FILE", "A torn recording.")]
Recovered = Annotated[Path, option("File to write.", "-o", "--output", metavar="FILE")]  # checked by `trial.recover`
Gait = Annotated[str | None, option("Gait cycles A to B in place of times.", metavar="A-B")]


@app.command()
def info(file: Any_) -> CommandAnswer:
    """List the contents of a file of any format.

    Streams with rates and gaps, columns with units and ranges, who recorded it.

    Example: bowden info trial.mcap
    """
    with terminal.waiting(f"reading {file}"):
        found = contents(file)
    return CommandAnswer(found.as_json(), _words(found))


def _words(found: Contents) -> Words:
    when = ""
    if found.begins_ns is not None and found.begins_ns > 10**17:  # an epoch, no trial's clock
        begins = datetime.datetime.fromtimestamp(found.begins_ns // 10**9, datetime.UTC)
        when = f", from {begins:%Y-%m-%d %H:%M:%S} UTC"
    lasts = "" if found.seconds is None else f", {found.seconds:.3f} s"
    yield f"{found.path}: {found.format}{when}{lasts}"
    yield from (f"  {remark}" for remark in found.remarks)
    if found.streams:
        yield AnswerTable("streams", ("stream", "kind", "count", "rate (Hz)", "gaps", "longest gap (s)"), [
            (one.name, one.kind, one.messages, one.rate_hz, one.gaps, terminal.number(one.longest_gap_s, 4))
            for one in found.streams])
    if found.columns:
        yield AnswerTable("columns", ("column", "unit", "least", "greatest", "unknown"), [
            (one.name, one.unit, *("–" if value is None else f"{value:.6g}" for value in (one.least, one.greatest)),
             one.unknown) for one in found.columns])
    yield from (f"  {name}: {value}" for name, value in words.shown(found.about).items())
    yield from (f"  {name.replace('_', ' ')}: {count}" for name, count in found.counts.items() if count)
    if found.attachments:
        yield "  attached: " + ", ".join(f"{name} ({size} bytes)" for name, size in found.attachments.items())
    rest = words.folded(found.about)
    if rest:
        yield f"  not shown: {', '.join(rest)}; --json has them."


@app.command()
def cut(
    file: Recording, output: NewRecording, from_: From = None, to: To = None, gait: Gait = None,
) -> CommandAnswer:
    """Write a part of a recording.

    By time or by gait cycles; what explains it is carried along.

    Example: bowden cut trial.mcap --from 2 --to 6 -o part.mcap
    """
    if from_ is None and to is None and gait is None:
        raise InputError("cut: nothing says what to keep; give --from, --to or --gait.")
    if gait is not None and (from_ is not None or to is not None):
        raise InputError("cut: --gait counts gait cycles, --from and --to seconds; give one kind.")
    with terminal.waiting(f"cutting {file}"):
        found = edit.cut(file, output, from_s=from_ or 0.0, to_s=to, gait=_span(gait), overwrite=True)
    return _written(output, found)


def _span(gait: str | None) -> tuple[int, int] | None:
    if gait is None:
        return None
    first, _, last = gait.partition("-")
    if not (first.isdecimal() and (last or first).isdecimal()) or int(last or first) < int(first):
        raise InputError(f"--gait {gait}: expected a gait cycle or two, such as 3 or 2-5.")
    return int(first), int(last or first)


@app.command()
def merge(files: Several, output: NewRecording) -> CommandAnswer:
    """Write several recordings as one, by time.

    Parts of one recording, or recordings of different topics.

    Example: bowden cut trial.mcap --to 2 -o a.mcap && bowden cut trial.mcap --from 2 -o b.mcap &&
    bowden merge a.mcap b.mcap -o whole.mcap
    """
    with terminal.waiting("merging"):
        found = edit.merge(files, output, overwrite=True)
    return _written(output, found)


def _written(output: Path, found: EditSummary) -> CommandAnswer:
    counts = ", ".join(f"{count} of {topic}" for topic, count in found.messages.items())
    return CommandAnswer({"file": str(output), "messages": found.messages, "seconds": found.seconds},
                         f"{output}: {found.seconds:.3f} s; {counts}.")


@app.command()
def recover(torn: Torn, output: Recovered, overwrite: options.Overwrite = False) -> CommandAnswer:
    """Repair a torn recording.

    Every message that survived is written, indexed again.

    Example: bowden recover torn.mcap -o whole.mcap
    """
    output_files.refuse_ending(output, ".mcap", what="a recording")
    with terminal.progress(f"recovering {torn}") as update:
        found = recovered(torn, output, overwrite=overwrite, progress=update)
    return CommandAnswer({"trial": str(output), **asdict(found)}, (
        f"{output}: {found.messages} messages from {found.chunks} chunks; {found.damaged} chunks damaged, "
        f"{found.bytes_skipped} bytes left out."))


@app.command()
def report(trial: options.Trial, output: options.Page, path: options.ForcePath = None) -> CommandAnswer:
    """Write a trial as one offline HTML page.

    Figures, plots that zoom together, timing, bus load and events; of several force paths all, or one with --path.

    Example: bowden report trial.mcap -o report.html
    """
    with terminal.waiting(f"reading {trial}"):
        recorded = force_paths.opened(trial, path, whole=True)
    size = figures.write_trial_page(recorded, output, overwrite=True, progress=terminal.TERMINAL)
    return CommandAnswer({"report": str(output), "bytes": size}, f"{output}: {terminal.size(size)}.")
