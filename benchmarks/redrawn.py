"""Each figure of the paper, drawn on axes that are handed in; each returns the sentence that goes under it.

The rule of this file: columns and formulas in, ink and one sentence out; the paper's units on the axes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from physics import laws
from physics.reference import paper_reference

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]
PERCENT = np.linspace(0.0, 100.0, 1001)
SCORED = 1
"""The gait cycle that is shown."""
TITLES = {
    "05": "Knee angle", "06": "Desired force", "09": "Stretch of rope and fabric, (10)",
    "10": "Rope that the knee takes, (11)", "13": "Without and with impedance",
    "15": "Simulation and experiment", "16": "Peaks of 50 N and 60 N",
}


def drawn(draw: Callable[[Any], str], path: Path) -> str:
    """Draw one figure into a PNG; returns its sentence."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    said = draw(axes)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110, metadata={"Software": None})
    return said


def page(said: Mapping[str, str]) -> str:
    """Return docs/figures.md."""
    head = ["# The paper's figures, redrawn", "`make figures` runs the virtual bench of serial 3 (identified on day 0, "
            "tried on day 1, 2.0 s, controller `paper`) and draws this page."]
    parts = [f"## Fig. {int(number)}: {TITLES[number]}\n\n![{TITLES[number]}](fig{number}.png)\n\n{text}"
             for number, text in said.items()]
    return "\n\n".join(head + parts) + "\n"


def knee(axes: Any) -> str:
    """Fig. 5: formula (1) and the closed reference."""
    reference = paper_reference(40.0, 2.0)
    formula = np.degrees(laws.knee_angle(PERCENT))
    closed = np.degrees([reference.knee_angle(at / 100.0) for at in PERCENT])
    axes.plot(PERCENT, formula, "--", color="0.3", label="formula (1)")
    axes.plot(PERCENT, closed, color="tab:blue", label="closed, as it runs")
    axes.set(xlabel="gait cycle (%)", ylabel="knee angle (°)")
    return (f"Formula (1) begins at {formula[0]:.2f}° and ends at {formula[-1]:.2f}°; the periodic reference departs "
            f"from it by at most {np.degrees(reference.departs_from_eq1_rad):.2f}°, within 10 % of the seam.")


def desired(axes: Any) -> str:
    """Fig. 6: formula (2)."""
    for peak in (40.0, 50.0, 60.0):
        axes.plot(PERCENT, laws.desired_force(PERCENT, peak), label=f"{peak:g} N")
    axes.set(xlabel="gait cycle (%)", ylabel="desired force (N)")
    return "Formula (2): two quarter sines between 10, 20 and 30 % of the gait."


def impedance(axes: Any, without: Columns, law: Columns) -> str:
    """Fig. 13: friction compensated, without and with the impedance law."""
    phase, wanted = cycle(without, "gait_percent"), cycle(without, "desired_force_n")
    axes.plot(phase, wanted, "--", color="0.2", label="desired")
    axes.plot(phase, cycle(without, "tension_end_n"), lw=0.8, color="tab:orange", label="END without impedance")
    axes.plot(phase, cycle(law, "tension_end_n"), lw=0.8, color="tab:blue", label="END with impedance")
    axes.set(xlabel="gait cycle (%)", ylabel="force (N)", xlim=(5, 35))
    return (f"At 40 N the relative RMSE is {relative(without, 40.0):.2f} % without impedance and "
            f"{relative(law, 40.0):.2f} % with it, by the END sensor.")


def experiment(axes: Any, simulated: Columns, tried: Columns) -> str:
    """Fig. 15: the nominal bench as the simulation, another bench on another day as the experiment."""
    axes.plot(cycle(tried, "gait_percent"), cycle(tried, "tension_end_n"), lw=0.8, color="tab:orange",
              label="“experiment”: serial 3, day 1")
    axes.plot(cycle(simulated, "gait_percent"), cycle(simulated, "tension_end_n"), lw=0.8, color="tab:blue",
              label="simulation: nominal")
    axes.set(xlabel="gait cycle (%)", ylabel="END force (N)", xlim=(5, 35))
    apart = cycle(simulated, "tension_end_n") - cycle(tried, "tension_end_n")
    return (f"Two benches under their own calibrations differ by {np.sqrt(np.mean(apart**2)):.2f} N rms and at most "
            f"{np.max(np.abs(apart)):.1f} N: stiffness, friction, breakaway and the zero of the day.")


def peaks(axes: Any, trials: Mapping[int, Columns]) -> str:
    """Fig. 16: the larger peaks."""
    for (peak, columns), colour in zip(trials.items(), ("tab:blue", "tab:orange"), strict=True):
        phase = cycle(columns, "gait_percent")
        axes.plot(phase, cycle(columns, "desired_force_n"), "--", color="0.2", label=f"desired, {peak} N")
        axes.plot(phase, cycle(columns, "tension_end_n"), lw=0.8, color=colour, label=f"END, {peak} N")
    axes.set(xlabel="gait cycle (%)", ylabel="force (N)", xlim=(5, 35))
    found = ", ".join(f"{relative(columns, float(peak)):.2f} % at {peak} N" for peak, columns in trials.items())
    return f"Relative RMSE by the END sensor: {found} (paper: 2.16 % and 2.07 %)."


def cycle(columns: Columns, name: str) -> Floats:
    """Return one column over the gait cycle that is shown."""
    shown: Floats = columns[name][columns["cycle"] == SCORED]
    return shown


def relative(columns: Columns, peak_n: float) -> float:
    """Return the relative RMSE, %, of the gait cycle that is shown."""
    error = cycle(columns, "tension_end_n") - cycle(columns, "desired_force_n")
    return float(100.0 * np.sqrt(np.nanmean(error**2)) / peak_n)
