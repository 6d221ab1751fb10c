"""Raw counts ↔ SI, from the devices' own unit objects.

No scale is written down twice. A plan's factors come from 0x608F, 0x6091, 0x6092, 0x60A8, 0x60A9, 0x6076, 0x6131 and
0x6132 of the dictionary, whoever made the device.
"""

import math
from collections.abc import Iterator
from typing import Final

from eds.dictionary import Dictionary, key
from parameters import InputError

_PREFIXES: Final = {n & 0xFF: 10.0 ** n for n in (-9, -6, -3, -2, -1, 0, 1, 2, 3, 6, 9)}
"""CiA 303-2 prefixes: a power of ten in a signed byte."""
_UNITS: Final = {
    0x01: 1.0,
    0x10: 1.0,
    0x21: 1.0,
    0x41: math.pi / 180.0,
    0x42: math.pi / 10_800.0,
    0x43: math.pi / 648_000.0,
    0xB4: 2.0 * math.pi,
}
"""CiA 303-2 unit codes met here: metre, radian, newton, degree, minute and second of arc, revolution."""
_TIMES: Final = {0x03: 1.0, 0x47: 60.0}
"""Denominators: second, minute."""

_POSITIONS: Final = (0x6062, 0x6064, 0x6065, 0x607A, 0x607C, 0x60B0, 0x60F4)
_VELOCITIES: Final = (0x606B, 0x606C, 0x606D, 0x606F, 0x607F, 0x6081, 0x60B1, 0x60FF)
_TORQUES: Final = (0x6071, 0x6072, 0x6074, 0x6077, 0x60B2, 0x60E0, 0x60E1)


def position_unit(dictionary: Dictionary) -> float:
    """Metres or radians per position unit, from 0x60A8."""
    return _unit(dictionary, 0x60A8)


def velocity_unit(dictionary: Dictionary) -> float:
    """m/s or rad/s per velocity unit: from 0x60A9, or position units per second where the device has none."""
    return _unit(dictionary, 0x60A9) if key(0x60A9) in dictionary.entries else position_unit(dictionary)


def torque_unit(dictionary: Dictionary) -> float:
    """N·m at the motor shaft per count of a torque object: a thousandth of 0x6076 (mN·m)."""
    return dictionary.initial(0x6076) * 1e-6


def increments_per_unit(dictionary: Dictionary) -> float:
    """Encoder increments per position unit (CiA 402-2: 0x608F × 0x6091 ÷ 0x6092)."""
    def ratio(index: int) -> float:
        return dictionary.initial(index, 1) / dictionary.initial(index, 2)

    return ratio(0x608F) * ratio(0x6091) / ratio(0x6092)


def drum_radius_m(dictionary: Dictionary) -> float:
    """Radius of the drum that turns the driving shaft into rope, from the feed constant 0x6092 (linear drives)."""
    feed = dictionary.initial(0x6092, 1) / dictionary.initial(0x6092, 2)
    return feed * position_unit(dictionary) / (2.0 * math.pi)


def gear_ratio(dictionary: Dictionary) -> float:
    """Motor revolutions per shaft revolution (0x6091)."""
    return dictionary.initial(0x6091, 1) / dictionary.initial(0x6091, 2)


def process_value_unit(dictionary: Dictionary) -> float:
    """Newtons per count of 0x7130 and 0x9130: the unit 0x6131 with the decimals 0x6132."""
    return _unit(dictionary, 0x6131, 1) * 10.0 ** -dictionary.initial(0x6132, 1)


def scales(dictionary: Dictionary) -> dict[int, float]:
    """SI per raw count of every object whose unit the device declares, by key; torques in N·m at the motor shaft."""
    return dict(_scales(dictionary))


_SYMBOLS: Final = {0x01: "m", 0x10: "rad", 0x21: "N", 0x41: "rad", 0x42: "rad", 0x43: "rad", 0xB4: "rad"}
"""SI unit of the numerators of `_UNITS`."""
UNIT_OBJECTS: Final = ((0x60A8, 0), (0x60A9, 0), (0x6076, 0), (0x6131, 1), (0x6132, 1))
"""Objects that declare a device's units."""


def units(dictionary: Dictionary) -> dict[int, tuple[float, str]]:
    """SI per raw count and SI unit of every object whose unit the device declares, by key.

    Objects with an unsupported unit word, such as 0, are left out.
    """
    found: dict[int, tuple[float, str]] = {}
    has = dictionary.entries.__contains__
    for indices, index, subindex, per_second, factor in (
        (_POSITIONS, 0x60A8, 0, "", position_unit), (_VELOCITIES, 0x60A9 if has(key(0x60A9)) else 0x60A8, 0, "/s",
                                                     velocity_unit),
        ((0x7130, 0x9130), 0x6131, 1, "", process_value_unit),
    ):
        if has(key(index, subindex)):
            try:
                scale = factor(dictionary)
            except InputError:
                continue
            symbol = _SYMBOLS.get(dictionary.initial(index, subindex) >> 16 & 0xFF, "") + per_second
            found.update({key(at, subindex): (scale, symbol) for at in indices})
    if has(key(0x6076)) and dictionary.initial(0x6076):
        found.update({key(at): (torque_unit(dictionary), "N·m") for at in _TORQUES})
    return found


def _scales(dictionary: Dictionary) -> Iterator[tuple[int, float]]:
    has = dictionary.entries.__contains__
    if has(key(0x60A8)):
        yield from ((key(index), position_unit(dictionary)) for index in _POSITIONS)
        yield from ((key(index), velocity_unit(dictionary)) for index in _VELOCITIES)
    if has(key(0x6076)):
        yield from ((key(index), torque_unit(dictionary)) for index in _TORQUES)
    if has(key(0x6131, 1)):
        yield from ((key(index, 1), process_value_unit(dictionary)) for index in (0x7130, 0x9130))


def _unit(dictionary: Dictionary, index: int, subindex: int = 0) -> float:
    """Read a CiA 303-2 unit word: prefix, numerator, denominator, reserved, from the top byte down."""
    word = dictionary.initial(index, subindex)
    prefix, numerator, denominator = word >> 24 & 0xFF, word >> 16 & 0xFF, word >> 8 & 0xFF
    time = _TIMES.get(denominator) if denominator else 1.0
    if prefix not in _PREFIXES or numerator not in _UNITS or time is None:
        raise InputError(f"{dictionary.path}: {index:04X} = {word:08X}h is no unit known here; expected metre, radian, "
                         "degree, revolution or newton with an SI prefix, or that per second or minute.")
    return _PREFIXES[prefix] * _UNITS[numerator] / time
