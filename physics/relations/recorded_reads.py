"""Dependencies of an equation, recorded as it reads its parameters; results cached by their inputs.

No list of dependencies exists. A prediction equation is run once on values that record (`Recorded`), its switches on
and off. A part of an equation is a function of arrays and numbers alone, so its result depends on its arguments only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np

Values = Mapping[str, float]
T = TypeVar("T")


class Recorded(Mapping[str, float]):
    """Values that record which of them are read, in `read`; to iterate over them reads all."""

    __slots__ = ("read", "values_")

    def __init__(self, values: Values) -> None:
        self.values_ = values
        self.read: set[str] = set()

    def __getitem__(self, name: str) -> float:
        value = self.values_[name]
        self.read.add(name)
        return value

    def __contains__(self, name: object) -> bool:
        return name in self.values_

    def __iter__(self) -> Iterator[str]:
        self.read.update(self.values_)
        return iter(self.values_)

    def __len__(self) -> int:
        return len(self.values_)


class Memory:
    """The last `size` results of each function, by its arguments: numbers by value, arrays by identity.

    An array that was handed in or out is never written to afterwards; the memory keeps a reference, so that no other
    array gets its identity.
    """

    __slots__ = ("_held", "size")

    def __init__(self, size: int) -> None:
        self.size = size
        self._held: dict[object, dict[tuple[Any, ...], tuple[Any, tuple[Any, ...]]]] = {}

    def recall(self, function: object, given: tuple[Any, ...], make: Callable[[], T]) -> T:
        """Return `make()`, from memory where `function` was called with `given` before."""
        key = tuple([id(v) if v.__class__ is np.ndarray else v for v in given])
        held = self._held.get(function)
        if held is None:
            held = self._held[function] = {}
        kept = held.pop(key, None)
        if kept is None:
            kept = make(), given
            if len(held) >= self.size:
                del held[next(iter(held))]
        held[key] = kept  # the last again: what goes first is what was asked for longest ago
        result: T = kept[0]
        return result
