"""Pictures of bench models: the paper's Figs. 9 and 10 from the experiments of an identification; discovered terms.

The fits of stretch over force and of rope over knee angle are those of `calibration_fit`, in the paper's units.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bowden.deferred import on_first_use
from estimation.transfer import calibration_fit
from estimation.transfer.calibration_fit import Segment
from physics import laws
from trial.report.plot import Plot, Series, picture, save
from trial.report.words import display_unit, words

with on_first_use():
    from diagnosis.laws.law_result import Laws
    from diagnosis.report import law_section

SAMPLES, FIT, PAPER = "#b5bcc6", "#1f6fb2", "#d9730d"


def draw_law(laws: Laws, path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) with one panel for each term: that of the report, with every residual."""
    plots = []
    for term, shown in zip(laws.terms, laws.pictures, strict=False):
        plot, factor = law_section.term_plot(shown), display_unit(law_section.AXES[shown.variable][1])[1]
        residuals = Series("residuals", shown.residual, SAMPLES, width=1.5, points=True, x=factor * shown.at)
        plots.append(plot._replace(title=term.equation.split(", size")[0], series=[residuals, *plot.series],
                                   y_label=f"{words(shown.output)} ({shown.unit})"))
    count = max(1, len(plots))
    save(picture(plots, (6.4 * count, 4.4), columns=count), path)


SWING_STEP, PULL_STEP = 20, 5
"""Steps at which points are drawn: fewer points than a page has room for, as many as the eye can separate."""


def stiffness(segments: Sequence[Segment]) -> Plot:
    """Return the paper's Fig. 9: pulls and releases, and the parabola (10) through them, N over mm."""
    fitted = calibration_fit.stiffness(segments, 0.0)
    a, b, c = (1e3 * coefficient for coefficient in fitted.coefficients)
    force = np.concatenate([s.start for s in segments if s.kind == "stiffness"])
    position = np.concatenate([s.position for s in segments if s.kind == "stiffness"])
    at = np.linspace(float(force.min()), float(force.max()), 200)
    return Plot(f"x1 = {a:.5f}·F² + {b:.3f}·F + {c:.2f} mm, R² = {fitted.r_squared:.4f}", at, [
        Series("pulls and releases", 1e3 * position[::PULL_STEP], SAMPLES, width=1.5, points=True,
               x=force[::PULL_STEP]),
        Series("fit", (a * at + b) * at + c, FIT, width=1.5),
        Series("the paper's (10)", 1e3 * laws.stiffness_displacement(at), PAPER, width=1.5, dash=True)],
        "START tension (N)", "rope position (mm)")


def swing(segments: Sequence[Segment]) -> Plot:
    """Return the paper's Fig. 10: slow swings at constant START tension, and the line (11) through them."""
    fitted = calibration_fit.swing(segments)
    slope, constant = 1e3 * fitted.coefficients[0] * np.pi / 180.0, 1e3 * fitted.coefficients[1]
    degrees = np.degrees(np.concatenate([s.knee for s in segments if s.kind == "swing"]))
    position = np.concatenate([s.position for s in segments if s.kind == "swing"])
    return Plot(f"x2 = {slope:.3f}·θ + {constant:.2f} mm, R² = {fitted.r_squared:.4f}", degrees, [
        Series("swings at 20 N", 1e3 * position[::SWING_STEP], SAMPLES, width=1.5, points=True,
               x=degrees[::SWING_STEP]),
        Series("fit", slope * degrees + constant, FIT, width=1.5)], "knee angle (°)", "rope position (mm)")


def draw_loops(segments: Sequence[Segment], title: str, path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) of whichever of the two experiments are among `segments`."""
    kinds = {segment.kind for segment in segments}
    plots = [panel(segments) for name, panel in (("stiffness", stiffness), ("swing", swing)) if name in kinds]
    figure = picture(plots, (5.6 * max(1, len(plots)), 4.2), columns=max(1, len(plots)))
    figure.suptitle(title)
    save(figure, path)
