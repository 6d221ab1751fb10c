"""The Python files that `docs/testing.md` shows, written out and run by a pytest of their own."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs" / "testing.md"


def written(folder: Path) -> list[Path]:
    """Write every titled Python block of the page into `folder`."""
    blocks = re.findall(r'```python title="([\w.]+)"\n(.*?)```', PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    for name, text in blocks:
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name, _ in blocks]


def shown() -> str:
    """Return the summary line that the page shows, without its time."""
    found = re.search(r"(?m)^(\d+ passed) in", PAGE.read_text(encoding="utf-8"))
    assert found is not None
    return found[1]
