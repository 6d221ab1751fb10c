"""`bowden init`, `check`, `doctor`, `home`, `tare`, `jog`, `release`, `acknowledge`: a bench before a trial."""

from __future__ import annotations

import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from bowden.bench import buses, configuration
from bowden.cli import ending, options, terminal
from bowden.cli.app import CommandGroup, app
from bowden.cli.options import Bus, SimulatedOptions, argument, new_file, option
from bowden.cli.terminal import AnswerTable, CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError, declarations
from parameters.files import write_whole

with on_first_use():
    from bowden.bench import examination
    from bowden.trials import session, setup_checks
    from eds.bench import bench_network, bus_load
    from eds.files.check import findings
    from master import limit_holders, own_limits, settings
    from master.motion import commission
    from master.network import acknowledge as acknowledging
    from master.network import bringup, host_computer, link
    from master.node_access import node_scan
    from physics import calibration as calibrations
    from physics import setup_check

check = CommandGroup(help="Find faults before anything runs.")
app.add_typer(check, name="check")


@app.command(example="bowden init -o bench.toml")
def init(
    output: Annotated[Path, new_file("File to write.", "a configuration", ".toml")] = Path("bench.toml"),
    shape: Annotated[str, option(
        "Packaged declaration: bench, bench_start_only (no END load cell), bench_no_knee_drive, bench_antagonists (two "
        "ropes on a joint), bench_two_legs.", "NAME")] = "bench",
) -> CommandAnswer:
    """Write a commented bench.toml.

    With every default, unit, range and source.  On a terminal it asks for specimen, rope, operator and notes, which
    every trial with that file then carries, and for the logbook that trials are entered in.
    """
    configuration.as_template(shape=shape)
    told = _asked(configuration.declaration("record")) if sys.stdin.isatty() else {}
    write_whole(output, configuration.as_template(told, shape), overwrite=True)
    return CommandAnswer({"configuration": str(output)}, f"Configuration: {output}")


def _asked(record: type[Any]) -> dict[str, str]:
    """Ask the operator for each field; Enter alone keeps a field empty."""
    return {name: typer.prompt(f"{name} ({told.text})", default="", show_default=False).strip()
            for name, _, told in declarations(record)}


@check.command("config", example="bowden init -o bench.toml && bowden check config bench.toml")
def check_config(file: Annotated[Path, argument("FILE", "bench.toml.")]) -> CommandAnswer:
    """Check a bench.toml: deadlines of its network, limits, and who holds each safety function."""
    sections = configuration.read(file, any_shape=True)
    network, limits = sections["network"], sections["limits"]
    refused = network.bench.refusal()
    missing = bench_network.lacks(network)
    if missing:
        return CommandAnswer({"lacks": missing}, missing, 1)
    above, of_paths = limits.above_packaged(), own_limits.by_path(limits, network.bench)
    built, held = bench_network.wire(network), configuration.held_limits(sections)
    nobody = limit_holders.unheld(held)
    found = bus_load.refuse(built)
    fits = bus_load.rate_that_fits(built)
    reason = f"reason: {limits.raised}." if limits.raised else "commands ask for --raise-limits REASON."
    runs = refused is None and (limits.raised or not (above or nobody))
    return CommandAnswer({
        "refusal": refused, "limits_above_packaged": above, "limits_raised": limits.raised,
        "limits": {path: _fields(found, *(name for name, _ in _numbers(found))) for path, found in of_paths.items()},
        "safety_functions": configuration.held_as_objects(held), "held_by_nobody": nobody,
        "load_percent": found.load_percent, "goal_percent": bus_load.LOAD_GOAL_PERCENT, "rate_that_fits_hz": fits,
        "inputs_ns": found.inputs_ns, "deadline_ns": found.deadline_ns, "streams": [
            {"name": stream.name, "cob_id": stream.can_id, "bits": stream.bits(), "period_ns": stream.period_ns,
             "response_ns": response} for stream, response in found.responses]}, [
        *(f"{file}: {text}: above what is packaged; {reason}" for text in above),
        AnswerTable(
            f"{file}: load {found.load_percent:.2f} % (goal {bus_load.LOAD_GOAL_PERCENT:g} %), last input at "
            f"{found.inputs_ns / 1e3:.0f} µs, due at {found.deadline_ns / 1e3:.0f} µs",
            ("stream", "COB-ID", "bits", "period (µs)", "worst response (µs)"), [
                (stream.name, f"{stream.can_id:03X}h", stream.bits(), stream.period_ns / 1e3,
                 None if response is None else response / 1e3) for stream, response in found.responses], ".0f"),
        AnswerTable(f"{file}: limits of each force path", ("limit", *of_paths), [
            (f"{name} ({unit})" if unit else name, *(getattr(found, name) for found in of_paths.values()))
            for name, unit in _numbers(limits)], "g"),
        AnswerTable(f"{file}: safety functions", limit_holders.COLUMNS, [row.cells for row in held]),
        *(f"{file}: nobody holds {text}; {reason}" for text in nobody),
        f"{file}: rate_hz = {network.rate_hz} is beyond the goal; "
        f"{f'{fits} Hz would fit.' if fits else 'no rate would fit.'}" if fits != network.rate_hz else "",
        f"{file}: no command runs this bench: {refused}. The wire is planned all the same." if refused else ""],
        0 if runs and found.load_percent <= bus_load.LOAD_GOAL_PERCENT else 1)


