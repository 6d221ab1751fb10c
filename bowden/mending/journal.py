"""Completed steps of an unattended repair, as JSON lines.

Each step has a line, on the disk before the next step begins.  A run that was killed is resumed by running the same
steps again: a step with a line returns its result.
"""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from parameters import InputError


class Journal:
    """Completed steps of a run in `path`, in their order; `settings` are the run's, on the first line."""

    def __init__(self, path: Path, settings: dict[str, Any], *, resume: bool) -> None:
        """Begin a journal, or with `resume` read the one at `path`.

        Raises `InputError` if a journal is there and `resume` is not asked for, and if its settings differ.
        """
        self.path, self.lines = path, list[dict[str, Any]]()
        if path.exists():
            if not resume:
                raise InputError(f"{path}: a run was recorded here; give another folder, or --resume.")
            self.lines = _read(path)
        if not self.lines:
            self._append({"step": "settings", "result": settings})
        elif (begun := self.lines[0]["result"]) != settings:
            other = "; ".join(f"{name} {begun.get(name)}, not {settings.get(name)}" for name in {**begun, **settings}
                              if begun.get(name) != settings.get(name))
            raise InputError(f"{path}: was begun with {other}; resume with the same options.")
        self._next = 1

    def step(self, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return the result of the next step: from its line if it was completed, else made and written.

        Raises `InputError` if the journal's line is of another step: the program or a file has changed.
        """
        if self._next < len(self.lines):
            line = self.lines[self._next]
            if line["step"] != name:
                raise InputError(f"{self.path}: line {self._next + 1} is {line['step']}, expected {name}; begin anew "
                                 "in another folder.")
        else:
            line = {"step": name, "result": make()}
            self._append(line)
        self._next += 1
        result: dict[str, Any] = line["result"]
        return result

    def _append(self, line: dict[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line, ensure_ascii=False, allow_nan=False) + "\n")
            file.flush()
            os.fsync(file.fileno())
        self.lines.append(line)


def _read(path: Path) -> list[dict[str, Any]]:
    """Return the complete lines of a journal; a last line that a killed process cut short is removed from the file."""
    text = path.read_bytes()
    whole = text[:text.rfind(b"\n") + 1]
    if whole != text:
        with path.open("r+b") as file:
            file.truncate(len(whole))
    try:
        return [json.loads(line) for line in whole.decode("utf-8").splitlines()]
    except ValueError:
        raise InputError(f"{path}: is no journal of bowden mend; give another folder.") from None
