"""`CONTRIBUTING.md`: its recipes run as they stand, and the tests and pages that it names exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from physics.effects.catalogue import CATALOGUE

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
RECIPES = re.findall(r"## ([^\n]+)\n(?:(?!## ).)*?```python\n(.*?)```", TEXT, re.DOTALL)


@pytest.mark.parametrize(("name", "recipe"), RECIPES, ids=[name for name, _ in RECIPES])
def test_a_recipe_holds_what_it_asserts_and_leaves_the_catalogue_as_it_was(name: str, recipe: str) -> None:
    before, made = dict(CATALOGUE), {}
    exec(compile(recipe, f"CONTRIBUTING.md, {name}", "exec"), made)
    assert re.findall(r"^ *assert ", recipe, re.MULTILINE), "the recipe shows no result"
    assert {"An effect": "dry", "An importer": "sheet"}[name] in made
    assert before == CATALOGUE


def test_there_are_recipes() -> None:
    assert [name for name, _ in RECIPES] == ["An effect", "An importer"]


def test_what_it_names_exists() -> None:
    named = re.findall(r"`((?:tests|docs|physics|trial)/[\w./]+\.(?:py|md))`", TEXT)
    assert len(named) >= 5
    assert [name for name in named if not (ROOT / name).exists()] == []
