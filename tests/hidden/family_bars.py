"""The bars on the family: each by structure and over all, with its bound and the one that the worst structure has.

The rule of this file: a figure is computed from answers alone; the oracle decided which of them count.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median

from physics.effects.hypotheses import HYPOTHESES
from tests.hidden.bars import IDENTIFIABLE, Error
from tests.hidden.family import Answer, session
from tests.plants import draws, effects, oracle
from tests.plants.bench import KNEES

Part = Callable[[Answer], bool]


@dataclass(frozen=True)
class Share:
    """The share of the answers `of` that `holds`, %: at least (at most) `bound`, of the worst structure `worst`."""

    name: str
    of: Part
    holds: Part
    bound: float | None = None
    worst: float | None = None
    at_least: bool = True


def _seen(a: Answer) -> bool:
    return a.counts and not a.job.left_out


def _one(a: Answer) -> bool:
    return _seen(a) and len(a.job.hidden) == 1 and a.job.hidden[0] in effects.EFFECTS


def _judged_part(a: Answer) -> bool:
    """Whether one effect of the forward model was hidden and the core says in which part of the bench it is."""
    return _one(a) and a.job.hidden[0] in HYPOTHESES


def _two(a: Answer) -> bool:
    return _seen(a) and len(a.job.hidden) == 2


def _outside(a: Answer) -> bool:
    return _seen(a) and len(a.job.hidden) == 1 and a.job.hidden[0] in effects.OUTSIDE


def _again(a: Answer) -> bool:
    """Whether a class that holds the truth was to be split, by an experiment that the bench runs by itself."""
    return _one(a) and a.right and a.after is not None


def _faint(a: Answer) -> bool:
    return not a.counts and not a.job.left_out


SHARES = (
    Share("right class", _one, lambda a: a.right, 88.0, 80.0),
    Share("first name", _one, lambda a: a.named[:1] == a.job.hidden, 88.0),
    Share("wrong name", _one, lambda a: a.wrong, 2.0, 4.0, False),
    Share("part right", _judged_part, lambda a: a.part == HYPOTHESES[a.job.hidden[0]].part, 92.0, 85.0),
    Share("part wrong", _judged_part, lambda a: a.part not in (None, HYPOTHESES[a.job.hidden[0]].part), 2.0, None,
          False),
    Share("false alarms", lambda a: not a.job.hidden and not a.job.left_out, lambda a: bool(a.rivals), 2.0, 4.0, False),
    Share("… `unexplained` said of a healthy bench", lambda a: not a.job.hidden and not a.job.left_out,
          lambda a: a.verdict == "unexplained"),
    Share("outside: named", _outside, lambda a: bool(a.rivals), 2.0, None, False),
    Share("outside: unexplained", _outside, lambda a: a.verdict == "unexplained", 90.0),
    Share("pairs: class", _two, lambda a: a.right, 70.0),
    Share("pairs: one right", _two, lambda a: bool(set(a.job.hidden) & set(a.rivals)), 97.0),
    Share("after the experiment: truth in the class", _again,
          lambda a: a.after is not None and a.job.hidden[0] in a.after.rivals, 95.0),
    Share("… alone", _again, lambda a: a.after is not None and a.after.rivals == a.job.hidden, 70.0),
    Share("no END: wrong name or alarm", lambda a: bool(a.job.left_out),
          lambda a: a.wrong or (not a.job.hidden and bool(a.rivals)), 2.0, None, False),
    Share("… in the class", lambda a: bool(a.job.left_out and a.job.hidden), lambda a: a.right),
    Share("not counted by the oracle: wrong name", _faint, lambda a: a.wrong),
)
MOST_ERROR, LEAST_COVERED = 5.0, 90.0
"""Median error of a parameter, %, at most; share of the intervals that hold the truth, %, at least."""


def errors(told: Iterable[Answer]) -> Iterator[Error]:
    """Yield every parameter of an identifiable effect that was hidden alone, counts, and was named."""
    for a in told:
        name = a.job.hidden[0] if _one(a) else ""
        for parameter, said in a.found.get(name, {}).items() if name in IDENTIFIABLE else ():
            true = a.values.get(parameter)
            if true:
                size = abs(true - (1.0 if parameter.endswith("_gain") else 0.0))
                yield Error(name, abs(said["value"] - true) / size, said["low"] <= true <= said["high"])


def _cell(bar: Share, told: Sequence[Answer]) -> tuple[str, float]:
    part = [a for a in told if bar.of(a)]
    hits = sum(bar.holds(a) for a in part)
    return (f"{hits}/{len(part)}", 100.0 * hits / len(part)) if part else ("–", math.nan)


def _row(bar: Share, by_kind: Sequence[Sequence[Answer]]) -> list[str]:
    cells, figures = zip(*(_cell(bar, told) for told in by_kind), strict=True)
    _, whole = _cell(bar, [a for told in by_kind for a in told])
    ends = [f for f in figures if not math.isnan(f)]
    sign = "≥" if bar.at_least else "≤"
    bound = "–" if bar.bound is None else f"{sign} {bar.bound:g} %"
    if bar.worst is not None:
        bound += f" (worst {sign} {bar.worst:g})"
    return [bar.name, *cells, _figure(whole, " %"), bound, _met(
        [(whole, bar.bound), *((f, bar.worst) for f in ends)], bar.at_least)]


def _met(pairs: Sequence[tuple[float, float | None]], at_least: bool) -> str:
    held = [(f, b) for f, b in pairs if b is not None and not math.isnan(f)]
    if not held:
        return "–"
    return "yes" if all(f >= b if at_least else f <= b for f, b in held) else "no"


def _figure(value: float, unit: str) -> str:
    return "–" if math.isnan(value) else f"{value:.1f}{unit}"


def _of_errors(by_kind: Sequence[Sequence[Answer]]) -> list[list[str]]:
    parts = [list(errors(told)) for told in by_kind]
    every = [e for part in parts for e in part]
    offs = [median(100.0 * e.share for e in part) if part else math.nan for part in (*parts, every)]
    held = [100.0 * sum(e.covered for e in part) / len(part) if part else math.nan for part in (*parts, every)]
    return [
        ["parameter error, median", *(_figure(o, " %") for o in offs[:-1]),
         f"{_figure(offs[-1], ' %')} of {len(every)}", f"≤ {MOST_ERROR:g} %", _met([(offs[-1], MOST_ERROR)], False)],
        ["interval covers", *(f"{sum(e.covered for e in part)}/{len(part)}" if part else "–" for part in parts),
         _figure(held[-1], " %"), f"≥ {LEAST_COVERED:g} %", _met([(held[-1], LEAST_COVERED)], True)]]


def rows(by_kind: Sequence[Sequence[Answer]]) -> list[list[str]]:
    """Return one row for each bar: name, a cell for each structure, over all, the bound, whether it is met."""
    counted = ["not counted by the oracle", *(str(sum(map(_faint, told))) for told in by_kind),
               str(sum(_faint(a) for told in by_kind for a in told)), "–", "–"]
    return [*(_row(bar, by_kind) for bar in SHARES), *_of_errors(by_kind), counted]


def table(kinds: Sequence[str], by_kind: Sequence[Sequence[Answer]]) -> str:
    """Return the table as Markdown."""
    heads = ["bar", *kinds, "all", "bound", "met"]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (heads, ["---"] * len(heads), *rows(by_kind)))


FAR_M = 25e-3
"""Encoder's zero from which a bench is far from the packaged one's: half of the family is."""
RIGS: tuple[tuple[str, Part], ...] = (
    *((f"{n} healthy trial{'s' if n > 1 else ''}", lambda a, n=n: session(a.job).healthy == n) for n in (1, 2, 3)),
    ("rope let go of in each cycle", lambda a: session(a.job).preload_n == 0.0),
    ("rope always taut", lambda a: session(a.job).preload_n > 0.0),
    ("encoder's zero within 25 mm", lambda a: abs(draws.draw(a.job.serial).zero) <= FAR_M),
    ("encoder's zero farther away", lambda a: abs(draws.draw(a.job.serial).zero) > FAR_M),
    *((f"knee: {knee}", lambda a, knee=knee: draws.structure(a.job.serial).knee == knee) for knee in KNEES),
)
BY_RIG = ("right class", "wrong name", "false alarms", "pairs: class")
SEPARATIONS = (oracle.COUNTS_FROM, 1000.0, 5000.0, math.inf)
"""χ² of the oracle between which the bars are told by how plain an effect is; from the first on a case counts."""
BY_SEPARATION = ("right class", "first name", "wrong name", "pairs: class", "pairs: one right")


def by_rig(told: Sequence[Answer]) -> str:
    """Return, as Markdown, what some of the bars come to on a part of the rigs and recordings."""
    return _by("rig", RIGS, BY_RIG, told)


def by_separation(told: Sequence[Answer]) -> str:
    """Return, as Markdown, what some of the bars come to by the χ² that an effect (of two: the lesser) is told by.

    That of the oracle, which has the bench's own laws and constants: what an ideal finder has to go by.
    """
    parts = [(f"{low:g} to {high:g}" if math.isfinite(high) else f"{low:g} and more",
              lambda a, low=low, high=high: a.separation is not None and low <= a.separation < high)
             for low, high in itertools.pairwise(SEPARATIONS)]
    return _by("χ² of the oracle", parts, BY_SEPARATION, told)


def _by(head: str, parts: Iterable[tuple[str, Part]], names: Sequence[str], told: Sequence[Answer]) -> str:
    bars = [bar for name in names for bar in SHARES if bar.name == name]
    lines = [[head, *names], ["---"] * (1 + len(bars))]
    for name, of in parts:
        found = [_cell(bar, [a for a in told if of(a)]) for bar in bars]
        lines.append([name, *(count if math.isnan(share) else f"{count} = {share:.1f} %" for count, share in found)])
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def against(a: Answer) -> bool:
    """Whether an answer tells against a bar, or is a wrong name where none is counted."""
    return a.wrong or bool(not a.job.hidden and a.verdict != "none") or (_seen(a) and not a.right)
