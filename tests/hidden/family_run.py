"""The finder on the family, by structure: each effect once on each implementation, healthy benches, effects outside.

    python -m tests.hidden.family_run [--aside] [--kinds maxwell,lugre] [--no-oracle]

The rule of this file: `--aside` are the serials that nothing was tuned on; run them once, at the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

from tests.hidden.family import KINDS, Answer, Job, answer, serials
from tests.plants import effects

HEALTHY = 10


def jobs(kind: str, aside: bool) -> Iterator[Job]:
    """Yield the cases of one implementation: nothing hidden, every effect, what no catalogue has."""
    own = serials(kind, 60, aside)
    hidden = [()] * HEALTHY + [(name,) for name in (*effects.EFFECTS, *effects.OUTSIDE)]
    for i, names in enumerate(hidden):
        yield Job(own[(7 * i + 3) % len(own)], names, i)


def row(kind: str, told: Sequence[Answer]) -> str:
    """Return one line of the table: shares of what counts."""
    named = [a for a in told if a.job.hidden and a.job.hidden[0] in effects.EFFECTS and a.counts]
    none = [a for a in told if not a.job.hidden]
    outside = [a for a in told if a.job.hidden and a.job.hidden[0] in effects.OUTSIDE and a.counts]

    def share(part: Sequence[bool]) -> str:
        return f"{sum(part)}/{len(part)}"

    return " | ".join((
        kind, share([a.right for a in named]), share([a.named[:1] == a.job.hidden for a in named]),
        share([a.wrong for a in named]), share([bool(a.rivals) for a in none]),
        share([a.verdict == "unexplained" for a in outside]), share([bool(a.rivals) for a in outside])))


def main() -> None:
    """Print every answer and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--aside", action="store_true")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--no-oracle", action="store_true")
    given = parser.parse_args()
    table = []
    for kind in given.kinds.split(","):
        told = []
        for job in jobs(kind, given.aside):
            told.append(answer(job, judged=not given.no_oracle))
            a = told[-1]
            said = "right" if a.right else "WRONG" if a.wrong else "  not"
            print(said, kind, job.serial, *job.hidden, "→", a.verdict, ", ".join(a.rivals),
                  "" if a.counts else "(does not count)", flush=True)
        table.append(row(kind, told))
    print("structure | right class | first name | wrong name | false alarms | unexplained | outside, named")
    print(*table, sep="\n")


if __name__ == "__main__":
    main()
