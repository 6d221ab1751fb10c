"""Declarations of parameters, and checks of values against them."""

import dataclasses
import math
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")
KINDS: typing.Final[Mapping[Any, str]] = {
    int: "a whole number", float: "a number", str: "a text", bool: "true or false", Mapping: "a table",
    Sequence: "a list"}
"""Types of parameters in the words of an error sentence."""


class InputError(ValueError):
    """Input of the user that cannot be used; the text is one sentence with the place, the fault and the remedy."""


class Remark(UserWarning):
    """Warning about a file that is read all the same; the text is one sentence."""


@dataclass(frozen=True)
class Declared:
    """Declaration of a parameter: `unit` ("" for a pure number), closed bounds, source of the value, description."""

    unit: str
    low: float
    high: float
    source: str
    text: str


def parameter(
    default: Any,
    unit: str,
    text: str,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    source: str,
) -> Any:
    """Declare one field of a frozen dataclass; `source` is an equation, a clause, or "assumed: …"."""
    return dataclasses.field(default=default, metadata={"declared": Declared(unit, low, high, source, text)})


def apart(default: Any) -> Any:
    """Declare a field that no table gives: whoever reads the table fills it."""
    return dataclasses.field(default=default, metadata={"apart": True})


def declarations(cls: type[Any]) -> Iterator[tuple[str, Any, Declared]]:
    """Yield (name, default, declaration) of each declared field of `cls`, in order."""
    for field in dataclasses.fields(cls):
        declared = field.metadata.get("declared")
        if declared is not None:
            yield field.name, field.default, declared


def checked(value: T, *, where: str) -> T:
    """Return `value` if each declared field keeps its type and bounds, else raise `InputError`."""
    hints = typing.get_type_hints(type(value))
    for name, _default, declared in declarations(type(value)):
        _check_one(name, getattr(value, name), hints[name], declared, where)
    return value


def _check_one(name: str, given: object, hint: object, declared: Declared, where: str) -> None:
    number = hint in (int, float)
    right = isinstance(given, int | float) and not isinstance(given, bool) if number else True
    if hint is int and isinstance(given, float):
        right = False
    if isinstance(hint, type) and not number:
        right = isinstance(given, hint)
    kinds: tuple[Any, ...] = (hint,)
    if isinstance(hint, types.UnionType):
        kinds = tuple(typing.get_origin(kind) or kind for kind in typing.get_args(hint))
        right = isinstance(given, kinds)
    if not right:
        expected = " or ".join(KINDS.get(kind, str(kind)) for kind in kinds if kind is not types.NoneType)
        raise InputError(f"{where}: {name} = {given!r} is not {expected}; {declared.text}.")
    if number and not declared.low <= typing.cast(float, given) <= declared.high:
        unit = f" {declared.unit}" if declared.unit else ""
        raise InputError(
            f"{where}: {name} = {given!r} is outside {declared.low:g} … {declared.high:g}{unit}; {declared.text}."
        )
