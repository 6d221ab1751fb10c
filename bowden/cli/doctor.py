"""`bowden doctor`: what stands between this computer and a trial, with what to type."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, grouped

if TYPE_CHECKING:
    from eds.bench_network import Network
    from master.network.doctor import DoctorFinding

Seconds = Annotated[float, typer.Option("--for", metavar="S", min=0.1, help="How long the timer is watched.")]


@app.command()
@grouped
def doctor(
    reached: Bus,
    seconds: Seconds = 5.0,
    config: options.Config = None,
    json: options.Json = False,
) -> int:
    """Look at the bench; say what to type.

    At interface, computer, bus and nodes: each finding has its remedy.

    Example: bowden doctor --interface socketcan --channel can0
    """
    network = reached.sections(config)["network"]
    with terminal.waiting("looking", shown=not json):
        found = list(_look(network, reached, seconds))
    bad = [finding for finding in found if not finding.good]
    if json:
        terminal.emit({"findings": [_object(finding) for finding in found], "faults": len(bad)})
    else:
        for finding in found:
            print(f"{'ok ' if finding.good else 'BAD'} {finding.what}: {finding.seen}")
            if not finding.good:
                print(f"      {finding.remedy}")
        print(f"{len(bad)} faults.")
    return 1 if bad else 0


def _look(network: Network, reached: Bus, seconds: float) -> Iterator[DoctorFinding]:
    from bowden import buses
    from eds.bench_network import wire
    from master.network import doctor as computer
    from master.network.bus_survey import bus as heard
    from master.network.link import Link, LinkError

    chosen = reached.chosen()
    yield from computer.computer()
    yield computer.jitter(seconds)
    if reached.interface == buses.KERNEL:
        found = list(computer.interface(reached.channel or "can0", network.bitrate))
        yield from found
        if not all(finding.good for finding in found if finding.what == "interface"):
            return
    needed = buses.missing_library(reached.interface or "")
    if needed is not None:
        yield computer.DoctorFinding(
            "interface", False, f"{reached.interface} needs {needed[0]}, which is not installed", f"say {needed[1]}")
        return
    more = buses.simulating(network) if chosen.simulated else {}
    with buses.opened_one(chosen, network.bitrate, **more) as opened:
        try:
            yield from heard(Link(opened, buses.clock_of(opened), heartbeat_ms=None), wire(network))
        except LinkError as error:
            yield computer.DoctorFinding("bus", False, str(error), "mend the interface first")


def _object(finding: DoctorFinding) -> dict[str, Any]:
    return {"what": finding.what, "good": finding.good, "seen": finding.seen,
            "remedy": None if finding.good else finding.remedy}
