"""Imports that wait until what they name is used: `bowden --help` stays quick, and imports stand on top of a module."""

from __future__ import annotations

import builtins
import importlib
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, Final

_BLOCK: Final = threading.RLock()
"""Held by the thread whose import statements wait."""


class Deferred:
    """A module, or a class or function of one, that is imported whenever it is used."""

    def __init__(self, module: str, name: str = "") -> None:
        self._module, self._name = module, name

    def _found(self) -> Any:
        found = importlib.import_module(self._module)
        if not self._name:
            return found
        named = getattr(found, self._name, self)
        return importlib.import_module(f"{self._module}.{self._name}") if named is self else named

    def __getattr__(self, name: str) -> Any:
        return getattr(self._found(), name)

    def __call__(self, *given: Any, **named: Any) -> Any:
        """Call the class or function."""
        return self._found()(*given, **named)

    def __instancecheck__(self, instance: object) -> bool:
        return isinstance(instance, self._found())


@contextmanager
def on_first_use() -> Iterator[None]:
    """Let the import statements inside wait, as `lazy import` of PEP 810 does.

    A constant or a class of exceptions is named through its module: `link.LinkError`, not `LinkError`.
    """
    def waiting(name: str, globals: Any = None, locals: Any = None, fromlist: Sequence[str] | None = (),
                level: int = 0) -> Any:
        if threading.get_ident() != thread:
            return at_once(name, globals, locals, fromlist or (), level)
        return SimpleNamespace(**{each: Deferred(name, each) for each in fromlist}) if fromlist else Deferred(name)

    with _BLOCK:
        thread, at_once, builtins.__import__ = threading.get_ident(), builtins.__import__, waiting
        try:
            yield
        finally:
            builtins.__import__ = at_once
