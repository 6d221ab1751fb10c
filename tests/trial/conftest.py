"""Fixtures of the trial room."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


def _load() -> ModuleType:
    name = "example_trials"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


_load()


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Return the path of a small whole trial."""
    path: Path = _load().write(tmp_path / "trial.mcap")
    return path
