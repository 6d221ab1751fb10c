"""Detection of a foreign package or file that hides one of this project's.

It imports nothing of the project, since the import may be the hidden one. A folder without Python files, such as a
test's folder `eds` of EDS files, hides nothing: the project's package of that name is loaded from its own place.
"""

import sys
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path

NAMES = ("diagnosis", "eds", "estimation", "logbook", "master", "nodes", "parameters", "physics", "safety_monitor",
         "trial", "virtual_bus")
"""The packages beside `bowden` that an installation puts at the top level."""


def hidden() -> str | None:
    """Return one sentence that names what hides a package of this project and what to do; None where nothing does."""
    home = Path(__file__).resolve().parents[1]
    behind_data = []
    for name in NAMES:
        place = _place(name)
        if place is None:
            return f"the package {name} of bowden-bench is not installed beside bowden in {home}; install it again."
        # Python takes a folder without a Python file for a namespace package
        if place.is_dir() and not any(place.glob("*.py")) and (home / name / "__init__.py").exists():
            behind_data.append(name)
        elif place.resolve() not in (home / name, home / name / "__init__.py"):
            return (f"{place} hides the package {name} of bowden-bench, which is in {home}; rename that file, leave "
                    "its folder (or take it out of PYTHONPATH), or give bowden-bench an environment of its own.")
    for name in behind_data:
        if name not in sys.modules:
            _load(name, home / name)
    return None


def _load(name: str, home: Path) -> None:
    """Load this project's package `name` from its own folder, whatever `sys.path` has before it."""
    spec = spec_from_file_location(name, home / "__init__.py", submodule_search_locations=[str(home)])
    assert spec is not None
    assert spec.loader is not None
    sys.modules[name] = module = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise


def _place(name: str) -> Path | None:
    """Return the file or folder that `import name` takes."""
    loaded = sys.modules.get(name)
    spec = loaded.__spec__ if loaded is not None else find_spec(name)
    if spec is None:
        return None if loaded is None else Path(str(loaded.__file__))
    return Path(spec.origin or next(iter(spec.submodule_search_locations or ()), ""))
