"""Rotary encoder of CiA 406 as a device type of the bench: its wire, its signal, and its simulated device."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from eds.declaration import DeviceType, ObservedPart
from eds.dictionary import key
from nodes import Application, ProfileHost
from parameters import parameter
from physics.plant.bench_plant import Outputs

POSITION = key(0x6004)
COUNT_RAD = 2.0 * math.pi / 65_536
"""One count of a 16-bit single-turn encoder, rad."""


@dataclass(frozen=True)
class EncoderMapping:
    """Keys of an encoder's `[[device]]`."""

    file: str = parameter("", "", "EDS or DCF of the device; empty: that of this package", source="its maker")
    position: str = parameter("6004", "", "object of the position value", source="CiA 406")
    position_scale: float = parameter(COUNT_RAD, "rad", "angle per count", low=1e-9, high=1.0, source="its data sheet")


class Encoder(Application):
    """Simulated encoder on the knee; it counts flexion, from 0."""

    def attach(self, device: ProfileHost) -> None:
        """Keep the device's objects."""
        self.values = device.values
        self.flexion_rad = 0.0

    def feel(self, now_ns: int, felt: Outputs) -> None:
        """Take the knee angle of the plant; flexion is negative there."""
        self.flexion_rad = max(0.0, -felt.knee_angle_rad)

    def latch(self, now_ns: int) -> None:
        """Show the position, in counts, at SYNC and before an upload."""
        self.values[POSITION] = round(self.flexion_rad / COUNT_RAD)

    refresh = latch


def encoder() -> DeviceType:
    """Return the device type."""
    return DeviceType(
        "encoder_cia406", str(Path(__file__).with_name("encoder.eds")), EncoderMapping, ("position",),
        observed=(ObservedPart("position", "flexion_rad", "rad", "knee flexion by an encoder on the joint"),),
        application=Encoder)
