"""`bowden safety-monitor`: the safety monitor of a real bench, on a computer of its own."""

import time
from pathlib import Path
from typing import Annotated

import typer

from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus
from bowden.cli.terminal import CommandAnswer

Person = Annotated[str, typer.Argument(metavar="FILE", help="Bounds of one person, or packaged.")]
Interface = Annotated[str, typer.Option(metavar="NAME", help="python-can interface of the bench's bus.")]
BoardName = Annotated[str, typer.Option("--board", metavar="MODULE:NAME", help="Sensors and enable output.")]


@app.command(name="safety-monitor")
def safety_monitor(
    person: Person, interface: Interface, board: BoardName, channel: options.Channel = None,
    bitrate: options.Bitrate = None, option: options.Extra = None, config: options.Config = None,
) -> CommandAnswer:
    """Watch a bench with sensors of its own and open the enable line (STO) where a bound is broken.

    It runs until Ctrl-C, which opens the line too. It belongs on a computer of its own, never on the master's.

    Example: bowden safety-monitor person.toml --interface socketcan --channel can0 --board my_board:Board
    """
    from bowden.bench import buses, configuration, monitor_program
    from eds.bench.bench_network import MASTER, MONITOR, wire
    from safety_monitor import MonitorNode, read

    network = configuration.with_monitor(configuration.read(config)["network"], person)
    bounds, made = read(Path(network.monitor)), monitor_program.board(board)
    node = MonitorNode(MONITOR, bounds, MASTER, wire(network).drives, made.sensors, made.line)
    with (ending.interrupted() as ended,
          buses.opened_one(Bus(interface, channel, bitrate, option).chosen(), bitrate or network.bitrate) as bus):
        terminal.remark(f"safety monitor, node {MONITOR}, bounds of {bounds.person}, SHA-256 {bounds.sha256}; "
                        "Ctrl-C opens the line.")
        found = monitor_program.run(bus, node, time.monotonic_ns, ended)
    return CommandAnswer(
        {"sha256": bounds.sha256, "steps": found.steps, "lost": found.lost, "cause": found.cause or None},
        found.cause or "No bound was broken.", int(bool(found.cause)))
