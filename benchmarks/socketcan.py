"""The master's cycle on the kernel's CAN, beside a stock canopen master, in guest time.

    python -m benchmarks.socketcan                   # prints the table, and writes it into docs/bench.md
    python -m benchmarks.socketcan --cycles 10000    # longer; what is counted is scaled to 10⁵ cycles either way
    python -m benchmarks.socketcan --rates           # which rate the guest carries with the plant on its processor
    python -m benchmarks.socketcan --adapters        # which rate each kind of adapter carries, by calculation

Needs `../shared/run_in_vm.sh` (back end `icount`): the guest's clock counts instructions, so any machine prints the
same.  The bench (`bowden bench`) and a master are two processes of the guest's one processor.  Every figure but the
processor time is read off the bus by a third socket, the same way for every master: SYNC, four TPDOs, one frame of
targets for both drives, no drive enabled.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from typing import Any

from benchmarks.frame import DOCS, ROOT, markdown, put
from eds.bench.bench_network import Network, wire
from eds.bench.bus_load import rate_that_fits

GUEST = ROOT.parent / "shared" / "run_in_vm.sh"
PAGE = DOCS / "bench.md"
LIMIT_S = 7200
RUNS = (("vcan0", "vcan0", 500, True), ("can0", "can1", 500, True), ("vcan0", "vcan0", 1000, False),
        ("can0", "can1", 1000, False))
"""Channel of the master, of the nodes; SYNC, Hz; nodes by `bowden bench`, or answers alone."""
MISSED = "missed per 10⁵ (95 % bound)"
HEAD = ("master on, nodes on", "nodes", "SYNC asked (Hz)", "master", "cycles", "SYNC held (Hz)", MISSED,
        "SYNC jitter, 99 % / worst (µs)", "last TPDO after SYNC, median / worst (µs)",
        "targets after SYNC, median / worst (µs)", "CPU per cycle (µs)")
RATES_HZ = (500, 625, 800, 1000)
"""Whole microseconds of period, as a configuration wants them."""
RATES_HEAD = ("SYNC asked (Hz)", "SYNC held (Hz)", "cycles", MISSED,
              "targets after SYNC, median / worst (µs)", "the trial")

ADAPTERS = (("PCIe", 90, "measured, mean"), ("USB high speed", 250, "two microframes of 125 µs"),
            ("USB full speed", 1000, "measured, upper end"), ("USB full speed", 2000, "two frames of 1 ms"))
"""Round trip of an adapter without the frames themselves (wire to program, program to wire), µs, and its origin."""


def main() -> None:
    """Run the benchmark in a guest and write its table; in the guest, run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=500)
    parser.add_argument("--run", type=int, choices=range(len(RUNS)), action="append", help="only this row of RUNS")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--rates", action="store_true", help="our cycle with the bench, at several rates")
    kind.add_argument("--adapters", action="store_true", help="rate that each kind of adapter carries, by calculation")
    chosen = parser.parse_args()
    if chosen.adapters:
        put(PAGE, "adapters", text := adapters())
        print(text)
        return
    if "CANVM" in os.environ:
        for told in measured_here(chosen):
            print(json.dumps(told), flush=True)
        return
    name, laid_out = ("socketcan rates", rates) if chosen.rates else ("socketcan", table)
    text = laid_out(in_guest(sys.argv[1:]))
    print(text)
    if not chosen.run:
        put(PAGE, name, text)


def measured_here(chosen: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """What was asked for, measured on this kernel."""
    from benchmarks import socketcan_masters as masters

    if chosen.rates:
        yield from masters.carried(RATES_HZ, chosen.cycles)
    else:
        for i in chosen.run or range(len(RUNS)):
            yield from masters.measured(*RUNS[i], chosen.cycles)


def in_guest(arguments: list[str]) -> list[dict[str, Any]]:
    """Run this module in a guest; what each run told."""
    from tests.warm import FOR_GUESTS, warm_guests

    warm_guests()
    with tempfile.TemporaryFile("w+") as out:
        ended = subprocess.run(
            [GUEST, "-b", "icount", "-t", str(LIMIT_S), "-m", "2048", "--", sys.executable, "-m",
             "benchmarks.socketcan", *arguments],
            cwd=ROOT, env={**os.environ, **FOR_GUESTS}, stdout=out, stderr=subprocess.STDOUT, check=False)
        out.seek(0)
        lines = out.read().splitlines()
    if ended.returncode:
        sys.exit("\n".join(["the guest ended with status", str(ended.returncode), *lines[-20:]]))
    return [json.loads(line) for line in lines if line.startswith("{")]


def adapters() -> str:
    """Return the largest rate at which the targets follow the inputs through each adapter within one cycle.

    The round trip adds to the compute budget: `[network] compute_budget_us` of a bench with that adapter.
    """
    head = ("adapter", "round trip (µs)", "origin", "`compute_budget_us`", "rate of the packaged bench (Hz)")
    network, rows = Network(), []
    for name, round_trip_us, origin in ADAPTERS:
        budget_us = network.compute_budget_us + round_trip_us
        rate = rate_that_fits(wire(dataclasses.replace(network, compute_budget_us=budget_us)))
        rows.append((name, str(round_trip_us), origin, str(budget_us), str(rate)))
    return markdown(head, rows)


def table(told: list[dict[str, Any]]) -> str:
    """The runs as a table of Markdown."""
    return markdown(HEAD, map(_cells, told))


def rates(told: list[dict[str, Any]]) -> str:
    """What came of each rate with the bench on the same processor."""
    return markdown(RATES_HEAD, [
        (str(each["rate_hz"]), "–", "–", "–", "–", f"stopped: {each['stopped']}") if each["stopped"] else
        (str(each["rate_hz"]), f"{each['held_hz']:.0f}", str(each["cycles"]), _missed(each),
         _pair(each["targets_us"]), "completed") for each in told])


def _pair(values: Sequence[float | None]) -> str:
    return " / ".join("–" if value is None else f"{value:.0f}" for value in values)


def _missed(told: dict[str, Any]) -> str:
    """Missed cycles per 10⁵, and the upper bound of the rate at 95 %."""
    from bowden.bench.examination import upper_bound

    missed, cycles = int(told["missed"]), int(told["cycles"])
    return f"{1e5 * missed / cycles:.0f} (≤ {1e5 * upper_bound(missed, cycles):.0f})"


def _cells(told: dict[str, Any]) -> tuple[str, ...]:
    return (f"{told['master_on']}, {told['nodes_on']}", told["nodes"], str(told["rate_hz"]), told["master"],
            str(told["cycles"]), f"{told['held_hz']:.2f}", _missed(told), _pair(told["jitter_us"]),
            _pair(told["inputs_us"]), _pair(told["targets_us"]), f"{told['cpu_us']:.0f}")


if __name__ == "__main__":
    main()
