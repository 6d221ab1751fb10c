"""Runs the matrix: `python -m tests.faults.run [--rows PATTERN] [--walks PATTERN] [--moments …] [--kind KIND]
[--gait …] [--cover | --all] [--every N] [--stealth] [--page FILE] [--json FILE] [--jobs N]`.

The rule of this file: it prints every row and says at the end which bounds are not kept; its exit status is their
number, at most 1.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from tests.faults import cover, stealth
from tests.faults.judge import Verdict, judged
from tests.faults.page import write
from tests.faults.rows import ROWS
from tests.faults.stage import Row, Walk, trial

KINDS: dict[str, tuple[bool, ...]] = {"all": (False, True), "at-once": (False,), "slow": (True,), "none": ()}
"""Values of `Row.gradual` by the name that `--kind` takes; "none" is for a run of the search alone."""
HEAD = (f"{'fault':42} {'at':7} {'motion':15} {'ms':>7} {'true peaks, N':>13} {'unsaid, N':>11} {'leg':>5} | "
        f"{'off':>5} {'over':>5} {'range':>9} {'END':>5} {'loose':>5} {'torque':>6}  said")


def line(verdict: Verdict) -> str:
    """One row as it is printed; behind the bar: from the stop to standstill."""
    v = verdict
    return (f"{v.name:42} {v.moment:7} {v.walk:15} {v.detected_ms:7.1f} {v.peak_start_n:6.1f}/{v.peak_end_n:6.1f} "
            f"{v.apart_n:5.1f}/{v.unsaid_n:5.1f} {v.leg_deg:5.1f} | {v.off_deg:5.1f} {v.over_deg_s:5.0f} "
            f"{v.low_deg:4.0f}/{v.high_deg:4.0f} {v.stop_end_n:5.1f} {v.slack_ms:5.0f} {v.torque_ms:6.0f}  "
            f"{'; '.join(v.faults) + ': ' if v.faults else ''}{v.said[:170]}")


def verdicts(pattern: str = "", jobs: int = 2, moments: tuple[str, ...] = (), walks: str = "",
             kind: str = "all", gait: Walk | None = None) -> list[Verdict]:
    """Run the rows of a kind (`KINDS`) whose name matches, at their own moments and gaits or at those given."""
    rows = [row for row in ROWS if re.search(pattern, row.name) and row.gradual in KINDS[kind]]
    if gait is not None:
        rows = [replace(row, moments=moments or row.moments, walks=(gait,), named=()) for row in rows]
    elif moments:
        rows = [replace(row, moments=tuple(m for m in row.moments if m in moments)) for row in rows]
    by_walk = {walk: [row for row in rows if walk in row.walks]
               for walk in dict.fromkeys(walk for row in rows for walk in row.walks) if re.search(walks, str(walk))}
    order = {row.name: i for i, row in enumerate(rows)}
    return sorted(ran(by_walk, jobs), key=lambda verdict: order[verdict.name])


def ran(by_walk: Mapping[Walk, Sequence[Row]], jobs: int) -> Iterator[Verdict]:
    """Run the rows of each walk in one trial, and yield their verdicts."""
    for walk, rows in by_walk.items():
        by_name = {row.name: row for row in rows}
        found, twin = trial(rows, jobs, walk)
        if twin.reason is not None:
            raise SystemExit(f"the twin stopped ({walk}): {twin.reason}")
        for told in found:
            yield judged(by_name[told.name], told, twin, walk)


def main() -> int:
    """Run, print, write."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--rows", default="")
    asked.add_argument("--walks", default="")
    asked.add_argument("--moments", nargs="*", default=())
    asked.add_argument("--gait", nargs=2, metavar=("CONTROLLER", "PERIOD"), help="in place of the rows' own gaits")
    asked.add_argument("--kind", choices=list(KINDS), default="all", help="faults that begin at once, or slow faults")
    asked.add_argument("--stealth", action="store_true", help="search the worst that goes unsaid, too")
    asked.add_argument("--cover", action="store_true", help="the covering sample alone")
    asked.add_argument("--all", action="store_true", help="the whole product of moments, gaits and benches, too")
    asked.add_argument("--every", type=int, default=1, help="one run in so many of the sample")
    asked.add_argument("--page", type=Path)
    asked.add_argument("--json", type=Path)
    asked.add_argument("--jobs", type=int, default=2)
    given = asked.parse_args()
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"):  # a shell's background job ignores some of them
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    unsaid = stealth.table(stealth.found(given.jobs)) if given.stealth else []
    print("\n".join(unsaid))
    found = [] if given.cover else verdicts(given.rows, given.jobs, tuple(given.moments), given.walks, given.kind,
                                                 given.gait and Walk(float(given.gait[1]), given.gait[0], 1))
    print(HEAD)
    for verdict in found:
        print(line(verdict))
    if given.cover or given.all:
        sampled = cover.matching(cover.sample(ROWS, whole=given.all), given.rows, given.walks)
        for verdict in ran(cover.thinned(sampled, given.every), given.jobs):
            print(line(verdict), flush=True)
            found.append(verdict)
            if given.json:
                given.json.write_text(json.dumps([one._asdict() for one in found]), encoding="utf-8")
    broken = [verdict for verdict in found if verdict.faults]
    rows = len({verdict.name for verdict in found})
    print(f"{rows} faults, {len(found)} rows with their moments, {len(broken)} beyond a bound.")
    if given.json:
        given.json.write_text(json.dumps([verdict._asdict() for verdict in found], indent=1), encoding="utf-8")
    if given.page:
        write(given.page, found, unsaid)
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
