"""Hide effects by seed, ask the finder, and print every bar with its figure, its count and whether it is met.

The rule of this file: which cases there are, who answers them, and where the answers are kept; a run that was
broken off goes on from there, and each answer is kept with the commit that gave it.

    python -m tests.hidden.run [--quick] [--first SEED] [--workers N | --scheduler HOST:PORT] [--most N]
                               [--answers FILE] [--page]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from benchmarks.frame import put
from bowden.cli import terminal
from bowden.trials import provenance
from bowden.workers import Workers, workers_of
from tests.hidden import cases, page
from tests.hidden.answers import answer, from_json
from tests.hidden.cases import Job

FIRST = 200_000
"""Seeds from here on were not looked at while the finder was built."""
FULL = {"one": 14 * len(cases.EFFECTS), "two": 60, "none": 90, "outside": 45, "wire": 30}
QUICK = {"one": len(cases.EFFECTS), "two": 8, "none": 14, "outside": 6, "wire": 6}
OUT = Path("out")
Question = Callable[[Any], Any]
DOCS = Path("docs/diagnosis_figures.md")


def jobs(quick: bool, first: int) -> list[Job]:
    """Return the cases, kinds evenly mixed, so that a part of them is like the whole; every effect equally often.

    Every second case of an effect or kind has an altered structure.
    """
    wanted, names, wires = (QUICK if quick else FULL), sorted(cases.EFFECTS), sorted(cases.WIRE)
    pool = {"one": names, "wire": wires}
    order = sorted(((i + 0.5) / count, kind, i) for kind, count in wanted.items() for i in range(count))
    made = []
    for seed, (_, kind, i) in enumerate(order, first):
        hidden = pool.get(kind, [""])
        name, lap = hidden[i % len(hidden)], i // len(hidden)
        altered = (lap + i % len(hidden) if kind in pool else i) % 2 == 1
        made.append(Job(kind, seed, (name,) if name else (), altered))
    return made


class Kept:
    """Answers in a file of JSON lines, one for a job, with the commit that gave it; `read`: makes one of plain values.
    """

    def __init__(self, path: Path, read: Callable[[Mapping[str, Any]], Any] = from_json) -> None:
        self.path = path
        self.answers: dict[Any, Any] = {}
        self.commits: dict[Any, str] = {}
        lines = path.read_text(encoding="utf-8").split("\n") if path.is_file() else []
        for line in lines:
            # a line that was cut off in writing is asked again
            if line.endswith("}}"):
                held = json.loads(line)
                told = read(held["answer"])
                self.answers[told.job], self.commits[told.job] = told, held["commit"]

    def add(self, told: Any, commit: str) -> None:
        """Keep an answer; it is in the file at once."""
        self.answers[told.job], self.commits[told.job] = told, commit
        self.path.parent.mkdir(exist_ok=True)
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({"commit": commit, "answer": told.as_json()}) + "\n")


def ask(todo: Iterable[Any], crew: Workers, question: Question) -> Iterator[Any]:
    """Yield answers as they come, little more than one a worker under way."""
    left, under_way = iter(todo), set[Future[Any]]()
    while True:
        for job in left:
            under_way.add(crew.executor.submit(question, job))
            if len(under_way) > crew.at_once:
                break
        if not under_way:
            return
        done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
        yield from (future.result() for future in done)


def answered(wanted: Sequence[Any], kept: Kept, crew: Callable[[], AbstractContextManager[Workers]],
             question: Question = answer) -> list[Any]:
    """Return the answers of `wanted`, in their order, those that are not kept yet by a crew."""
    todo = [job for job in wanted if job not in kept.answers]
    commit = provenance.commit()
    if todo:
        with crew() as workers, terminal.progress(f"{len(todo)} cases") as update:
            for i, told in enumerate(ask(todo, workers, question), 1):
                kept.add(told, commit)
                update(i / len(todo))
    return [kept.answers[job] for job in wanted]


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """Return what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"{sum(QUICK.values())} cases, not {sum(FULL.values())}")
    parser.add_argument("--first", type=int, default=FIRST, help="first seed")
    parser.add_argument("--most", type=int, help="only so many of the cases, from the first on")
    parser.add_argument("--workers", type=int, help="processes (default: one a processor)")
    parser.add_argument("--scheduler", help="Dask scheduler to run on, host:port")
    parser.add_argument("--answers", type=Path, help="where answers are kept (default: out/hidden-COMMIT.jsonl)")
    parser.add_argument("--page", action="store_true", help=f"write the tables into {DOCS}")
    return parser.parse_args(arguments)


def command(arguments: Sequence[str]) -> str:
    """Return what prints the same again."""
    given = asking(arguments)
    return f"python -m tests.hidden.run {given}" if given else "make hidden"


def asking(arguments: Sequence[str]) -> str:
    """Return what of the arguments says what is asked, not where the answers are kept and shown."""
    left = [a for before, a in zip(["", *arguments], arguments, strict=False) if "--answers" not in (before, a)]
    return " ".join(a for a in left if a != "--page" and not a.startswith("--answers="))


def main(arguments: Sequence[str]) -> int:
    """Run the set that was asked for; status 0 whatever the bars say: they are a measurement."""
    asked = options(arguments)
    wanted = jobs(asked.quick, asked.first)[:asked.most]
    kept = Kept(asked.answers or OUT / f"hidden-{provenance.commit()}.jsonl")
    told = answered(wanted, kept, lambda: workers_of(asked.scheduler, asked.workers))
    written = page.text(told, f"Printed by `{command(arguments)}` at commit "
                        f"{', '.join(sorted({kept.commits[job] for job in wanted}))}: {len(told)} cases, seeds "
                        f"{wanted[0].seed} to {wanted[-1].seed}.")
    print(written)
    if asked.page:
        put(DOCS, "judged", written)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
