"""A loop, such as START over END or force over position, as a picture in the page: lines whose x may rise and fall."""

from collections.abc import Sequence
from html import escape
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
WIDTH, HEIGHT = 720, 380
LEFT, RIGHT, TOP, BOTTOM = 66, 16, 12, 48
INK, SOFT, GRID = "#1d2430", "#5b6675", "#e6eaef"
STEPS: Final = (1.0, 2.0, 2.5, 5.0, 10.0)
"""Distances of axis ticks, by their power of ten."""


class Loop(NamedTuple):
    """One line of the picture: x and y of its points in order, NaN where it is broken."""

    label: str
    x: Floats
    y: Floats
    colour: str
    width: float = 1.6
    dash: bool = False


def picture(loops: Sequence[Loop], x_label: str, y_label: str, title: str) -> str:
    """Return an SVG element with the loops, axes with ticks, and a legend."""
    xs, ys = (np.concatenate([getattr(one, part) for one in loops]) for part in ("x", "y"))
    across, up = _Scale(xs, LEFT, WIDTH - RIGHT), _Scale(ys, HEIGHT - BOTTOM, TOP)
    parts = [f'<svg class="loop" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">']
    for tick in across.ticks():
        at = across(tick)
        parts += [f'<path d="M{at:.1f} {TOP}V{HEIGHT - BOTTOM}" stroke="{GRID}"/>',
                  _label(at, HEIGHT - BOTTOM + 16, _text(tick), "middle")]
    for tick in up.ticks():
        at = up(tick)
        parts += [f'<path d="M{LEFT} {at:.1f}H{WIDTH - RIGHT}" stroke="{GRID}"/>',
                  _label(LEFT - 6, at + 4, _text(tick), "end")]
    parts += [_label((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 10, x_label, "middle"),
              f'<text transform="rotate(-90)" x="{-(TOP + HEIGHT - BOTTOM) / 2:.1f}" y="16" text-anchor="middle" '
              f'fill="{SOFT}">{escape(y_label)}</text>']
    for one in loops:
        dash = ' stroke-dasharray="6 4"' if one.dash else ""
        parts.append(f'<path d="{_path(across(one.x), up(one.y))}" fill="none" stroke="{one.colour}" '
                     f'stroke-width="{one.width}" stroke-linejoin="round"{dash}/>')
    return "".join([*parts, *_legend(loops), "</svg>"])


class _Scale:
    """Linear map of values to a range of pixels, with 5 % of room at both ends."""

    def __init__(self, values: Floats, first: float, last: float) -> None:
        known = values[np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
        room = 0.05 * (high - low) or 0.5
        self.low, self.high, self.first, self.last = low - room, high + room, first, last

    def __call__(self, value: float | Floats) -> float | Floats:
        return self.first + (value - self.low) / (self.high - self.low) * (self.last - self.first)

    def ticks(self) -> list[float]:
        """Return five to eleven round values inside the range."""
        rough = (self.high - self.low) / 7.0
        power = 10.0 ** np.floor(np.log10(rough))
        step = next(power * one for one in STEPS if power * one >= rough)
        return [float(k * step) for k in range(int(np.ceil(self.low / step)), int(self.high / step) + 1)]


def _path(x: float | Floats, y: float | Floats) -> str:
    """Return the path through points; it is interrupted where a point is unknown."""
    text, pen = [], "M"
    for a, b in zip(np.atleast_1d(x).tolist(), np.atleast_1d(y).tolist(), strict=True):
        if not (np.isfinite(a) and np.isfinite(b)):
            pen = "M"
            continue
        text.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    return "".join(text)


def _legend(loops: Sequence[Loop]) -> list[str]:
    parts = []
    for row, one in enumerate(loops):
        y, dash = TOP + 14 + 18 * row, ' stroke-dasharray="6 4"' if one.dash else ""
        parts += [f'<path d="M{LEFT + 10} {y}h26" stroke="{one.colour}" stroke-width="{max(one.width, 2)}"{dash}/>',
                  _label(LEFT + 42, y + 4, one.label, "start", INK)]
    return parts


def _label(x: float | Floats, y: float | Floats, text: str, anchor: str, colour: str = SOFT) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{escape(text)}</text>'


def _text(value: float) -> str:
    return f"{value:.6g}".replace("-", "−")
