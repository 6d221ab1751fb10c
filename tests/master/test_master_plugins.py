"""Controllers of others: found by name, refused with a sentence, stopped safely, with columns of their own."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bowden
from bowden.controllers import Column, Conditions, Controller, ControllerInput, ControllerOutput, GaitTable, Trace
from master.control import controller
from master.control.packaged import PaperController
from parameters import InputError

HERE = __name__
AT = 250
"""Sample of gait cycle 0 at which the bad ones fail: the rope is taut."""


class Counting(PaperController):
    """The paper's, with a column that counts its steps."""

    columns = (Column("steps", "1", "steps so far"),)

    def step(self, seen: ControllerInput, state: Any) -> Any:
        outputs, after, trace = super().step(seen, state)
        return outputs, after, trace._replace(own=(float(seen.sample),))


class Raises(PaperController):
    def step(self, seen: ControllerInput, state: Any) -> Any:
        if seen.sample == AT:
            raise ZeroDivisionError("float division by zero")
        return super().step(seen, state)


class Exits(PaperController):
    def step(self, seen: ControllerInput, state: Any) -> Any:
        if seen.sample == AT:
            raise SystemExit("enough")
        return super().step(seen, state)


class NotANumber(PaperController):
    wrong: float = math.nan

    def step(self, seen: ControllerInput, state: Any) -> Any:
        outputs, after, trace = super().step(seen, state)
        return (outputs._replace(servo_target_m=self.wrong) if seen.sample == AT else outputs), after, trace


class Infinite(NotANumber):
    wrong = -math.inf


class Untraced(PaperController):
    """It leaves the rope slack, and traces no desired force with which that could be compared."""

    def step(self, seen: ControllerInput, state: Any) -> Any:
        outputs, after, trace = super().step(seen, state)
        slack_m = min(0.02, 1e-4 * max(0, seen.sample))
        return outputs._replace(servo_target_m=outputs.servo_target_m - slack_m), after, trace._replace(
            desired_force_n=math.nan)


class TooManyValues(Counting):
    def step(self, seen: ControllerInput, state: Any) -> Any:
        outputs, after, trace = super().step(seen, state)
        return outputs, after, trace._replace(own=trace.own * (2 if seen.sample == AT else 1))


class Text(Counting):
    def step(self, seen: ControllerInput, state: Any) -> Any:
        outputs, after, trace = super().step(seen, state)
        return outputs, after, trace._replace(own=("many",)) if seen.sample == AT else trace


class RaisesAfterHoming(PaperController):
    def __init__(self, model: Any, gait: GaitTable, conditions: Conditions) -> None:
        super().__init__(model, gait, conditions)
        if conditions.homing != controller.HomingFit():
            raise RuntimeError("a bench unlike\nany other")


class RaisesAtOnce(PaperController):
    def initial(self) -> Any:
        raise RuntimeError("nothing to begin with")


class GivesNothing(PaperController):
    def step(self, seen: ControllerInput, state: Any) -> Any:
        return None


class WithoutStep(Controller[float]):
    def initial(self) -> float:
        return 0.0


class TakenName(PaperController):
    columns = (Column("cycle", "1"),)


class Unfit:
    pass


def run(kind: type[Any], **more: Any) -> bowden.Trial:
    """One gait cycle of a controller on a simulated bench."""
    return bowden.run(bowden.Experiment(controller=kind, period_s=1.0, cycles=1, settle=0, **more))


@pytest.fixture(scope="module")
def counted() -> bowden.Trial:
    """A trial by the controller with a column of its own."""
    return run(Counting)


def test_own_columns_are_in_the_trial_with_unit_and_the_others_are_as_without(counted: bowden.Trial) -> None:
    own, plain = counted, run(PaperController)
    assert own.metadata["controller"] == f"{HERE}:Counting"
    assert own.units["steps"] == "1"
    walked = np.isfinite(own.columns["gait_percent"])
    assert (np.isfinite(own.columns["steps"]) == walked).all()
    assert (np.diff(own.columns["steps"][walked & (own.columns["cycle"] == 0)]) == 1.0).all()
    for name, column in plain.columns.items():
        np.testing.assert_array_equal(column, own.columns[name])


