"""Runs the matrix: `python -m tests.faults.run [--rows PATTERN] [--walks PATTERN] [--moments …] [--kind KIND]
[--gait …] [--cover | --all] [--every N] [--stealth] [--page FILE] [--kept FILE] [--jobs N]`.

It prints every row and says at the end which bounds are not kept; its exit status is 1 if there are any. With `--kept`
an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import itertools
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


def own(pattern: str, moments: tuple[str, ...], kind: str, gait: Walk | None) -> dict[Walk, list[Row]]:
    """Return the rows of a kind whose name matches, by walk, at their own moments and gaits or those given."""
    rows = [row for row in ROWS if re.search(pattern, row.name) and row.gradual in KINDS[kind]]
    if gait is not None:
        rows = [replace(row, moments=moments or row.moments, walks=(gait,), named=()) for row in rows]
    elif moments:
        rows = [replace(row, moments=tuple(m for m in row.moments if m in moments)) for row in rows]
    walks = dict.fromkeys(walk for row in rows for walk in row.walks)
    return {walk: [row for row in rows if walk in row.walks] for walk in walks}


def left(by_walk: Mapping[Walk, Sequence[Row]], done: Sequence[Verdict], walks: str) -> dict[Walk, list[Row]]:
    """Return the runs of the walks that match which are not among those done; a walk without any is left out."""
    keys = {(verdict.name, verdict.walk, verdict.moment) for verdict in done}
    found: dict[Walk, list[Row]] = {}
    for walk, rows in by_walk.items():
        for row in rows if re.search(walks, str(walk)) else ():
            at = tuple(moment for moment in row.moments if (row.name, str(walk), moment) not in keys
                       and (not walk.moments or moment in walk.moments))
            if at:
                found.setdefault(walk, []).append(replace(row, moments=at))
    return found


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
    asked.add_argument("--kept", type=Path, help="verdicts, a line of JSON each; runs that are in it are not run again")
    asked.add_argument("--jobs", type=int, default=2)
    given = asked.parse_args()
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"):  # a shell's background job ignores some of them
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    unsaid = stealth.table(stealth.found(given.jobs)) if given.stealth else []
    print("\n".join(unsaid))
    lines = given.kept.read_text(encoding="utf-8").splitlines() if given.kept and given.kept.exists() else []
    found = [Verdict(**(row | {"faults": tuple(row["faults"])})) for row in map(json.loads, lines)]
    gait = given.gait and Walk(float(given.gait[1]), given.gait[0], 1)
    turns = [] if given.cover else [own(given.rows, tuple(given.moments), given.kind, gait)]
    if given.cover or given.all:
        sampled = cover.matching(cover.sample(ROWS, whole=given.all), given.rows, given.walks)
        turns.append(cover.thinned(sampled, given.every))
    print(HEAD)
    for verdict in itertools.chain.from_iterable(ran(left(turn, found, given.walks), given.jobs) for turn in turns):
        print(line(verdict), flush=True)
        found.append(verdict)
        if given.kept:
            with given.kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(verdict._asdict()) + "\n")
    broken = [verdict for verdict in found if verdict.faults]
    rows = len({verdict.name for verdict in found})
    print(f"{rows} faults, {len(found)} rows with their moments, {len(broken)} beyond a bound.")
    if given.page:
        write(given.page, found, unsaid)
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
