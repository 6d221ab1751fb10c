"""Drawing of a bench as declared, or of a rig by its recorded signals, with the part that changed marked.

A bench is a rope from a servo's drum over START, cable, fabric and knee to END, without the load cells that its
declaration leaves out.  A rig has the parts that its columns measure.  A part whose signal is not recorded is dashed.
"""

from collections.abc import Collection, Sequence
from html import escape
from typing import Final, NamedTuple

from eds.declaration import ForcePath

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
_DRIVE, _DRUM, _START, _CABLE, _FABRIC, _KNEE, _END = BENCH
RIG: Final = (
    _DRIVE._replace(name="drive", measures="force or torque"), _DRUM._replace(name="axis", measures="position"), _START,
    _CABLE._replace(name="transmission", sites=_CABLE.sites | _FABRIC.sites), _KNEE._replace(name="joint"), _END)
ALWAYS: Final = frozenset({"drive", "axis", "transmission"})
"""Parts that every rig has."""


def parts_of(path: ForcePath) -> tuple[DrawnPart, ...]:
    """Return the parts of a declared force path, its load cells and joint under their own names."""
    names = {_START: path.start, _KNEE: path.joint, _END: path.end}
    return tuple(part._replace(name=part.name if part not in names or names[part].upper() == part.name else names[part])
                 for part in BENCH if names.get(part, part.name))


def parts_of_rig(recorded: Collection[str]) -> tuple[DrawnPart, ...]:
    """Return the parts of a rig, which no file declares, by its columns."""
    return tuple(part for part in RIG if part.name in ALWAYS or {*recorded} & {*part.columns})


def svg(parts: Sequence[DrawnPart], recorded: Collection[str], sites: Collection[str]) -> str:
    """Return the drawing of a rig or bench whose columns `recorded` exist, with the parts at `sites` marked."""
    width = (WIDTH - GAP * (len(parts) - 1) - 4) / len(parts)
    height = TOP + BOX_HEIGHT + 46
    title = escape(_title(parts, sites))
    drawn = [f'<svg class="bench" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{title}">',
             f'<path d="M2 {TOP + BOX_HEIGHT / 2}H{WIDTH - 2}" stroke="{INK}" stroke-width="2"/>']
    for place, part in enumerate(parts):
        drawn += _box(part, 2 + place * (width + GAP), width, recorded, changed=bool(part.sites & {*sites}))
    if "bus" in sites:
        drawn.append(f'<text x="{WIDTH / 2}" y="14" text-anchor="middle" fill="{CHANGED}">changed: the bus</text>')
    return "".join([*drawn, "</svg>"])


def _title(parts: Sequence[DrawnPart], sites: Collection[str]) -> str:
    changed = [part.name for part in parts if part.sites & {*sites}]
    return f"{', '.join(part.name for part in parts)}; changed: {', '.join(changed) or 'none'}"


def _box(part: DrawnPart, x: float, width: float, recorded: Collection[str], *, changed: bool) -> list[str]:
    recorded_here = not part.columns or bool({*part.columns} & {*recorded})
    colour, middle = CHANGED if changed else INK if recorded_here else SOFT, x + width / 2
    dash = "" if recorded_here else ' stroke-dasharray="5 4"'
    fill = "#fdecea" if changed else PAPER
    below = "" if not part.measures else part.measures if recorded_here else "not recorded"
    texts = [(TOP + 26, part.name, colour, ' font-weight="600"'), (TOP + 44, below, SOFT, "")]
    texts += [(TOP + BOX_HEIGHT + 20, "changed", CHANGED, ' font-weight="600"')] if changed else []
    return [f"<g><title>{escape(', '.join(part.columns) or part.name)}</title>"
            f'<rect x="{x:.1f}" y="{TOP}" width="{width:.1f}" height="{BOX_HEIGHT}" rx="7" fill="{fill}" '
            f'stroke="{colour}" stroke-width="{3 if changed else 1.5}"{dash}/>',
            *(f'<text x="{middle:.1f}" y="{y}" text-anchor="middle" fill="{ink}"{style}>{escape(text)}</text>'
              for y, text, ink, style in texts if text), "</g>"]
