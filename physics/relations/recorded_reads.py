"""What a law depends on, recorded as it reads its parameters, and results kept by what was read.

The rule of this file: nothing lists what a law reads.  A result holds for every set of values that agrees in all that
was read while it was made; a law that reads more where a switch is on is recorded once for each state of its switches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

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
    """The last `size` results of laws, each kept by the values that were read while it was made."""

    __slots__ = ("_reads", "_results", "size")

    def __init__(self, size: int) -> None:
        self.size = size
        self._reads: dict[object, list[tuple[str, ...]]] = {}
        self._results: dict[tuple[object, ...], Any] = {}

    def recall(self, law: object, p: Values, make: Callable[[Values], T]) -> T:
        """Return `make(p)`, from memory where all that it read then is as it was; `law` names what is made."""
        values = p.values_ if isinstance(p, Recorded) else p
        for names in self._reads.get(law, ()):
            key = (law, names, *[values[name] for name in names])
            if key in self._results:
                if isinstance(p, Recorded):
                    p.read.update(names)
                known: T = self._results[key]
                return known
        recorded = Recorded(values)
        made = make(recorded)
        self._keep(law, recorded, made)
        if isinstance(p, Recorded):
            p.read.update(recorded.read)
        return made

    def _keep(self, law: object, recorded: Recorded, made: object) -> None:
        names = tuple(sorted(recorded.read))
        known = self._reads.setdefault(law, [])
        if names not in known:
            known.append(names)
        if len(self._results) >= self.size:
            self._results.pop(next(iter(self._results)))
        self._results[law, names, *[recorded.values_[name] for name in names]] = made
