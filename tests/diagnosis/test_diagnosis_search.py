"""The search itself, on lines: effects that hide each other are found together, and none where they do not pay."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from diagnosis.problem.blocks import Block
from diagnosis.problem.candidates import Candidate
from diagnosis.problem.cross_validation import folds_of
from diagnosis.problem.fit import Problem
from diagnosis.problem.prior import Free
from diagnosis.search.search import FittedEffects, Search
from physics.relations.measured import Signals
from physics.relations.relation import RELATIONS

LEAST_FALL = 30.0


@dataclass(frozen=True)
class Line(Block):
    """What was measured, in units of its noise, less a sum of columns, each by its factor."""

    measured: np.ndarray
    columns: Mapping[str, np.ndarray]

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        return self.measured - sum(values[name] * column for name, column in self.columns.items())


@dataclass(frozen=True)
class Falls:
    """An effect pays where χ² on unseen cycles falls by enough; `pairs`: two are tried where none pays."""

    pairs: bool

    def pays(self, lesser: FittedEffects, model: FittedEffects, search: Search) -> bool:
        return lesser.score - model.score >= LEAST_FALL

    def stopped(self, effect: Candidate, model: FittedEffects) -> bool:
        return False

    def can_improve(self, model: FittedEffects) -> bool:
        return True

    def needs_full_search(self, model: FittedEffects, baseline: FittedEffects) -> bool:
        return False

    def needs_pairs(self, baseline: FittedEffects) -> bool:
        return self.pairs


def found(drag: float, inertia: float, pairs: bool) -> tuple[str, ...]:
    """What is found where inertia is felt against almost the same motion as drag: each alone takes next to nothing."""
    rng = np.random.default_rng(0)
    speed, other, noise = (rng.normal(size=1000) for _ in range(3))
    columns = {"drag": 10.0 * speed, "inertia": -10.0 * speed + other, "offset": np.ones(1000)}
    measured = drag * columns["drag"] + inertia * columns["inertia"] + noise
    cycle = np.repeat(np.arange(10), 100)
    block = Line(RELATIONS["drive_force"], Signals({}, np.zeros(1000, dtype=bool), np.linspace(0.0, 1.0, 1000)),
                 np.arange(1000), cycle, frozenset(columns), measured, columns)
    offered = [Candidate(n, "", (Free(n, 0.0, 10.0, 0.0, math.inf, 1.0),), ({n: 1.0},), {}) for n in columns]
    search = Search(Problem([block], {"drive_force": 1.0}), dict.fromkeys(columns, 0.0), (), offered, folds_of(cycle),
                    Falls(pairs))
    return search.run(2).best.names


@pytest.mark.parametrize("pairs", [True, False])
def test_two_effects_that_hide_each_other_are_found_together_where_pairs_are_tried(pairs: bool) -> None:
    assert found(drag=1.0, inertia=1.0, pairs=pairs) == (("drag", "inertia") if pairs else ())


def test_no_pair_is_found_where_there_is_none() -> None:
    assert found(drag=0.0, inertia=0.0, pairs=True) == ()


def test_an_effect_that_pays_alone_is_found_alone() -> None:
    assert found(drag=1.0, inertia=0.0, pairs=True) == ("drag",)
