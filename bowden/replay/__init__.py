"""Replay of a recorded trial onto a bus, the controller or a plant.

    bowden.replay.onto("controller", trial)                        # its inputs, stepped again: bit for bit the same?
    bowden.replay.onto("plant", trial, bus=bowden.simulated(3))    # its commands, to a simulated bench: residuals

`onto` is the public name of this package; its imports wait until the call.  A comparison is bit for bit: it counts
differences by name and keeps the first one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from bowden.bench import buses
from bowden.bench.buses import BusSettings
from bowden.deferred import on_first_use
from bowden.progress import SILENT, Progress
from parameters import InputError

with on_first_use():
    from bowden.replay import onto_controller, onto_plant
    from bowden.replay.onto_controller import ControllerComparison
    from bowden.replay.onto_plant import Residuals
    from bowden.trials import recorded
    from bowden.trials.recorded_trial import Trial
    from eds.bench.bench_network import Network, wire
    from trial.read import Trial as Recorded

__all__ = ["onto"]


def onto(
    target: str, trial: Trial | str | Path, *, bus: BusSettings | None = None, allow: str | None = None,
    progress: Progress = SILENT,
) -> ControllerComparison | Residuals:
    """Replay a trial and return the comparison with its recording (`same`: bit for bit).

    `target`: "controller", the trial's measurements to its controller's steps, or "plant", the master's commands to a
    simulated bench, `bus` (None: the one of serial number 1). `allow`: a controller outside of this package that the
    trial names and that may be imported. Raises `InputError`; replay onto a real bus is `bowden replay`.
    """
    if target not in ("controller", "plant"):
        raise InputError(f"onto {target!r}: expected 'controller' or 'plant'; say bowden replay for a real bus.")
    given = (trial if isinstance(trial, Trial) else Trial(trial)).recorded
    refuse_imported(given, target)
    if target == "plant":
        return onto_plant.replay(given, bus or buses.simulated(), progress=progress)
    experiment = recorded.experiment(given, allowed=allow)
    with progress.running("controller") as update:
        return onto_controller.replay(given, experiment, update)


def refuse_imported(recorded: Recorded, onto: str) -> None:
    """Raise `InputError`, with an alternative, for an imported log or table that cannot be replayed onto `onto`."""
    source = recorded.metadata.get("imported_from")
    if source is None:
        return
    said = f"{recorded.path}: was imported from {source}"
    if not len(recorded.frames):
        raise InputError(f"{said}, a table without CAN frames, so nothing of it can be replayed; bowden diagnose reads "
                         "it, and bowden report shows it.")
    commands = bool((recorded.frames["can_id"] == wire(Network()).targets.cob_id).any())
    others = "--onto bus" + (" or --onto plant" if commands else "")
    if onto == "controller":
        raise InputError(f"{said}, which carries neither the calibration nor the configuration that the controller's "
                         f"steps need; replay it {others}.")
    if onto == "plant" and not commands:
        raise InputError(f"{said}, which holds no targets that a plant could follow; replay it {others}.")


Difference = TypeVar("Difference")


@dataclass(frozen=True, kw_only=True)
class Comparison(Generic[Difference]):
    """`differing`: number of differences by name; `first`: the first difference, None if all agree."""

    differing: Mapping[str, int]
    first: Difference | None

    @property
    def same(self) -> bool:
        """True if every compared value is as recorded, bit for bit."""
        return self.first is None

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as values that JSON can hold."""
        told = asdict(self)
        ends = {name: told.pop(name) for name in ("differing", "first")}
        return {"same": self.same, **told, **ends}
