"""Table of the checks that can stop a motion, for docs/safety.md: `python -m benchmarks.checks [--page]`.

The largest share of a bound in healthy trials comes from docs/healthy.csv, which `make healthy` writes.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from benchmarks.frame import put
from master.cycle.safety import Reaction
from master.motion.checks import CHECKS

DOCS = Path(__file__).parents[1] / "docs"
SHORT = {Reaction.UNWIND: "unwind", Reaction.RELEASE: "servo off", Reaction.RELEASE_BOTH: "both off",
         Reaction.ABANDON: "0x6007"}
"""Words of a reaction in the table."""


def table() -> str:
    """Return the lines of the table."""
    with (DOCS / "healthy.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["check"]: row for row in csv.DictReader(file)}
    trials = max(row["trials"] for row in rows.values())
    lines = [f"| check | signals | bound | bound from | reaction | most of {trials} healthy trials | test |",
             "|---|---|---|---|---|---|---|"]
    lines += [f"| {check.name} | {check.signals} | {check.bound} | {check.source} | {SHORT[check.reaction]} | "
              f"{rows[check.healthy]['share'] if check.healthy else '–'} | `{check.test}` |" for check in CHECKS]
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
    if "--page" in sys.argv:
        put(DOCS / "safety.md", "checks", table())
