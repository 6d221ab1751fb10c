"""Drawing of a bench or rig by its recorded signals, with the part that changed marked.

A bench is a rope from a servo's drum over START, cable, fabric and knee to END.  A rig has the parts that its columns
measure.  A part whose signal is not recorded is dashed.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from html import escape
from typing import Final, NamedTuple

WIDTH, TOP, BOX_HEIGHT, GAP = 900, 34, 58, 18
INK, SOFT, PAPER, CHANGED = "#1d2430", "#5b6675", "#ffffff", "#b3261e"


class DrawnPart(NamedTuple):
    """One part: name, measured quantity in words, and the columns of which one shows that it is recorded.

    `sites`: sites of the effect catalogue that are this part.  `columns` empty: a part without a signal.
    """

    name: str
    measures: str
    columns: tuple[str, ...]
    sites: frozenset[str]


def _part(name: str, measures: str, columns: str, sites: str) -> DrawnPart:
    return DrawnPart(name, measures, tuple(columns.split()), frozenset(sites.split(", ")))


BENCH: Final = (
    _part("servo drive", "torque", "servo_force_n", "servo drive, supply"),
    _part("drum", "rope", "servo_position_m", "drum"),
    _part("START", "load cell", "tension_start_n", "START sensor, converter"),
    _part("cable", "", "", "cable, cable and fabric"),
    _part("fabric", "", "", "fabric, cable and fabric"),
    _part("knee", "angle", "knee_angle_rad", "knee drive, leg"),
    _part("END", "load cell", "tension_end_n", "END sensor"),
)
RIG: Final = (
    _part("drive", "force or torque", "servo_force_n", "servo drive, supply"),
    _part("axis", "position", "servo_position_m", "drum"),
    _part("START", "load cell", "tension_start_n", "START sensor, converter"),
    _part("transmission", "", "", "cable, fabric, cable and fabric"),
    _part("joint", "angle", "knee_angle_rad", "knee drive, leg"),
    _part("END", "load cell", "tension_end_n", "END sensor"),
)
ALWAYS: Final = frozenset({"drive", "axis", "transmission"})
"""Parts that every rig has."""


def svg(recorded: Collection[str], sites: Collection[str], *, of_rig: bool) -> str:
    """Return the drawing of the rig or bench whose columns `recorded` exist, with the parts at `sites` marked."""
    parts = [part for part in (RIG if of_rig else BENCH)
             if not of_rig or part.name in ALWAYS or {*recorded} & {*part.columns}]
    width = (WIDTH - GAP * (len(parts) - 1) - 4) / len(parts)
    height = TOP + BOX_HEIGHT + 46
    title = escape(_told(parts, sites))
    drawn = [f'<svg class="bench" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{title}">',
             f'<path d="M2 {TOP + BOX_HEIGHT / 2}H{WIDTH - 2}" stroke="{INK}" stroke-width="2"/>']
    for place, part in enumerate(parts):
        drawn += _box(part, 2 + place * (width + GAP), width, recorded, changed=bool(part.sites & {*sites}))
    if "bus" in sites:
        drawn.append(f'<text x="{WIDTH / 2}" y="14" text-anchor="middle" fill="{CHANGED}">changed: the bus</text>')
    return "".join([*drawn, "</svg>"])


def _told(parts: Sequence[DrawnPart], sites: Collection[str]) -> str:
    changed = [part.name for part in parts if part.sites & {*sites}]
    return f"{', '.join(part.name for part in parts)}; changed: {', '.join(changed) or 'none'}"


def _box(part: DrawnPart, x: float, width: float, recorded: Collection[str], *, changed: bool) -> list[str]:
    seen = not part.columns or bool({*part.columns} & {*recorded})
    colour, middle = CHANGED if changed else INK if seen else SOFT, x + width / 2
    dash = "" if seen else ' stroke-dasharray="5 4"'
    fill = "#fdecea" if changed else PAPER
    below = "" if not part.measures else part.measures if seen else "not recorded"
    texts = [(TOP + 26, part.name, colour, ' font-weight="600"'), (TOP + 44, below, SOFT, "")]
    texts += [(TOP + BOX_HEIGHT + 20, "changed", CHANGED, ' font-weight="600"')] if changed else []
    return [f"<g><title>{escape(', '.join(part.columns) or part.name)}</title>"
            f'<rect x="{x:.1f}" y="{TOP}" width="{width:.1f}" height="{BOX_HEIGHT}" rx="7" fill="{fill}" '
            f'stroke="{colour}" stroke-width="{3 if changed else 1.5}"{dash}/>',
            *(f'<text x="{middle:.1f}" y="{y}" text-anchor="middle" fill="{ink}"{style}>{escape(text)}</text>'
              for y, text, ink, style in texts if text), "</g>"]
