"""The doors of the documentation run by copy and paste: own data and an own controller.

`docs/bench.md`, the door of who has a bench, is typed by `test_bowden_bench_page.py`.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r'```(sh|text|python title="([^"]+)")\n(.*?)```', re.DOTALL)


def walk(page: str, bowden: Callable[..., Any], statuses: tuple[int, ...] = (0,)) -> None:
    """Write and type the blocks of a page; each line of a `text` block must have been printed before it."""
    printed = ""
    for kind, title, text in BLOCK.findall((DOCS / page).read_text(encoding="utf-8")):
        if title:
            Path(title).write_text(text, encoding="utf-8")
        elif kind == "sh":
            for line in text.splitlines():
                told = bowden(*shlex.split(line)[1:])
                assert told[0] in statuses, (line, told[2])
                printed += told[1]
        else:
            assert [line for line in text.splitlines() if line not in printed] == []


def test_who_has_data_walks_from_a_table_to_a_report(here: Path, bowden: Callable[..., Any]) -> None:
    rows = ["Zeit [s];Seilweg [mm];Kraft vorne [g];Kraft hinten [g];Knie [deg];Temperatur"]
    for k in range(801):
        phase = 2 * math.pi * k / 200
        row = (k / 200, 40 - 40 * math.cos(phase), 2200 - 1800 * math.cos(phase), 1700 - 1400 * math.cos(phase - 0.1),
               30 - 30 * math.cos(phase), 21.5)
        rows.append(";".join(f"{value:.4f}".replace(".", ",") for value in row))
    (here / "lab.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    assert "\n".join(rows[:2]) in (DOCS / "data.md").read_text(encoding="utf-8")
    walk("data.md", bowden)


def test_who_builds_a_controller_walks_to_a_comparison(
    here: Path, bowden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    walk("build.md", bowden, statuses=(0, 1))  # 1: the two trials differ
    assert (here / "integral.mcap").is_file()


@pytest.mark.parametrize("page", ["index.md", "../README.md"])
def test_the_first_page_opens_on_the_three_doors(page: str) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    doors = [text.index(f"[I {words}") for words in ("have data", "have a bench", "build controllers or devices")]
    assert doors == sorted(doors)
