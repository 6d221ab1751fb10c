"""The bars: each with its figure, what it is out of, its bound and whether it is met.

The rule of this file: a bar is computed from answers alone, and cases that no figure can be had of are counted, never
left out silently.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean, median
from typing import NamedTuple

from tests.hidden.answers import LEAST_RATIO, Answer

IDENTIFIABLE = (
    "viscous_friction", "friction_drift", "presliding", "knee_backlash", "end_mass", "end_gain", "start_gain",
    "end_offset", "start_offset", "end_drift", "start_drift", "end_delay", "end_filter", "timestamp_skew",
    "drive_coulomb", "drive_viscous", "drive_inertia", "drive_offset")
"""Effects whose parameter one gait trial determines: listed in docs/diagnosis_figures.md before the run."""


FAINT = 1.5
"""Residual in healthy floors up to which a case is near what the data can show."""


@dataclass(frozen=True)
class Bar:
    """One bar: the figure, what it is out of, the bound and whether it is met (None: none set, or nothing to say).

    `against`: what was hidden and what was said, of the cases that tell against it, the most frequent first; `faint` of
    them have a residual below `FAINT` healthy floors, `altered` are of an altered structure.
    """

    name: str
    figure: float
    count: int
    bound: str
    met: bool | None
    against: tuple[tuple[str, int], ...] = ()
    faint: int = 0
    altered: int = 0


def share(name: str, told: Sequence[Answer], holds: Callable[[Answer], bool], bound: float | None,
          at_least: bool = True) -> Bar:
    """Return the bar of a share of answers, %; `bound` None: a figure without one."""
    hits = [holds(a) for a in told]
    figure = 100.0 * sum(hits) / len(hits) if hits else math.nan
    contrary = [a for a, hit in zip(told, hits, strict=True) if hit != at_least]
    against = Counter(_case(a) for a in contrary)
    if bound is None:
        return Bar(name, figure, len(hits), "", None)
    met = None if not hits else figure >= bound if at_least else figure <= bound
    return Bar(name, figure, len(hits), f"{'≥' if at_least else '≤'} {bound:g} %", met, tuple(against.most_common()),
               sum(a.ratio < FAINT for a in contrary), sum(a.job.altered for a in contrary))


def value(name: str, values: Iterable[float], reduce: Callable[[Sequence[float]], float], bound: float, unit: str
          ) -> Bar:
    """Return the bar of a figure that is to stay at or below a bound."""
    held = list(values)
    figure = reduce(held) if held else math.nan
    return Bar(name, figure, len(held), f"≤ {bound:g}{unit}", figure <= bound if held else None)


def _case(a: Answer) -> str:
    hidden = " + ".join(a.hidden) or ("altered structure" if a.job.altered else "nothing")
    said = " + ".join(c["effect"] for c in a.causes) if a.causes else a.verdict
    rest = a.rivals[len(a.causes):]
    return f"{hidden} → {said}" + (f" (or {', '.join(rest)})" if rest else "")


class Error(NamedTuple):
    """A parameter of a rightly named effect: off by this share of its size; inside its interval?"""

    effect: str
    share: float
    covered: bool


def errors(told: Iterable[Answer]) -> Iterator[Error]:
    """Yield every parameter of an identifiable effect that was named and hidden."""
    for a in told:
        for cause in a.causes:
            if cause["effect"] in a.hidden and cause["effect"] in IDENTIFIABLE:
                for name, p in cause["parameters"].items():
                    if a.sizes.get(name):
                        true = a.sizes[name]
                        healthy = 1.0 if name.endswith("_gain") else 0.0
                        yield Error(cause["effect"], abs(p["value"] - true) / abs(true - healthy),
                                    p["low"] <= true <= p["high"])


def bars(told: Sequence[Answer]) -> list[Bar]:
    """Return every bar in the order of the list they were set in."""
    of = {kind: [a for a in told if a.job.kind == kind] for kind in ("one", "two", "outside", "none", "wire")}
    one, two, outside = ([a for a in of[kind] if a.counts] for kind in ("one", "two", "outside"))
    able = of["one"] + of["two"] + of["outside"]
    return [
        share("right class", one, _in_class, 95),
        share("first name right", one, lambda a: a.first == a.hidden[0], 90),
        share("wrong name", one, _wrong, 1, False),
        value("mean class size", [float(len(a.rivals)) for a in one if a.named], fmean, 1.6, ""),
        *_healthy(of["none"]),
        share("outside: named", outside, lambda a: a.named, 2, False),
        share("outside: unexplained", outside, lambda a: a.verdict == "unexplained", 95),
        *_parameters(one),
        share("0.9 of the achievable gain", [a for a in one if a.share is not None], lambda a: (a.share or 0.0) >= 0.9,
              90),
        share("two: class", two, lambda a: set(a.hidden) <= set(a.rivals), 85),
        share("two: one right", two, lambda a: bool(set(a.hidden) & set(a.rivals)), 95),
        *_all_pairs(of["two"]),
        share("wire fault: right class", of["wire"], _in_class, 95),
        share("wire fault: wrong name", of["wire"], _wrong, 1, False),
        *_after(one),
        value("single: seconds, median", [a.seconds for a in one], median, 10, " s"),
        value("pair: seconds, most", [a.seconds for a in two], max, 60, " s"),
        share(f"not counted: residual below {LEAST_RATIO} healthy floors", able, lambda a: not a.counts, None),
    ]


def _in_class(a: Answer) -> bool:
    return a.hidden[0] in a.rivals


def _wrong(a: Answer) -> bool:
    return a.named and not _in_class(a)


def _healthy(healthy: Sequence[Answer]) -> list[Bar]:
    def alarm(a: Answer) -> bool:
        return a.verdict != "none"

    plain, altered = ([a for a in healthy if a.job.altered is asked] for asked in (False, True))
    return [share("false alarms", healthy, alarm, 2, False),
            share("… on the plain structure", plain, alarm, None),
            share("… on altered structures", altered, alarm, None)]


def _all_pairs(two: Sequence[Answer]) -> list[Bar]:
    """The same of pairs of which one effect, by itself, would be below what counts."""
    seen = [a for a in two if a.ratio >= LEAST_RATIO]
    return [share("… of all pairs with a residual: class", seen, lambda a: set(a.hidden) <= set(a.rivals), None),
            share("… of all pairs with a residual: one right", seen, lambda a: bool(set(a.hidden) & set(a.rivals)),
                  None)]


def _parameters(one: Sequence[Answer]) -> list[Bar]:
    found = list(errors(one))
    covered = 100.0 * fmean(e.covered for e in found) if found else math.nan
    outside = Counter(e.effect for e in found if not e.covered)
    return [value("parameter error, median", [100.0 * e.share for e in found], median, 10, " %"),
            Bar("interval covers", covered, len(found), "≥ 90 %", covered >= 90 if found else None,
                tuple(outside.most_common()))]


def _after(one: Sequence[Answer]) -> list[Bar]:
    """What the proposed experiment does to a class that holds the truth."""
    undecided = [a for a in one if a.verdict == "ambiguous" and _in_class(a)]
    again = [dataclasses.replace(a, verdict=a.after.verdict, rivals=a.after.rivals, causes=[])
             for a in undecided if a.after is not None]
    return [share("after the experiment: truth in the class", again, _in_class, 95),
            share("after the experiment: truth alone", again, lambda a: a.rivals == a.hidden, 60),
            share("… ambiguous, but the experiment needs hands, or none is proposed", undecided,
                  lambda a: a.after is None, None)]
