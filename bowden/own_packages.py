"""Detection of a foreign package or file that hides one of this project's.

It imports nothing of the project, since the import may be the hidden one.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

NAMES = ("diagnosis", "eds", "logbook", "master", "nodes", "parameters", "physics", "safety_monitor",
         "trial", "virtual_bus")
"""The packages beside `bowden` that an installation puts at the top level."""


def hidden() -> str | None:
    """Return one sentence that names what hides a package of this project and what to do; None where nothing does."""
    home = Path(__file__).resolve().parents[1]
    for name in NAMES:
        place = _place(name)
        if place is None:
            return f"the package {name} of bowden-bench is not installed beside bowden in {home}; install it again."
        if place.resolve() not in (home / name, home / name / "__init__.py"):
            return (f"{place} hides the package {name} of bowden-bench, which is in {home}; rename that file, leave "
                    "its folder (or take it out of PYTHONPATH), or give bowden-bench an environment of its own.")
    return None


def _place(name: str) -> Path | None:
    """Return the file or folder that `import name` takes."""
    loaded = sys.modules.get(name)
    spec = loaded.__spec__ if loaded is not None else find_spec(name)
    if spec is None:
        return None if loaded is None else Path(str(loaded.__file__))
    return Path(spec.origin or next(iter(spec.submodule_search_locations or ()), ""))
