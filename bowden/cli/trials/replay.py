"""`bowden replay`: a recorded trial once more, onto a bus, the controller or the simulated bench."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from bowden.bench import buses
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.options import BusAlone, SimulatedOptions, below, new_file, option, parsed
from bowden.cli.terminal import AnswerTable, CommandAnswer
from bowden.deferred import on_first_use
from bowden.trials import force_paths
from parameters import InputError

with on_first_use():
    from bowden.replay import Comparison, onto_bus, onto_controller, onto_master, onto_plant, player, refuse_imported
    from bowden.trials import recorded as recordings
    from trial.read import Trial, whole

LOST = ("frames were not taken: nodes on the bus send the same COB-IDs, or nobody is on it; "
        "--direction tx leaves out what the recorded nodes sent.")
HELP = "Enter sends the next frame, a number seeks to that second, play plays the rest, pause ends it there."
ONTO = ("bus", "controller", "plant")
SIMULATED = frozenset({"serial", "day", "seed", "plant", "plant_model", "channel", "option"})
FRAMES = frozenset({"speed", "loop", "from", "to", "step", "node", "cob_id", "direction", "map"})
BUS = frozenset({"interface", "channel", "bitrate", "option"})
TAKES = {
    "controller": frozenset({"allow_controller", "path"}), "plant": SIMULATED | {"output", "overwrite"},
    "bus": FRAMES | BUS | SIMULATED,
    "bus --nodes-only": BUS,
}
"""Options by target of the replay; every other option is refused."""


@app.command(example="bowden replay trial.mcap --onto controller")
def replay(
    context: typer.Context, trial: options.Trial,
    onto: Annotated[str, option("bus, controller or plant.", "WHERE", show_default=False)],
    speed: Annotated[float, option("bus: speed, recorded time by playing time.", "X")] = 1.0,
    loop: Annotated[int, option("bus: number of passes.", "N")] = 1,
    from_: Annotated[float, option("bus: begin there, nodes and PDOs restored first.", "S", "--from")] = 0.0,
    to: Annotated[float | None, option("bus: end there.", "S")] = None,
    step: Annotated[bool, option("bus: one frame for each line of standard input.")] = False,
    node: Annotated[list[int] | None, option(
        "bus: frames of this node only, 0 for NMT and SYNC; repeatable.", "NODE")] = None,
    cob_id: Annotated[list[str] | None, option(
        "bus: frames with this COB-ID only, such as 0x181; repeatable.", "ID")] = None,
    direction: Annotated[str | None, option(
        "bus: rx (received by the recorder), tx (sent by it) or both; tx on the simulated bench.", "WAY")] = None,
    map_: Annotated[list[str] | None, option("bus: recorded channel → channel.", "N=CHANNEL", "--map")] = None,
    nodes_only: Annotated[bool, option("bus: the nodes' frames, answering a live master.")] = False,
    allow_controller: Annotated[str | None, option(
        "controller: import this class, which the trial names.", "MODULE:CLASS")] = None,
    path: options.ForcePath = None, *, reached: BusAlone, simulated: SimulatedOptions,
    output: Annotated[Path | None, new_file("plant: residuals, MCAP.", "residuals", ".mcap")] = None,
) -> CommandAnswer:
    """Replay a recorded trial.

    Its frames onto a bus, its inputs onto the controller, or its commands onto the simulated plant.
    """
    if onto not in ONTO:
        raise InputError(f"--onto {onto}: expected one of {', '.join(ONTO)}; choose where the trial is replayed.")
    _refuse_others(context, f"{onto} --nodes-only" if nodes_only else onto)
    given = whole(force_paths.opened(trial, path, whole=onto != "controller"))
    refuse_imported(given, onto)
    if onto == "controller":
        return _controller(given, allow_controller)
    chosen = reached.chosen(simulated, always_simulated=onto == "plant")
    if onto == "plant":
        return _plant(given, chosen, output)
    network = recordings.sections(given)["network"]
    if nodes_only:
        return _nodes(given, chosen, reached.bitrate or network.bitrate)
    channels = onto_bus.channel_map(map_)
    by_default = direction is None and reached.interface is None and not channels
    if by_default:
        direction = onto_bus.own_direction(given)
    identifiers = frozenset(parsed("--cob-id", one, "expected a CAN identifier; write for instance --cob-id 0x181",
                                   lambda text: below(1 << 29, int(text, 0))) for one in cob_id or ())
    selection = player.Selection(frozenset(node or ()), identifiers, direction, frozenset(channels), from_, to)
    with onto_bus.opened(
            given, selection, buses.rated(chosen, reached.bitrate or network.bitrate, network), channels,
            speed=speed, loops=loop) as playing:
        if by_default:
            terminal.notice("Plays what the recorder sent onto the simulated bench, whose nodes send their own frames; "
                            "--direction both plays all.")
        if step:
            _step(playing)
        else:
            with terminal.progress("replay") as update:
                playing.run(update)
        return _played(given, playing.played())


def _controller(recorded: Trial, allowed: str | None) -> CommandAnswer:
    chosen = recordings.experiment(recorded, allowed=allowed)
    with terminal.progress("controller") as update:
        found = onto_controller.replay(recorded, chosen, update)
    lines = [f"Controller {found.controller}: {found.rows} steps and {found.frames} frames of targets compared."]
    if recorded.recovered is not None:
        whole = onto_controller.whole_rows(recorded)
        lines.append(f"Recovered from a torn recording: {whole} control cycles survived whole, up to "
                     f"{float(recorded.columns['time_s'][whole - 1]):.3f} s; the comparison ends there.")
    return _compared(recorded, {"onto": "controller"}, found, lines, (
        "The same, bit for bit.", "row {0.row}, {0.time_s:.3f} s, gait cycle {0.cycle:g} at {0.gait_percent:.2f} %: "
        "{0.signal} was {0.recorded!r}, now {0.replayed!r}."), ("signal", "rows"))


def _compared(recorded: Trial, onto: dict[str, Any], found: Comparison[Any], lines: list[str],
              sentences: tuple[str, str], counted: tuple[str, str]) -> CommandAnswer:
    """Return a comparison in words: `lines`, then that nothing differs, or the first difference and a table of counts.

    `sentences`: if nothing differs, and format of the first difference; `counted`: header of the table.
    """
    differing = [sentences[0]] if found.same else [
        f"First difference: {sentences[1].format(found.first)}",
        AnswerTable(f"{counted[1]} that differ", counted, list(found.differing.items()))]
    return CommandAnswer({"trial": str(recorded.path), **onto, **found.as_json()}, [*lines, *differing],
                         0 if found.same else 1)


def _plant(recorded: Trial, chosen: buses.BusSettings, output: Path | None) -> CommandAnswer:
    found = onto_plant.replay(recorded, chosen, output, overwrite=True, progress=terminal.TERMINAL)
    return CommandAnswer({"trial": str(recorded.path), "onto": "plant", "serial": chosen.serial, **found.as_json()}, [
        f"{len(found.time_ns)} control cycles, recorded − simulated:"
        f" {'the same, bit for bit.' if found.same else 'they differ.'}",
        AnswerTable("residuals", ("signal", "unit", "rows", "RMS", "in the gait", "largest", "at (s)"), [
            (name, row.unit, row.differing + row.one_sided, row.rms, row.gait_rms, row.largest, row.largest_at_s)
            for name, row in found.figures.items()], ".3g"),
        f"Residuals: {output}" if output else ""], 0 if found.same else 1)


def _nodes(recorded: Trial, chosen: buses.BusSettings, bitrate: int) -> CommandAnswer:
    found = onto_master.replay(recorded, chosen, bitrate, progress=terminal.TERMINAL)
    return _compared(recorded, {"onto": "bus", "nodes_only": True}, found, [
        f"{found.frames} frames of the master compared, {found.beyond} after the recording's end; times differ by "
        f"{found.timing_max_us:.1f} µs at most."], (
        "The same, byte for byte.", "{0.cob_id:03X} number {0.number}, {0.time_s:.3f} s from the master's first "
        "frame: was {0.recorded}, now {0.live}."), ("COB-ID", "frames"))


def _step(playing: onto_bus.Playing) -> None:
    """Read one line of standard input at a time."""
    terminal.notice(HELP)
    for line in sys.stdin:
        word = line.strip()
        if word == "pause":
            playing.pause()
            break
        if word == "play":
            playing.run()
        elif word:
            try:
                playing.seek(round(float(word) * 1e9))
            except (ValueError, OverflowError):
                raise InputError(f"{word!r} is no command; {HELP}") from None
        else:
            frame = playing.step()
            if frame is not None and not terminal.quiet():
                print(f"{playing.position_ns / 1e9:12.6f} s  {frame.can_id:03X}  {frame.data.hex(' ')}")
        if playing.ended:
            break


def _played(recorded: Trial, played: onto_bus.PlaybackResult) -> CommandAnswer:
    """Return the figures of a replay; status 1 if the bus refused some frames."""
    result = {"trial": str(recorded.path), "onto": "bus", **played.as_json()}
    if played.lost:
        terminal.notice(LOST)
    return CommandAnswer(result, [
        f"{played.frames} frames in {played.passes} passes, {played.lost} not taken by the bus; "
        f"{played.restored} restored what was before.",
        AnswerTable("lateness", ("figure", "µs"), [
            (name, result[f"lateness_{name}_us"]) for name in ("median", "p99", "max")], ".1f")],
        1 if played.lost else 0)


def _refuse_others(context: typer.Context, onto: str) -> None:
    """Raise `InputError` for an option that was given and means nothing here."""
    if onto not in TAKES:
        raise InputError("--nodes-only belongs to --onto bus; leave it out.")
    for name in context.params:
        option = name.rstrip("_")
        source = context.get_parameter_source(name)
        given = source is not None and source.name == "COMMANDLINE"
        if given and option not in TAKES[onto] | {"trial", "onto", "nodes_only", "json"}:
            raise InputError(f"--{option.replace('_', '-')} means nothing to --onto {onto}; leave it out.")
