"""The devices of a declared bench: each declared type with the application behind it."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from eds.bench.bench_network import WireLayout
from eds.declaration import JOINT_DRIVE, JOINT_ENCODER, LOAD_CELL, ROPE_DRIVE
from nodes.core.device import Application, Device
from nodes.drives.drive import KneeDrive
from nodes.drives.servo import ServoDrive
from nodes.sensors.joint_encoder import JointEncoder
from nodes.sensors.tension_sensor import TensionSensor
from parameters import InputError

APPLICATIONS: Final[Mapping[str, Callable[[], Application]]] = MappingProxyType(
    {ROPE_DRIVE.name: ServoDrive, JOINT_DRIVE.name: KneeDrive, LOAD_CELL.name: TensionSensor,
     JOINT_ENCODER.name: JointEncoder})
"""The application behind a simulated device of each declared type."""


def build(node_id: int, wire: WireLayout) -> tuple[Device, Application]:
    """Make the bench's device `node_id`, not yet powered on, and the application behind it.

    Raises `InputError` for a node id that is no device of the bench.
    """
    declared = next((device for device in wire.network.bench.devices if device.node_id == node_id), None)
    if declared is None:
        raise InputError(f"node {node_id} is no device of this bench; expected one of {sorted(wire.nodes)}.")
    kind = declared.type
    made = APPLICATIONS[kind.name]() if kind.name in APPLICATIONS else (kind.application or Application)()
    return Device(wire.nodes[node_id].dictionary, node_id, made), made
