"""TOML tables in and out, by the declarations."""

import dataclasses
import difflib
import math
import tomllib
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from parameters.declared import InputError, checked, declarations
from parameters.files import refuse_special

TOML_LIMIT = 16 << 20  # bytes
T = TypeVar("T")


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; raises `InputError` with the file's name and the line where it stops making sense."""
    try:
        refuse_special(path)
        if path.stat().st_size > TOML_LIMIT:
            raise InputError(f"{path}: is longer than {TOML_LIMIT} bytes; give a TOML file.")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of an existing TOML file.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a readable UTF-8 TOML file.") from None
    except (ValueError, RecursionError) as error:  # also a number of thousands of digits, tables in tables without end
        raise InputError(f"{path}: not valid TOML ({error}); mend that line.") from None


def from_table(cls: type[T], table: Mapping[str, Any], *, where: str) -> T:
    """Build `cls` from a TOML table; `where` names file and table in messages ("bench.toml [network]")."""
    fields = dataclasses.fields(typing.cast(Any, cls))
    known = {field.name for field in fields if "apart" not in field.metadata}
    for key in table:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean {close[0]}?" if close else f"expected one of {', '.join(sorted(known))}."
            raise InputError(f"{where}: unknown key {key}; {hint}")
    try:
        return checked(cls(**table), where=where)
    except TypeError:
        missing = sorted(
            f.name for f in dataclasses.fields(typing.cast(Any, cls))
            if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING and f.name not in table
        )
        raise InputError(f"{where}: missing {', '.join(missing)}; add it.") from None


def template(cls: type[Any], table: str) -> str:
    """Write `cls` as a commented TOML table with every default, unit, range and source."""
    lines = [f"[{table}]"]
    for name, default, declared in declarations(cls):
        bounds = f", {declared.low:g} … {declared.high:g}" if math.isfinite(declared.low + declared.high) else ""
        unit = declared.unit or "1"
        shown = {True: "true", False: "false"}.get(default) if isinstance(default, bool) else None
        shown = shown or (f'"{default}"' if isinstance(default, str) else repr(default))
        lines.append(f"# {declared.text} ({unit}{bounds}; {declared.source})")
        lines.append(f"{name} = {shown}")
    return "\n".join(lines) + "\n"
