"""numba's cache cannot go stale: the digest covers every module that the compiled step is made of."""

import re
from pathlib import Path

from physics.plant import step

HERE = Path(step.__file__).parent


def _imported(name: str, seen: set[str]) -> set[str]:
    if name not in seen:
        seen.add(name)
        text = (HERE / f"{name}.py").read_text(encoding="utf-8")
        for several, one in re.findall(r"(?m)^from physics import ([\w, ]+)|^from physics\.(\w+) import", text):
            for module in (several or one).split(", "):
                _imported(module, seen)
    return seen


def test_digest_covers_the_sources_of_the_step() -> None:
    assert _imported("step", set()) == set(step.SOURCES)


def test_digest_is_a_constant_of_the_compiled_function() -> None:
    cells = [cell.cell_contents for cell in step.advance.py_func.__closure__]
    assert step.digest() in cells
