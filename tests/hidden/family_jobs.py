"""What is asked of the finder on the family: each effect once on each implementation, healthy benches, pairs, no END.

The rule of this file: all that a run asks comes from `jobs`, and `digest` of it is what is committed before a run on
the serials set aside; which serial a case falls on hangs on its place among all, so that a part of them is spread.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from tests.hidden.family import WIRE, Job
from tests.plants import draws, effects

KINDS = ("maxwell", "lugre", "dahl", "fronts")
SERIALS = 400
HEALTHY, PAIRS = 10, 12
GOLDEN = 0.5 * (5.0**0.5 - 1.0)
"""Step through the serials, of their number: any part of the cases, taken evenly, falls on many of them."""
NO_END = ("tension_end_n",)
HEALTHY_NO_END = 2


def serials(kind: str, aside: bool, first: int = 0) -> list[int]:
    """The serials of an implementation from `first` on, set aside for the last run or not."""
    return [s for s in range(first, first + SERIALS)
            if draws.structure(s).implementation == kind and draws.set_aside(s) == aside]


def pairs(kind: str) -> list[tuple[str, str]]:
    """Two effects at a time, other ones for each implementation; none of the wire, which is judged before the bench."""
    able = [name for name in effects.EFFECTS if name not in WIRE]
    every = list(itertools.combinations(able, 2))
    return [every[i] for i in np.random.default_rng((KINDS.index(kind), 7)).permutation(len(every))[:PAIRS]]


def hidden(kind: str) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    """What is hidden and which columns are left out, case by case.

    Nothing, each effect, what no catalogue has, pairs; without END nothing and every second effect, the odd ones and
    the even ones in turn.
    """
    own = KINDS.index(kind)
    whole = [()] * HEALTHY + [(name,) for name in (*effects.EFFECTS, *effects.OUTSIDE)] + pairs(kind)
    blind = [()] * HEALTHY_NO_END + [(name,) for name in list(effects.EFFECTS)[own % 2::2]]
    return [(names, ()) for names in whole] + [(names, NO_END) for names in blind]


def jobs(kind: str, aside: bool, every: int = 1, rest: bool = False, first: int = 0) -> Iterator[Job]:
    """Yield the cases of one implementation, on the `SERIALS` from `first` on.

    `every`: only each so many, from another one on for each; `rest`: all but those.
    """
    own, each = serials(kind, aside, first), KINDS.index(kind) % every
    for i, (names, left_out) in enumerate(hidden(kind)):
        if (i % every == each) != rest:
            yield Job(own[int(len(own) * (i * GOLDEN % 1.0))], names, i, left_out=left_out)


def digest(asked: Sequence[Job]) -> str:
    """Return the SHA-256 of what is asked: serial, what is hidden, seed and the columns left out of each case."""
    text = "\n".join(f"{job.serial} {'+'.join(job.hidden)} {job.seed} {'+'.join(job.left_out)}" for job in asked)
    return hashlib.sha256(text.encode()).hexdigest()
