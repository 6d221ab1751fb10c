"""A class and a module have a name of their own, so that a name alone says what is meant."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("parameters", "eds", "physics", "nodes", "trial", "master", "estimation", "diagnosis",
         "logbook", "virtual_bus", "bowden")

SHARED = {
    "Trial": "bowden.Trial is trial.read.Trial with its provenance, for a notebook",
}


def classes() -> dict[str, list[str]]:
    """Class → the files that define it at their top level."""
    found = defaultdict(list)
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef):
                    found[node.name].append(str(path.relative_to(ROOT)))
    return found


def test_no_two_classes_have_one_name() -> None:
    twice = {name: paths for name, paths in classes().items() if len(paths) > 1 and name not in SHARED}
    assert not twice


def test_no_two_modules_have_one_name() -> None:
    """A file of `bowden/cli` has the name of its command, which may be that of what the command calls."""
    found = defaultdict(list)
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            if path.stem != "__init__" and "cli" not in path.relative_to(ROOT).parts:
                found[path.stem].append(str(path.relative_to(ROOT)))
    assert not {name: paths for name, paths in found.items() if len(paths) > 1}