def _fields(found: Any, *names: str) -> dict[str, Any]:
    return {name: getattr(found, name) for name in names}


def _numbers(section: Any) -> list[tuple[str, str]]:
    """Return name and unit of each number of a section."""
    return [(name, told.unit) for name, default, told in declarations(type(section)) if not isinstance(default, str)]


@check.command("eds", example="bowden check eds my_drive.eds")
def check_eds(files: Annotated[list[Path], argument("FILE…", "EDS or DCF files.")]) -> CommandAnswer:
    """List the faults of EDS or DCF files, with the place and the remedy."""
    found = [finding for file in files for finding in findings(file)]
    return CommandAnswer(
        {"files": [str(file) for file in files], "findings": [asdict(finding) for finding in found]},
        [*map(str, found), f"{len(found)} findings in {len(files)} file{'s' if len(files) > 1 else ''}."],
        1 if found else 0)


Weight = Annotated[float | None, option("Known weight on this load cell, N; at least 10.", "N")]


@check.command("bench",
    example="bowden check bench --calibration calibration.toml --start 20 --end 20 --knee 0 --knee -60")
def check_bench(
    calibration: Annotated[Path, option("Calibration to enter the checks in.", "FILE")],
    start: Weight = None, end: Weight = None,
    knee: Annotated[list[float] | None, option(
        "Knee angle by a goniometer, degrees (flexion < 0); twice, at least 40 apart.", "DEG")] = None,
    path: options.ForcePath = None, *, simulated: SimulatedOptions, reached: Bus,
) -> CommandAnswer:
    """Compare load cells with a known weight and the knee with a goniometer.

    No drive is enabled. On hardware it asks for each weight and angle in turn; on the simulated bench a hand supplies
    them. A trial with a limb declared ([record] limb) needs these checks, no older than a day.
    """
    asked = [(of, weight, "N") for of, weight in (("start", start), ("end", end)) if weight is not None]
    for of, weight, _ in asked:
        if not setup_check.LEAST_N <= weight <= 300.0:
            raise InputError(f"--{of} {weight:g}: expected a weight from {setup_check.LEAST_N:g} to 300 N; give "
                             "another one.")
    asked += [("knee", math.radians(angle), "rad") for angle in knee or ()]
    if not asked:
        raise InputError("check bench: no weight and no angle is given; name some of --start, --end and --knee.")
    setup_check.read(calibration)
    sections, chosen = reached.sections(), reached.chosen(simulated)
    made: list[setup_check.SetupCheck] = []
    for of, reference, unit in asked:
        if not chosen.simulated and sys.stdin.isatty():
            typer.prompt(f"{setup_checks.asked(of, reference, unit)}, then Enter", default="", show_default=False,
                         err=True)
        with terminal.waiting(f"reading {of}"):
            made.append(setup_checks.compared(of, reference, unit, chosen, sections, path))
    setup_checks.enter(calibration, made)
    return CommandAnswer(
        {"calibration": str(calibration), "checks": [_fields(
            one, "of", "reference", "reading", "deviation", "tolerance", "unit", "passed", "date") for one in made]},
        [*(f"{'ok ' if one.passed else 'BAD'} {one.in_words()}" for one in made), f"Entered in {calibration}."],
        0 if all(one.passed for one in made) else 1)


