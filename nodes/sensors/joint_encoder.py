"""A joint encoder (CiA 406): the joint's angle in counts of a revolution, with direction and preset."""

import math
from typing import Final

from eds.datatype import Value
from eds.dictionary import key
from nodes.core.application import Application, ProfileHost
from physics.plant.bench_plant import Outputs

OPERATING, UNITS, POSITION = key(0x6000), key(0x6001), key(0x6004)
PRESET, SIGNED_POSITION = key(0x6010, 1), key(0x6020, 1)
REVERSED: Final = 1
"""Bit of 0x6000: counts fall while the angle rises."""


class JointEncoder(Application):
    """Encoder on a joint: `feel` sets the angle; a SYNC or an SDO upload reads it in counts."""

    watched = frozenset({PRESET})

    def attach(self, device: ProfileHost) -> None:
        """Initialise the objects; the joint is at 0."""
        super().attach(device)
        self.angle_rad = 0.0
        self._offset = 0

    def feel(self, now_ns: int, felt: Outputs) -> None:
        """Read the joint's angle from the plant's outputs."""
        self.angle_rad = felt.knee_angle_rad

    def written(self, key: int, value: Value, now_ns: int) -> None:
        """Apply a preset: the present joint angle reads this value from now on."""
        self._offset = int(value) - self._counts()

    def latch(self, now_ns: int) -> None:
        """Copy the position into its objects, signed and within one revolution."""
        counts = self._counts() + self._offset
        self.values[SIGNED_POSITION] = counts
        self.values[POSITION] = counts % int(self.values[UNITS])

    def refresh(self, now_ns: int) -> None:
        """Copy the position into its objects before an upload."""
        self.latch(now_ns)

    def _counts(self) -> int:
        turns = self.angle_rad / (2.0 * math.pi)
        return round((-turns if int(self.values[OPERATING]) & REVERSED else turns)
                     * int(self.values[UNITS]))
