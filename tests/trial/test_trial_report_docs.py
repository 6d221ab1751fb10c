"""The example of docs/reports.md runs, and what it makes is drawn."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"


def test_the_example_makes_a_page_that_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, browser: Any) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "reports.md").read_text(), re.S)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/reports.md", "exec"), {})
    browser.open(tmp_path / "page.html")
    assert browser.complaints == []
    assert browser.run("document.documentElement.dataset.drawn") == "1"
    assert "2.5 %" in browser.run("document.body.innerText")


def test_files_that_the_page_names_are_there() -> None:
    for name in re.findall(r"\]\(([^):#]+)(?:#[^)]*)?\)", (DOCS / "reports.md").read_text()):
        assert (DOCS / name).is_file(), name
