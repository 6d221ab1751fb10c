"""The example of docs/reports.md runs, and what it makes is drawn."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run the example of the page and return the file that it writes."""
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "reports.md").read_text(), re.S)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/reports.md", "exec"), {})
    return tmp_path / "page.html"


def test_the_example_makes_a_page(page: Path) -> None:
    assert "Two waves" in page.read_text()


def test_the_example_makes_a_page_that_is_drawn(page: Path, browser: Any) -> None:
    browser.open(page)
    assert browser.complaints == []
    assert browser.run("document.documentElement.dataset.drawn") == "1"
    assert "2.5 %" in browser.run("document.body.innerText")


def test_files_that_the_page_names_are_there() -> None:
    for name in re.findall(r"\]\(([^):#]+)(?:#[^)]*)?\)", (DOCS / "reports.md").read_text()):
        assert (DOCS / name).is_file(), name
