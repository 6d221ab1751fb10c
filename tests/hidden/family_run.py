"""The finder on the family, by structure: each effect once on each implementation, healthy benches, effects outside.

    python -m tests.hidden.family_run [--aside] [--kinds maxwell,lugre] [--every N] [--no-oracle] [--page]

The rule of this file: `--aside` are the serials that nothing was tuned on; run them once, at the end.  What is asked is
known beforehand by its hash (`--hash`), which is committed before the run.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks import marked
from bowden import provenance
from tests.hidden.family import KINDS, Answer, Job, answer, serials
from tests.plants import effects

HEALTHY = 10
DOCS = Path(__file__).parents[2] / "docs" / "diagnosis.md"
HEADS = ("structure", "right class", "first name", "wrong name", "false alarms", "outside: unexplained",
         "outside: named", "not counted")


def jobs(kind: str, aside: bool, every: int = 1) -> Iterator[Job]:
    """Yield the cases of one implementation: nothing hidden, every effect, what no catalogue has.

    `every`: only each so many of them, beginning at another one for each implementation.
    """
    own = serials(kind, 60, aside)
    hidden = [()] * HEALTHY + [(name,) for name in (*effects.EFFECTS, *effects.OUTSIDE)]
    for i, names in enumerate(hidden):
        if i % every == KINDS.index(kind) % every:
            yield Job(own[(7 * i + 3) % len(own)], names, i)


def digest(asked: Sequence[Job]) -> str:
    """Return the SHA-256 of what is asked: serial, what is hidden and seed of each case."""
    text = "\n".join(f"{job.serial} {'+'.join(job.hidden)} {job.seed}" for job in asked)
    return hashlib.sha256(text.encode()).hexdigest()


def row(kind: str, told: Sequence[Answer]) -> list[str]:
    """Return one row of the table: shares of what counts."""
    every = [a for a in told if a.job.hidden and a.job.hidden[0] in effects.EFFECTS]
    named = [a for a in every if a.counts]
    none = [a for a in told if not a.job.hidden]
    outside = [a for a in told if a.job.hidden and a.job.hidden[0] in effects.OUTSIDE and a.counts]

    def share(part: Sequence[bool]) -> str:
        return f"{sum(part)}/{len(part)}"

    return [kind, share([a.right for a in named]), share([a.named[:1] == a.job.hidden for a in named]),
            share([a.wrong for a in named]), share([bool(a.rivals) for a in none]),
            share([a.verdict == "unexplained" for a in outside]), share([bool(a.rivals) for a in outside]),
            str(len(every) - len(named))]


def said(answered: Answer) -> str:
    """Return what was hidden and what was said, in one line."""
    a = answered
    verdict = "right" if a.right else "WRONG" if a.wrong else "  not"
    return " ".join((verdict, a.structure, str(a.job.serial), *a.job.hidden, "→", a.verdict, ", ".join(a.rivals),
                     "" if a.counts else "(does not count)")).rstrip()


def table(rows: Sequence[Sequence[str]]) -> str:
    """Return the table as Markdown."""
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (HEADS, ["---"] * len(HEADS), *rows))


def main() -> None:
    """Print every answer and the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--aside", action="store_true")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--every", type=int, default=1, metavar="N")
    parser.add_argument("--no-oracle", action="store_true")
    parser.add_argument("--hash", action="store_true", help="print the hash of what would be asked, and ask nothing")
    parser.add_argument("--page", action="store_true", help=f"write the table into {DOCS.name}")
    given = parser.parse_args()
    kinds = given.kinds.split(",")
    asked = {kind: list(jobs(kind, given.aside, given.every)) for kind in kinds}
    key = digest([job for kind in kinds for job in asked[kind]])
    print(f"{sum(map(len, asked.values()))} cases, SHA-256 {key}", flush=True)
    if given.hash:
        return
    rows, missed = [], []
    for kind in kinds:
        told = []
        for job in asked[kind]:
            told.append(answer(job, judged=not given.no_oracle))
            print(said(told[-1]), flush=True)
        rows.append(row(kind, told))
        missed += [said(a) for a in told if a.counts and not a.right]
    print(table(rows))
    if given.page:
        options = " ".join(argument for argument in sys.argv[1:] if argument != "--page")
        head = f"Printed by `python -m tests.hidden.family_run {options}` at commit {provenance.commit()};"
        against = [f"- {m}" for m in missed] or ["nothing."]
        text = "\n".join((head, f"SHA-256 of what is asked: {key}.", "", table(rows), "", "Not right:", "", *against))
        marked.put(DOCS, "family", text)


if __name__ == "__main__":
    main()
