"""docs/wire.md says what the code says."""

from pathlib import Path

from tests.eds.wire_page import page

PAGE = Path(__file__).parents[2] / "docs" / "wire.md"


def test_the_page_is_the_one_that_the_code_writes():
    assert PAGE.read_text(encoding="utf-8") == page(), "run: python -m tests.eds.wire_page docs/wire.md"
