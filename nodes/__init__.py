"""CANopen devices, sans-IO: the core (CiA 301), the drives (CiA 402), the sensors (CiA 404), I/O (CiA 401).

The rule of this room: frames, samples and times go in, frames and torques come out; no clock, no bus, no thread.

Start reading in `nodes.core.device`: one device from frames in to frames out; `nodes.drives` and `nodes.sensors` add
profiles.
"""

import importlib
from typing import TYPE_CHECKING, Any

from nodes.core.application import ProfileHost
from nodes.core.device import Application, Device
from nodes.drives.generic_drive import GenericDrive
from nodes.io_module import IoModule
from parameters import extras

if TYPE_CHECKING:
    from nodes.bench_devices import APPLICATIONS, build
    from nodes.drives.axis_law import prepare
    from nodes.drives.drive import Drive, KneeDrive
    from nodes.drives.servo import ServoDrive
    from nodes.sensors.joint_encoder import JointEncoder
    from nodes.sensors.tension_sensor import TensionSensor

_HOMES = {
    "APPLICATIONS": "bench_devices", "Drive": "drives.drive", "JointEncoder": "sensors.joint_encoder",
    "KneeDrive": "drives.drive", "ServoDrive": "drives.servo", "TensionSensor": "sensors.tension_sensor",
    "build": "bench_devices", "prepare": "drives.axis_law",
}
"""Names whose modules are compiled, and so are imported when they are first used."""

__all__ = ["APPLICATIONS", "Application", "Device", "Drive", "GenericDrive", "IoModule", "JointEncoder", "KneeDrive",
           "ProfileHost", "ServoDrive", "TensionSensor", "build", "prepare"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'nodes' has no attribute {name!r}")
    try:
        found = getattr(importlib.import_module(f"nodes.{_HOMES[name]}"), name)
    except ModuleNotFoundError as error:
        raise extras.refusal(error) from None
    globals()[name] = found
    return found
