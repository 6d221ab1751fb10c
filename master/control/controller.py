"""Which controller runs: one pure `step`, whatever the name.

The rule of this file: it chooses and decides nothing; `none`, `friction`, `impedance` and `paper` are the paper's
(`control.paper`), `extended` goes beyond (`control.extended`); any of them may be told of effects
(`control.effect_correction`).
"""

from __future__ import annotations

from dataclasses import dataclass

from master.control import extended, paper
from master.control.controller_io import ControllerInput, Outputs, Trace
from master.control.effect_correction import Correction
from master.control.gait_table import GaitTable
from master.control.homing_fit import HomingFit
from master.settings import Impedance
from physics.calibration import Calibration

Uncorrected = paper.Config | extended.Config
State = paper.State | extended.State


@dataclass(frozen=True)
class Corrected:
    """A controller with effects that it knows of undone around it; its targets act `ahead` samples later."""

    within: Uncorrected
    correction: Correction
    ahead: int

    @property
    def gait(self) -> GaitTable:
        """The gait of the controller within."""
        return self.within.gait


Config = Uncorrected | Corrected

__all__ = ["Config", "ControllerInput", "Outputs", "State", "Trace", "configure", "initial", "step"]


def configure(
    name: str, calibration: Calibration, gait: GaitTable, impedance: Impedance, day: HomingFit,
    undone: Correction | None = None,
) -> Config:
    """Fold a controller's constants; `day` is what homing found, and only `extended` uses it.

    `undone`: effects that the calibration's scalars do not say, tabulated for this gait.
    """
    config: Uncorrected
    if name == "extended":
        config = extended.configure(calibration, day, gait, impedance)
        ahead = config.ahead
    else:
        config, ahead = paper.configure(name, calibration, gait, impedance), 0
    return config if undone is None else Corrected(config, undone, ahead)


def initial(config: Config) -> State:
    """The memory that a controller starts with."""
    if isinstance(config, Corrected):
        return initial(config.within)
    return extended.State(config.law) if isinstance(config, extended.Config) else paper.State()


def step(seen: ControllerInput, state: State, config: Config) -> tuple[Outputs, State, Trace]:
    """One control cycle, pure: the same arguments give the same answer; `state` is of `config`'s controller."""
    if type(config) is Corrected:
        undone, within = config.correction, config.within
        outputs, state, trace = step(undone.seen(seen, within.start_offset_n), state, within)
        return undone.feed_forward(outputs, seen.sample + config.ahead), state, trace
    if type(config) is extended.Config:
        return extended.step(seen, state, config)  # type: ignore[arg-type]
    return paper.step(seen, state, config)  # type: ignore[arg-type]
