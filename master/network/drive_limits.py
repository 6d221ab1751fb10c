"""Limits in the drives themselves: bring-up writes them and reads them back, so that they hold without the master.

Each value is the master's limit with a margin, and never more than the device's own file declares. With the margin a
trial that the master would let pass is not stopped by a drive; a limit that was lowered for a person is lowered in
the drives, too.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from eds.bench.bench_network import NodeEntry, WireLayout
from eds.device_mapping import ServoMapping
from eds.dictionary import Entry, key
from eds.scale_factors import gear_ratio, scales, torque_unit
from master.own_limits import by_path
from master.settings import Limits
from parameters import InputError

YIELD_MARGIN: Final = 1.1
"""Tension at which the drum pays out, over the master's limit of START: a tenth, so that the master's stop, which
unwinds in order, comes first. Larger values hold a limb longer at a tension that nobody asked for."""
TRIP_MARGIN: Final = 1.2
"""Tension at which the drive faults, over the master's limit of START: a tenth beyond the paying out."""
SPEED_MARGIN: Final = 1.125
"""Speed limit of a drive over the master's: the knee drive's 900 degrees a second over the master's 14 rad/s."""
ANGLE_MARGIN_RAD: Final = math.radians(3.0)
"""Angle by which a knee drive's range exceeds the master's: 3 degrees. The master's stop comes first, and both stay
within the 5 degrees that a person's range allows a monitor."""
TORQUE_MARGIN_N: Final = 80.0
"""Rope force beyond the master's limit of START that a servo's torque may give: it accelerates the rotor and overcomes
the drive's friction. 120 N and 80 N make the 4 N·m of the packaged drive."""
UNHELD_SHARE: Final = 0.5
"""Rope force of a servo without a tension limit of its own, over the master's limit of START: a force that is applied
suddenly to a rope at rest swings to twice its static tension (docs/safety.md, a stage that conducts)."""
FOLLOWING_M: Final = 5e-3
FOLLOWING_RAD: Final = math.radians(5.0)
FOLLOWING_S: Final = 0.1
"""Following error of rope and joint, and the time for which it may last: those of the packaged drives, which healthy
trials stay below (docs/safety.md, false alarms: servo 0.68 and knee 0.52 of a narrower tolerance)."""
SERVO_RANGE_M: Final = 0.2
"""Rope position range on both sides of zero: that of the packaged drive; homing takes up 0.12 m at most."""
_UNLIMITED: Final = 0


@dataclass(frozen=True, slots=True)
class DriveLimit:
    """One object of a drive that holds a limit: its safety function, the object, its raw value, the value in words."""

    function: str
    index: int
    subindex: int
    value: int
    text: str


@dataclass(frozen=True, slots=True)
class _LimitTarget:
    """A limit in SI that an object is to hold; `scale` is SI per count, None where the device does not declare it.

    `low`: the object bounds a range from below.
    """

    function: str
    index: int
    subindex: int
    si: float
    scale: float | None
    unit: str
    low: bool = False


TENSION, TORQUE, SPEED = "START tension", "torque", "speed"
FOLLOWING, RANGE = "following error", "position range"


def drive_limits(wire: WireLayout, limits: Limits) -> dict[int, list[DriveLimit]]:
    """Return the limits that each drive is to hold, by node id, in the order in which they are written.

    An object that the drive lacks, or whose unit its file does not declare, is left out: the drive holds no such limit.
    """
    found = {}
    for node in wire.drives:
        entry = wire.nodes[node]
        wanted = (_of_rope if isinstance(entry.fitting, ServoMapping) else _of_joint)(wire, node, limits)
        found[node] = [limit for one in wanted if (limit := _made(entry, one)) is not None]
    return found


def _of_rope(wire: WireLayout, node: int, limits: Limits) -> Iterator[_LimitTarget]:
    """Yield the limits of a rope drive; those of its force path."""
    bench, entry = wire.network.bench, wire.nodes[node]
    path = next(path for path in bench.force_paths if bench.named(path.actuator).node_id == node)
    own = by_path(limits, bench)[path.name]
    position, torque = entry.part("position").scale, entry.part("torque").scale
    fitting = entry.fitting
    assert isinstance(fitting, ServoMapping)
    held = bool(fitting.tension and path.start) and has_tension_limit(entry)
    if held:
        yield _LimitTarget(TENSION, 0x2012, 0, YIELD_MARGIN * own.start_n, fitting.tension_scale, "N")
        yield _LimitTarget(TENSION, 0x2013, 0, TRIP_MARGIN * own.start_n, fitting.tension_scale, "N")
    yield from _following(entry, FOLLOWING_M, position, "m")
    force_n = own.start_n + TORQUE_MARGIN_N if held else UNHELD_SHARE * own.start_n
    yield from _torque(force_n * _radius_m(entry), torque, "N·m")
    yield from _speed(entry, SPEED_MARGIN * own.rope_m_s, position, "m/s")
    yield from _range((-SERVO_RANGE_M, SERVO_RANGE_M), position, "m")


