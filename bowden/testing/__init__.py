"""A virtual CANopen bus with exact time for the tests of any CANopen program, as a pytest plugin.

    def test_my_master(can_bus, canopen_node):
        drive = canopen_node("vendor.eds", node_id=5)
        with can_bus.virtual_time():
            network = canopen.Network(can_bus.open())

`docs/testing.md` explains it with examples that run.  The rule of this package: a name is imported when it is first
used, because pytest loads the plugin in every run.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from bowden import own_packages

if TYPE_CHECKING:
    from bowden.testing.can_bus import BusFrame, CanBus
    from bowden.testing.canopen_node import CanopenNode
    from bowden.testing.golden import assert_same_frames, assert_same_trial

_HOMES = {
    "BusFrame": "can_bus", "CanBus": "can_bus", "CanopenNode": "canopen_node", "assert_same_frames": "golden",
    "assert_same_trial": "golden",
}
"""Each public name and the module of this package that defines it."""

__all__ = ["BusFrame", "CanBus", "CanopenNode", "assert_same_frames", "assert_same_trial"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'bowden.testing' has no attribute {name!r}")
    hidden = own_packages.hidden()
    if hidden is not None:
        raise ImportError(f"bowden.testing.{name}: {hidden}")
    found = getattr(importlib.import_module(f"bowden.testing.{_HOMES[name]}"), name)
    globals()[name] = found
    return found
