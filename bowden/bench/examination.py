"""Checks before a trial: computer, timer, interface, bus and nodes, one finding each.

Checks only read, nothing moves; a finding that is not good names the command to type.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bowden.bench import buses, configuration
from bowden.bench.buses import BusSettings

if TYPE_CHECKING:
    from eds.bench.bench_network import Network
    from master.network.doctor import DoctorFinding

WATCHED_S = 5.0
"""Default duration of the timer check, s."""


def doctor(
    bus: BusSettings | None = None, *, seconds: float = WATCHED_S, config: str | Path | None = None,
) -> list[DoctorFinding]:
    """Return the findings of `bowden doctor` at a bus: item, whether it is good, observation, remedy.

    `bus`: `bowden.simulated(…)`, also the default, or `bowden.bus(…)`; `seconds`: duration of the timer check, s;
    `config`: a bench.toml. Raises `InputError` if the bus cannot be opened.
    """
    sections = configuration.read(None if config is None else Path(config))
    return list(examine(sections["network"], bus or buses.simulated(), seconds))


def examine(network: Network, chosen: BusSettings, seconds: float) -> Iterator[DoctorFinding]:
    """Yield the findings one by one; an interface that is not fit ends them."""
    from eds.bench.bench_network import wire
    from master.network import doctor as computer
    from master.network.doctor import bus as heard
    from master.network.link import Link, LinkError

    interface, channel = str(chosen.arguments["interface"]), chosen.arguments.get("channel")
    yield from computer.computer()
    yield computer.jitter(seconds)
    if interface == buses.KERNEL:
        found = list(computer.interface(channel or "can0", network.bitrate))
        yield from found
        if not all(finding.good for finding in found if finding.what == "interface"):
            return
    needed = buses.missing_library(interface)
    if needed is not None:
        yield computer.DoctorFinding(
            "interface", False, f"{interface} needs {needed[0]}, which is not installed", f"say {needed[1]}")
        return
    more = buses.simulating(network) if chosen.simulated else {}
    with buses.opened_one(chosen, network.bitrate, **more) as opened:
        try:
            yield from heard(Link(opened, buses.clock_of(opened), heartbeat_ms=None), wire(network))
        except LinkError as error:
            yield computer.DoctorFinding("bus", False, str(error), "mend the interface first")
