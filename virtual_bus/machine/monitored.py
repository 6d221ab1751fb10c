"""The safety monitor on a simulated bench: its own sensors, the enable line, and the drives' delay behind it.

The monitor's sensors are not those of the devices: what a device measures wrongly, the monitor measures rightly.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from eds.bench.bench_network import MASTER, MONITOR, WireLayout
from eds.declaration import ForcePath, mirrored_rad
from parameters import InputError
from safety_monitor import MonitorNode, PathInputs, PersonError, read
from virtual_bus.kernel import TIMER, Kernel
from virtual_bus.machine.machine import Machine, SwitchedPlant

CELL_N: Final = 200.0 / 4096
"""Quantisation step of a second load cell, N: 12 bits of 200 N; assumed."""
ANGLE_DEG: Final = 360.0 / 16384
"""Quantisation step of a second angle sensor, degrees: 14 bits of a turn; assumed."""

ROPE_M: Final = 2.0 * math.pi * 0.02 / 131072
"""Quantisation step of a second encoder at the drum, m of rope: 17 bits of a turn; assumed."""


class SensedPath(NamedTuple):
    """Readings of the monitor's own sensors on one force path."""

    path: ForcePath
    plant: SwitchedPlant


class EnableLine:
    """The monitor's sensors and its enable line; the machines of the bench are connected after it is made.

    The torque ends `delay_ns` after the line has opened: response time of a drive's STO input.
    """

    def __init__(self, delay_ns: int) -> None:
        self._delay_ns = delay_ns
        self._kernel: Kernel | None = None
        self._paths: Sequence[SensedPath] = ()
        self._machines: Sequence[Machine] = ()
        self.closed = True

    def join(self, kernel: Kernel, paths: Sequence[SensedPath], machines: Sequence[Machine]) -> None:
        """Connect the line to the machines of the bench, and the sensors to their plants."""
        self._kernel, self._paths, self._machines = kernel, paths, machines
        self.sensed(0)

    def sensed(self, now_ns: int) -> list[PathInputs]:
        """Return the monitor's own inputs, quantised, one row a force path."""
        del now_ns  # the plant stands at the tick of this instant
        found = []
        for path, plant in self._paths:
            start_n, end_n, angle_rad, rope_m = plant.second_sensors()
            degrees = math.degrees(mirrored_rad(path, angle_rad))
            found.append(PathInputs(_rounded(start_n, CELL_N), _rounded(end_n, CELL_N), _rounded(degrees, ANGLE_DEG),
                                    _rounded(rope_m, ROPE_M)))
        return found

    def switch(self, closed: bool) -> None:
        """Close or open the line; a drive acts on it after its response time."""
        if closed == self.closed or self._kernel is None:
            return
        self.closed = closed
        self._kernel.at(self._kernel.now_ns + self._delay_ns, TIMER, self._act)

    def _act(self) -> None:
        for machine in self._machines:
            machine.enable(self.closed)


def _rounded(value: float, step: float) -> float:
    return round(value / step) * step


def monitor(file: str, wire: WireLayout, line: EnableLine) -> MonitorNode:
    """Return the monitor of a bench with the bounds in a file; raises `InputError` for a file that cannot be used."""
    if MONITOR in wire.nodes:
        raise InputError(f"monitor {file}: node {MONITOR} is the safety monitor's, and the bench declares "
                         f"{wire.nodes[MONITOR].name} there; give the device another node id.")
    try:
        bounds = read(Path(file))
    except PersonError as error:
        raise InputError(f"monitor {error}") from None
    return MonitorNode(MONITOR, bounds, MASTER, wire.drives, line.sensed, line.switch)
