"""CANopen devices, sans-IO: the core (CiA 301), the drives (CiA 402), the tension sensors (CiA 404).

The rule of this room: frames, samples and times go in, frames and torques come out; no clock, no bus, no thread.
"""

from __future__ import annotations

from eds.bench_network import KNEE, SENSORS, SERVO, WireLayout
from nodes.axis_law import prepare
from nodes.core.device import Application, Device
from nodes.drive import Drive
from nodes.knee import KneeDrive
from nodes.servo import ServoDrive
from nodes.tension_sensor import TensionSensor
from parameters import InputError

__all__ = ["Application", "Device", "Drive", "KneeDrive", "ServoDrive", "TensionSensor", "build", "prepare"]


def build(node_id: int, wire: WireLayout) -> tuple[Device, Drive | TensionSensor]:
    """Make the bench's device `node_id`, not yet powered on, and the application behind it.

    Raises `InputError` for a node id that is no device of the bench.
    """
    made: Drive | TensionSensor
    if node_id == SERVO:
        made = ServoDrive()
    elif node_id == KNEE:
        made = KneeDrive()
    elif node_id in SENSORS:
        made = TensionSensor()
    else:
        raise InputError(f"node {node_id} is no device of this bench; expected one of {sorted(wire.nodes)}.")
    return Device(wire.nodes[node_id].dictionary, node_id, made), made
