"""docs/wire.md says what the code says."""

from pathlib import Path

from eds.bench.wire_page import diagram, page
from eds.cia402 import TRANSITIONS, State

PAGE = Path(__file__).parents[2] / "docs" / "wire.md"


def test_the_page_is_the_one_that_the_code_writes():
    assert PAGE.read_text(encoding="utf-8") == page(), "run: python -m eds.bench.wire_page docs/wire.md"


def test_the_diagram_shows_every_state_and_row():
    arrows = [line.split(": ") for line in diagram().splitlines() if "-->" in line]
    assert {int(words.split()[0]) for _, words in arrows} == {row.number for row in TRANSITIONS}
    assert {end for ends, _ in arrows for end in ends.split() if end not in ("-->", "[*]")} == {s.name for s in State}
