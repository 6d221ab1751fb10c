"""The paper's Figs. 9 and 10 from the experiments of an identification: stretch over force, rope over knee angle.

The rule of this file: recorded segments in, ink and one sentence out; the fits are `calibration_fit`'s, the paper's
units stand on the axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from estimation.transfer import calibration_fit
from estimation.transfer.calibration_fit import Segment
from physics import laws

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


def draw(segments: Sequence[Segment], title: str, path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) of whichever of the two experiments are among `segments`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    kinds = {segment.kind for segment in segments}
    wanted = [(name, panel) for name, panel in (("stiffness", stiffness), ("swing", swing)) if name in kinds]
    figure = Figure(figsize=(5.6 * max(1, len(wanted)), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    for axes, (_, panel) in zip(figure.subplots(1, max(1, len(wanted)), squeeze=False)[0], wanted, strict=False):
        axes.set_title(panel(axes, segments).split(" (paper")[0], fontsize="medium")
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=120)
