"""The finder on the family, by structure: each effect once on each implementation, healthy benches, pairs, no END.

    python -m tests.hidden.family_run [--aside] [--first N] [--kinds maxwell,lugre] [--every N] [--rest]
                                      [--most N] [--workers N] [--no-oracle]
                                      [--answers FILE] [--hash | --page]

The rule of this file: `--aside` are the serials that nothing was tuned on; run them once, at the end.  What is asked is
known beforehand by its hash (`--hash`), which is committed before the run.  A run that was broken off goes on from
there; each answer is kept with the commit that gave it.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import sys
from pathlib import Path

from benchmarks.frame import put
from bowden.trials import provenance
from bowden.workers import local
from tests.hidden import family_bars, run
from tests.hidden.family import Answer, answer, from_json
from tests.hidden.family_jobs import KINDS, SERIALS, digest, jobs

OUT = Path("out")
DOCS = Path(__file__).parents[2] / "docs" / "diagnosis_figures.md"


def said(answered: Answer) -> str:
    """Return what was hidden and what was said, in one line."""
    a = answered
    verdict = "right" if a.right else "WRONG" if a.wrong or (a.alarm and a.rivals) else "  not"
    return " ".join((verdict, a.structure, str(a.job.serial), " + ".join(a.job.hidden) or "nothing",
                     *(["without END"] if a.job.left_out else []), "→", a.verdict, ", ".join(a.rivals),
                     "" if a.counts else "(does not count)")).rstrip()


def options(arguments: list[str]) -> argparse.Namespace:
    """Return what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--aside", action="store_true")
    parser.add_argument("--first", type=int, default=0, metavar="N", help=f"of {SERIALS} serials (default: 0)")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--every", type=int, default=1, metavar="N")
    parser.add_argument("--rest", action="store_true", help="all but each so many")
    parser.add_argument("--most", type=int, help="only so many, from the first on, the structures in turns")
    parser.add_argument("--workers", type=int, help="processes (default: one a processor)")
    parser.add_argument("--no-oracle", action="store_true")
    parser.add_argument("--answers", type=Path, help="where answers are kept (default: out/family-COMMIT.jsonl)")
    parser.add_argument("--hash", action="store_true", help="print the hash of what would be asked, and ask nothing")
    parser.add_argument("--page", action="store_true", help=f"write the table into {DOCS.name}")
    given = parser.parse_args(arguments)
    if given.rest and given.every < 2:
        parser.error("--rest: all but each single case are none; give --every 2 or more.")
    return given


def page(options: str, commits: list[str], key: str, whole: int, kinds: list[str], by_kind: list[list[Answer]]) -> str:
    """Return what a run says: the command that prints it, the hash, the table, and what tells against it.

    `whole`: of how many cases the hash is; `by_kind`: those that were asked.
    """
    told = [a for part in by_kind for a in part]
    missed = [f"- {said(a)}" for a in told if family_bars.against(a)] or ["nothing."]
    return "\n".join((
        f"Printed by `python -m tests.hidden.family_run {options}` at commit {', '.join(commits)}:",
        f"{len(told)} of {whole} cases; SHA-256 of all: {key}.", "", family_bars.table(kinds, by_kind), "",
        family_bars.by_rig(told), "", family_bars.by_separation(told), "", "Not right:", "", *missed))


def main(arguments: list[str]) -> None:
    """Print every answer and the table."""
    given = options(arguments)
    kinds = given.kinds.split(",")
    asked = {kind: list(jobs(kind, given.aside, given.every, given.rest, given.first)) for kind in kinds}
    key = digest([job for kind in kinds for job in asked[kind]])
    # the structures in turns, so that a run that is broken off has asked of each
    every = [job for turn in itertools.zip_longest(*asked.values()) for job in turn if job is not None]
    print(f"{len(every)} cases, SHA-256 {key}", flush=True)
    if given.hash:
        return
    name = f"family-{provenance.commit()}{'-no-oracle' if given.no_oracle else ''}.jsonl"
    kept = run.Kept(given.answers or OUT / name, from_json)
    whole, every = len(every), every[:given.most]
    run.answered(every, kept, lambda: local(given.workers), functools.partial(
        answer, judged=not given.no_oracle))
    by_kind = [[kept.answers[job] for job in asked[kind] if job in every] for kind in kinds]
    for told in by_kind:
        print("\n".join(said(a) for a in told))
    text = page(run.asking(arguments), sorted({kept.commits[job] for job in every}), key, whole, kinds, by_kind)
    print(text)
    if given.page:
        put(DOCS, "family", text)


if __name__ == "__main__":
    main(sys.argv[1:])
