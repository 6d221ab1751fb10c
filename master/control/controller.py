"""Interface of a controller: configured for a gait and stepped once a control cycle.

No controller is named here. The packaged ones are in `control.packaged`; others come by the entry-point group
bowden.controllers or as "module:Class". Around any of them effects beyond the calibration can be compensated
(`control.effect_correction`), or the targets of a recorded trial repeated.
"""

from __future__ import annotations

import dataclasses
import re
import typing
from abc import abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Final, NamedTuple, Protocol, TypeVar, cast

from estimation.transfer.homing_fit import HomingFit
from master.control.controller_io import Column, ControllerInput, ControllerOutput, Trace
from master.control.effect_correction import Correction
from master.control.gait_table import GaitTable
from master.settings import Impedance
from parameters import InputError, from_table
from parameters.plugins import load
from physics.calibration import Calibration
from trial.signals import UNITS, Signal

GROUP: Final = "bowden.controllers"
_HOME: Final = "master.control.packaged"
PACKAGED: Final[Mapping[str, str]] = MappingProxyType({
    "none": f"{_HOME}:Uncompensated", "friction": f"{_HOME}:FrictionCompensation", "impedance": f"{_HOME}:ImpedanceLaw",
    "paper": f"{_HOME}:PaperController", "extended": f"{_HOME}:ExtendedController",
})
"""The controllers of this project by name."""
CONTROLLERS: Final = tuple(PACKAGED)
WALKING: Final = (
    Column("stride_percent", "%", "true phase of the stride that is played; unknown in a stumble or rest"),
    Column("phase_doubt_percent", "%", "standard deviation of the felt phase, gait_percent; 29 where there is none"),
    Column("phase_share", "1", "share of the desired force that is asked for; below 0 the rope is paid out instead"),
    Column("true_phase_force_n", "N", "desired force at the true phase; 0 where there is none"),
    Column("followed_zero_m", "m", "shift of the rope's zero since homing that the controller follows"),
)
"""Columns of a trial whose strides differ, or whose phase is felt."""
_NAME: Final = re.compile("[a-z][a-z0-9_]*")

__all__ = ["CONTROLLERS", "Column", "Conditions", "Controller", "ControllerInput", "ControllerOutput", "Trace", "find",
           "with_effects"]

State = TypeVar("State")


class Conditions(NamedTuple):
    """Settings of a controller in addition to the model and the gait.

    `homing`: the homing fit of this session; the default before homing.  `own`: the controller's own `parameters`.
    `migration`: shift of the rope's zero that may be followed from one gait cycle to the next, and in a trial, m.
    """

    impedance: Impedance
    homing: HomingFit = HomingFit()
    own: Any = None
    migration: tuple[float, float] = (0.0, 0.0)


class Controller(Protocol[State]):
    """Controller configured for one gait on one bench. Constants are in the object, memory is in `State`, an argument
    and a result of `step`.

    A class that inherits this writes `step` and `initial`, and a constructor that takes the arguments of `configure`.

    `slack_share`: share of the configured idle slack while no force is desired. `follows_knee`: it asks for the force
    that `GaitTable.wanted` has at the knee's angle. `uses_homing_fit`: it takes friction,
    stretch and START's offset from `Conditions.homing`, else from the model. `columns`: further columns in the trial.
    `ahead`: control cycles after the step at which a target acts, as the controller assumes. `parameters`: a frozen
    dataclass that declares the controller's own parameters with `parameters.parameter`; its values are
    `Conditions.own`.
    """

    slack_share: ClassVar[float] = 1.0
    follows_knee: ClassVar[bool] = False
    uses_homing_fit: ClassVar[bool] = False
    columns: ClassVar[tuple[Column, ...]] = ()
    parameters: ClassVar[type[Any] | None] = None
    ahead: int = 0

    @classmethod
    def configure(cls, model: Calibration, gait: GaitTable, conditions: Conditions) -> Controller[State]:
        """Return the controller for one gait on one bench: called before the first control cycle, and after homing."""
        made: Controller[State] = cast(Any, cls)(model, gait, conditions)
        return made

    @abstractmethod
    def initial(self) -> State:
        """Return the controller's memory before the first control cycle."""

    @abstractmethod
    def step(self, seen: ControllerInput, state: State) -> tuple[ControllerOutput, State, Trace]:
        """Return one control cycle's targets, the memory after it, and its trace.

        Pure: equal arguments give equal answers, so that a trial can be replayed onto it bit for bit.  It has less
        than the compute budget of a control cycle.
        """


Kind = type[Controller[Any]]


def find(name: str, *, where: str) -> Kind:
    """Return the controller of that name, or at "module:Class"; raises `InputError`, beginning with `where`."""
    try:
        kind = load("controller", name, GROUP, PACKAGED)
        _check(name, kind)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return cast(Kind, kind)


