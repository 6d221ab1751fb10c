"""Names of files, modules and their contents that the pages of `docs/` give exist in the repository."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("parameters", "eds", "physics", "nodes", "trial", "master", "estimation", "diagnosis",
         "logbook", "virtual_bus", "bowden")
PAGES = sorted((ROOT / "docs").glob("*.md"))
MODULES = {path.stem: path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))
           if path.stem != "__init__" and "cli" not in path.relative_to(ROOT).parts}
SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
FILE = re.compile(r"(?:[a-z_]+/)+[a-z0-9_]+\.py")
DOTTED = re.compile(r"((?:[a-z_]+\.)*)([a-z_]+)\.([A-Za-z_]+)(?:\(.*\))?")

ENDINGS = ("py", "md", "toml", "eds", "csv", "mcap", "html", "jsonl")
OTHERWISE = frozenset({
    "homing", "bench", "table", "network", "departure", "files",  # tables of bench.toml and of a sweep, with their keys
    "bus", "can_bus", "sync",  # objects of an example: a bus, the testing fixture, canopen's SYNC
    "parameters",  # the package, not physics/parameters.py
})
"""First parts of dotted names that mean something else than the module of that name."""


def spans(page: Path) -> Iterator[str]:
    """Yield the code spans of a page, fenced blocks left out."""
    text = page.read_text(encoding="utf-8")
    yield from SPAN.findall(re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE))


def defined(module: Path) -> set[str]:
    """Return the names that a module defines or imports at its top level."""
    found = set()
    for node in ast.parse(module.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
            found.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {name.asname or name.name for name in node.names}
        else:
            found |= {name.id for name in ast.walk(node) if isinstance(name, ast.Name)}
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_files_that_a_page_names_are_there(page: Path) -> None:
    named = [file for span in spans(page) if (file := span.split("::")[0]) and FILE.fullmatch(file)]
    assert not [file for file in named if not (ROOT / file).exists()]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_a_page_names_in_a_module_is_there(page: Path) -> None:
    wrong = []
    for span in spans(page):
        found = DOTTED.fullmatch(span)
        if found is None or found[2] not in MODULES or found[2] in OTHERWISE or found[3] in ENDINGS:
            continue
        module = MODULES[found[2]]
        folder = module.relative_to(ROOT).parent.parts
        if found[1] and tuple(found[1].rstrip(".").split(".")) != folder:
            continue
        if found[3] not in defined(module):
            wrong.append(span)
    assert not wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_modules_in_a_table_of_modules_are_there(page: Path) -> None:
    """A table whose first column is headed "module" names modules of the project in it."""
    wrong, inside = [], False
    for line in page.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")] if line.startswith("|") else []
        inside = bool(cells) and (inside or cells[0] == "module")
        if inside and cells[0] != "module":
            wrong += [name for name in SPAN.findall(cells[0])
                      if name.rsplit("/", 1)[-1].removesuffix(".py") not in MODULES
                      and not (ROOT / name).exists()]
    assert not wrong


def test_the_interfaces_of_the_master_are_there() -> None:
    """What the Python blocks of docs/master.md call is defined in the module, or in a module of the master."""
    page = (ROOT / "docs" / "master.md").read_text(encoding="utf-8")
    everything = {name for path in (ROOT / "master").rglob("*.py") for name in defined(path)}
    called = [node.func for block in re.findall(r"^```python\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
              for node in ast.walk(ast.parse(block.replace("-> (outputs", "; (outputs"))) if isinstance(node, ast.Call)]
    names = [call.id for call in called if isinstance(call, ast.Name)]
    dotted = [(call.value.id, call.attr) for call in called
              if isinstance(call, ast.Attribute) and isinstance(call.value, ast.Name) and call.value.id in MODULES]
    assert names
    assert dotted
    assert not [name for name in names if name not in everything]
    assert not [f"{module}.{name}" for module, name in dotted if name not in defined(MODULES[module])]
