"""Holders of each safety function of a bench: drive, master, monitor, or nobody.

One table for `bowden check config`, `bowden doctor` and the trial's file. What a drive holds is read from the limits
that bring-up writes into it; what a monitor holds comes from the monitor's own declaration.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from eds.bench.bench_network import MASTER, WireLayout
from eds.declaration import ForcePath, Joint
from eds.device_mapping import ServoMapping
from eds.dictionary import key
from master.cycle.reception import REACH_M
from master.network.drive_limits import (
    FOLLOWING,
    RANGE,
    SPEED,
    TENSION,
    TORQUE,
    DriveLimit,
    drive_limits,
    in_words,
)
from master.own_limits import by_path
from master.settings import Limits

NOBODY: Final = "nobody"
COLUMNS: Final = ("function", "of", "held by", "drive", "master", "monitor")


class HeldLimit(NamedTuple):
    """One safety function of a device, joint or force path, and the bound of each holder in words; "" holds nothing."""

    function: str
    of: str
    drive: str = ""
    master: str = ""
    monitor: str = ""

    @property
    def held_by(self) -> str:
        """Names of the holders, or `NOBODY`."""
        return ", ".join(name for name in ("drive", "master", "monitor") if getattr(self, name)) or NOBODY

    @property
    def cells(self) -> tuple[str, ...]:
        """Return the row in the order of `COLUMNS`."""
        return self.function, self.of, self.held_by, self.drive, self.master, self.monitor


def holders(wire: WireLayout, limits: Limits, monitor: Mapping[str, str] | None = None) -> list[HeldLimit]:
    """Return the table of a bench, path by path, then joint by joint.

    `monitor`: bound in words of each function that a declared monitor holds, by the function's name.
    """
    bench, held = wire.network.bench, drive_limits(wire, limits)
    rows = [row for path in bench.force_paths for row in _of_path(wire, path, limits, held)]
    rows += [row for joint in bench.joints for row in _of_joint(wire, joint, limits, held)]
    return [row._replace(monitor=(monitor or {}).get(row.function, "")) for row in rows]


def unheld(rows: list[HeldLimit]) -> list[str]:
    """Return, in words, the safety functions that nobody holds."""
    return [f"{row.function} of {row.of}" for row in rows if row.held_by == NOBODY]


def _of_path(
    wire: WireLayout, path: ForcePath, limits: Limits, held: Mapping[int, list[DriveLimit]]
) -> Iterator[HeldLimit]:
    bench = wire.network.bench
    own, node = by_path(limits, bench)[path.name], bench.named(path.actuator).node_id
    mine = held[node]
    tension = in_words(mine, TENSION)
    yield HeldLimit("START tension", path.name, tension, f"{own.start_n:g} N")
    yield HeldLimit("START tension without the master", path.name, tension)
    yield HeldLimit("END tension", path.name, "", f"{own.end_n:g} N" if path.end else f"{own.start_n:g} N at START")
    yield HeldLimit("torque of the rope drive", path.name, in_words(mine, TORQUE))
    yield HeldLimit("rope speed", path.name, in_words(mine, SPEED), f"{own.rope_m_s:g} m/s")
    yield HeldLimit("rope position", path.name, in_words(mine, RANGE), f"± {REACH_M:g} m of plausible reading")
    yield HeldLimit("rope following error", path.name, in_words(mine, FOLLOWING), "against the answer of the loop")
    fitting = wire.nodes[node].fitting
    deadline = wire.network.start_deadline_ms if isinstance(fitting, ServoMapping) and fitting.tension else 0
    yield HeldLimit("START lost", path.name, f"0x1402:05 {deadline} ms" if deadline and path.start else "",
                    f"{own.stale_cycles} cycles")
    yield from _watchdogs(wire, node)


def _of_joint(
    wire: WireLayout, joint: Joint, limits: Limits, held: Mapping[int, list[DriveLimit]]
) -> Iterator[HeldLimit]:
    bench = wire.network.bench
    own = next((by_path(limits, bench)[path.name] for path in bench.force_paths if path.joint == joint.name), limits)
    node = bench.named(joint.driven_by).node_id if joint.driven_by else 0
    mine = held.get(node, [])
    yield HeldLimit("knee angle", joint.name, in_words(mine, RANGE),
                    f"{math.degrees(own.knee_low_rad):.4g}° … {math.degrees(own.knee_high_rad):.4g}°")
    yield HeldLimit("knee speed", joint.name, in_words(mine, SPEED), f"{own.knee_rad_s:g} rad/s")
    if node:
        yield HeldLimit("torque of the joint drive", joint.name, in_words(mine, TORQUE))
        yield HeldLimit("knee following error", joint.name, in_words(mine, FOLLOWING), "against the target")
        yield from _watchdogs(wire, node)


def _watchdogs(wire: WireLayout, node: int) -> Iterator[HeldLimit]:
    """Yield the watchdogs of a drive; bring-up refuses a drive without a heartbeat consumer."""
    entry, network = wire.nodes[node], wire.network
    yield HeldLimit("master lost", entry.name, f"0x1016 node {MASTER} {network.heartbeat_timeout_ms} ms")
    deadline = network.targets_deadline_ms if key(0x1400, 5) in entry.dictionary.entries else 0
    yield HeldLimit("targets lost", entry.name, f"0x1400:05 {deadline} ms" if deadline else "")

