"""The page names every option, fault, and bit rate there is."""

from __future__ import annotations

import re
from pathlib import Path

from parameters import declarations
from virtual_bus.bus_options import Options
from virtual_bus.wire.bits import BITRATES
from virtual_bus.wire.faults import KINDS

PAGE = (Path(__file__).resolve().parents[2] / "docs/virtual_bus.md").read_text(encoding="utf-8")


def rows(heading: str) -> dict[str, str]:
    """Return the first two columns of the table under a heading."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    return dict(re.findall(r"^\| `(\w+)` \| ([^|]*?) \|", section, flags=re.MULTILINE))


def test_options_and_their_defaults() -> None:
    table = rows("Options")
    for name, default, _ in declarations(Options):
        told = "none" if default in (None, ()) else f"`{default}`" if isinstance(default, str) else str(default)
        assert table[name] == told, name


def test_faults() -> None:
    assert set(rows("Faults")) == set(KINDS)


def test_bit_rates() -> None:
    assert all(str(bitrate) in PAGE for bitrate in BITRATES)
