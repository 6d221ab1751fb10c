"""`bowden acknowledge`: the operator's release of drives after an emergency stop."""

from __future__ import annotations

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, grouped

REMEDY = "free the emergency stop (STO) first, then say this again"


@app.command()
@grouped
def acknowledge(
    reached: Bus,
    config: options.Config = None,
    json: options.Json = False,
) -> int:
    """Release drives after an emergency stop.

    A drive that had its emergency stop (STO) stays off until an operator says so; nothing is enabled by it.

    Example: bowden acknowledge --interface socketcan --channel can0
    """
    from bowden import buses
    from eds.bench_network import wire
    from master.cycle.acknowledge import acknowledge as release
    from master.network.bringup import BringUpError
    from master.network.link import Link, LinkError
    from parameters import InputError

    network = reached.sections(config)["network"]
    with buses.opened_one(reached.chosen(), network.bitrate) as opened:
        try:
            found = release(Link(opened, buses.clock_of(opened), heartbeat_ms=None), wire(network))
        except (BringUpError, LinkError) as error:
            raise InputError(str(error)) from None
    active = [one for one in found if one.became == "still active"]
    if json:
        terminal.emit({one.drive: one.became for one in found})
    else:
        for one in found:
            print(f"{one.drive}: {one.became}" + (f"; {REMEDY}." if one in active else "."))
    return 1 if active else 0

