"""The master's cycle on the kernel's CAN, beside a stock canopen master, in guest time.

    python -m benchmarks.socketcan                   # prints the table, and writes it into docs/bench.md
    python -m benchmarks.socketcan --cycles 10000    # longer; what is counted is scaled to 10⁵ cycles either way

Needs `../shared/run_in_vm.sh` (back end `icount`): the guest's clock counts instructions, so any machine prints the
same.  The bench (`bowden bench`) and a master are two processes of the guest's one processor.  Every figure but the
processor time is read off the bus by a third socket, the same way for every master: SYNC, four TPDOs, one frame of
targets for both drives, no drive enabled.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
GUEST = ROOT.parent / "shared" / "run_in_vm.sh"
PAGE = ROOT / "docs" / "bench.md"
LIMIT_S = 7200
RUNS = (("vcan0", "vcan0", 500, True), ("can0", "can1", 500, True), ("vcan0", "vcan0", 1000, False),
        ("can0", "can1", 1000, False))
"""Channel of the master, of the nodes; SYNC, Hz; nodes by `bowden bench`, or answers alone."""
HEAD = ("master on, nodes on", "nodes", "SYNC asked (Hz)", "master", "cycles", "SYNC held (Hz)", "missed per 10⁵",
        "SYNC jitter, 99 % / worst (µs)", "last TPDO after SYNC, median / worst (µs)",
        "targets after SYNC, median / worst (µs)", "CPU per cycle (µs)")
BEGIN, END = "<!-- benchmarks.socketcan begins -->", "<!-- benchmarks.socketcan ends -->"


def main() -> None:
    """Run the benchmark in a guest and write its table; in the guest, run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=500)
    parser.add_argument("--run", type=int, choices=range(len(RUNS)), action="append", help="only this row of RUNS")
    chosen = parser.parse_args()
    runs = [RUNS[i] for i in chosen.run] if chosen.run else list(RUNS)
    if "CANVM" in os.environ:
        from benchmarks.socketcan_masters import measured

        for run in runs:
            for told in measured(*run, chosen.cycles):
                print(json.dumps(told), flush=True)
        return
    text = table(in_guest(sys.argv[1:]))
    print(text)
    if not chosen.run:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(re.sub(f"{BEGIN}.*?{END}", lambda _: f"{BEGIN}\n{text}\n{END}", page, flags=re.DOTALL),
                        encoding="utf-8")


def in_guest(arguments: list[str]) -> list[dict[str, Any]]:
    """Run this module in a guest; what each run told."""
    from tests.socketcan.warm import ENVIRONMENT, warm

    warm()
    with tempfile.TemporaryFile("w+") as out:
        ended = subprocess.run(
            [GUEST, "-b", "icount", "-t", str(LIMIT_S), "-m", "2048", "--", sys.executable, "-m",
             "benchmarks.socketcan", *arguments],
            cwd=ROOT, env={**os.environ, **ENVIRONMENT}, stdout=out, stderr=subprocess.STDOUT, check=False)
        out.seek(0)
        lines = out.read().splitlines()
    if ended.returncode:
        sys.exit("\n".join(["the guest ended with status", str(ended.returncode), *lines[-20:]]))
    return [json.loads(line) for line in lines if line.startswith("{")]


def table(told: list[dict[str, Any]]) -> str:
    """The runs as a table of Markdown."""
    rows = [HEAD, ("---",) * len(HEAD), *map(_cells, told)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _cells(told: dict[str, Any]) -> tuple[str, ...]:
    def pair(name: str) -> str:
        return " / ".join("–" if value is None else f"{value:.0f}" for value in told[name])

    missed = 1e5 * told["missed"] / told["cycles"]
    return (f"{told['master_on']}, {told['nodes_on']}", told["nodes"], str(told["rate_hz"]), told["master"],
            str(told["cycles"]), f"{told['held_hz']:.2f}", f"{missed:.0f}", pair("jitter_us"), pair("inputs_us"),
            pair("targets_us"), f"{told['cpu_us']:.0f}")


if __name__ == "__main__":
    main()
