"""Comparison of a replay with the recording: the parts that every comparison has.

A comparison is bit for bit; it counts differences by name and keeps the first one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Generic, TypeVar

Difference = TypeVar("Difference")


@dataclass(frozen=True, kw_only=True)
class Comparison(Generic[Difference]):
    """`differing`: number of differences by name; `first`: the first difference, None if all agree."""

    differing: Mapping[str, int]
    first: Difference | None

    @property
    def same(self) -> bool:
        """True if every compared value is as recorded, bit for bit."""
        return self.first is None

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as values that JSON can hold."""
        told = asdict(self)
        ends = {name: told.pop(name) for name in ("differing", "first")}
        return {"same": self.same, **told, **ends}
