"""The force loop's margin, and what is done where the control rate leaves too little."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from eds.bench.bench_network import Network
from master.control.stability import GAIN_MARGIN, crossing_rad_s, derated, gain_margin
from master.settings import Impedance
from physics.calibration import nominal

if TYPE_CHECKING:
    from conftest import Composer


def test_the_crossing_is_where_the_phase_is_180_degrees() -> None:
    omega = crossing_rad_s(7.5e-3, 2.5e-3)
    assert 90.0 + math.degrees(omega * 2.5e-3 + math.atan(omega * 7.5e-3)) == pytest.approx(180.0, abs=1e-6)


def test_at_a_kilohertz_the_papers_impedance_is_left_alone() -> None:
    assert derated(nominal(), Impedance(), 1e-3, 60.0) == (Impedance(), None)


def test_at_a_hundred_hertz_it_is_slowed_and_said() -> None:
    """Two samples of delay make the paper's loop unstable at 100 Hz and 60 N: its margin is below one."""
    assert gain_margin(nominal(), Impedance(), 1e-2, 60.0) < 1.0
    slower, sentence = derated(nominal(), Impedance(), 1e-2, 60.0)
    assert gain_margin(nominal(), slower, 1e-2, 60.0) >= GAIN_MARGIN
    assert slower.stiffness_n_m == Impedance().stiffness_n_m
    assert sentence is not None
    assert "B is raised from 100" in sentence


@pytest.mark.parametrize(("controller", "percent"), [("paper", 6.0), ("extended", 1.0)])
def test_sixty_newton_at_a_hundred_hertz_runs(composer: Composer, controller: str, percent: float) -> None:
    """Undamped it gives 8.8 %; the extended controller has the force from its model and hardly needs the loop."""
    ran = composer.run(peak_n=60.0, period_s=2.0, cycles=2, controller=controller, serial=0, rate_hz=100,
                       experiment={"network": Network(rate_hz=100)})
    assert ran.result.outcome == "completed"
    assert ran.result.warning is not None
    assert ran.said("warning") == [ran.result.warning]
    found = ran.figures(60.0, 2, rate_hz=100)["true_relative_rmse_percent"]
    assert found is not None
    assert found < percent
