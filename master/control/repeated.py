"""Targets of a recorded trial in place of a controller's: rope and knee repeat their motion whatever has changed since.

A controller that listens to forces, or that another model feeds, would move the rope otherwise.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

from master.control.controller import Controller
from master.control.controller_io import ControllerInput, ControllerOutput, Trace

State = TypeVar("State")


class RecordedTargets(NamedTuple):
    """Targets of a recorded trial, one a control cycle from its run-in on: rope position, m, and knee angle, rad."""

    rope_m: tuple[float, ...]
    knee_rad: tuple[float, ...]


class Repeated(Controller[State]):
    """A controller whose targets are those of a recorded trial; its trace stays its own.

    `first`: sample of the first recorded targets.
    """

    def __init__(self, within: Controller[State], targets: RecordedTargets, first: int) -> None:
        self._within, self._targets, self._first = within, targets, first
        self.ahead = within.ahead

    def initial(self) -> State:
        """Return the memory of the controller within."""
        return self._within.initial()

    def step(self, seen: ControllerInput, state: State) -> tuple[ControllerOutput, State, Trace]:
        """Return the recorded targets of this sample, and the memory and trace of the controller within."""
        _, state, trace = self._within.step(seen, state)
        i = seen.sample - self._first
        return ControllerOutput(self._targets.rope_m[i], self._targets.knee_rad[i]), state, trace
