"""The list of the commands' modules; importing one registers its commands on the application."""

from __future__ import annotations

import importlib

MODULES = (
    "run", "replay", "identify", "sweep", "serve", "commission", "acknowledge", "doctor", "nodes", "files", "diagnose",
    "verify", "report_command", "live", "convert", "setup",
)


def load() -> None:
    """Register every command; cheap, since commands import their rooms when they run."""
    for name in MODULES:
        importlib.import_module(f"bowden.{name}")
