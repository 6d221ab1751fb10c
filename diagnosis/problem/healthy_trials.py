"""Healthy trials and what is fitted to them, once for all the diagnoses that use them.

The rule of this file: a fit depends on the healthy trials, the relations that are checked and the reference alone, so
that one fit serves every trial in question that has the same columns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from diagnosis.data.table import Table
from diagnosis.problem import blocks
from diagnosis.problem.candidates import candidates
from diagnosis.problem.floors import CORRELATION_LENGTH, FLOORS
from diagnosis.problem.healthy_fit import HealthyFit, fit_healthy
from diagnosis.problem.reference import Reference

Key = tuple[tuple[str, ...], tuple[tuple[str, float], ...], tuple[object, ...]]


class HealthyTrials:
    """Trials of this or a like bench with nothing wrong, as they are fitted: usable samples, filtered alike."""

    def __init__(self, tables: Sequence[Table] = ()) -> None:
        self.tables = tuple(tables)
        self._fits: dict[Key, HealthyFit] = {}

    def __len__(self) -> int:
        return len(self.tables)

    def __iter__(self) -> Iterator[Table]:
        return iter(self.tables)

    def fit(self, checked: Sequence[str], reference: Reference) -> HealthyFit:
        """Return what these trials say of the relations `checked`, about `reference`; computed once for each pair."""
        key = tuple(checked), tuple(sorted(reference.values.items())), tuple(reference.nuisance)
        if key not in self._fits:
            taught = [blocks.blocks_of([t], [n for n in checked if not blocks.allowed([t])[n]], blocks.TAUT_N)
                      for t in self.tables]
            self._fits[key] = fit_healthy(
                taught, reference, candidates(tuple(checked), reference.values, reference.nuisance),
                {n: FLOORS[n] for n in checked}, {n: CORRELATION_LENGTH[n] for n in checked})
        return self._fits[key]
