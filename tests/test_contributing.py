"""`CONTRIBUTING.md`: its recipes run as they stand, and the tests and pages that it names exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
RECIPES = re.findall(r"## ([^\n]+)\n(?:(?!## ).)*?```python\n(.*?)```", TEXT, re.DOTALL)


@pytest.mark.parametrize(("name", "recipe"), RECIPES, ids=[name for name, _ in RECIPES])
def test_a_recipe_runs(name: str, recipe: str) -> None:
    exec(compile(recipe, f"CONTRIBUTING.md, {name}", "exec"), {})


def test_there_are_recipes() -> None:
    assert [name for name, _ in RECIPES] == ["An effect", "An importer"]


def test_what_it_names_exists() -> None:
    named = re.findall(r"`((?:tests|docs|physics|trial)/[\w./]+\.(?:py|md))`", TEXT)
    assert len(named) >= 5
    assert [name for name in named if not (ROOT / name).exists()] == []
