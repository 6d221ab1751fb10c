"""Safety monitor: a CANopen node with sensors of its own that opens the enable line (STO) of the drives.

It shares no code with master, nodes and physics: it imports `eds` and the standard library alone. Sensor values and
heartbeats go in, the state of the enable line comes out; no bus, no clock, no thread. The bounds of one person are in
one file, whose SHA-256 digest the monitor reports. Start reading in `safety_monitor.node`.
"""

from safety_monitor.checks import CHECKS, MonitorState, PathInputs, step
from safety_monitor.node import MonitorNode
from safety_monitor.person import Bounds, PersonError, packaged, read

__all__ = ["CHECKS", "Bounds", "MonitorNode", "MonitorState", "PathInputs", "PersonError", "packaged", "read", "step"]
