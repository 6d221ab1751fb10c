"""Options of `can.Bus(interface="bowden", …)`, declared once.

An option may be text, from `can.conf` or a command line, or a value.
"""

import dataclasses
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eds.bench.bench_network import Network
from parameters import from_table, parameter
from virtual_bus.wire.faults import Fault

LARGEST = 2**31 - 1
NETWORK = Network()


@dataclass(frozen=True)
class Options:
    """Options of a simulated bench; the first bus opened on a channel sets them for all others on it."""

    bitrate: int = parameter(NETWORK.bitrate, "bit/s", "bit rate", low=125_000, high=1_000_000,
                             source="[network] bitrate")
    rate_hz: int = parameter(NETWORK.rate_hz, "Hz", "SYNC frames per second the bench is laid out for", low=10,
                             high=2000, source="[network] rate_hz")
    serial: int = parameter(1, "", "serial number of the bench, 0 for the nominal one", low=0, high=LARGEST,
                            source="draws the manufacturing tolerances")
    day: int = parameter(0, "", "day of the bench, 0 for that of its making", low=0, high=LARGEST,
                         source="draws what changes from day to day")
    seed: int = parameter(0, "", "seed of the noise and of the faults' chances", low=0, high=LARGEST,
                          source="one seed, one trial")
    steady: str | Sequence[str] = parameter(
        (), "", "what the day leaves as it was: names of its table, such as plant.mu1, or their text with commas",
        source="virtual_bus/machine/scatter.py, DAY")
    plant: str = parameter("bowden", "", "plant, by its name in the entry-point group bowden.plants",
                           source="docs/plants.md")
    plant_model: str | Mapping[str, float] | None = parameter(
        None, "", "plant parameters in place of nominal ones: a TOML file or a table", source="PlantParameters")
    declaration: str | Mapping[str, Any] | None = parameter(
        None, "", "declared bench: a TOML file with [[device]], [[joint]] and [[force_path]], or these tables; None is "
        "the packaged bench", source="docs/bench.md")
    truth: str | None = parameter(None, "", "file to write what no device feels to; None writes none",
                                  source="trial.truth.mcap")
    faults: str | Sequence[Fault | Mapping[str, Any]] = parameter(
        (), "", "faults of the wire: a TOML file of [[fault]] tables or the tables",
        source="virtual_bus/wire/faults.py")
    master_turnaround_us: int = parameter(
        NETWORK.compute_budget_us, "µs", "time from what the master hears to the frame it answers with", low=0,
        high=100_000, source="[network] compute_budget_us")
    node_turnaround_us: int = parameter(
        NETWORK.node_turnaround_us, "µs", "time from what a node hears to the frame it answers with", low=0,
        high=10_000, source="[network] node_turnaround_us")
    hand_lag_ms: int = parameter(
        20, "ms", "lag of the hand behind the asked angle, on a bench without a knee drive", low=0, high=1000,
        source="assumed: a machine that is told the angle; an operator at a display has 100 ms and more")
    monitor: str | None = parameter(
        None, "", "file with the bounds of one person; a safety monitor is then on the bench, None is none",
        source="docs/safety.md")
    sto_us: int = parameter(5_000, "µs", "time from the opened enable line (STO) until the drives give no torque",
                            low=0, high=100_000, source="assumed: 5 ms at most of item BL 1-04/C (its manual, "
                            "response time); HIWIN D1-N has 6 to 10 ms, Engel HFI 20 ms")
    hand: Mapping[str, float] | None = parameter(
        None, "", "what the hand of a set-up check does: weights start_n and end_n on the load cells, or the knee "
        "at knee_rad by a goniometer", source="bowden check bench")
    tx_queue: int = parameter(64, "frame", "frames that wait for the wire in the computer", low=1, high=100_000,
                              source="ip link set can0 txqueuelen 64")
    restart_ms: int = parameter(100, "ms", "time after bus-off until the computer's controller restarts", low=0,
                                high=1_000_000, source="ip link set can0 type can restart-ms 100")


def options(given: Mapping[str, Any], where: str) -> Options:
    """Check options, turning the text of numbers into numbers; raises `InputError` that begins with `where`."""
    hints = typing.get_type_hints(Options)
    names = {field.name for field in dataclasses.fields(Options)}
    return from_table(
        Options, {name: _number(value, hints[name] if name in names else str) for name, value in given.items()},
        where=where,
    )


def _number(value: Any, hint: object) -> Any:
    if hint is int and isinstance(value, str):
        try:
            return int(value, 0)
        except ValueError:
            return value
    return value
