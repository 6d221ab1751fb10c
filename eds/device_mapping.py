"""Mapping of a device to its place on the bench: its file, the objects that play each part, their units.

The bench names parts (position, target, torque …); a mapping names the object of the device that plays each. The
defaults are the profile's objects, whose units the device declares.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from eds.dictionary import Dictionary, Entry
from eds.files.notation import number
from eds.scale_factors import scales
from parameters import InputError, parameter

_OBJECT: Final = "as index or index:sub-index in hexadecimal"
_FILE: Final = "EDS or DCF of the device; empty: the one that ships with this project"


def _part(default: str, text: str) -> str:
    part: str = parameter(default, "", f"object of {text}, {_OBJECT}", source="CiA 402-2 and CiA 404")
    return part


def _scale(unit: str, text: str) -> float:
    scale: float = parameter(0.0, unit, f"{text}; 0: as the device's unit objects say", low=-1e3, high=1e3,
                             source="the device's manual")
    return scale


@dataclass(frozen=True)
class ServoMapping:
    """`[servo]` of the configuration."""

    file: str = parameter("", "", _FILE, source="the device's maker")
    statusword: str = _part("6041", "the statusword")
    controlword: str = _part("6040", "the controlword")
    position: str = _part("6064", "the actual rope position")
    target: str = _part("607A", "the target rope position")
    torque: str = _part("6077", "the actual torque")
    tension: str = _part("2011", "START's tension, which the drive watches itself; empty: it cannot")
    position_scale: float = _scale("m", "rope per count of position and target")
    torque_scale: float = _scale("N·m", "torque at the drum per count of torque")
    tension_scale: float = parameter(0.01, "N", "tension per count of tension", low=1e-6, high=1e3,
                                     source="comments of servo_drive.eds")


@dataclass(frozen=True)
class KneeMapping:
    """`[knee]` of the configuration."""

    file: str = parameter("", "", _FILE, source="the device's maker")
    statusword: str = _part("6041", "the statusword")
    controlword: str = _part("6040", "the controlword")
    position: str = _part("6064", "the actual knee position")
    target: str = _part("607A", "the target knee position")
    position_scale: float = _scale("rad", "knee angle per count of position and target")


@dataclass(frozen=True)
class SensorMapping:
    """Keys of the `[[device]]` of a START or END load cell."""

    file: str = parameter("", "", _FILE, source="the device's maker")
    value: str = _part("7130:01", "the tension")
    value_scale: float = _scale("N", "tension per count of value")


@dataclass(frozen=True)
class EncoderMapping:
    """Keys of the `[[device]]` of a joint encoder."""

    file: str = parameter("", "", _FILE, source="the device's maker")
    position: str = parameter("6020:01", "", f"object of the joint's angle, {_OBJECT}", source="CiA 406")
    position_scale: float = parameter(
        2.0 * math.pi / 65536.0, "rad", "angle of the joint per count; negative where the encoder counts flexion",
        low=-1.0, high=1.0, source="0x6001 of joint_encoder.eds: 65536 counts per revolution")


DeviceMapping = ServoMapping | KneeMapping | SensorMapping | EncoderMapping

_SCALED_BY: Final = {"position": "position_scale", "target": "position_scale", "torque": "torque_scale",
                     "tension": "tension_scale", "value": "value_scale"}


_TAKEN: Final = ("target", "controlword", "tension")
"""Objects that a device receives from the bus; all others it sends."""


class MappedPart(NamedTuple):
    """A part and the object that plays it; `scale` is SI per count."""

    entry: Entry
    scale: float

    @property
    def word(self) -> int:
        """PDO mapping entry: index, sub-index and length in bits as CiA 301 packs them."""
        return self.entry.key << 8 | self.entry.data_type.bits

    @property
    def dummy(self) -> int:
        """PDO mapping entry of a dummy object of the same length."""
        return self.entry.data_type << 16 | self.entry.data_type.bits

    def unit(self, symbol: str) -> str:
        """Return the value of one count, with its unit."""
        return f"{self.scale:g} {symbol} in {self.entry.data_type.name}"


def part(device: Dictionary, fitting: DeviceMapping, name: str) -> MappedPart:
    """Find the object that plays a part; `InputError` where it is missing, unfit for a PDO, or of no known unit."""
    given = str(getattr(fitting, name))
    index, _, sub = given.partition(":")
    at = number(f"0x{index}"), number(f"0x{sub or 0}")
    entry = None if None in at else device.entries.get((at[0] or 0) << 8 | (at[1] or 0))
    if entry is None:
        raise InputError(f"{device.path}: no object {given}, which should be the {name}; name another ({_OBJECT}).")
    if not entry.mappable or (name in _TAKEN and entry.access in ("ro", "const", "rwr")):
        raise InputError(f"{device.path}: {given} {entry.name}, which should be the {name}, has PDOMapping="
                         f"{int(entry.mappable)}, AccessType={entry.access}; name another ({_OBJECT}).")
    if name not in _SCALED_BY:
        return MappedPart(entry, 1.0)
    stated = float(getattr(fitting, _SCALED_BY[name]))
    scale = stated or scales(device).get(entry.key)
    if scale is None:
        raise InputError(f"{device.path}: the unit of {given} ({name}) is not declared; give {_SCALED_BY[name]}.")
    return MappedPart(entry, scale)
