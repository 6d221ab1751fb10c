"""The rule against tuning to one plant: no number of its own beside what is identified, all of it in a calibration."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import pytest

from estimation.transfer.calibration_fit import _UNKNOWNS, END_LAG
from estimation.transfer.homing_fit import HomingFit
from master.control import extended
from master.control.gait_table import tabulate
from master.motion import gait
from master.settings import Impedance
from physics import calibration
from physics.calibration import nominal
from physics.reference import paper_reference

if TYPE_CHECKING:
    from conftest import Composer

FITTED = {unknown.name for unknown in _UNKNOWNS} - {END_LAG}
MEASURED = {"swing_p", "servo_bandwidth", "start_noise", "start_offset", "identified_to", "homed_friction",
            "homed_softness"}
PROCEDURE = {"home_preload", "servo_delay"}
"""What the experiment is: the preload that the zero is homed to, and the two SYNC periods of a target."""
GAUGE = {"fabric_wrap"}
"""What only a product holds: see `test_only_the_products_of_wrap_and_friction_move_the_rope`."""


def test_every_scalar_is_identified() -> None:
    assert not set(calibration.scalars()) - FITTED - MEASURED - PROCEDURE - GAUGE


def test_the_controller_knows_nothing_beside_the_calibration_and_the_day() -> None:
    """Two calibrations with equal scalars give equal constants, whatever evidence, label or bench they carry."""
    knee, desired = gait.sampled(paper_reference(40.0, 2.0), 2000)
    table = tabulate(nominal(), knee, desired, 1e-3, 2e-3)
    other = dataclasses.replace(nominal(), label="another", bench="7")
    made = [extended.configure(c, HomingFit(), table, Impedance()) for c in (nominal(), other)]
    assert made[0].law == made[1].law
    assert (made[0].start_lag, made[0].start_gain) == (made[1].start_lag, made[1].start_gain)


def test_start_lag_is_what_the_sensor_declares_where_nobody_measured_it(composer: Composer) -> None:
    """0.5 ms at an interval of 500 µs and no average: half of it for a sample, half for its age."""
    ran = composer.run(cycles=1, controller="extended", serial=0)
    assert ran.result.day is not None
    assert ran.result.day.lag_s + nominal().start_lag == pytest.approx(5e-4)
