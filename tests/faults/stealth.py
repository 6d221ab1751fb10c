"""The worst fault of each sensor that goes unsaid: bisection over its size, as an attacker would look for it.

`found(jobs)` runs six gait cycles for each size; a size is unsaid where the whole trial ends without a stop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from tests.faults import slow
from tests.faults.judge import LEG_DEG, MOMENT_N, UNSAID_MS, UNSAID_N, Verdict, judged
from tests.faults.slow import DEGREE, Act
from tests.faults.stage import Row, Walk, trial

ROUNDS = 5
WALKS = (Walk(1.1, "paper", 6), Walk(2.0, "extended", 6))


@dataclass(frozen=True)
class Attack:
    """One lie of free size: `most` is its greatest, in `unit`; `made` gives the fault of a size.

    `beyond`: why no signal could show a size that moves END or the leg beyond its bound.
    """

    name: str
    most: float
    unit: str
    made: Callable[[float], Act]
    beyond: str = ""


ATTACKS: tuple[Attack, ...] = (
    Attack("START off while loaded, within 2 s", 10.0, "N", slow.start_loaded),
    Attack("START off while loaded, within 2 s", -10.0, "N", slow.start_loaded),
    Attack("START's gain, within 2 s", -30.0, "%", lambda x: slow.start_gain(x / 100.0)),
    Attack("START's gain, within 2 s", 30.0, "%", lambda x: slow.start_gain(x / 100.0)),
    Attack("START late, within 6 s", 20.0, "ms", lambda x: slow.start_late(x / 1e3)),
    Attack("END's gain, within 2 s", -30.0, "%", lambda x: slow.end_gain(x / 100.0)),
    Attack("START, END and torque alike, within 2 s", -35.0, "%", lambda x: slow.alike(x / 100.0),
           slow.TWO_LIE),
    Attack("sheath slips, within 2 s", 4.0, "mm", lambda x: slow.slips(x / 1e3)),
    Attack("sheath slips, within 2 s", -4.0, "mm", lambda x: slow.slips(x / 1e3)),
    Attack("servo encoder creeps", 1.0, "mm/s", lambda x: slow.servo_creeps(x / 1e3)),
    Attack("servo encoder and its velocity err with START", 0.1, "mm/N",
           lambda x: slow.counted(slow.servo_by_tension(x / 1e3))),
    Attack("knee encoder's scale, within 2 s", 15.0, "%", lambda x: slow.knee_scale(x / 100.0)),
    Attack("knee encoder's scale and its velocity, within 2 s", 15.0, "%",
           lambda x: slow.counted(slow.knee_scale(x / 100.0)), slow.LEG),
    Attack("knee encoder creeps", 1.5, "°/s", lambda x: slow.knee_creeps(x * DEGREE), slow.LEG),
    Attack("friction, within 2 s", 3.0, "×", lambda x: slow.friction(1.0 + x)),
)


class Stealthy(NamedTuple):
    """The greatest unsaid size that was found, the smallest that was said (NaN: none), and what the former moved."""

    attack: Attack
    walk: Walk
    size: float
    said: float
    moved: Verdict | None


@dataclass
class _Search:
    attack: Attack
    low: float = 0.0
    high: float = field(default=float("nan"))
    best: Verdict | None = None

    def next(self) -> float:
        """Return the size to try next: the greatest, then halves."""
        return self.attack.most if self.high != self.high and self.best is None and self.low == 0.0 else (
            0.5 * (self.low + self.high))

    def take(self, size: float, verdict: Verdict) -> None:
        """Keep what a size did."""
        if verdict.said:
            self.high = size
        else:
            self.low, self.best = size, verdict


def found(jobs: int = 2) -> list[Stealthy]:
    """Search every attack in every gait."""
    told = []
    for walk in WALKS:
        searches = [_Search(attack) for attack in ATTACKS]
        for _round in range(ROUNDS + 1):
            sizes = {str(i): search.next() for i, search in enumerate(searches) if search.low != search.attack.most}
            rows = [Row(name, searches[int(name)].attack.made(size), (), ("idle",), walks=(walk,))
                    for name, size in sizes.items()]
            if not rows:
                break
            ran, twin = trial(rows, jobs, walk)
            for each in ran:
                row = next(row for row in rows if row.name == each.name)
                searches[int(each.name)].take(sizes[each.name], judged(row, each, twin, walk))
        told += [Stealthy(s.attack, walk, s.low, s.high, s.best) for s in searches]
    return told


HEAD = ["", "## The worst that goes unsaid", "",
        "`make faults` halves the size of each slow fault until it finds the largest that six gait cycles do not show "
        "(`tests/faults/stealth.py`); from 60 % of the first gait cycle on. END off: for a moment, for 200 ms.", "",
        "| fault | gait | largest unsaid | smallest said | END off, N | leg, degrees | true peak START / END, N |",
        "|---|---|---|---|---|---|---|"]


def table(told: list[Stealthy]) -> list[str]:
    """Return the lines of the table in docs/faults.md."""
    lines = list(HEAD)
    for one in told:
        unit, v = one.attack.unit, one.moved
        said = "none" if one.said != one.said else f"{one.said:.3g} {unit}"
        moved = ("– | – | –" if v is None else f"{v.apart_n:.1f} / {v.unsaid_n:.1f} | {v.leg_deg:.1f} | "
                 f"{v.peak_start_n:.0f} / {v.peak_end_n:.0f}")
        lines.append(f"| {one.attack.name} | {one.walk} | {one.size:.3g} {unit} | {said} | {moved} |")
    over = [one for one in told if one.moved is not None and (
        one.moved.apart_n > MOMENT_N or one.moved.unsaid_n > UNSAID_N or one.moved.leg_deg > LEG_DEG)]
    lines += ["", f"Bounds: {MOMENT_N:g} N for a moment, {UNSAID_N:g} N for {UNSAID_MS} ms, {LEG_DEG:g}°. "
              f"{len(over)} of {len(told)} searches found a size beyond one." + "\n" * bool(over)]
    lines += [f"- {one.attack.name} ({one.walk}): {one.attack.beyond or 'no reason is known'}." for one in over]
    return lines
