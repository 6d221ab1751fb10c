"""`bowden bench` and `bowden safety-monitor`: simulated nodes with a plant, or the monitor, on a bus in wall time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from bowden.bench import buses, configuration
from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.options import Bus, SimulatedOptions, option
from bowden.cli.terminal import AnswerTable, CommandAnswer
from bowden.deferred import on_first_use
from parameters.files import write_whole

with on_first_use():
    import can

    from bowden.bench import monitor_bounds as bench_bounds
    from bowden.bench import monitor_program
    from bowden.trials import session
    from eds.bench import bench_network
    from master.network.host_computer import prepared
    from safety_monitor import MonitorNode, read
    from safety_monitor import person as persons
    from virtual_bus.bus import BowdenBus
    from virtual_bus.serve import ServeFigures, servable, serve


@app.command(example="bowden bench --interface udp_multicast --channel 239.74.163.2 --for 5")
def bench(
    interface: options.AnyInterface, channel: options.Channel = None, rate: options.Rate = None,
    config: options.Config = None, *, simulated: SimulatedOptions, bitrate: options.Bitrate = None,
    option: options.Extra = None,
    faults: Annotated[Path | None, option(
        "Faults of nodes: [[fault]] tables with kind, node, start_s, stop_s.", "FILE")] = None,
    monitor: options.SafetyMonitor = None, seconds: options.Seconds = None,
) -> CommandAnswer | int:
    """Serve the simulated bench on a bus.

    The four nodes and the plant run in wall time until Ctrl-C; several masters may listen.
    """
    chosen = Bus(interface, channel, bitrate, option).chosen()
    arguments = Bus().chosen(simulated).arguments
    injected = () if faults is None else servable(faults)
    network = configuration.with_monitor(configuration.read(config)["network"], monitor)
    session.compile_laws(simulated=True, progress=terminal.TERMINAL)
    made = {**arguments, **buses.simulating(network), "bitrate": bitrate or network.bitrate,
            "rate_hz": rate or network.rate_hz, "faults": injected}
    made.pop("interface")
    with buses.opened_one(chosen, made["bitrate"]) as real, BowdenBus(**made) as hidden, prepared():
        return served("the bench", chosen, seconds, partial(serve, real, hidden.bench), asdict)


def served(what: str, chosen: buses.BusSettings, seconds: float | None, run: Callable[..., ServeFigures],
           shown: Callable[[ServeFigures], dict[str, Any]]) -> CommandAnswer | int:
    """Run `run(clock, stop, echoes=)` in wall time until Ctrl-C or for `seconds`; return its `shown` figures.

    Status 1 if the interface is gone.
    """
    over, interface = ending.after(seconds), chosen.arguments["interface"]
    terminal.remark(f"{what} is on {chosen.in_words}; Ctrl-C ends it.")
    try:
        with ending.interrupted() as ended:
            figures = run(time.monotonic_ns, lambda: ended() or over(), echoes=interface == "udp_multicast")
    except can.CanOperationError as error:
        terminal.remark(f"{interface} is gone ({error}); {what} ends.")
        return 1
    result = shown(figures)
    return CommandAnswer(result, ", ".join(f"{name} {value}" for name, value in result.items()),
                         ending.CTRL_C if ended() else 0)


@app.command(name="monitor-bounds", example="bowden monitor-bounds bench.mcap --person person.toml -o P-017.toml")
def monitor_bounds(
    trials: Annotated[list[Path], options.argument("TRIAL…", "Completed trials of the bench without a limb: MCAP.")],
    person: Annotated[Path, option("The person's file.", "FILE")],
    output: Annotated[Path, options.new_file("The person's file to write.", "a person's file", ".toml")],
) -> CommandAnswer:
    """Set the safety monitor's bounds that are the bench's.

    START, the rise of a tension and the speed of the rope become at least 1.25 times the largest values of the trials;
    no bound becomes smaller.  Whoever signed the person's file signs the new one.
    """
    with terminal.waiting("reading the trials"):
        found, text = bench_bounds.of_trials(trials, person)
    write_whole(output, text, overwrite=True)
    margin, ranges = bench_bounds.BENCH_MARGIN, persons.RANGES
    raised = [f"{bound.key} {bound.before:g} to {bound.after:g} {ranges[bound.key][0]}"
              for bound in found if bound.after > bound.before]
    return CommandAnswer({"person": str(output), "bounds": {bound.key: bound._asdict() for bound in found}}, [
        AnswerTable("bounds of the bench", ("bound", "unit", "largest", f"× {margin}", "before", "now"), [
            (bench_bounds.NAMES[bound.key], ranges[bound.key][0], bound.largest, margin * bound.largest, bound.before,
             bound.after) for bound in found], ".3g"),
        f"{output}: " + (f"larger now: {'; '.join(raised)}." if raised else "no bound had to be larger.")])


@app.command(name="safety-monitor",
    example="bowden safety-monitor person.toml --interface socketcan --channel can0 --board my_board:Board")
def safety_monitor(
    person: Annotated[str, typer.Argument(metavar="FILE", help="Bounds of one person, or packaged.")],
    interface: Annotated[str, option("python-can interface of the bench's bus.", "NAME")],
    board: Annotated[str, option("Sensors and enable output.", "MODULE:NAME")],
    channel: options.Channel = None, bitrate: options.Bitrate = None, option: options.Extra = None,
    config: options.Config = None,
) -> CommandAnswer:
    """Run the safety monitor: read its sensors, and open the enable line (STO) when a bound of FILE is exceeded.

    The sensors and the enable output are those of --board, not the bench's. Ctrl-C ends the monitor and opens the line.
    Run it on a separate computer, never on the master's.
    """
    network = configuration.with_monitor(configuration.read(config)["network"], person)
    bounds, made = read(Path(network.monitor)), monitor_program.board(board)
    node = MonitorNode(bench_network.MONITOR, bounds, bench_network.MASTER, bench_network.wire(network).drives,
                       made.sensors, made.line)
    with (ending.interrupted() as ended,
          buses.opened_one(Bus(interface, channel, bitrate, option).chosen(), bitrate or network.bitrate) as bus):
        terminal.remark(f"safety monitor, node {bench_network.MONITOR}, bounds of {bounds.person}, SHA-256 "
                        f"{bounds.sha256}; Ctrl-C opens the line.")
        found = monitor_program.run(bus, node, time.monotonic_ns, ended)
    return CommandAnswer(
        {"sha256": bounds.sha256, "steps": found.steps, "lost": found.lost, "cause": found.cause or None},
        found.cause or "No bound was broken.", int(bool(found.cause)))
