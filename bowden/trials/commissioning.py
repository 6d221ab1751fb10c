"""One procedure on a bench between trials, such as homing: bring-up, the procedure inside the cycle, safe end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bowden.bench.buses import BusSettings, opened
from bowden.trials import session
from parameters import InputError

if TYPE_CHECKING:
    from eds.declaration import DeclaredBench, ForcePath
    from master.cycle.run_safely import Outcome
    from master.motion.commission import Procedure


def perform(
    chosen: BusSettings, sections: Mapping[str, Any], procedure: Procedure, path: str | None = None,
) -> tuple[Outcome, dict[str, Any]]:
    """Run a procedure of `master.motion.commission` on a bus; returns how it ended and the figures it found, SI.

    `sections` are those of a configuration; `path` is the force path that it is for, None on a bench of a single one.
    Raises `InputError` for a bus that cannot be opened, and for a path that is missing or not declared.
    """
    from master.cycle.run_safely import run_safely
    from master.network.link import Link

    network = sections["network"]
    place = network.bench.force_paths.index(named(network.bench, path))
    found: dict[str, Any] = {}
    session.compile_laws(simulated=chosen.simulated)
    with opened(chosen, network) as bus, bus.host():
        outcome = run_safely(Link(bus.bus, bus.clock), bus.tap, None, network, sections["limits"],
                             lambda exchange: found.update(procedure(exchange.paths[place])))
    return outcome, found


def named(bench: DeclaredBench, path: str | None) -> ForcePath:
    """Return the force path of a name, or without a name the only one; raises `InputError`."""
    paths = {one.name: one for one in bench.force_paths}
    if path is None and len(paths) == 1:
        return bench.force_paths[0]
    if path not in paths:
        raise InputError(f"--path {path or 'is missing'}: the bench has the force paths {', '.join(paths)}; name one.")
    return paths[path]
