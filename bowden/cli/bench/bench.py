"""`bowden bench`: the four simulated nodes and the plant, in wall time, on any python-can bus."""

import time
from pathlib import Path
from typing import Annotated

import typer

from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, SimulatedOptions
from bowden.cli.terminal import CommandAnswer

Faults = Annotated[Path | None, typer.Option(
    metavar="FILE", help="Faults of nodes: [[fault]] tables with kind, node, start_s, stop_s.")]


@app.command()
def bench(
    interface: options.AnyInterface, channel: options.Channel = None, rate: options.Rate = None,
    config: options.Config = None, *, simulated: SimulatedOptions, bitrate: options.Bitrate = None,
    option: options.Extra = None, faults: Faults = None, monitor: options.SafetyMonitor = None,
    seconds: options.Seconds = None,
) -> CommandAnswer | int:
    """Serve the simulated bench on a bus.

    The four nodes and the plant run in wall time until Ctrl-C; several masters may listen.

    Example: bowden bench --interface udp_multicast --channel 239.74.163.2 --for 5
    """
    import can

    from bowden.bench import buses, configuration
    from bowden.trials import session
    from master.network.host_computer import prepared
    from virtual_bus.bus import BowdenBus
    from virtual_bus.serve import servable, serve

    chosen = Bus(interface, channel, bitrate, option).chosen()
    arguments = Bus().chosen(simulated).arguments
    injected = () if faults is None else servable(faults)
    network = configuration.with_monitor(configuration.read(config)["network"], monitor)
    session.compile_laws(simulated=True, progress=terminal.Terminal())
    with buses.opened_one(chosen, bitrate or network.bitrate) as real:
        made = {**arguments, **buses.simulating(network), "bitrate": bitrate or network.bitrate,
                "rate_hz": rate or network.rate_hz, "faults": injected}
        made.pop("interface")
        hidden = BowdenBus(**made)
        terminal.remark(f"the bench is on {interface} {channel or ''}; Ctrl-C ends it.")
        over = ending.after(seconds)
        try:
            with prepared(), ending.interrupted() as ended:
                served = serve(real, hidden.bench, time.monotonic_ns, lambda: ended() or over(),
                               echoes=interface == "udp_multicast")
        except can.CanOperationError as error:
            terminal.remark(f"{interface} is gone ({error}); the bench ends.")
            return 1
        finally:
            hidden.shutdown()
    result = {"received": served.received, "sent": served.sent, "lost": served.lost, "behind_ns": served.behind_ns}
    return CommandAnswer(result, ", ".join(f"{name} {value}" for name, value in result.items()),
                         ending.CTRL_C if ended() else 0)
