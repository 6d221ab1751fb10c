"""One procedure on a bench between trials, such as homing: bring-up, the procedure inside the cycle, safe end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bowden.bench.buses import BusSettings, opened
from bowden.trials import session

if TYPE_CHECKING:
    from master.cycle.run_safely import Outcome
    from master.motion.commission import Procedure


def perform(chosen: BusSettings, sections: Mapping[str, Any], procedure: Procedure) -> tuple[Outcome, dict[str, Any]]:
    """Run a procedure of `master.motion.commission` on a bus; returns how it ended and the figures it found, SI.

    `sections` are those of a configuration.  Raises `InputError` for a bus that cannot be opened.
    """
    from master.cycle.run_safely import run_safely
    from master.network.link import Link

    network = sections["network"]
    found: dict[str, Any] = {}
    session.compile_laws(simulated=chosen.simulated)
    with opened(chosen, network) as bus, bus.host():
        outcome = run_safely(Link(bus.bus, bus.clock), bus.tap, None, network, sections["limits"],
                             lambda exchange: found.update(procedure(exchange)))
    return outcome, found
