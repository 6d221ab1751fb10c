"""Output files: kept when they exist, refused when they cannot be written, before any work is done."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from parameters import InputError


def refuse(paths: Iterable[Path | None], *, overwrite: bool) -> None:
    """Raise `InputError` for the first path that exists already (unless `overwrite`) or cannot be written."""
    seen: set[Path] = set()
    for path in paths:
        if path is None:
            continue
        if path in seen:
            raise InputError(f"{path}: named for two outputs; give each its own file.")
        seen.add(path)
        if path.is_dir():
            raise InputError(f"{path}: is a directory; give the name of a file in it.")
        if path.exists() and not overwrite:
            raise InputError(f"{path}: the file exists; give another name or --overwrite.")
        if not path.parent.is_dir():
            raise InputError(f"{path}: {path.parent} is no directory; make it first.")
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            raise InputError(f"{path}: cannot be written (permission denied); give a writable place.")
