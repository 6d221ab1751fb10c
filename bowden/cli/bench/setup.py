"""`bowden init` and `bowden check`: a first configuration, and its faults before anything runs."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.command import CommandGroup
from bowden.cli.terminal import CommandAnswer
from parameters import declarations
from parameters.files import write_whole

check = CommandGroup(help="Find faults before anything runs.", rich_markup_mode=None)
app.add_typer(check, name="check")

Files = Annotated[list[Path], typer.Argument(metavar="FILE…", help="EDS or DCF files.", show_default=False)]
ConfigFile = Annotated[Path, typer.Argument(metavar="FILE", help="bench.toml.", show_default=False)]


@app.command()
def init(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")] = Path("bench.toml"),
    shape: Annotated[str, typer.Option(
        metavar="NAME", help="Packaged declaration: bench, bench_start_only (no END load cell), bench_no_knee_drive, "
        "bench_antagonists (two ropes on a joint), bench_two_legs.",
    )] = "bench",
    overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Write a commented bench.toml.

    With every default, unit, range and source.  On a terminal it asks for specimen, rope, operator and notes, which
    every trial with that file then carries, and for the logbook that trials are entered in.

    Example: bowden init -o bench.toml
    """
    from bowden.bench import configuration

    output_files.refuse([output], overwrite=overwrite)
    output_files.refuse_ending(output, ".toml", what="a configuration")
    configuration.as_template(shape=shape)
    told = _asked(configuration.declaration("record")) if sys.stdin.isatty() else {}
    write_whole(output, configuration.as_template(told, shape), overwrite=True)
    return CommandAnswer({"configuration": str(output)}, f"Configuration: {output}")


def _asked(record: type[Any]) -> dict[str, str]:
    """Ask the operator for each field; Enter alone keeps a field empty."""
    return {name: typer.prompt(f"{name} ({told.text})", default="", show_default=False).strip()
            for name, _, told in declarations(record)}


@check.command("config")
def check_config(file: ConfigFile) -> CommandAnswer:
    """Check a bench.toml: deadlines of its network, limits, and who holds each safety function.

    Example: bowden init -o bench.toml && bowden check config bench.toml
    """
    from bowden.bench import configuration, safety_table
    from eds.bench.bench_network import lacks, wire
    from eds.bench.bus_load import LOAD_GOAL_PERCENT, rate_that_fits, refuse
    from master.limit_holders import COLUMNS, unheld
    from master.own_limits import by_path

    sections = configuration.read(file, any_shape=True)
    network, limits = sections["network"], sections["limits"]
    refused = network.bench.refusal()
    missing = lacks(network)
    if missing:
        return CommandAnswer({"lacks": missing}, missing, 1)
    above, of_paths = limits.above_packaged(), by_path(limits, network.bench)
    built, held = wire(network), safety_table.table(sections)
    nobody = unheld(held)
    found = refuse(built)
    fits = rate_that_fits(built)
    reason = f"reason: {limits.raised}." if limits.raised else "commands ask for --raise-limits REASON."

    def words() -> None:
        for text in above:
            print(f"{file}: {text}: above what is packaged; {reason}")
        terminal.table(
            f"{file}: load {found.load_percent:.2f} % (goal {LOAD_GOAL_PERCENT:g} %), last input at "
            f"{found.inputs_ns / 1e3:.0f} µs, due at {found.deadline_ns / 1e3:.0f} µs",
            ("stream", "COB-ID", "bits", "period (µs)", "worst response (µs)"), [
                (stream.name, f"{stream.can_id:03X}h", str(stream.bits()), f"{stream.period_ns / 1e3:.0f}",
                 terminal.number(None if response is None else response / 1e3, 0))
                for stream, response in found.responses])
        terminal.table(f"{file}: limits of each force path", ("limit", *of_paths), [
            (f"{name} ({unit})" if unit else name, *(f"{getattr(found, name):g}" for found in of_paths.values()))
            for name, unit in _numbers(limits)])
        terminal.table(f"{file}: safety functions", COLUMNS, [row.cells for row in held])
        for text in nobody:
            print(f"{file}: nobody holds {text}; {reason}")
        if fits != network.rate_hz:
            print(f"{file}: rate_hz = {network.rate_hz} is beyond the goal; " + (
                f"{fits} Hz would fit." if fits else "no rate would fit."))
        if refused is not None:
            print(f"{file}: no command runs this bench: {refused}. The wire is planned all the same.")

    runs = refused is None and (limits.raised or not (above or nobody))
    return CommandAnswer({
        "refusal": refused, "limits_above_packaged": above, "limits_raised": limits.raised,
        "limits": {path: {name: getattr(found, name) for name, _ in _numbers(found)}
                   for path, found in of_paths.items()},
        "safety_functions": safety_table.as_objects(held), "held_by_nobody": nobody,
        "load_percent": found.load_percent, "goal_percent": LOAD_GOAL_PERCENT, "rate_that_fits_hz": fits,
        "inputs_ns": found.inputs_ns, "deadline_ns": found.deadline_ns, "streams": [
            {"name": stream.name, "cob_id": stream.can_id, "bits": stream.bits(), "period_ns": stream.period_ns,
             "response_ns": response} for stream, response in found.responses]},
        words, 0 if runs and found.load_percent <= LOAD_GOAL_PERCENT else 1)


def _numbers(section: Any) -> list[tuple[str, str]]:
    """Return name and unit of each number of a section."""
    return [(name, told.unit) for name, default, told in declarations(type(section)) if not isinstance(default, str)]


@check.command("eds")
def check_eds(files: Files) -> CommandAnswer:
    """List the faults of EDS or DCF files, with the place and the remedy.

    Example: bowden check eds my_drive.eds
    """
    from eds.files.check import findings

    found = [finding for file in files for finding in findings(file)]
    return CommandAnswer(
        {"files": [str(file) for file in files], "findings": [asdict(finding) for finding in found]},
        [*map(str, found), f"{len(found)} findings in {len(files)} file{'s' if len(files) > 1 else ''}."],
        1 if found else 0)
