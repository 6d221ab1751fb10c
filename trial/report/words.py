"""Signals in words, and quantities in units that a hand can feel: END (measured) in N, rope in mm, knee in °.

Pages show words; the column's name is in the tooltip. Of a trial's metadata and result, `bowden info` and the report
show what `shown` returns; digests, commits, bit rates and the homing fit are in `folded`.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Final

from trial.report.page import UNKNOWN

WORDS: Final = {
    "time_s": "time", "gait_percent": "gait phase", "cycle": "gait cycle", "servo_target_m": "rope (commanded)",
    "servo_position_m": "rope (measured)", "servo_velocity_m_s": "rope speed (derived)",
    "servo_force_n": "servo force (measured)", "knee_target_rad": "knee (commanded)",
    "knee_angle_rad": "knee (measured)", "tension_start_n": "START (measured)", "tension_end_n": "END (measured)",
    "desired_force_n": "END (desired)", "estimated_end_force_n": "END (estimated)",
    "feedforward_m": "stretch and swing fed forward", "impedance_dx_m": "correction of the impedance law",
    "estimated_end_half_n": "half the 95 % interval of END",
    "friction_ratio": "START by END (friction model)",
    "rope_direction": "rope's direction (friction model)", "strain_direction": "strain's direction (friction model)",
    "sync_jitter_ns": "SYNC against its nominal time", "step_duration_ns": "controller's step",
}
"""Signals in words, by column."""
SPELT: Final = {"start": "START", "end": "END", "pdo": "PDO", "stribeck": "Stribeck", "presliding": "pre-sliding"}
"""Parts of the names of effects, constants and other columns that are not written in small letters or as one word."""
UNITS: Final = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "rad": ("°", 180.0 / math.pi),
                "rad/s": ("°/s", 180.0 / math.pi), "m/N": ("mm/N", 1e3),
               **{f"m/rad{power}": (f"mm/rad{power}", 1e3) for power in ("", "²", "³")},
               "ns": ("µs", 1e-3), "1": ("", 1.0)}
"""Unit shown and factor to it, by SI unit; others are shown as they are."""
SMALLER: Final = {"mm": ("µm", 1e3), "mm/N": ("µm/N", 1e3), "N": ("mN", 1e3), "s": ("ms", 1e3)}
SMALL: Final = 0.1
"""Magnitude below which a quantity is shown in the smaller unit of `SMALLER`."""


def words(name: str) -> str:
    """Return a column, an effect or a constant in words; of one of several paths with the path before it."""
    path, dot, own = name.rpartition(".")
    if own in WORDS:
        text = WORDS[own]
    elif "_pdo_" in own:
        text = f"{own.partition('_pdo_')[0]} inputs"
    else:
        text = " ".join(SPELT.get(part, part) for part in own.removesuffix("_ns").split("_"))
    return f"{path}: {text}" if dot else text


def display_unit(unit: str) -> tuple[str, float]:
    """Return the unit in which a page shows values of an SI unit, and the factor to it."""
    return UNITS.get(unit, (unit, 1.0))


def quantity(value: float | None, unit: str = "") -> str:
    """Return a value in an SI `unit` as text, with a prefixed unit and three significant digits."""
    (text,), shown = quantities((value,), unit)
    return text if text == UNKNOWN else f"{text} {shown}".rstrip()


def quantities(values: Sequence[float | None], unit: str = "") -> tuple[list[str], str]:
    """Return values in an SI `unit` as texts with three significant digits, and the prefixed unit of the largest."""
    shown, factor = display_unit(unit)
    known = [math.nan if value is None else value for value in values]
    if shown in SMALLER and 0.0 < factor * max(filter(math.isfinite, map(abs, known)), default=0.0) < SMALL:
        shown, factor = SMALLER[shown][0], factor * SMALLER[shown][1]
    return [_rounded(factor * value) for value in known], shown


def _rounded(value: float) -> str:
    if not math.isfinite(value):
        return UNKNOWN
    if value == 0.0 or 1e-3 <= abs(value) < 1e6:
        places = max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0
        text = f"{value:.{places}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
    else:
        text = f"{value:.3g}"
    return text.replace("-", "−")


LABELS: Mapping[str, str] = {
    "experiment": "experiment", "controller": "controller", "tuning": "its parameters",
    "controller_model": "effects the controller is told of",
    "calibration": "calibration", "peak_n": "peak force", "period_s": "gait cycle", "cycles": "gait cycles",
    "settle": "first gait cycles not counted", "rate_hz": "control rate", "operator": "operator",
    "specimen": "specimen", "rope": "rope", "notes": "notes", "bus": "bus", "interface": "CAN interface",
    "channel": "CAN channel", "source": "recorded by", "imported_from": "imported from", "outcome": "ended",
    "stop_reason": "why it stopped", "warning": "warning", "missed_cycles": "control cycles with a missed input",
    "stale_inputs": "stale inputs", "duration_s": "time on the bus",
    "friction_half_width_m": "rope travel to reverse friction at homing", "frames": "CAN frames",
    "left_out": "left out", "read_as": "read with", "damage": "damaged places",
}
"""Label of each key that is shown; other keys are folded."""
FACT_UNITS: Mapping[str, str] = {"peak_n": "N", "period_s": "s", "rate_hz": "Hz", "duration_s": "s",
                             "friction_half_width_m": "m"}
"""SI unit of each key that is a quantity; it is shown with a prefixed unit and three significant digits."""
ALWAYS_FOLDED = frozenset({"commit", "course", "bitrate", "signal", "day", "dry_run"})


def label(key: str) -> str:
    """Return the label of a key; the key with spaces if it has none."""
    return LABELS.get(key, key.replace("_", " "))


def shown(facts: Mapping[str, object]) -> dict[str, object]:
    """Return the entries to show at once, by label: documented keys with a value, and keys of foreign files."""
    return {label(key): plain(key, value) for key, value in facts.items()
            if key not in ALWAYS_FOLDED and value not in (None, "", [], {}, "[]", "{}", "null")}


def plain(key: str, value: object) -> object:
    """Return an entry as text: a quantity in its unit, a long fraction rounded, a mapping and a list without brackets.

    A text that the file holds as JSON loses its quotes.
    """
    unit = FACT_UNITS.get(key)
    if isinstance(value, Mapping):
        labels = {"cycles": "control cycles"} if key == "counts" else {}  # of a log, which has no gait
        return "; ".join(f"{labels.get(name) or label(name)} {plain(name, one)}" for name, one in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(str(plain(key, one)) for one in value)
    if isinstance(value, str) and value[:1] == value[-1:] == '"' and len(value) > 1:
        return json.loads(value)
    number = re.fullmatch(r"-?\d+(\.\d+)?(e-?\d+)?", str(value))
    if number and unit is not None:
        return quantity(float(str(value)), unit)
    if number and re.search(r"\.\d{4,}|e-", str(value)):
        return quantity(float(str(value)))
    return value


def folded(facts: Mapping[str, object]) -> dict[str, object]:
    """Return the entries that `shown` leaves out, by key: digests, the commit, and settings that are seldom needed."""
    return {key: value for key, value in facts.items() if key in ALWAYS_FOLDED and value not in (None, "")}
