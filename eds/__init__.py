"""The agreement on the wire: EDS files, profiles' numbers and tables, PDO plans, this bench's network.

The rule of this room: it imports nothing of ours but `parameters`, and no CAN library.

Start reading in `eds.dictionary` (a file), `eds.pdo_plan` (its PDOs) and `eds.bench.bench_network` (the bench's
wire).
"""

from eds.bench.bench_network import DRIVES, END, KNEE, MASTER, SENSORS, SERVO, START, NodeEntry, WireLayout, wire
from eds.bench.network import Network
from eds.cia301 import Frame
from eds.datatype import DataType, Value
from eds.device_mapping import DeviceMapping, KneeMapping, SensorMapping, ServoMapping
from eds.dictionary import Dictionary, Entry, key, packaged, read
from eds.pdo_plan import Field, PdoPlan, compile_plan

__all__ = [
    "DRIVES",
    "END",
    "KNEE",
    "MASTER",
    "SENSORS",
    "SERVO",
    "START",
    "DataType",
    "DeviceMapping",
    "Dictionary",
    "Entry",
    "Field",
    "Frame",
    "KneeMapping",
    "Network",
    "NodeEntry",
    "PdoPlan",
    "SensorMapping",
    "ServoMapping",
    "Value",
    "WireLayout",
    "compile_plan",
    "key",
    "packaged",
    "read",
    "wire",
]
