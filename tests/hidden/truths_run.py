"""The diagnosis asked about rigs of another structure: what is in the ambiguity set, and what is named in its place.

    python -m tests.hidden.truths_run [--first SEED] [--singles N] [--healthy N] [--pairs N] [--outside N]
                                      [--structures truth1,truth2] [--motion] [--alone] [--hash] [--workers N]
                                      [--answers FILE]

The structures `truth1` and `truth2` need the folder ../shared/truths; `--structures rate_state` needs no such folder.

`--motion` gives the diagnosis a reference trial of the trial's own motion, too, `--alone` that one only.  Answers
are stored with the commit, and a run that was broken off goes on from there.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import hashlib
import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from bowden.trials import provenance
from diagnosis.compared_signals import SignalResiduals
from diagnosis.finder import Finder
from diagnosis.findings import Findings
from estimation.data.table import table
from estimation.path_model import PATH_MODEL
from tests.hidden import truths
from tests.hidden.truths import Drawn, Question

OUT = Path("out")


@dataclass(frozen=True)
class Answer:
    """Verdict on one case.

    `gains`: of what is named over the adapted session, %, as said (held-out cycles of the trial), and on a repeat of
    its motion and another motion in the same session, to which nothing is fitted; empty without a name.
    """

    structure: str
    hidden: tuple[str, ...]
    seed: int
    motion: bool
    separation: float
    verdict: str
    named: tuple[str, ...]
    among: tuple[str, ...]
    part: str | None
    nats: dict[str, float]
    detail: dict[str, Any]
    seconds: float
    gains: tuple[float, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the catalogue that are hidden."""
        return Question(self.structure, self.hidden, self.seed).effects

    @property
    def right(self) -> bool:
        """Whether every hidden effect, or one that no gait separates from it, is in the ambiguity set."""
        return bool(self.effects) and all(set(truths.alike(name)) & set(self.among) for name in self.effects)

    @property
    def wrong(self) -> bool:
        """Whether effects are named and none of the ambiguity set is right."""
        return bool(self.among) and not any(set(truths.alike(name)) & set(self.among) for name in self.effects)


def stored(asked: Question, folder: Path = OUT / "truths") -> Drawn:
    """Return the trials of a case, drawn once by each version of the rig and stored under `folder`."""
    path = folder / f"{asked.structure}-{'+'.join(asked.hidden)}-{asked.seed}-{truths.version(asked.structure)}.npz"
    if not path.is_file():
        made = truths.draw(asked)
        folder.mkdir(parents=True, exist_ok=True)
        sets = [*made.references, made.same_motion, made.trial, made.repeat, made.further]
        columns = {f"{k}.{name}": values for k, part in enumerate(sets) for name, values in part.items()}
        np.savez(path, separation=made.separation, clean=made.clean, **columns)
    with np.load(path) as held:
        sets = [{name.split(".")[1]: held[name] for name in held.files if name.startswith(f"{k}.")} for k in range(6)]
        return Drawn(tuple(sets[:2]), *sets[2:], float(held["separation"]), held["clean"])


def answer(asked: Question, motion: bool = False, alone: bool = False) -> Answer:
    """Return the diagnosis of one case; `motion`: a reference trial of the trial's own motion is given, too; `alone`:
    without the others."""
    made = stored(asked)
    healthy = [table(f"healthy{k}", columns) for k, columns in enumerate(
        (*(() if alone else made.references), *([made.same_motion] if motion or alone else [])))]
    began = time.perf_counter()
    further = [table("repeat", made.repeat), table("further", made.further)]
    found = Finder().examine(healthy).diagnose([table("trial", made.trial)], further)
    seconds = time.perf_counter() - began
    evidence = found.evidence or {}
    return Answer(asked.structure, asked.hidden, asked.seed, motion or alone, made.separation, found.verdict,
                  tuple(cause["effect"] for cause in found.causes), tuple(found.rivals), found.part,
                  {k: round(v, 1) for k, v in list(evidence.get("log_bayes_factors", {}).items())[:5]},
                  {"misfit": evidence.get("misfit"), "warnings": found.warnings, "simulation": found.simulation},
                  round(seconds, 1), _gains(found))


def _gains(found: Findings) -> tuple[float, ...]:
    """Return the gain of what is named over the adapted session, %, as said and on each further trial; () without one.
    """
    if not found.causes or found.simulation is None:
        return ()
    further = zip(*(found.held_traces[name] for name in PATH_MODEL.judged), strict=True)
    return tuple(round(gain, 1) for gain in (
        found.simulation["gain_percent"], *(_gain(signals) for signals in further)))


def _gain(signals: Sequence[SignalResiduals]) -> float:
    """Return the gain in one trial over its judged signals, %."""
    session, named = (np.sqrt(sum(float(np.mean(errors**2)) for errors in each)) for each in (
        [signal.session for signal in signals], [signal.after for signal in signals]))
    return float(100.0 * (1.0 - named / session))


def digest(asked: Sequence[Question]) -> str:
    """Return the SHA-256 of what is asked."""
    return hashlib.sha256("\n".join(f"{q.structure} {'+'.join(q.hidden)} {q.seed}" for q in asked).encode()).hexdigest()


