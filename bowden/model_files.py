"""Bench models for callers of the library: read, written, and handed to simulator, controller and diagnosis.

All conversions of a model for its users are here; `physics.bench_model` defines its content.
"""

import tomllib
from pathlib import Path
from typing import Any

from parameters import InputError
from physics.bench_model import BenchModel, nominal, read

__all__ = ["BenchModel", "Model", "given", "nominal", "read", "tables", "write"]

Model = BenchModel | str | Path
"""A bench model, or the file that holds one."""


def write(model: BenchModel, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a model as TOML; raises `InputError` for an existing file, unless `overwrite`."""
    from bowden import output_files

    path = Path(path)
    output_files.refuse([path], overwrite=overwrite)
    try:
        path.write_text(model.text(), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give a writable place.") from None
    return path


def given(model: Model | None) -> BenchModel:
    """Return a model given as an object or a file; None gives the packaged nominal model."""
    if model is None:
        return nominal()
    return model if isinstance(model, BenchModel) else read(model)


def tables(model: BenchModel) -> dict[str, Any]:
    """Return a model as the tables of its file."""
    return tomllib.loads(model.text())
