"""Runs the matrix: `python -m tests.faults.run [--rows PATTERN] [--walks PATTERN] [--moments …] [--kind KIND]
[--stealth] [--page FILE] [--json FILE] [--jobs N]`.

The rule of this file: it prints every row and says at the end which bounds are not kept; its exit status is their
number, at most 1.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import sys
from pathlib import Path

from tests.faults import stealth
from tests.faults.judge import Verdict, judged
from tests.faults.page import write
from tests.faults.rows import ROWS
from tests.faults.stage import trial

KINDS: dict[str, tuple[bool, ...]] = {"all": (False, True), "at-once": (False,), "slow": (True,), "none": ()}
"""Values of `Row.gradual` by the name that `--kind` takes; "none" is for a run of the search alone."""
HEAD = (f"{'fault':42} {'at':7} {'gait':15} {'ms':>7} {'true peaks, N':>13} {'unsaid, N':>11} {'leg':>5} {'slack':>6} "
        f"{'pull':>5}  said")


def line(verdict: Verdict) -> str:
    """One row as it is printed."""
    v = verdict
    return (f"{v.name:42} {v.moment:7} {v.walk:15} {v.detected_ms:7.1f} {v.peak_start_n:6.1f}/{v.peak_end_n:6.1f} "
            f"{v.apart_n:5.1f}/{v.unsaid_n:5.1f} {v.leg_deg:5.1f} {v.slack_ms:6.0f} {v.pulled:5.2f}  "
            f"{'; '.join(v.faults) + ': ' if v.faults else ''}{v.said[:170]}")


def verdicts(pattern: str = "", jobs: int = 2, moments: tuple[str, ...] = (), walks: str = "",
             kind: str = "all") -> list[Verdict]:
    """Run every row of a kind (`KINDS`) whose name matches, at its moments and gaits."""
    from dataclasses import replace

    rows = [row for row in ROWS if re.search(pattern, row.name) and row.gradual in KINDS[kind]]
    if moments:
        rows = [replace(row, moments=tuple(m for m in row.moments if m in moments)) for row in rows]
    by_name = {row.name: row for row in rows}
    order = {row.name: i for i, row in enumerate(rows)}
    all_found = []
    for walk in dict.fromkeys(walk for row in rows for walk in row.walks if re.search(walks, str(walk))):
        found, twin = trial(rows, jobs, walk)
        if twin.reason is not None:
            raise SystemExit(f"the twin stopped ({walk}): {twin.reason}")
        all_found += [judged(by_name[told.name], told, twin, walk) for told in found]
    return sorted(all_found, key=lambda verdict: order[verdict.name])


def main() -> int:
    """Run, print, write."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--rows", default="")
    asked.add_argument("--walks", default="")
    asked.add_argument("--moments", nargs="*", default=())
    asked.add_argument("--kind", choices=list(KINDS), default="all", help="faults that begin at once, or slow faults")
    asked.add_argument("--stealth", action="store_true", help="search the worst that goes unsaid, too")
    asked.add_argument("--page", type=Path)
    asked.add_argument("--json", type=Path)
    asked.add_argument("--jobs", type=int, default=2)
    given = asked.parse_args()
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"):  # a shell's background job ignores some of them
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    unsaid = stealth.table(stealth.found(given.jobs)) if given.stealth else []
    print("\n".join(unsaid))
    found = verdicts(given.rows, given.jobs, tuple(given.moments), given.walks, given.kind)
    print(HEAD)
    for verdict in found:
        print(line(verdict))
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
