"""Limits of single devices, joints and force paths of a bench: which ones exist, and those that hold on each path.

`[limits]` of a configuration is for the whole bench; `[limits.<name>]` replaces some of its values for one device,
joint or force path.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from eds.declaration import EXTENDS, MIRROR_RAD, DeclaredBench, ForcePath
from master.settings import Limits, OwnLimit
from parameters import InputError, from_table

DRIVE_LIMITS: Final = ("rope_m_s", "unwind_m_s")
START_LIMITS: Final = ("start_n", "unwound_n")
END_LIMITS: Final = ("end_n",)
JOINT_LIMITS: Final = ("knee_low_rad", "knee_high_rad", "knee_rad_s", "knee_n_m")
PATH_LIMITS: Final = (*START_LIMITS, *END_LIMITS, *DRIVE_LIMITS, "unwind_s", "progress_ms")
"""Limits that a rope drive, a START or END load cell, a joint and a force path may have as their own."""


def of_path(limits: Limits, bench: DeclaredBench, path: ForcePath) -> Limits:
    """Return the limits of one force path: its own, those of its devices and its joint, and else the bench's."""
    held = _held(bench, path)
    mine: dict[str, Any] = {own.name: own.value for own in limits.own if own.name in held.get(own.of, ())}
    return dataclasses.replace(limits, own=(), **mine)


def counted(limits: Limits, bench: DeclaredBench, path: ForcePath) -> Limits:
    """Return the limits of one force path, with the joint's angles as the path counts them: mirrored or not."""
    found = of_path(limits, bench, path)
    if path.acts != EXTENDS:
        return found
    return dataclasses.replace(found, knee_low_rad=MIRROR_RAD - found.knee_high_rad,
                               knee_high_rad=MIRROR_RAD - found.knee_low_rad)


def by_path(limits: Limits, bench: DeclaredBench) -> dict[str, Limits]:
    """Return the limits of every force path, by its name."""
    return {path.name: of_path(limits, bench, path) for path in bench.force_paths}


def checked(tables: Mapping[str, Mapping[str, Any]], bench: DeclaredBench, *, where: str) -> tuple[OwnLimit, ...]:
    """Return the limits of single devices, joints and force paths of the tables `[limits.<name>]`.

    Raises `InputError` for a name that the bench does not have, a limit that the named thing does not have, a value
    out of its bounds, and a limit that a path is given twice.
    """
    held: dict[str, dict[str, None]] = {}
    for path in bench.force_paths:
        for of, names in _held(bench, path).items():
            held.setdefault(of, {}).update(dict.fromkeys(names))
    found = []
    for of, table in tables.items():
        at = f"{where} [limits.{of}]"
        if of not in held:
            raise InputError(f"{at}: the bench has no device, joint or force path {of} with limits; expected one of "
                             f"{', '.join(held)}.")
        for name in table:
            if name not in held[of]:
                raise InputError(f"{at}: {name} is no limit of {of}; expected one of {', '.join(held[of])}.")
        given = from_table(Limits, table, where=at)
        found += [OwnLimit(of, name, getattr(given, name)) for name in table]
    for path in bench.force_paths:
        _refuse_twice(found, bench, path, where)
    return tuple(found)


def _held(bench: DeclaredBench, path: ForcePath) -> dict[str, tuple[str, ...]]:
    """Return the names of the limits that a force path, its devices and its joint may declare, by name of each."""
    joint = next(joint for joint in bench.joints if joint.name == path.joint)
    found: dict[str, dict[str, None]] = {}
    for of, names in ((path.name, PATH_LIMITS), (path.actuator, DRIVE_LIMITS), (path.start, START_LIMITS),
                      (path.end, END_LIMITS), (joint.name, JOINT_LIMITS), (joint.device, JOINT_LIMITS)):
        if of:
            found.setdefault(of, {}).update(dict.fromkeys(names))
    return {of: tuple(names) for of, names in found.items()}


def _refuse_twice(found: list[OwnLimit], bench: DeclaredBench, path: ForcePath, where: str) -> None:
    held, given = _held(bench, path), dict[str, OwnLimit]()
    for own in found:
        if own.name in held.get(own.of, ()):
            other = given.setdefault(own.name, own)
            if other is not own:
                raise InputError(f"{where}: limits.{other.of}.{own.name} and limits.{own.of}.{own.name} are both of "
                                 f"the force path {path.name}; leave one out.")
