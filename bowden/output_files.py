"""Output files: existing files are kept, and unwritable paths are refused before any work is done.

An output is never one of the inputs, by whatever name or link; its content is that of its ending.
"""

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from parameters import InputError
from parameters.files import refuse_special


def refuse(paths: Iterable[Path | None], *, overwrite: bool, inputs: Iterable[Path | None] = ()) -> None:
    """Raise `InputError` for the first path that exists already (unless `overwrite`) or cannot be written.

    Before that, for one that is among `inputs`: it would be destroyed while it is read.
    """
    paths, seen = list(paths), set[Path]()
    refuse_inputs(paths, inputs)
    for path in paths:
        if path is None:
            continue
        if path in seen:
            raise InputError(f"{path}: named for two outputs; give each its own file.")
        seen.add(path)
        if path.is_dir():
            raise InputError(f"{path}: is a directory; give the name of a file in it.")
        refuse_special(path)
        if path.exists() and not overwrite:
            raise InputError(f"{path}: the file exists; give another name or --overwrite.")
        if not path.parent.is_dir():
            raise InputError(f"{path}: {path.parent} is no directory; make it first.")
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            raise InputError(f"{path}: cannot be written (permission denied); give a writable place.")
        _refuse_unwritable(path)


def refuse_inputs(paths: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """Raise `InputError` for the first path that is one of `inputs`, whatever its name."""
    read = {_identity(path): path for path in inputs if path is not None and path.exists()}
    for path in paths:
        if path is not None and path.exists() and _identity(path) in read:
            raise InputError(f"{path}: is the input {read[_identity(path)]} itself; give the output another name.")


def _refuse_unwritable(path: Path) -> None:
    """Raise `InputError` if the folder takes no new file, which its permissions do not show (/proc, a full disk)."""
    if path.exists():
        return
    try:
        descriptor, name = tempfile.mkstemp(prefix=".bowden-", dir=path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give a writable place.") from None
    os.close(descriptor)
    os.unlink(name)


@contextmanager
def restored_unless_written(output: Path, side: Path | None = None) -> Iterator[bool]:
    """Move existing files aside while the block writes them anew, and move them back if `output` is then missing.

    If it is there, the old files are deleted. `side`: a file that belongs to `output`. Yields whether an `output`
    was there. After a killed process the old files are in folders beside them, `.old-NAME-…`.
    Raises `InputError` for a file that cannot be moved.
    """
    aside = dict[Path, Path]()
    try:
        for path in (output, side):
            if path is not None and path.exists():
                aside[path] = _moved_aside(path)
        yield output in aside
    finally:
        written = output.exists()
        for path, old in aside.items():
            if written:
                old.unlink()
            else:
                old.replace(path)
            old.parent.rmdir()


def _moved_aside(path: Path) -> Path:
    try:
        return path.replace(Path(tempfile.mkdtemp(prefix=f".old-{path.name[:100]}-", dir=path.parent), path.name))
    except OSError as error:
        raise InputError(f"{path}: cannot be replaced ({error.strerror}); give a writable place.") from None


def _identity(path: Path) -> tuple[int, int]:
    told = path.stat()
    return told.st_dev, told.st_ino


PICTURES = (".png", ".svg", ".svgz", ".pdf", ".ps", ".eps", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")
"""File endings of supported pictures."""


def refuse_ending(path: Path | None, *endings: str, what: str) -> None:
    """Raise `InputError` if a file's ending is not one for `what`."""
    if path is not None and path.suffix.lower() not in endings:
        raise InputError(f"{path}: {what} is written as {' or '.join(endings)}; give a name that ends so.")
