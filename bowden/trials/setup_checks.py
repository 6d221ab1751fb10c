"""Set-up checks of a bench: which sensors need one, and whether a calibration's file clears the bench for a limb.

`perform` runs one procedure between trials, such as a reading or homing: bring-up, the procedure in the cycle, safe
end.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bowden.bench.buses import BusSettings, handled, opened
from bowden.deferred import on_first_use
from bowden.trials import session
from bowden.trials.force_paths import file_of
from parameters import InputError
from parameters.files import write_whole

with on_first_use():
    from eds.declaration import DeclaredBench, ForcePath
    from master.cycle.run_safely import Outcome, run_safely
    from master.motion.commission import Procedure, reading
    from master.network.link import Link
    from physics import setup_check
    from physics.setup_check import SetupCheck


CELLS, JOINT = ("start", "end"), "knee"
"""Sensors of a force path, by the names of the packaged declaration."""


def refuse_unchecked(
    sections: Mapping[str, Any], calibration: Path | None, now: datetime.datetime | None = None
) -> None:
    """Raise `InputError` for a bench with a limb declared whose calibration has no recent check of each sensor."""
    if "record" not in sections or not (limb := sections["record"].limb):  # a sweep's rows declare no limb
        return
    bench = sections["network"].bench
    remedy = "run bowden check bench on its calibration"
    if calibration is None:
        raise InputError(f"[record] limb = {limb!r}: a trial with a limb needs a checked bench, and no --calibration "
                         f"is given; identify the bench, then {remedy}.")
    several = len(bench.force_paths) > 1
    for path in bench.force_paths:
        file = file_of(calibration, path.name) if several else calibration
        why = setup_check.refusal(setup_check.read(file), _cells(bench, path.name), (JOINT,),
                                  now or datetime.datetime.now())
        if why is not None:
            raise InputError(f"{file}: a trial with a limb ({limb}) needs a checked bench: {why}; {remedy}.")


def _cells(bench: DeclaredBench, path: str) -> list[str]:
    declared = next(one for one in bench.force_paths if one.name == path)
    return [name for name in CELLS if getattr(declared, name)]


def attached(calibration: Path | None) -> dict[str, bytes]:
    """Return the set-up checks in a calibration's file, for attachment to a trial; none without any."""
    found = setup_check.read(calibration) if calibration is not None and calibration.exists() else ()
    return {"setup_check.toml": setup_check.rows(found).encode()} if found else {}


def enter(calibration: Path, new: Sequence[SetupCheck]) -> None:
    """Write checks into a calibration's file, in place of earlier ones of the same sensors."""
    kept = setup_check.merged(setup_check.read(calibration), new)
    text = setup_check.without_rows(calibration.read_text(encoding="utf-8"))
    write_whole(calibration, text + setup_check.rows(kept), overwrite=True)


def perform(
    chosen: BusSettings, sections: Mapping[str, Any], procedure: Procedure, path: str | None = None,
) -> tuple[Outcome, dict[str, Any]]:
    """Run a procedure of `master.motion.commission` on a bus; returns how it ended and the figures it found, SI.

    `sections` are those of a configuration; `path` is the force path that it is for, None on a bench of a single one.
    Raises `InputError` for a bus that cannot be opened, and for a path that is missing or not declared.
    """
    network = sections["network"]
    place = network.bench.force_paths.index(named(network.bench, path))
    found: dict[str, Any] = {}
    session.compile_laws(simulated=chosen.simulated)
    with opened(chosen, network) as bus, bus.host():
        outcome = run_safely(Link(bus.bus, bus.clock), bus.tap, None, network, sections["limits"],
                             lambda exchange: found.update(procedure(exchange.paths[place])))
    return outcome, found


def asked(of: str, reference: float, unit: str) -> str:
    """Return in words what an operator puts on a load cell, N, or turns a joint to, rad."""
    return f"{reference:g} N on {of}" if unit == "N" else f"{of} at {math.degrees(reference):g} degrees"


def compared(of: str, reference: float, unit: str, chosen: BusSettings, sections: Mapping[str, Any], path: str | None
             ) -> SetupCheck:
    """Read a load cell (N) or a joint (rad) that is held at a reference, by a hand on a simulated bench.

    Raises `InputError` if the reading is stopped.
    """
    held = handled(chosen, **{f"{of}_{'n' if unit == 'N' else 'rad'}": reference})
    outcome, found = perform(held, sections, reading(of), path)
    if outcome.reason is not None:
        raise InputError(f"{asked(of, reference, unit)}: the reading was stopped ({outcome.reason}); nothing was "
                         "written.")
    return SetupCheck(of, reference, found["reading"], unit, datetime.datetime.now().isoformat(timespec="minutes"))


def named(bench: DeclaredBench, path: str | None) -> ForcePath:
    """Return the force path called `path`, without a name the only one of the bench; raises `InputError`."""
    paths = {one.name: one for one in bench.force_paths}
    if path is None and len(paths) == 1:
        return bench.force_paths[0]
    if path not in paths:
        raise InputError(f"--path {path or 'is missing'}: the bench has the force paths {', '.join(paths)}; name one.")
    return paths[path]
