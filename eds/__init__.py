"""The agreement on the wire: EDS files, profiles' numbers and tables, PDO plans, this bench's network.

The rule of this room: it imports nothing of ours but `parameters`, and no CAN library.
"""

from eds.bench import DRIVES, END, KNEE, MASTER, SENSORS, SERVO, START, NodeEntry, Wire, wire
from eds.datatype import DataType, Value
from eds.dictionary import Dictionary, Entry, key, packaged, read
from eds.fitting import Fitting, KneeFitting, SensorFitting, ServoFitting
from eds.frame import Frame
from eds.network import Network
from eds.plan import Field, PdoPlan, compile_plan

__all__ = [
    "DRIVES", "END", "KNEE", "MASTER", "SENSORS", "SERVO", "START",
    "DataType", "Dictionary", "Entry", "Field", "Fitting", "Frame", "KneeFitting", "Network", "NodeEntry", "PdoPlan",
    "SensorFitting", "ServoFitting", "Value", "Wire",
    "compile_plan", "key", "packaged", "read", "wire",
]
