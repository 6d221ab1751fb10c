"""Checks before a trial: computer, timer, interface, bus and nodes, one finding each.

Checks only read, nothing moves; a finding that is not good names the command to type. `soak` measures wake-ups and
SDO round trips (reads of 0x1000) over minutes.
"""

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from bowden.bench import buses, configuration
from bowden.bench.buses import BusSettings
from eds.bench.bench_network import Network, wire
from master.network import doctor as computer
from master.network.doctor import DoctorFinding
from master.network.doctor import bus as heard
from master.network.link import Link, LinkError
from master.network.sdo import SdoError

WATCHED_S = 5.0
"""Default duration of the timer check, s."""


def doctor(
    bus: BusSettings | None = None, *, seconds: float = WATCHED_S, config: str | Path | None = None,
) -> list[DoctorFinding]:
    """Return the findings of `bowden doctor` at a bus: item, whether it is good, observation, remedy.

    `bus`: `bowden.simulated(…)`, also the default, or `bowden.bus(…)`; `seconds`: duration of the timer check, s;
    `config`: a bench.toml. Raises `InputError` if the bus cannot be opened.
    """
    sections = configuration.read(None if config is None else Path(config))
    return list(examine(sections["network"], bus or buses.simulated(), seconds))


def examine(network: Network, chosen: BusSettings, seconds: float) -> Iterator[DoctorFinding]:
    """Yield the findings one by one; an interface that is not fit ends them."""
    interface, channel = str(chosen.arguments["interface"]), chosen.arguments.get("channel")
    yield from computer.computer()
    yield computer.jitter(seconds)
    if interface == buses.KERNEL:
        found = list(computer.interface(channel or "can0", network.bitrate))
        yield from found
        if not all(finding.good for finding in found if finding.what == "interface"):
            return
    needed = buses.missing_library(interface)
    if needed is not None:
        yield computer.DoctorFinding(
            "interface", False, f"{interface} needs {needed[0]}, which is not installed", f"say {needed[1]}")
        return
    more = buses.simulating(network) if chosen.simulated else {}
    with buses.opened_one(chosen, network.bitrate, **more) as opened:
        try:
            yield from heard(Link(opened, buses.clock_of(opened), heartbeat_ms=None), wire(network))
        except LinkError as error:
            yield computer.DoctorFinding("bus", False, str(error), "mend the interface first")


PAUSE_NS: Final = 10_000_000
"""Time between two round trips: little load, 6,000 round trips a minute."""
RATES_HZ: Final = (1000, 500, 250, 100)
"""Control rates whose period the round trips are compared with."""
QUANTILES: Final = (0.5, 0.99, 0.999, 1.0)
CONFIDENCE: Final = 0.95


@dataclass
class Soak:
    """Round trips by node, ns; how late waits ended, ns; unanswered reads, error frames, frames lost by the kernel.

    `stamps`: the clock that stamps the frames, "" if the interface does not report it.
    """

    minutes: float
    round_trips_ns: dict[int, list[int]] = field(default_factory=dict)
    late_ns: list[int] = field(default_factory=list)
    unanswered: int = 0
    error_frames: int = 0
    lost: int = 0
    stamps: str = ""

    def slower(self, rate_hz: int) -> tuple[int, int]:
        """Return how many round trips took longer than a period of `rate_hz`, or failed, and their number."""
        trips = [trip for trips in self.round_trips_ns.values() for trip in trips]
        return sum(trip > 1_000_000_000 // rate_hz for trip in trips) + self.unanswered, len(trips) + self.unanswered


def upper_bound(events: int, trials: int) -> float:
    """Return the upper bound of an event's probability at the one-sided `CONFIDENCE` (Clopper and Pearson, 1934).

    The bound p solves P(at most `events` of `trials`) = 1 − `CONFIDENCE`, here by bisection; without an event it is
    1 − (1 − `CONFIDENCE`)^(1/trials), about 3/trials at 95 %.
    """
    if events >= trials:
        return 1.0
    low, high = events / trials, 1.0
    counts = np.arange(1, events + 1)
    ratios = np.concatenate(([0.0], np.cumsum(np.log((trials - counts + 1) / counts))))
    for _ in range(60):
        p = 0.5 * (low + high)
        terms = ratios + np.arange(events + 1) * np.log(p) + (trials - np.arange(events + 1)) * np.log1p(-p)
        low, high = (p, high) if float(np.exp(terms).sum()) > 1.0 - CONFIDENCE else (low, p)
    return high


def soak(link: Link, nodes: Sequence[int], minutes: float, ended: Callable[[], bool] = lambda: False) -> Soak:
    """Read 0x1000 of the nodes in turn for some minutes, or until `ended()`; return the figures.

    Raises `LinkError` if the interface fails.
    """
    figures = Soak(minutes, {node: [] for node in nodes})
    errors = link.controller.count
    end_ns, turn = link.clock() + round(minutes * 60e9), 0
    while link.clock() < end_ns and not ended():
        due_ns = link.clock() + PAUSE_NS
        link.wait(PAUSE_NS)
        figures.late_ns.append(link.clock() - due_ns)
        if nodes:
            node = nodes[turn % len(nodes)]
            turn += 1
            began_ns = link.clock()
            try:
                link.sdo_read(node, 0x1000)
            except SdoError:
                figures.unanswered += 1
            else:
                figures.round_trips_ns[node].append(link.clock() - began_ns)
    figures.error_frames = link.controller.count - errors
    figures.lost = int(getattr(link.bus, "lost", 0))
    figures.stamps = getattr(link.bus, "stamps", "")
    return figures


def as_text(figures: Soak, where: str) -> str:
    """Return the report of a soak as Markdown."""
    lines = [f"# Soak of {where}", "", f"{platform.system()} {platform.release()}, {platform.machine()}, Python "
             f"{platform.python_version()}; {figures.minutes:g} min. {figures.error_frames} error frames, "
             f"{figures.lost} frames lost by the receive queue, {figures.unanswered} reads without an answer."
             + (f" {figures.stamps[0].upper()}{figures.stamps[1:]}." if figures.stamps else ""), "",
             "| | count | median (µs) | 99 % (µs) | 99.9 % (µs) | worst (µs) |", "|---|---|---|---|---|---|",
             _row("wake-up after its time", figures.late_ns)]
    lines += [_row(f"SDO round trip, node {node}", trips) for node, trips in figures.round_trips_ns.items()]
    lines += ["", "| rate (Hz) | round trips longer than its period | of | 95 % bound of the rate per 10⁵ |",
              "|---|---|---|---|"]
    for rate_hz in RATES_HZ:
        slow, count = figures.slower(rate_hz)
        bound = "–" if not count else f"{1e5 * upper_bound(slow, count):.1f}"
        lines.append(f"| {rate_hz} | {slow} | {count} | {bound} |")
    return "\n".join([*lines, ""])


def _row(what: str, durations_ns: Sequence[int]) -> str:
    cells = ["–"] * len(QUANTILES) if not durations_ns else [
        f"{value * 1e-3:.1f}" for value in np.quantile(durations_ns, QUANTILES)]
    return f"| {what} | {len(durations_ns)} | {' | '.join(cells)} |"