def _of_joint(wire: WireLayout, node: int, limits: Limits) -> Iterator[_LimitTarget]:
    """Yield the limits of a joint drive: the widest of the force paths over that joint."""
    bench, entry = wire.network.bench, wire.nodes[node]
    joint = next(joint for joint in bench.joints if joint.driven_by == entry.name)
    own = [by_path(limits, bench)[path.name] for path in bench.force_paths if path.joint == joint.name] or [limits]
    position = entry.part("position").scale
    yield from _following(entry, FOLLOWING_RAD, position, "rad")
    yield from _torque(max(one.knee_n_m for one in own), _joint_torque(entry), "N·m")
    yield from _speed(entry, SPEED_MARGIN * max(one.knee_rad_s for one in own), position, "rad/s")
    yield from _range((min(one.knee_low_rad for one in own) - ANGLE_MARGIN_RAD,
                       max(one.knee_high_rad for one in own) + ANGLE_MARGIN_RAD), position, "rad")


def has_tension_limit(entry: NodeEntry) -> bool:
    """Return whether a rope drive watches START's tension itself: both objects of its limit are there."""
    return all(key(index) in entry.dictionary.entries for index in (0x2012, 0x2013))


def _following(entry: NodeEntry, window: float, position: float, unit: str) -> Iterator[_LimitTarget]:
    yield _LimitTarget(FOLLOWING, 0x6065, 0, window, abs(position), unit)
    yield _LimitTarget(FOLLOWING, 0x6066, 0, FOLLOWING_S, 1e-3, "s")


def _torque(torque: float, scale: float | None, unit: str) -> Iterator[_LimitTarget]:
    for index in (0x6072, 0x60E0, 0x60E1):
        yield _LimitTarget(TORQUE, index, 0, torque, None if scale is None else abs(scale), unit)


def _speed(entry: NodeEntry, speed: float, position: float, unit: str) -> Iterator[_LimitTarget]:
    declared = _quantity(lambda: scales(entry.dictionary).get(key(0x607F)))
    yield _LimitTarget(SPEED, 0x607F, 0, speed, abs(declared or position), unit)
    yield _LimitTarget(SPEED, 0x6080, 0, speed, _quantity(lambda: _motor_speed(entry)), unit)


def _range(ends: tuple[float, float], position: float, unit: str) -> Iterator[_LimitTarget]:
    low, high = ends if position > 0.0 else ends[::-1]
    yield _LimitTarget(RANGE, 0x607D, 1, low, position, unit, low=True)
    yield _LimitTarget(RANGE, 0x607D, 2, high, position, unit)


def _motor_speed(entry: NodeEntry) -> float:
    """Return the speed of rope or joint, SI, per 1/min of the motor (CiA 402-2, 0x6091 and 0x6092)."""
    device = entry.dictionary
    per_turn = device.initial(0x6092, 1) / device.initial(0x6092, 2) * abs(entry.part("position").scale)
    return per_turn / gear_ratio(device) / 60.0


def _radius_m(entry: NodeEntry) -> float:
    """Return the drum's radius by the drive's feed constant; that of the packaged drive where it declares none."""
    return _quantity(lambda: _motor_speed(entry) * 60.0 * gear_ratio(entry.dictionary) / (2.0 * math.pi)) or 0.02


def _joint_torque(entry: NodeEntry) -> float | None:
    """Return the torque at the joint, N·m, per count; None where the drive's file does not declare it."""
    return _quantity(lambda: torque_unit(entry.dictionary) * gear_ratio(entry.dictionary))


def _quantity(compute: Callable[[], float | None]) -> float | None:
    """Return a positive quantity; None where the device's file lacks an object that declares it."""
    try:
        found = compute()
    except (InputError, ZeroDivisionError):
        return None
    return found if found else None


def _made(entry: NodeEntry, wanted: _LimitTarget) -> DriveLimit | None:
    """Return a limit in counts, no wider than the device's file declares; None for an object that cannot hold it."""
    declared = entry.dictionary.entries.get(key(wanted.index, wanted.subindex))
    if declared is None or not declared.writable or not declared.data_type.integer or wanted.scale is None:
        return None
    narrower = max if wanted.low else min
    value = narrower(round(wanted.si / wanted.scale), *_declared(declared, wanted.low))
    shown = value * wanted.scale
    if wanted.unit == "rad":
        text = f"{math.degrees(shown):.4g}°"
    elif wanted.unit == "rad/s":
        text = f"{shown:.4g} rad/s"
    else:
        text = f"{shown:.4g} {wanted.unit}"
    return DriveLimit(wanted.function, wanted.index, wanted.subindex, value, text)


def _declared(entry: Entry, low: bool) -> list[int]:
    """Return the bounds that a device's file has for an object: its type, its limit, and its value at power-on."""
    bounds = [entry.data_type.low if low else entry.data_type.high]
    stated = entry.low if low else entry.high
    if stated is not None:
        bounds.append(stated)
    if isinstance(initial := entry.initial, int) and initial != _UNLIMITED:
        bounds.append(initial)
    return bounds


def in_words(limits: Sequence[DriveLimit], function: str) -> str:
    """Return the objects that hold one safety function, with their values; "" where none does."""
    of_value: dict[str, list[str]] = {}
    for one in limits:
        if one.function == function:
            sub = f":{one.subindex:02X}" if one.subindex else ""
            of_value.setdefault(one.text, []).append(f"0x{one.index:04X}{sub}")
    return "; ".join(f"{' '.join(names)} {text}" for text, names in of_value.items())
