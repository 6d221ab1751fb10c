"""`docs/architecture.md` names the rooms and folders that the import contracts name, and no other."""

from __future__ import annotations

import ast
import pkgutil
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
LINTER = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]


def rooms() -> dict[str, list[str]]:
    """Room → its folders, as the table of §1 has them."""
    rows = re.findall(r"(?m)^\| `(\w+)` \| .* \| (.*) \|$", PAGE.split("## 2.")[0])
    return {room: re.findall(r"`(\w+)`", folders) for room, folders in rows}


def layers(container: str) -> list[str]:
    """Names in the layers of a contract, highest first."""
    contract = next(c for c in LINTER["contracts"] if c.get("containers") == [container])
    return [name for layer in contract["layers"] for name in re.split(r"[ |]+", layer)]


def test_every_room_is_on_the_page_and_in_the_diagram() -> None:
    assert set(rooms()) == set(LINTER["root_packages"])
    drawn = re.findall(r"(?m)^    (\w+)\[", PAGE)
    assert set(drawn) == set(LINTER["root_packages"])


def test_arrows_of_the_diagram_go_down() -> None:
    order = [set(re.split(r"[ |]+", layer)) for layer in LINTER["contracts"][0]["layers"]]
    level = {room: i for i, layer in enumerate(order) for room in layer}
    arrows = re.findall(r"(?m)^    (\w+) --> ([\w& ]+)$", PAGE)
    assert arrows
    for above, below in arrows:
        assert all(level[above] < level[room] for room in re.split(r"[ &]+", below)), above


def imported() -> set[tuple[str, str]]:
    """Return the pairs of rooms of which the first imports the second, read from the code."""
    found = set()
    for room in LINTER["root_packages"]:
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = ([alias.name for alias in node.names] if isinstance(node, ast.Import) else
                         [node.module] if isinstance(node, ast.ImportFrom) and node.module else [])
                found |= {(room, name.split(".")[0]) for name in names} - {(room, room)}
    return {(above, below) for above, below in found if below in LINTER["root_packages"]}


def test_the_arrows_are_the_imports_of_the_code() -> None:
    """An arrow without an import is no rule, and an import that no chain of arrows allows is no way down."""
    arrows = {(above, below) for above, row in re.findall(r"(?m)^    (\w+) --> ([\w& ]+)$", PAGE)
              for below in re.split(r"[ &]+", row)}
    reached = set(arrows)
    while more := {(a, d) for a, b in reached for c, d in arrows if b == c} - reached:
        reached |= more
    assert arrows <= imported()
    assert imported() <= reached


@pytest.mark.parametrize("room", sorted(LINTER["root_packages"]))
def test_a_room_says_what_it_promises_and_where_to_start(room: str) -> None:
    docstring = ast.get_docstring(ast.parse((ROOT / room / "__init__.py").read_text(encoding="utf-8"))) or ""
    assert "Start reading" in docstring
    assert len(docstring.splitlines()) >= 3


@pytest.mark.parametrize("room", [
    "physics", "nodes", "trial", "estimation", "master", "diagnosis", "virtual_bus", "bowden"])
def test_folders_stand_in_the_order_of_their_contract(room: str) -> None:
    order, named = layers(room), rooms()[room]
    assert named == [name for name in order if name in named] != []


def test_every_name_on_the_page_can_be_imported() -> None:
    names = {name for name in re.findall(r"`([a-z_]+(?:\.\w+)+)", PAGE) if name.split(".")[0] in rooms()}
    assert len(names) > 10
    for name in sorted(names):
        assert pkgutil.resolve_name(name) is not None


def test_every_decision_has_a_number_of_its_own() -> None:
    numbers = [path.name[:4] for path in (ROOT / "docs" / "decisions").glob("*.md")]
    assert len(set(numbers)) == len(numbers)


def numbers(path: Path) -> set[str]:
    """Return the upper-case names of a module in whose value a number stands, each as module.NAME."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and any(
                isinstance(part, ast.Constant) and type(part.value) in (int, float) for part in ast.walk(node.value)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [name for t in targets for name in (t.elts if isinstance(t, ast.Tuple) else [t])]
            found |= {f"{path.stem}.{name.id}" for name in names if isinstance(name, ast.Name) and name.id.isupper()}
    return found


def test_every_number_of_the_diagnosis_is_on_its_page_and_there_are_at_most_twenty() -> None:
    def on(page: str) -> set[str]:
        return set(re.findall(r"(?m)^\| `(\w+\.[A-Z_]+)` \|", (ROOT / "docs" / page).read_text(encoding="utf-8")))

    def there(*rooms: str) -> set[str]:
        return set().union(*(numbers(path) for room in rooms for path in (ROOT / room).rglob("*.py")
                             if path.parent.name != "transfer"))

    laws = there("diagnosis/laws")
    assert laws == on("laws.md")
    rest = there("diagnosis", "estimation") - laws
    assert rest == on("evidence.md")
    assert len(rest) <= 20
