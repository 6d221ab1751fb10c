"""The list of the commands' modules; importing one registers its commands on the application."""

from __future__ import annotations

import importlib

MODULES = (
    "trial", "replay", "identify", "sweep", "bench", "commission", "acknowledge", "doctor", "node", "monitor", "files",
    "diagnose", "fit", "simulate", "verify", "report", "live", "convert", "recordings", "record", "setup", "logbook",
)


def load() -> None:
    """Register every command; cheap, since commands import their rooms when they run."""
    for name in MODULES:
        importlib.import_module(f"bowden.cli.{name}")
