"""Labels in words for the keys of a trial's metadata and result, and which keys an engineer reads first.

`bowden info` and the report's summary show `shown`; digests, commits, bit rates and the homing fit are in `folded`.
"""

import json
import re
from collections.abc import Mapping

from trial.report.words import quantity

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
    "left_out": "left out", "read_as": "read with",
}
"""Label of each key that is shown; other keys are folded."""
UNITS: Mapping[str, str] = {"peak_n": "N", "period_s": "s", "rate_hz": "Hz", "duration_s": "s",
                             "friction_half_width_m": "m"}
"""SI unit of each key that is a quantity; it is shown with a prefixed unit and three significant digits."""
ALWAYS_FOLDED = frozenset({"commit", "course", "bitrate", "signal", "day", "dry_run"})


def label(key: str) -> str:
    """Return the label of a key; the key with spaces if it has none."""
    return LABELS.get(key, key.replace("_", " "))


def shown(facts: Mapping[str, object]) -> dict[str, object]:
    """Return the entries to show at once, by label: documented keys with a value, and keys of foreign files."""
    return {label(key): _plain(value, UNITS.get(key)) for key, value in facts.items()
            if key not in ALWAYS_FOLDED and value not in (None, "", [], {}, "[]", "{}", "null")}


def _plain(value: object, unit: str | None) -> object:
    """Return a text that the file holds as JSON without its quotes; a quantity in `unit`, a long fraction rounded."""
    if isinstance(value, str) and value[:1] == value[-1:] == '"' and len(value) > 1:
        return json.loads(value)
    number = re.fullmatch(r"-?\d+(\.\d+)?(e-?\d+)?", str(value))
    if number and unit is not None:
        return quantity(float(str(value)), unit)
    if number and re.search(r"\.\d{4,}|e-", str(value)):
        return quantity(float(str(value)))
    return value


def folded(facts: Mapping[str, object]) -> dict[str, object]:
    """Return the rest by key: digests, the commit, settings that are seldom asked for."""
    return {key: value for key, value in facts.items() if key in ALWAYS_FOLDED and value not in (None, "")}
