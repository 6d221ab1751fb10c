"""Parts that others bring, found by name: an entry point, or "module:attribute".

The rule of this file: the project's own parts need no installation; a module is found on the module path first and in
the current folder then; whatever a part's module raises while it is imported becomes one sentence.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Mapping
from functools import reduce
from importlib.metadata import entry_points
from typing import Any

from parameters.declared import InputError


def load(what: str, name: str, group: str, own: Mapping[str, str]) -> Any:
    """Return the part of that name: of `own` ("module:attribute" by name), of the entry-point `group`, or imported.

    `what` is what a message calls it, such as "plant".  Raises `InputError` for what is neither installed nor
    importable.
    """
    if ":" in name:
        return _imported(what, name)
    if name in own:
        return _imported(what, own[name])
    installed = {entry.name: entry.value for entry in entry_points(group=group)}
    if name not in installed:
        known = ", ".join(sorted({*own, *installed}))
        raise InputError(f"{what} {name!r} is not installed; expected one of {known}, module:callable, or install what "
                         "offers it.")
    return _imported(what, installed[name])


def _imported(what: str, name: str) -> Any:
    """Return "module:attribute"; the attribute may have dots."""
    module, _, attribute = name.partition(":")
    here = os.getcwd()
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)  # last: a file of the user must not hide an installed module; kept for its own imports
    try:
        found = reduce(getattr, attribute.strip().split("."), importlib.import_module(module))
    except Exception as error:
        raise InputError(f"{what} {name!r} cannot be imported ({type(error).__name__}: {error}); give module:callable "
                         "of what is on the module path or in the current folder.") from None
    if not callable(found):
        raise InputError(f"{what} {name!r} is no callable; name a class or a function.")
    return found
