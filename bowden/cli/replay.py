"""`bowden replay`: a recorded trial once more, onto a bus, the controller or the simulated bench."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bowden.cli import options
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, Simulated, grouped
from parameters import InputError

ONTO = ("bus", "controller", "plant")
SIMULATED = frozenset({"serial", "day", "seed", "plant", "plant_model", "channel", "option"})
FRAMES = frozenset({"speed", "loop", "from", "to", "step", "node", "cob_id", "direction", "map"})
BUS = frozenset({"interface", "channel", "bitrate", "option"})
TAKES = {
    "controller": frozenset[str](), "plant": SIMULATED | {"output", "overwrite"}, "bus": FRAMES | BUS | SIMULATED,
    "bus --nodes-only": BUS,
}
"""Options by what a trial is replayed onto; the others are refused."""
Recorded = Annotated[Path, typer.Argument(metavar="TRIAL", help="A recorded trial.", show_default=False)]
Onto = Annotated[str, typer.Option(help="bus, controller or plant.", show_default=False)]
Speed = Annotated[float, typer.Option(help="bus: recorded by played time.")]
Loop = Annotated[int, typer.Option("--loop", metavar="N", help="bus: play it exactly so often.")]
From = Annotated[float, typer.Option("--from", metavar="S", help="bus: begin there; nodes and PDOs are brought there.")]
To = Annotated[float | None, typer.Option("--to", metavar="S", help="bus: end there.")]
Step = Annotated[bool, typer.Option("--step", help="bus: one frame for each line of standard input.")]
Node = Annotated[list[int] | None, typer.Option(help="bus: frames of this node only, 0 for NMT and SYNC; repeatable.")]
CobId = Annotated[list[str] | None, typer.Option(help="bus: frames with this COB-ID only, such as 0x181; repeatable.")]
Direction = Annotated[str | None, typer.Option(help="bus: rx (what the recorder heard) or tx (what it sent).")]
Map = Annotated[list[str] | None, typer.Option("--map", metavar="N=CHANNEL", help="bus: recorded channel → channel.")]
NodesOnly = Annotated[bool, typer.Option("--nodes-only", help="bus: the nodes' frames, answering a live master.")]
Residuals = Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE", help="plant: residuals, MCAP.")]


@app.command()
@grouped
def replay(
    context: typer.Context,
    trial: Recorded,
    onto: Onto,
    speed: Speed = 1.0,
    loop: Loop = 1,
    from_: From = 0.0,
    to: To = None,
    step: Step = False,
    node: Node = None,
    cob_id: CobId = None,
    direction: Direction = None,
    map_: Map = None,
    nodes_only: NodesOnly = False,
    *,
    reached: Bus,
    simulated: Simulated,
    output: Residuals = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> int:
    """Replay a recorded trial.

    Its frames onto a bus, its inputs onto the controller, or its commands onto the simulated plant.

    Example: bowden replay trial.mcap --onto controller
    """
    from bowden import buses, recorded
    from bowden.replay import onto_bus, onto_controller, onto_master, onto_plant
    from bowden.replay.schedule import Selection
    from trial.read import open as opened

    if onto not in ONTO:
        raise InputError(f"--onto {onto}: expected one of {', '.join(ONTO)}; choose where the trial is replayed.")
    _refuse_others(context, f"{onto} --nodes-only" if nodes_only else onto)
    given = opened(trial)
    if onto == "controller":
        return onto_controller.replay(given, json=json)
    chosen = reached.chosen(simulated)
    if onto == "plant":
        return onto_plant.replay(given, chosen, output, overwrite=overwrite, json=json)
    network = recorded.sections(given)["network"]
    if nodes_only:
        return onto_master.replay(given, chosen, reached.bitrate or network.bitrate, json=json)
    channels = onto_bus.channel_map(map_)
    selection = Selection(
        frozenset(node or ()), frozenset(map(_cob_id, cob_id or ())), direction, frozenset(channels), from_, to)
    return onto_bus.replay(
        given, selection, buses.rated(chosen, reached.bitrate or network.bitrate, network.rate_hz), channels,
        speed=speed, loops=loop, stepped=step, json=json)


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


def _cob_id(text: str) -> int:
    try:
        number = int(text, 0)
    except ValueError:
        number = -1
    if not 0 <= number < 1 << 29:
        raise InputError(f"--cob-id {text}: expected a CAN identifier; write for instance --cob-id 0x181.")
    return number
