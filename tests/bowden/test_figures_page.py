"""docs/figures.md: every figure is there, and what formulas say is said again."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks import redrawn
from bowden.pages import loops_picture
from estimation.transfer.calibration_fit import Segment
from physics import laws

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "figures.md").read_text(encoding="utf-8")


def test_every_figure_of_the_page_is_a_picture_with_its_title() -> None:
    found = re.findall(r"!\[(.+)\]\(fig(\d\d)\.png\)", PAGE)
    assert {number: title for title, number in found} == redrawn.TITLES
    for number in redrawn.TITLES:
        assert (DOCS / f"fig{number}.png").read_bytes().startswith(b"\x89PNG")


def test_the_figures_of_formulas_say_what_the_page_says() -> None:
    for draw in (redrawn.knee, redrawn.desired):
        assert draw(Figure().subplots()) in PAGE


def test_a_scatter_of_the_papers_own_stretch_gives_its_coefficients_and_no_residual() -> None:
    force = np.linspace(20.0, 60.0, 500)
    stretch = laws.stiffness_displacement(force)
    pulls = Segment("stiffness", 1e-3, stretch, stretch, np.zeros(500), force, force)
    said = loops_picture.stiffness(Figure().subplots(), [pulls])
    assert said.startswith("x1 = -0.00170·F² + 0.300·F + 9.70 mm, R² = 1.0000")
    knee = np.radians(np.linspace(-65.0, -5.0, 400))
    taken, held = laws.swing_displacement(knee), np.full(400, 20.0)
    swings = Segment("swing", 1e-3, taken, taken, knee, held, held)
    assert loops_picture.swing(Figure().subplots(), [swings]).startswith(
        "x2 = 0.706·θ + 22.17 mm, R² = 1.0000")


def test_the_figures_of_trials_are_scored_over_the_cycle_that_is_shown() -> None:
    phase = np.tile(np.arange(0.0, 100.0, 0.1), 2)
    wanted = laws.desired_force(phase, 40.0)
    cycle = np.repeat([0.0, 1.0], 1000)
    columns = {"gait_percent": phase, "desired_force_n": wanted, "cycle": cycle,
               "tension_end_n": wanted + np.where(cycle == 1.0, 0.4, 9.0)}
    exact = {**columns, "tension_end_n": wanted}
    assert redrawn.impedance(Figure().subplots(), columns, exact) == (
        "At 40 N the relative RMSE is 1.00 % without impedance and 0.00 % with it, by the END sensor.")
    assert "differ by 0.40 N rms and at most 0.4 N" in redrawn.experiment(Figure().subplots(), columns, exact)
    assert "0.80 % at 50 N" in redrawn.peaks(Figure().subplots(), {50: columns, 60: exact})
