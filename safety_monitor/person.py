"""The bounds of one person: a TOML file with nine numbers, read whole or refused, and its digest."""

import hashlib
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final


class PersonError(ValueError):
    """A person's file that cannot be used; the text is one sentence with the file, the fault and the remedy."""


RANGES: Final[Mapping[str, tuple[str, float, float]]] = MappingProxyType({
    "start_n": ("N", 1.0, 120.0),
    "end_n": ("N", 1.0, 90.0),
    "force_rate_n_s": ("N/s", 100.0, 20_000.0),
    "rope_m_s": ("m/s", 0.01, 2.0),
    "knee_low_deg": ("degrees", -130.0, 0.0),
    "knee_high_deg": ("degrees", -130.0, 30.0),
    "knee_deg_s": ("degrees/s", 10.0, 900.0),
    "heartbeat_ms": ("ms", 20.0, 5_000.0),
    "trial_s": ("s", 1.0, 36_000.0),
})
"""Unit, least and greatest value of each key. The greatest forces are those at which servo drive and master stop by
themselves. Wider: a slip of the pen goes unnoticed."""
LARGEST_BYTES: Final = 65_536
"""Size of a file above which it is refused unread; a person's file has about 1 kB."""


@dataclass(frozen=True)
class Bounds:
    """Absolute bounds of one person, in the units of the names, and the SHA-256 digest of their file."""

    person: str
    start_n: float
    end_n: float
    force_rate_n_s: float
    rope_m_s: float
    knee_low_deg: float
    knee_high_deg: float
    knee_deg_s: float
    heartbeat_ms: float
    trial_s: float
    sha256: str


def packaged() -> Path:
    """Return the path of the packaged file: a 40 N trial."""
    return Path(__file__).with_name("person.toml")


def read(path: Path) -> Bounds:
    """Return the bounds in a file; raises `PersonError` unless every key is there, once, and within its range."""
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise PersonError(f"{path}: more than {LARGEST_BYTES} bytes; a person's file has ten lines: name another.")
        content = path.read_bytes()
        table = tomllib.loads(content.decode("utf-8"))
    except OSError as error:
        raise PersonError(f"{path}: cannot be read ({error.strerror}); name the person's file.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise PersonError(f"{path}: is no TOML ({str(error)[:200]}); copy {packaged().name} and alter it.") from None
    return checked(table, str(path), hashlib.sha256(content).hexdigest())


def checked(table: Mapping[str, Any], where: str, sha256: str) -> Bounds:
    """Return the bounds of a table; raises `PersonError` that begins with `where`."""
    for key in table:
        if key not in RANGES and key != "person":
            raise PersonError(f"{where}: unknown key {key}; expected person, {', '.join(RANGES)}.")
    person = table.get("person")
    if not isinstance(person, str) or not person.strip():
        raise PersonError(f"{where}: person = {person!r} is not a text; write whose bounds these are.")
    numbers = {key: _number(table, key, where) for key in RANGES}
    if numbers["knee_low_deg"] >= numbers["knee_high_deg"]:
        raise PersonError(f"{where}: knee_low_deg = {numbers['knee_low_deg']:g} is not below knee_high_deg = "
                          f"{numbers['knee_high_deg']:g}; flexion is negative: exchange them.")
    return Bounds(person=person, sha256=sha256, **numbers)


def _number(table: Mapping[str, Any], key: str, where: str) -> float:
    unit, low, high = RANGES[key]
    value = table.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) \
            or not low <= value <= high:
        raise PersonError(f"{where}: {key} = {value!r}, expected a number from {low:g} to {high:g} {unit}; write one.")
    return float(value)
