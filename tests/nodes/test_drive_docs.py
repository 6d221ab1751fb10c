"""docs/drives.md says what the tables say, and names only tests that exist, and every test of drives and sensors."""

from __future__ import annotations

import re
from pathlib import Path

from eds.cia402 import TRANSITIONS, State
from tests.nodes.drives_page import page, states

HERE = Path(__file__).parent
TEXT = (HERE.parents[1] / "docs" / "drives.md").read_text(encoding="utf-8")
NAMED = set(re.findall(r"`(test_\w+)`", TEXT))


def defined() -> set[str]:
    paths = [path for kind in ("drive", "sensor") for path in HERE.glob(f"test_{kind}_*.py") if "docs" not in path.name]
    return set(re.findall(r"^def (test_\w+)\(", "\n".join(p.read_text(encoding="utf-8") for p in paths), re.MULTILINE))


def test_generated_parts_are_up_to_date() -> None:
    assert page(TEXT) == TEXT, "run: python -m tests.nodes.drives_page"


def test_every_test_named_exists_and_every_test_is_named() -> None:
    assert defined() == NAMED


def test_the_diagram_shows_every_state_and_row() -> None:
    arrows = [line.split(": ") for line in states().splitlines() if "-->" in line]
    assert {int(words.split()[0]) for _, words in arrows} == {row.number for row in TRANSITIONS}
    assert {end for ends, _ in arrows for end in ends.split() if end not in ("-->", "[*]")} == {s.name for s in State}
