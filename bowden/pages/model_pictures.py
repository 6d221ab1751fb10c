"""Pictures of bench models: the paper's Figs. 9 and 10 from the experiments of an identification; discovered terms.

The fits of stretch over force and of rope over knee angle are those of `calibration_fit`, in the paper's units.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimation.transfer import calibration_fit
from estimation.transfer.calibration_fit import Segment
from physics import laws
from trial.report.words import display_unit

if TYPE_CHECKING:
    from diagnosis.laws.law_result import Laws

SIGNALS: Final = {"tension_start_n": "START", "tension_end_n": "END", "servo_force_n": "servo force"}


def draw_law(laws: Laws, path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) with one panel for each term."""
    from matplotlib.figure import Figure

    from diagnosis.report.law_section import AXES

    figure = Figure(figsize=(6.4 * max(1, len(laws.terms)), 4.4), layout="constrained")
    panels = figure.subplots(1, max(1, len(laws.terms)), squeeze=False)[0]
    for axes, term, picture in zip(panels, laws.terms, laws.pictures, strict=False):
        axis, si = AXES[picture.variable]
        unit, factor = display_unit(si)
        axes.plot(factor * picture.at, picture.residual, ".", ms=1.5, color="0.75",
                  label="measured less model without the term")
        at, *lines = picture.means()
        for values, colour, name in zip(lines, ("0.25", "tab:blue"), ("its mean", "the term"), strict=True):
            axes.plot(factor * at, values, color=colour, label=name)
        axes.set(xlabel=f"{axis} ({unit})", ylabel=f"{SIGNALS.get(picture.output, picture.output)} ({picture.unit})")
        axes.set_title(term.equation.split(", size")[0], fontsize="medium", wrap=True)
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=120)


SWING_STEP, PULL_STEP = 20, 5
"""Steps at which points are drawn: fewer points than a page has room for, as many as the eye can separate."""


def stiffness(axes: Any, segments: Sequence[Segment]) -> str:
    """Draw the paper's Fig. 9: pulls and releases, and the parabola (10) through them; return a sentence. N over mm."""
    fitted = calibration_fit.stiffness(segments, 0.0)
    a, b, c = (1e3 * coefficient for coefficient in fitted.coefficients)
    force = np.concatenate([s.start for s in segments if s.kind == "stiffness"])
    position = np.concatenate([s.position for s in segments if s.kind == "stiffness"])
    at = np.linspace(float(force.min()), float(force.max()), 200)
    axes.plot(force[::PULL_STEP], 1e3 * position[::PULL_STEP], ".", ms=1.5, color="0.6", label="pulls and releases")
    axes.plot(at, (a * at + b) * at + c, color="tab:blue", label="fit")
    axes.plot(at, 1e3 * laws.stiffness_displacement(at), "--", color="tab:orange", label="the paper's (10)")
    axes.set(xlabel="START tension (N)", ylabel="rope position (mm)")
    return (f"x1 = {a:.5f}·F² + {b:.3f}·F + {c:.2f} mm, R² = {fitted.r_squared:.4f} "
            "(paper: −0.0017, 0.3, 9.7, R² = 0.9868); "
            "the loop is friction, which a parabola through both sides leaves out.")


def swing(axes: Any, segments: Sequence[Segment]) -> str:
    """Draw the paper's Fig. 10: slow swings at constant START tension, and the line (11) through them; return a
    sentence."""
    fitted = calibration_fit.swing(segments)
    slope, constant = 1e3 * fitted.coefficients[0] * np.pi / 180.0, 1e3 * fitted.coefficients[1]
    degrees = np.degrees(np.concatenate([s.knee for s in segments if s.kind == "swing"]))
    position = np.concatenate([s.position for s in segments if s.kind == "swing"])
    axes.plot(degrees[::SWING_STEP], 1e3 * position[::SWING_STEP], ".", ms=1.5, color="0.6", label="swings at 20 N")
    axes.plot(degrees, slope * degrees + constant, color="tab:blue", label="fit")
    axes.set(xlabel="knee angle (°)", ylabel="rope position (mm)")
    return (f"x2 = {slope:.3f}·θ + {constant:.2f} mm, R² = {fitted.r_squared:.4f} (paper: 0.706, R² = 0.998; the "
            "constant is a matter of the encoder's zero).")


def draw_loops(segments: Sequence[Segment], title: str, path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) of whichever of the two experiments are among `segments`."""
    from matplotlib.figure import Figure

    kinds = {segment.kind for segment in segments}
    wanted = [(name, panel) for name, panel in (("stiffness", stiffness), ("swing", swing)) if name in kinds]
    figure = Figure(figsize=(5.6 * max(1, len(wanted)), 4.2), layout="constrained")
    figure.suptitle(title)
    for axes, (_, panel) in zip(figure.subplots(1, max(1, len(wanted)), squeeze=False)[0], wanted, strict=False):
        axes.set_title(panel(axes, segments).split(" (paper")[0], fontsize="medium")
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=120)
