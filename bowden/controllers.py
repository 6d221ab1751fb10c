"""Types and base class for a controller plug-in; docs/controllers.md explains them with one that runs."""

from estimation.transfer.homing_fit import HomingFit
from master.control.controller import Column, Conditions, Controller, ControllerInput, ControllerOutput, Trace
from master.control.gait_table import GaitTable
from master.settings import Impedance
from parameters import parameter
from physics.calibration import Calibration

__all__ = [
    "Calibration", "Column", "Conditions", "Controller", "ControllerInput", "ControllerOutput", "GaitTable",
    "HomingFit", "Impedance", "Trace", "parameter",
]
