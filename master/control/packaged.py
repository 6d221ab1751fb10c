"""The five controllers of this project, as the plug-ins that they are.

The rule of this file: it joins the pure steps of `paper` and `extended` to `Controller` and holds no law.
"""

from typing import ClassVar

from master.control import extended, paper
from master.control.controller import Conditions, Controller
from master.control.controller_io import ControllerInput, ControllerOutput, Trace
from master.control.gait_table import GaitTable
from physics.calibration import Calibration


class _OfThePaper(Controller[paper.PaperState]):
    """A controller of the paper: with or without friction in the feedforward, with or without impedance on the END
    estimate."""

    compensates: ClassVar[bool]
    listens: ClassVar[bool]

    def __init__(self, model: Calibration, gait: GaitTable, conditions: Conditions) -> None:
        self._config = paper.configure(
            model, gait, conditions.impedance, compensates=self.compensates, listens=self.listens)

    def initial(self) -> paper.PaperState:
        """Return the controller's memory before the first cycle: no deviation."""
        return paper.PaperState()

    def step(self, seen: ControllerInput, state: paper.PaperState) -> tuple[ControllerOutput, paper.PaperState, Trace]:
        """Return one control cycle (`paper.step`)."""
        return paper.step(seen, state, self._config)


class Uncompensated(_OfThePaper):
    """Feedforward of stretch and swing only."""

    compensates, listens = False, False


class FrictionCompensation(_OfThePaper):
    """Feedforward of stretch, swing and friction."""

    compensates, listens = True, False


class ImpedanceLaw(_OfThePaper):
    """Impedance law on the estimated END force."""

    compensates, listens = False, True


class PaperController(_OfThePaper):
    """The paper's compensated impedance controller: friction compensation and impedance law."""

    compensates, listens = True, True


class ExtendedController(Controller[extended.ExtendedState]):
    """The controller beyond the paper (`extended`).

    It undoes the drive's lag, so that the rope follows the knee and two thirds of the idle slack are enough.
    """

    slack_share = 2.0 / 3.0
    follows_knee = True
    uses_homing_fit = True

    def __init__(self, model: Calibration, gait: GaitTable, conditions: Conditions) -> None:
        self._config = extended.configure(model, conditions.homing, gait, conditions.impedance, conditions.migration)
        self.ahead = self._config.ahead

    def initial(self) -> extended.ExtendedState:
        """Return the memory before the first gait cycle."""
        return extended.ExtendedState(self._config.law)

    def step(
        self, seen: ControllerInput, state: extended.ExtendedState
    ) -> tuple[ControllerOutput, extended.ExtendedState, Trace]:
        """Return one control cycle (`extended.step`)."""
        return extended.step(seen, state, self._config)