def test_end_is_compared_with_the_gait_tables_force_whatever_a_controller_traces() -> None:
    ran = run(Untraced)
    assert ran.outcome == "stopped"
    assert "desired are" in ran.stop_reason


@pytest.mark.parametrize(("kind", "says"), [
    (Raises, "raised ZeroDivisionError (float division by zero), gait cycle 0 at 25.0 %"),
    pytest.param(Exits, "raised SystemExit (enough), gait cycle 0 at 25.0 %", marks=pytest.mark.exhaustive),
    (NotANumber, "gave a servo target of nan, gait cycle 0 at 25.0 %"),
    pytest.param(Infinite, "gave a servo target of -inf, gait cycle 0 at 25.0 %", marks=pytest.mark.exhaustive),
    (TooManyValues, "gave 2 values for its 1 own columns, gait cycle 0 at 25.0 %"),
    pytest.param(Text, "raised TypeError (", marks=pytest.mark.exhaustive),
    (RaisesAfterHoming, "raised RuntimeError (a bench unlike any other)"),
])
def test_a_controller_that_fails_ends_in_the_safe_stop_that_names_it(kind: type[Any], says: str) -> None:
    trial = run(kind)
    assert trial.outcome == "stopped"
    assert trial.stop_reason is not None
    assert f"controller failed: {HERE}:{kind.__name__} {says}" in trial.stop_reason
    assert abs(trial.columns["tension_start_n"][-1]) < 2.0
    assert np.isfinite(trial.columns["servo_target_m"]).all()


@pytest.mark.parametrize(("kind", "says"), [
    (RaisesAtOnce, "raised RuntimeError (nothing to begin with) when it was tried before the trial"),
    (GivesNothing, "raised TypeError"),
    (WithoutStep, "lacks step"),
    (TakenName, "'cycle' is taken"),
    (Unfit, "lacks configure, initial, step"),
])
def test_a_controller_that_cannot_run_is_refused_before_a_frame_is_sent(kind: type[Any], says: str) -> None:
    with pytest.raises(InputError) as raised:
        run(kind)
    assert says in str(raised.value)
    assert f"{HERE}:{kind.__name__}" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_the_packaged_controllers_are_entry_points() -> None:
    from importlib.metadata import entry_points

    offered = {entry.name: entry.value for entry in entry_points(group=controller.GROUP)}
    assert {name: offered.get(name) for name in controller.PACKAGED} == dict(controller.PACKAGED)
    assert all(controller.find(name, where="test").configure for name in offered)


@pytest.mark.parametrize(("name", "says"), [
    ("fast", "expected one of extended, friction, impedance, none, paper, module:callable"),
    ("no_such_module:Thing", "cannot be imported (ModuleNotFoundError"),
    (f"{HERE}:Missing", "cannot be imported (AttributeError"),
    (f"{HERE}:AT", "is no callable"),
    ("own.py", "names no callable in that file; give own.py:callable"),
])
def test_a_name_that_is_nobodys_is_refused(name: str, says: str) -> None:
    with pytest.raises(InputError, match="--controller: controller") as raised:
        controller.find(name, where="--controller")
    assert says in str(raised.value)


def test_a_file_that_exits_when_imported_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "leaves.py").write_text("import sys\nsys.exit(3)\n")
    with pytest.raises(InputError, match=r"cannot be imported \(SystemExit: 3\); mend"):
        controller.find(f"{tmp_path}/leaves.py:Own", where="--controller")


def test_a_replay_onto_a_controller_of_others_compares_its_own_columns(counted: bowden.Trial) -> None:
    from bowden.replay import onto_controller
    from bowden.trials.recorded import experiment

    trial = counted.recorded
    chosen = experiment(trial, allowed=trial.metadata["controller"])
    assert onto_controller.replay(trial, chosen).same
    before = Counting.step
    try:
        Counting.step = lambda self, seen, state: _later(before(self, seen, state))  # type: ignore[method-assign]
        found = onto_controller.replay(trial, chosen)
    finally:
        Counting.step = before  # type: ignore[method-assign]
    assert set(found.differing) == {"steps"}


def _later(given: tuple[ControllerOutput, Any, Trace]) -> tuple[ControllerOutput, Any, Trace]:
    outputs, state, trace = given
    return outputs, state, trace._replace(own=(trace.own[0] + 1.0,))