@app.command(example="bowden doctor --interface socketcan --channel can0")
def doctor(
    reached: Bus,
    seconds: Annotated[float, option("Duration of the timer check.", "S", "--for", min=0.1)] = 5.0,
    compiles: Annotated[bool, option(
        "Compile the laws and end: the warm-up of a container image.", None, "--compile")] = False,
    soak: Annotated[float | None, option(
        "Instead, measure wake-ups and SDO round trips for so many minutes.", "MINUTES", min=0.0)] = None,
    output: Annotated[Path | None, new_file("With --soak: the report, Markdown.")] = None,
) -> CommandAnswer:
    """Check the bench; name the commands to type.

    Of interface, computer, bus and nodes: each finding has its remedy.
    """
    if compiles:
        session.compile_laws(simulated=True, progress=terminal.TERMINAL)
        return CommandAnswer({"compiled": True}, "The laws are compiled.")
    if soak is not None:
        return _soak(reached, soak, output)
    if output is not None:
        raise InputError(f"-o {output}: is the report of a soak; add --soak MINUTES.")
    sections = reached.sections()
    held = configuration.held_limits(sections)
    with terminal.waiting("looking"):
        found = list(examination.examine(sections["network"], reached.chosen(), seconds))
    faults = sum(not finding.good for finding in found)
    return CommandAnswer({"findings": [
        _fields(finding, "what", "good", "seen") | {"remedy": None if finding.good else finding.remedy}
        for finding in found], "faults": faults,
        "safety_functions": configuration.held_as_objects(held)}, [
        *(f"ok  {finding.what}: {finding.seen}" if finding.good else
          f"BAD {finding.what}: {finding.seen}\n      {finding.remedy}" for finding in found),
        AnswerTable("safety functions", limit_holders.COLUMNS, [row.cells for row in held]), f"{faults} faults."],
        1 if faults else 0)


def _soak(reached: Bus, minutes: float, output: Path | None) -> CommandAnswer:
    """Soak the bus and print or write the report; 1 where no node answered or the bus had errors."""
    with reached.linked() as link, ending.interrupted() as ended, host_computer.prepared() as refused:
        nodes = [one.node_id for one in node_scan.scan(link, []) if one.identity is not None]
        figures = examination.soak(link, nodes, minutes, ended)
    text = examination.as_text(figures, f"{reached.interface or 'the virtual bus'} {reached.channel or ''}".strip())
    text += "".join(f"\n{sentence}\n" for sentence in refused)
    if output is not None:
        write_whole(output, text, overwrite=True)
    return CommandAnswer(
        {**asdict(figures), "file": None if output is None else str(output)},
        text if output is None else f"{output}: {len(figures.late_ns)} waits, {len(nodes)} nodes.",
        0 if nodes and not figures.error_frames and not figures.unanswered else 1)


SPEED = 10.0
REMEDY = "free the emergency stop (STO) first, then say this again"


@app.command(example="bowden home --interface socketcan --channel can0")
def home(
    calibration: options.Calibration = None, rate: options.Rate = None, path: options.ForcePath = None,
    homing_n: options.HomingForce = None, *, reached: Bus,
) -> CommandAnswer:
    """Find the encoder zero at the preload.

    The rope is left slack.
    """
    bench = _Bench(reached, rate, path)
    measured = calibrations.nominal() if calibration is None else calibrations.read(calibration)
    homing = configuration.homing(bench.sections["homing"], homing_n)
    return bench.perform("home", commission.home(measured, homing, bench.sections["gait"].idle_slack_m),
                         pulls=commission.home_pulls(homing))


@app.command(example="bowden tare start --interface socketcan --channel can0")
def tare(
    sensor: Annotated[str, argument("SENSOR", "start, end, or a declared load cell.")],
    rate: options.Rate = None, path: options.ForcePath = None, *, reached: Bus,
) -> CommandAnswer:
    """Zero a tension sensor.

    The rope must be slack, and no drive is enabled.
    """
    bench = _Bench(reached, rate, path)
    return bench.perform(f"tare {sensor}", commission.tare(bench.place(sensor)))


