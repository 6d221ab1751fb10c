"""Table of safety functions and their holders, for `check config`, `doctor` and a trial's file."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parameters import InputError, read_toml

if TYPE_CHECKING:
    from master.limit_holders import HeldLimit

ATTACHMENT = "safety_functions.csv"
"""Name of the table in a trial's file."""


def table(sections: Mapping[str, Any]) -> list[HeldLimit]:
    """Return the table of a checked configuration; raises `InputError` for devices that do not fit their places."""
    from eds.bench.bench_network import wire
    from master.limit_holders import holders

    network = sections["network"]
    return holders(wire(network), sections["limits"], _monitored(getattr(network, "monitor", "")))


def _monitored(person: str) -> dict[str, str]:
    """Return the bounds that the safety monitor of a person's file holds, by function; none without a file."""
    if not person:
        return {}
    bounds = read_toml(Path(person))
    held = {
        "START tension": "{start_n} N", "START tension without the master": "{start_n} N", "END tension": "{end_n} N",
        "rope speed": "{rope_m_s} m/s", "knee angle": "{knee_low_deg}° … {knee_high_deg}°",
        "knee speed": "{knee_deg_s} °/s", "master lost": "{heartbeat_ms} ms"}
    return {function: text.format_map(bounds) for function, text in held.items()}


def as_csv(rows: list[HeldLimit]) -> bytes:
    """Return the table as CSV with a header."""
    from master.limit_holders import COLUMNS

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(row.cells for row in rows)
    return text.getvalue().encode()


def as_objects(rows: list[HeldLimit]) -> list[dict[str, str]]:
    """Return the table as JSON objects, one a row."""
    return [{**row._asdict(), "held_by": row.held_by} for row in rows]


def refuse_unheld(sections: Mapping[str, Any], where: str) -> None:
    """Raise `InputError` for a safety function that nobody holds, without a reason that a trial carries with it."""
    from master.limit_holders import unheld

    if sections["limits"].raised.strip():
        return
    functions = unheld(table(sections))
    if functions:
        raise InputError(f"{where}: nobody holds {'; '.join(functions)}: use a drive that has the objects (bowden "
                         "check config lists them), declare a monitor, or say why with --raise-limits REASON.")
