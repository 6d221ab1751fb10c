"""docs/devices.md names only tests that exist, and every test of the core; its table of mutants is today's."""

from __future__ import annotations

import re
from pathlib import Path

from tests.mutation_check import counts, mutants

HERE = Path(__file__).parent
TEXT = (HERE.parents[1] / "docs" / "devices.md").read_text(encoding="utf-8")
NAMED = set(re.findall(r"`((?:test_|Test)\w+)`", TEXT))


def defined(pattern: str, *rooms: str) -> set[str]:
    paths = [path for room in rooms or ("nodes",) for path in (HERE.parent / room).glob(pattern)]
    text = "\n".join(path.read_text(encoding="utf-8") for path in paths)
    return set(re.findall(r"^(?:def |class )?((?:test_|Test)\w+)(?: =|\()", text, re.MULTILINE))


def test_every_test_named_exists() -> None:
    assert NAMED - defined("test_*.py", "nodes", "eds", "virtual_bus") == set()


def test_every_test_of_the_core_is_named() -> None:
    own = defined("test_core_docs.py")
    assert defined("test_core_*.py") - own - NAMED == set()


def test_every_mutant_of_today_was_run() -> None:
    for kind, number in counts([mutant.name for mutant in mutants()]).items():
        assert f"| {kind} | {number} |" in TEXT, "run: python tests/mutation_check.py"
