"""Imports that wait name modules, functions and classes alone, where Python asks them for no more than these."""

import ast
import importlib
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import bowden

ROOT = Path(bowden.__file__).parent


def deferring() -> list[Path]:
    """Return the modules with a block of imports that wait."""
    return [path for path in sorted(ROOT.rglob("*.py"))
            if "with on_first_use()" in path.read_text(encoding="utf-8") and path.name != "deferred.py"]


def waiting(tree: ast.Module) -> Iterator[tuple[str, Any]]:
    """Yield each name that waits, and what it stands for."""
    for block in tree.body:
        if isinstance(block, ast.With) and "on_first_use" in ast.unparse(block.items[0]):
            for statement in block.body:
                if isinstance(statement, ast.ImportFrom):
                    assert statement.module is not None
                    module = importlib.import_module(statement.module)
                    for each in statement.names:
                        found = getattr(module, each.name, None)
                        if found is None:
                            found = importlib.import_module(f"{statement.module}.{each.name}")
                        yield each.asname or each.name, found
                else:
                    assert isinstance(statement, ast.Import), ast.unparse(statement)
                    for each in statement.names:
                        yield each.asname or each.name, importlib.import_module(each.name)


def names(node: ast.AST | None) -> set[str]:
    """Return the bare names in an expression, without those that stand before a dot."""
    if node is None:
        return set()
    dotted = {id(each.value) for each in ast.walk(node) if isinstance(each, ast.Attribute)}
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name) and id(each) not in dotted}


@pytest.mark.parametrize("path", deferring(), ids=lambda path: str(path.relative_to(ROOT)))
def test_what_waits_is_no_constant_and_stands_in_no_except_clause(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = dict(waiting(tree))
    for name, of in found.items():
        assert isinstance(of, types.ModuleType) or callable(of), f"{name} is a {type(of).__name__}"
    for node in ast.walk(tree):
        if isinstance(node, ast.ExceptHandler):
            assert not names(node.type) & set(found), f"line {node.lineno}"
        if isinstance(node, ast.ClassDef):
            assert not {name for base in node.bases for name in names(base)} & set(found), f"line {node.lineno}"
