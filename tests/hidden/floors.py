"""How far each relation is from holding on healthy hidden benches of many structures, nothing healthy beside them.

The rule of this file: root mean squares of what the finder's baseline leaves on cycles it has not seen, all benches
together; `diagnosis/problem/floors.py` states them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from tests.hidden import cases
from tests.hidden.cases import Job


def left(job: Job) -> dict[str, float]:
    """Return the residual of each relation on one healthy bench."""
    from diagnosis.data import table as data
    from diagnosis.finder import diagnose

    said = diagnose([data.table("healthy", cases.case(job, healthy=0).trial)])
    return {name: f.rmse_before for name, f in said.relations.items() if f.rmse_before is not None}


def table(benches: Sequence[dict[str, float]]) -> list[str]:
    """Return the table of floors."""
    names = sorted(set().union(*benches))
    rows = [(name, [bench[name] for bench in benches if name in bench]) for name in names]
    return ["| relation | rms over benches | least | most | benches |", "|---|---|---|---|---|",
            *(f"| {name} | {math.sqrt(sum(v * v for v in held) / len(held)):.3g} | {min(held):.3g} | {max(held):.3g} "
              f"| {len(held)} |" for name, held in rows)]
