"""A share of what `make fuzz` feeds, and for ever what it once found."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.surfaces import SURFACES, chance_of

FOUND = Path(__file__).parent / "found"
SHARE = {"device": 25, "sdo": 25, "mcap": 60, "eds": 40, "csv": 40, "log": 40, "toml": 60, "command": 20}


@pytest.mark.parametrize("name", sorted(SURFACES))
def test_a_surface_answers_or_refuses(name: str) -> None:
    for number in range(SHARE[name]):
        SURFACES[name](chance_of(name, 10_000_000 + number))


@pytest.mark.parametrize("name", sorted(SURFACES))
def test_what_was_found_once_is_not_found_again(name: str) -> None:
    path = FOUND / f"{name}.txt"
    for line in path.read_text(encoding="utf-8").split() if path.exists() else []:
        SURFACES[name](chance_of(name, int(line)))