def _check(name: str, kind: Any) -> None:
    lacks = [part for part in ("configure", "initial", "step", "slack_share", "uses_homing_fit", "columns", "ahead")
             if not hasattr(kind, part)]
    if lacks or getattr(kind.step, "__isabstractmethod__", False):
        raise InputError(f"controller {name!r} lacks {', '.join(lacks) or 'step'}; inherit "
                         "bowden.controllers.Controller and write initial and step.")
    taken = set(UNITS)
    for column in kind.columns:
        if not _NAME.fullmatch(column.name) or column.name in taken:
            why = "taken" if column.name in taken else "no name of a column"
            raise InputError(f"controller {name!r}: {column.name!r} is {why}; give small letters, digits and _, unlike "
                             "any signal of /cycle.")
        taken.add(column.name)


def own_parameters(kind: Kind, tuning: str, *, where: str) -> Any:
    """Return a controller's own parameters with the values of `tuning` ("kp=40, ki=2"), checked; None without any.

    Raises `InputError`, beginning with `where`, for a name that the controller does not declare and for values beyond
    the declared bounds.
    """
    declared = getattr(kind, "parameters", None)
    assigned = [_assigned(part, where) for part in tuning.split(",") if part.strip()]
    given = dict(assigned)
    if len(given) < len(assigned):
        raise InputError(f"{where}: {tuning} gives a parameter two values; keep one.")
    if declared is None:
        if given:
            raise InputError(f"{where}: this controller declares no parameters, so {', '.join(given)} cannot be set; "
                             "see docs/controllers.md.")
        return None
    if not (isinstance(declared, type) and dataclasses.is_dataclass(declared)):
        raise InputError(f"{where}: its parameters are no dataclass; write @dataclass(frozen=True) above that class.")
    hints = typing.get_type_hints(declared)
    return from_table(declared, {name: _typed(hints.get(name), text) for name, text in given.items()}, where=where)


def _assigned(part: str, where: str) -> tuple[str, str]:
    name, equals, value = part.partition("=")
    if not equals or not _NAME.fullmatch(name.strip()) or not value.strip():
        raise InputError(f"{where}: {part.strip()!r} is no NAME=VALUE; write for instance kp=40.")
    return name.strip(), value.strip()


def _typed(kind: Any, text: str) -> Any:
    """Return a value in its declared type; the text if it is of another."""
    try:
        if kind is int:
            return int(float(text)) if float(text).is_integer() else float(text)
        return float(text) if kind is float else {"true": True, "false": False}[text] if kind is bool else text
    except (ValueError, OverflowError, KeyError):
        return text


def signals(kind: Kind, walking: bool = False) -> tuple[Signal, ...]:
    """Return a controller's own columns as signals of `/cycle`, which follow the signals of every trial.

    `walking`: the strides differ or their phase is felt, so that `WALKING` come last.
    """
    columns = (*kind.columns, *(WALKING if walking else ()))
    return tuple(Signal(column.name, column.unit, column.text, derived=True) for column in columns)


class WithEffects(Controller[State]):
    """A controller extended by the compensation of further effects."""

    def __init__(self, within: Controller[State], correction: Correction, start_offset_n: float) -> None:
        self._within, self._correction, self._start_offset_n = within, correction, start_offset_n
        self.ahead = within.ahead

    def initial(self) -> State:
        """Return the memory of the controller within."""
        return self._within.initial()

    def step(self, seen: ControllerInput, state: State) -> tuple[ControllerOutput, State, Trace]:
        """Step the inner controller on its inputs without the effects, and put the effects into its targets."""
        undone = self._correction
        outputs, state, trace = self._within.step(undone.seen(seen, self._start_offset_n), state)
        return undone.feed_forward(outputs, seen.table_index(len(undone.rope_m), self.ahead)), state, trace


def with_effects(
    kind: Kind, model: Calibration, gait: GaitTable, conditions: Conditions, undone: Correction | None
) -> Controller[Any]:
    """Configure a controller; `undone`: effects outside the model's scalars, tabulated for this gait."""
    within = kind.configure(model, gait, conditions)
    if undone is None:
        return within
    offset_n = conditions.homing.start_offset_n if kind.uses_homing_fit else model.start_offset
    return WithEffects(within, undone, offset_n)


class RecordedTargets(NamedTuple):
    """Targets of a recorded trial, one a control cycle from its run-in on: rope position, m, and knee angle, rad."""

    rope_m: tuple[float, ...]
    knee_rad: tuple[float, ...]


class Repeated(Controller[State]):
    """A controller whose targets are those of a recorded trial, whatever has changed since; its trace stays its own.

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