def said(a: Answer) -> str:
    """Return one case in one line."""
    state = "right" if a.right else "WRONG" if a.wrong else "  not"
    best = ", ".join(f"{name} {nats:g}" for name, nats in a.nats.items())
    errors = a.detail["simulation"] or {}
    figures = " → ".join("–" if errors.get(f"{which}_rms_n") is None else f"{errors[f'{which}_rms_n']:.2f}"
                         for which in ("healthy", "before", "session", "after"))
    return (f"{state} {a.structure} {a.seed} {'+'.join(a.hidden)} χ² {a.separation:.0f} → {a.verdict} "
            f"{', '.join(a.named)} | {', '.join(a.among)} | {best} | {figures} N"
            + (f", gain {a.gains[0]:g} %, on a repeat {a.gains[1]:g} %, in another motion {a.gains[2]:g} %"
               if a.gains else "") + f" | {a.seconds:g} s")


def summary(told: Sequence[Answer]) -> list[str]:
    """Return the figures over answers, one a line."""
    one = [a for a in told if len(a.effects) == 1 and a.separation >= truths.SEPARABLE]
    healthy = [a for a in told if a.hidden in (("null",), ("null_alt",))]
    rows = [("separable, in the set", [a.right for a in one]), ("first name right", [
        bool(a.named) and a.named[0] in truths.alike(a.effects[0]) for a in one]),
        ("wrong", [a.wrong for a in told if a.effects]), ("alarms", [bool(a.among) for a in healthy]),
        ("unexplained alone, reference condition", [a.verdict == "unexplained" for a in healthy]),
        ("unexplained alone, effect of the catalogue", [a.verdict == "unexplained" for a in one]),
        ("part right, of named", [a.part == truths.part(a.effects[0]) for a in one if a.among]),
        *((f"gain within 5 points of that {where}", [abs(a.gains[0] - a.gains[k]) <= 5.0 for a in one if a.gains])
          for k, where in ((1, "on a repeat"), (2, "in another motion"))),
        ("pairs, both in the set", [a.right for a in told if len(a.effects) == 2]),
        ("outside the catalogue, named", [bool(a.among) for a in told if a.hidden[0] in truths.OUTSIDE])]
    return [f"{name}: {sum(held)} of {len(held)}" for name, held in rows if held]


def matrix(told: Sequence[Answer]) -> str:
    """Return how often each first name is given for each hidden effect, as Markdown."""
    counted: Counter[tuple[str, str]] = Counter()
    for a in told:
        if len(a.hidden) == 1:
            hidden = a.effects[0] if a.effects else ("nothing" if a.hidden[0].startswith("null") else a.hidden[0])
            counted[hidden, a.named[0] if a.named else a.verdict] += 1
    rows, heads = sorted({r for r, _ in counted}), sorted({c for _, c in counted})
    lines = [f"| hidden | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    return "\n".join([*lines, *(f"| {r} | {' | '.join(str(counted[r, c] or '') for c in heads)} |" for r in rows)])


def main(arguments: list[str]) -> None:
    """Ask every case and print each answer, the matrix and the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, count in (("--first", 1000), ("--singles", 20), ("--healthy", 8), ("--pairs", 0), ("--outside", 0),
                        ("--workers", 1)):
        parser.add_argument(name, type=int, default=count)
    parser.add_argument("--structures", default=",".join(truths.STRUCTURES),
                        help="comma-separated; rate_state needs no folder ../shared, truth1 and truth2 do")
    parser.add_argument("--motion", action="store_true")
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--hash", action="store_true")
    parser.add_argument("--answers", type=Path)
    given = parser.parse_args(arguments)
    asked = [q for turn in zip(*(truths.questions(s, given.first, given.singles, given.healthy, given.pairs,
                                                  given.outside) for s in given.structures.split(",")), strict=True)
             for q in turn]
    print(f"{len(asked)} cases, SHA-256 {digest(asked)}", flush=True)
    if given.hash:
        return
    kind = "-alone" if given.alone else "-motion" if given.motion else ""
    path = given.answers or OUT / f"truths-{provenance.commit()}{kind}.jsonl"
    path.parent.mkdir(exist_ok=True)
    told = _kept(path)
    todo = [q for q in asked if (q.structure, q.hidden, q.seed) not in told]
    ask = functools.partial(answer, motion=given.motion, alone=given.alone)
    with contextlib.ExitStack() as stack, path.open("a") as out:
        crew = map(ask, todo) if given.workers == 1 else stack.enter_context(ProcessPoolExecutor(
            given.workers, mp_context=get_context("spawn"))).map(ask, todo)
        for a in crew:
            told[a.structure, a.hidden, a.seed] = a
            out.write(json.dumps(asdict(a)) + "\n")
            out.flush()
            print(said(a), flush=True)
    every = [told[q.structure, q.hidden, q.seed] for q in asked]
    print(matrix(every))
    for structure in given.structures.split(","):
        print(f"{structure}: {'; '.join(summary([a for a in every if a.structure == structure]))}")
    print("all:", "; ".join(summary(every)))


def _kept(path: Path) -> dict[tuple[str, tuple[str, ...], int], Answer]:
    lines = path.read_text().splitlines() if path.is_file() else []
    rows = [json.loads(line) for line in lines]
    return {(r["structure"], tuple(r["hidden"]), r["seed"]): Answer(**{
        **r, **{name: tuple(r[name]) for name in ("hidden", "named", "among", "gains")}}) for r in rows}


if __name__ == "__main__":
    main(sys.argv[1:])
