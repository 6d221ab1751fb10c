"""`bowden replay --onto controller`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bowden.cli import terminal
from bowden.recorded import experiment

if TYPE_CHECKING:
    from bowden.replay.onto_controller_laws import Comparison
    from trial.read import Trial


def replay(recorded: Trial, *, json: bool) -> int:
    """Step the controller again and say whether it says the same."""
    from bowden.replay import onto_controller_laws

    chosen = experiment(recorded)
    with terminal.progress("controller", shown=not json) as update:
        found = onto_controller_laws.replay(recorded, chosen, update)
    terminal.emit({"trial": str(recorded.path), "onto": "controller", **found.as_json()}) if json else _tell(found)
    return 0 if found.same else 1


def _tell(found: Comparison) -> None:
    print(f"Controller {found.controller}: {found.rows} steps and {found.frames} frames of targets compared.")
    if found.first is None:
        print("The same, bit for bit.")
        return
    first = found.first
    print(f"First difference: row {first.row}, {first.time_s:.3f} s, gait cycle {first.cycle:g} at "
          f"{first.gait_percent:.2f} %: {first.signal} was {first.recorded!r}, now {first.replayed!r}.")
    terminal.table("rows that differ", ("signal", "rows"), [
        (name, str(count)) for name, count in found.differing.items()])