@app.command(example="bowden jog servo --by -2 --speed 5 --interface socketcan --channel can0")
def jog(
    axis: Annotated[str, argument("AXIS", "servo or knee, or a declared drive.")],
    by: Annotated[float, option("mm of rope (pulling > 0) or degrees of knee (flexion < 0).", "X")],
    speed: Annotated[float, option("mm/s or degrees/s at most (default 10).", "V", show_default=False)] = SPEED,
    rate: options.Rate = None, path: options.ForcePath = None, *, reached: Bus,
) -> CommandAnswer:
    """Move one axis slowly, alone; the other drive stays off."""
    bench = _Bench(reached, rate, path)
    place = bench.place(axis)
    unit = math.radians(1.0) if place == "knee" else 1e-3
    limits = bench.limits()
    return bench.perform(f"jog {axis}", commission.jog(place, by * unit, speed * unit, limits),
                         pulls=commission.jog_pulls(limits))


@app.command(example="bowden release --interface socketcan --channel can0")
def release(rate: options.Rate = None, path: options.ForcePath = None, *, reached: Bus) -> CommandAnswer:
    """Take the tension off.

    The servo alone unwinds the rope until START is slack.
    """
    bench = _Bench(reached, rate, path)
    return bench.perform("release", commission.release(bench.sections["homing"], bench.limits()))


class _Bench:
    """The bench that the options name: its bus, its configuration and a force path."""

    def __init__(self, reached: Bus, rate: int | None, path: str | None) -> None:
        self.sections = reached.sections(rate)
        self.chosen, self.path = reached.chosen(), path

    def place(self, name: str) -> str:
        """Return the role of a declared device on its force path: servo, knee, start or end; else the name itself.

        If one path alone has the device, that path is chosen.
        """
        places = self.sections["network"].bench.roles(name, self.path)
        if len(places) == 1:
            self.path = places[0][0]
        return places[0][1] if places else name

    def limits(self) -> settings.Limits:
        """Return the limits of the force path; raises `InputError` for a path that is missing or not declared."""
        bench = self.sections["network"].bench
        return own_limits.of_path(self.sections["limits"], bench, setup_checks.named(bench, self.path))

    def perform(self, what: str, procedure: commission.Procedure, *, pulls: str = "") -> CommandAnswer:
        """Run one procedure and return its result; `pulls` is the largest force that it may pull, as a sentence."""
        terminal.notice(pulls)
        with terminal.waiting(what):
            outcome, found = setup_checks.perform(self.chosen, self.sections, procedure, self.path)
        result = {"procedure": what, "outcome": "completed" if outcome.reason is None else "stopped",
                  "stop_reason": outcome.reason, "missed_cycles": outcome.missed_cycles, **found}
        return CommandAnswer(result, [
            *([AnswerTable(what, ("figure", "value"), list(found.items()), ".4f")] if found else []),
            f"{what}, {self.chosen.in_words}: {result['outcome']}"
            + (f": {outcome.reason}" if outcome.reason else "."),
        ], ending.status_of(outcome.reason))


@app.command(example="bowden acknowledge --interface socketcan --channel can0")
def acknowledge(reached: Bus) -> CommandAnswer:
    """Release drives after an emergency stop.

    A drive that had its emergency stop (STO) stays off until an operator releases it; nothing is enabled by this.
    """
    network = reached.network()
    with buses.opened_one(reached.chosen(), network.bitrate) as opened:
        try:
            silent = link.Link(opened, buses.clock_of(opened), heartbeat_ms=None)
            found = acknowledging.acknowledge(silent, bench_network.wire(network))
        except (bringup.BringUpError, link.LinkError) as error:
            raise InputError(str(error)) from None
    active = [one for one in found if one.became == "still active"]
    return CommandAnswer({one.drive: one.became for one in found}, [
        f"{one.drive}: {one.became}" + (f"; {REMEDY}." if one in active else ".") for one in found],
        1 if active else 0)
