"""Plug-ins, found by name: an entry point, "module:attribute" or "path/to/file.py:attribute".

The rule of this file: the project's own parts need no installation; a module is found on the module path first and in
the current folder then; whatever a part's module raises while it is imported becomes one sentence.
"""

import importlib
import importlib.util
import os
import sys
import zlib
from collections.abc import Mapping
from functools import reduce
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from parameters.declared import InputError


def load(what: str, name: str, group: str, own: Mapping[str, str]) -> Any:
    """Return a part by its name: from `own` ("module:attribute" by name), from the entry-point `group`, or imported.

    `what` is the part's kind in messages, such as "plant".  Raises `InputError` if the part is neither installed nor
    importable.
    """
    if ":" in name:
        return _imported(what, name)
    if name in own:
        return _imported(what, own[name])
    if name.endswith(".py"):
        raise InputError(f"{what} {name!r} names no callable in that file; give {name}:callable.")
    installed = {entry.name: entry.value for entry in entry_points(group=group)}
    if name not in installed:
        known = ", ".join(sorted({*own, *installed}))
        raise InputError(f"{what} {name!r} is not installed; expected one of {known}, module:callable, or install what "
                         "offers it.")
    return _imported(what, installed[name])


def _imported(what: str, name: str) -> Any:
    """Return "module:attribute"; the attribute may have dots."""
    module, _, attribute = name.rpartition(":")
    if module.endswith(".py") or "/" in module or os.sep in module:
        return _callable(what, name, _from_file(what, name, Path(module), attribute))
    here = os.getcwd()
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)  # last: a file of the user must not hide an installed module; kept for its own imports
    try:
        found = reduce(getattr, attribute.strip().split("."), importlib.import_module(module))
    except (Exception, SystemExit) as error:
        raise InputError(f"{what} {name!r} cannot be imported ({type(error).__name__}: {error}); give module:callable "
                         "of what is on the module path or in the current folder, or path/to/file.py:callable."
                         ) from None
    return _callable(what, name, found)


def _from_file(what: str, name: str, path: Path, attribute: str) -> Any:
    """Return the attribute of a Python file; modules that the file imports are searched in its folder."""
    if not path.is_file():
        raise InputError(f"{what} {name!r}: {path} is no file; give path/to/file.py:callable.")
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)
    label = f"{path.stem}_{zlib.crc32(str(path.resolve()).encode()):08x}"  # hides no installed module
    try:
        if label not in sys.modules:
            spec = importlib.util.spec_from_file_location(label, path)
            if spec is None or spec.loader is None:
                raise ImportError("its name does not end in .py")
            sys.modules[label] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(sys.modules[label])
        return reduce(getattr, attribute.strip().split("."), sys.modules[label])
    except (Exception, SystemExit) as error:
        sys.modules.pop(label, None)
        raise InputError(f"{what} {name!r} cannot be imported ({type(error).__name__}: "
                         f"{str(error).replace(label, path.name)}); mend {path}, or give "
                         "the name of a callable in it.") from None


def _callable(what: str, name: str, found: Any) -> Any:
    """Return `found`; raise `InputError` if it cannot be called."""
    if not callable(found):
        raise InputError(f"{what} {name!r} is no callable; name a class or a function.")
    return found
