"""numba's cache cannot go stale: the digest covers every module that the compiled step is made of."""

import re
from pathlib import Path

from physics.plant import step

HERE = Path(step.__file__).parents[1]


def _imported(name: str, seen: set[str]) -> set[str]:
    if name not in seen:
        seen.add(name)
        text = (HERE / f"{name}.py").read_text(encoding="utf-8")
        for package, several in re.findall(r"(?m)^from physics(\.plant)? import ([\w, ]+)", text):
            for module in several.split(", "):
                _imported(f"plant/{module}" if package else module, seen)
        for module in re.findall(r"(?m)^from physics\.([\w.]+) import", text):
            if module != "plant":
                _imported(module.replace(".", "/"), seen)
    return seen


def test_digest_covers_the_sources_of_the_step() -> None:
    assert _imported("plant/step", set()) == set(step.SOURCES)


def test_digest_is_a_constant_of_the_compiled_function() -> None:
    cells = [cell.cell_contents for cell in step.advance.py_func.__closure__]
    assert step.digest() in cells
