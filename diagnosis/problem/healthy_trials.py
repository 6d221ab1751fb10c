"""Reference trials and the bench model fitted to them, computed once for all diagnoses that use them.

A fit depends only on the reference trials, the checked equations, the reference and the rate. It therefore serves every
trial under diagnosis that has the same columns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from diagnosis.data.table import Table
from diagnosis.problem import blocks, simulated_blocks
from diagnosis.problem.floors import CORRELATION_LENGTH, FLOORS
from diagnosis.problem.healthy_reference import HealthyReference, of_bench
from diagnosis.problem.learnt_bands import Learnt, geometry, learn, of_geometry
from physics.parameters import RELATION_PARAMETERS

SECONDS: Final = 5.0
"""Length of all trials together to which the simulation is fitted, s."""
RATES_HZ: Final = (50.0, 62.5, 80.0, 100.0, 125.0)
Key = tuple[tuple[str, ...], tuple[tuple[str, float], ...], float]


class HealthyTrials:
    """Trials of this bench or of its population without fault: usable samples, filtered alike."""

    def __init__(self, tables: Sequence[Table] = ()) -> None:
        self.tables = tuple(tables)
        self._fits: dict[Key, Learnt] = {}
        self._simulated: dict[int, dict[str, float]] = {}

    def __len__(self) -> int:
        return len(self.tables)

    def __iter__(self) -> Iterator[Table]:
        return iter(self.tables)

    def rate(self, trials: Sequence[Table]) -> float:
        """Return the sampling rate, Hz, for `trials` and these: the rate that suits the longest of them.

        Rates are limited to `RATES_HZ`, so that trials of similar length share a fit.
        """
        least = min(blocks.working_rate(group) for group in (trials, *([t] for t in self.tables)) if group)
        return max((r for r in RATES_HZ if r <= least), default=least)

    def fit(self, checked: Sequence[str], known: HealthyReference, rate_hz: float | None = None) -> Learnt:
        """Return the bench model fitted to these trials with the equations `checked`; `known` is one starting point."""
        rate = self.rate(()) if rate_hz is None else rate_hz
        key = tuple(checked), tuple(sorted(known.values.items())), rate
        if key not in self._fits:
            self._fits[key] = self._learn(tuple(checked), known, rate)
        return self._fits[key]

    def simulated(self, learnt: Learnt) -> dict[str, float]:
        """Return the identified constants, adjusted so that the simulation fits these trials; computed once."""
        if id(learnt) not in self._simulated:
            values = {n: v for n, v in learnt.reference.values.items() if n in RELATION_PARAMETERS}
            self._simulated[id(learnt)] = simulated_blocks.fitted(
                self.tables, values, learnt.sigma, learnt.like, SECONDS / max(len(self.tables), 1))
        return self._simulated[id(learnt)]

    def _learn(self, checked: tuple[str, ...], known: HealthyReference, rate: float) -> Learnt:
        own = of_bench(None)
        if known.measured:
            own = replace(own, values=known.values, measured=known.measured)
        taught = [blocks.blocks_of([t], [n for n in checked if not blocks.allowed([t])[n]], blocks.TAUT_N, rate)
                  for t in self.tables]
        columns = [t.columns for t in self.tables]
        near, closed = geometry(columns, own.values["rope_per_knee"]), geometry(columns)
        # a calibration measured the constants more accurately than the closed form estimates them
        start = own.values if near is None or known.measured else of_geometry(own.values, near)
        others = [known.values] if known.kind == "calibration" and not known.measured else []
        others += [of_geometry(own.values, closed)] if closed is not None else []
        return learn(taught, replace(own, kind="healthy", values=start), {n: FLOORS[n] for n in checked},
                     {n: CORRELATION_LENGTH[n] for n in checked}, others)
