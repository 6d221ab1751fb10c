"""What an effect must do to be named: each gate with a case that it stops, beside one that passes all of them."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest

from diagnosis.data.table import table
from diagnosis.judgement import verdict
from diagnosis.judgement.criteria import SearchCriteria
from diagnosis.judgement.judge import Judge
from diagnosis.problem.blocks import signals_of
from diagnosis.problem.deviations import chance
from diagnosis.problem.fit import Space
from diagnosis.problem.healthy_trials import HealthyTrials
from diagnosis.problem.problem import build_problem
from diagnosis.search.search import FittedEffects, Search, SearchResult
from physics.effects.catalogue import CATALOGUE
from tests.hidden.bench import Bench
from tests.hidden.walk import trial

OFFSET_N = 2.0


@pytest.fixture(scope="module")
def judge() -> Judge:
    """A bench whose END reads 2 N too much, beside a healthy trial of it."""
    shown = trial(Bench(), seed=1, cycles=4)
    shown = {**shown, "tension_end_n": shown["tension_end_n"] + OFFSET_N}
    taught = HealthyTrials([table("good.csv", trial(Bench(), seed=2, cycles=4))])
    return Judge(build_problem([table("walk.csv", shown)], taught, None), ())


@dataclasses.dataclass(frozen=True)
class Supposed(FittedEffects):
    """A fitted model with a stated χ² of each relation on held-out cycles."""

    stated: Mapping[str, float] = dataclasses.field(kw_only=True)

    @property
    def by_relation(self) -> Mapping[str, float]:
        """Return the stated χ²."""
        return self.stated


def supposed(model: FittedEffects, stated: Mapping[str, float]) -> Supposed:
    """Return `model` with these χ² on held-out cycles."""
    own = {f.name: getattr(model, f.name) for f in dataclasses.fields(FittedEffects)}
    return Supposed(**own, stated=stated)


def moved(model: FittedEffects, by_relation: dict[str, float] | None = None,
          values: dict[str, float] | None = None) -> FittedEffects:
    """Return `model` with other χ² on all cycles and on held-out ones, or with other values of its parameters."""
    there = {**model.fit.values, **(values or {})}
    more = sum(left - model.by_relation[name] for name, left in (by_relation or {}).items())
    space = Space(model.fit.free, model.problem.prior)
    fit = dataclasses.replace(
        model.fit, values=there, penalty=space.penalty(space.of(there)), cost=model.fit.cost + 0.5 * more)
    return supposed(dataclasses.replace(model, fit=fit), {**model.by_relation, **(by_relation or {})})


def test_the_offset_is_named_with_its_size_and_passes_every_gate(judge: Judge) -> None:
    assert [c["effect"] for c in judge.causes()] == ["end_offset"]
    told = judge.causes()[0]["parameters"]["end_offset"]
    assert told["low"] <= OFFSET_N <= told["high"]
    assert judge.criteria.pays(judge.found.baseline, judge.found.best, judge.search)


def test_what_looks_like_a_find_was_fitted_in_its_place_from_every_start(judge: Judge) -> None:
    chosen, = judge.found.best.effects
    alike = [c for c in judge.search.offered if c.name in chosen.rivals]
    assert {c.name for c in alike} >= {"slack", "end_mass"}
    assert all(((), c.name, s) in judge.search.grown for c in alike for s in range(len(c.starts)))


def test_an_effect_that_makes_a_relation_worse_by_more_than_its_law_may_is_no_cause(judge: Judge) -> None:
    base, best = judge.found.baseline, judge.found.best
    chance, taken = judge.criteria.noise("knee", base), base.score - best.score
    law = verdict.MISMATCH * taken
    assert 1.2 * chance < 0.8 * law
    for more, pays in ((1.2 * chance, True), (0.8 * law, True), (1.2 * law, False)):
        worse = base.by_relation["knee"] + more
        assert judge.criteria.pays(base, moved(best, {"knee": worse}), judge.search) == pays


def test_an_effect_that_bends_the_rest_away_from_what_is_known_of_it_is_no_cause(judge: Judge) -> None:
    base, best = judge.found.baseline, judge.found.best
    strained = {f.name: f.high for f in best.fit.free if np.isfinite(f.sigma)}
    assert not judge.criteria.pays(base, moved(best, values=strained), judge.search)


def test_an_effect_within_what_like_benches_differ_by_is_no_cause(judge: Judge) -> None:
    band = next(f for f in judge.setting.reference.nuisance if f.name == "end_offset")
    small = moved(judge.found.best, values={"end_offset": 0.9 * band.high})
    assert not judge.criteria.pays(judge.found.baseline, small, judge.search)


def test_what_was_named_is_not_smaller_than_what_could_have_been(judge: Judge) -> None:
    limits = judge.limits()
    assert limits is not None
    assert limits["end_offset"]["value"] <= judge.causes()[0]["parameters"]["end_offset"]["value"]


def test_a_value_on_its_bound_is_said_not_to_be_measured(judge: Judge) -> None:
    high = judge.found.best.effects[0].frees[0].high
    bound = copy.copy(judge)
    bound.found = dataclasses.replace(judge.found, best=moved(judge.found.best, values={"end_offset": high}))
    assert judge.on_bounds() == []
    assert bound.on_bounds() == [f"end_offset: end_offset stands on its bound, {high:.4g}; it is not measured."]


@pytest.mark.parametrize(("changed", "says"), [({"load": 0.5, "cap": 0.22}, True), ({"cap": 0.28}, False)])
def test_a_law_that_moves_its_level_far_must_say_more_than_the_level(changed: dict[str, float], says: bool) -> None:
    shown = table("walk.csv", trial(Bench(**changed), seed=1, cycles=4))
    setting = build_problem([shown], HealthyTrials([table("good.csv", trial(Bench(), seed=2, cycles=4))]), None)
    criteria = SearchCriteria(setting)
    search = Search(setting.problem, setting.reference.values, setting.reference.nuisance, setting.offered,
                    setting.folds, criteria)
    law = next(c for c in setting.offered if c.name == "load_dependent_friction")
    model = min((search.model([law], {**search.start, **start}) for start in law.starts), key=lambda m: m.fit.cost)
    assert criteria.leads(law, model, search) == says
    assert search.lacks, "the level has not moved far: the test asks nothing"


def test_what_pays_on_unseen_cycles_alone_is_the_ill_luck_of_a_fold(judge: Judge) -> None:
    base, best = judge.found.baseline, judge.found.best
    level = supposed(dataclasses.replace(best, fit=dataclasses.replace(best.fit, cost=base.fit.cost)),
                     best.by_relation)
    assert judge.criteria.pays(base, best, judge.search)
    assert not judge.criteria.pays(base, level, judge.search)


def test_a_second_effect_must_take_three_tenths_of_what_the_first_left(judge: Judge) -> None:
    best, noise = judge.found.best, judge.setting.noise_squares("friction")
    left = 100.0 * best.by_relation["friction"]
    first = moved(best, {"friction": left})
    seconds = [moved(best, {"friction": left - share * (left - noise)}) for share in (0.25, 0.35)]
    assert [judge.criteria.pays(first, second, judge.search) for second in seconds] == [False, True]
    # where nothing is named yet, 8 % of the RMSE do
    bare = moved(judge.found.baseline, {"friction": left})
    assert judge.criteria.pays(bare, seconds[0], judge.search)


def test_what_leaves_the_bench_strained_must_take_what_some_law_takes_of_a_healthy_one(judge: Judge) -> None:
    best = judge.found.best
    own = {f.name for c in best.effects for f in c.frees}
    calm = {f.name: f.mean for f in best.fit.free if np.isfinite(f.sigma) and f.name not in own}
    named = moved(best, values=calm)
    left = {n: judge.setting.healthy_squares(n) for n in best.by_relation}
    lesser, *models = (moved(named, {**left, "friction": left["friction"] + more * verdict.BENT})
                       for more in (2.0, 1.5, 0.5))
    lesser = supposed(dataclasses.replace(lesser, effects=()),
                      {**left, "friction": left["friction"] + 2.0 * verdict.BENT})
    search = copy.copy(judge.search)
    search.tried = {**search.tried, (): lesser}
    assert [judge.criteria.pays(lesser, model, search) for model in models] == [False, True]
    assert verdict.least_fall(0.0) == verdict.BENT
    assert verdict.least_fall(20.0 * verdict.BENT) > verdict.BENT


def test_a_small_relation_is_not_strange_by_its_share_alone(judge: Judge) -> None:
    base = judge.found.baseline
    calm = moved(base, {n: judge.setting.healthy_squares(n) for n in base.by_relation})
    twice = {n: 2.0 * judge.setting.healthy_squares(n) for n in ("friction", "knee")}
    assert twice["knee"] < verdict.STRANGE_FALL < 0.5 * twice["friction"]
    strange = [judge.criteria.has_unexplained_residual(moved(calm, {n: left}), calm) for n, left in twice.items()]
    assert strange == [True, False]


def test_a_value_near_absence_is_no_find() -> None:
    effect = CATALOGUE["end_delay"]
    assert not verdict.material(effect, "end_delay", 1e-3)
    assert verdict.material(effect, "end_delay", 5e-3)


def test_the_noise_of_a_residual_is_told_from_what_a_law_lacks() -> None:
    time = np.arange(2000) * 8e-3
    rng = np.random.default_rng(0)
    lacking = 0.5 * np.sin(2.0 * np.pi * time) + np.where(np.mod(time, 1.3) < 0.02, 2.0, 0.0)
    noise = 0.1 * rng.normal(size=time.size)
    # the estimate stands for noise behind the low-pass, which leaves 0.7 of its power: 0.084 of 0.1; the medians of 24
    # neighbouring differences scatter by a third, half of which their mean square keeps
    assert chance(lacking + noise) == pytest.approx(0.084, rel=0.17)
    assert chance(lacking) < 0.03


def test_behind_the_low_pass_the_noise_of_a_residual_is_what_is_left_of_it() -> None:
    fast = {"time_s": np.arange(40_000) * 1e-3, "tension_end_n": np.random.default_rng(0).normal(size=40_000)}
    slow = signals_of(table("noise.csv", fast), 125.0)["tension_end_n"]
    # some 5000 samples of which 24 neighbours share a median
    assert chance(slow) == pytest.approx(float(np.std(slow)), rel=0.05)


def test_another_speed_of_a_breakaway_is_no_find_where_the_breakaway_is_the_same(judge: Judge) -> None:
    breakaway = next(c for c in judge.search.offered if c.name == "stribeck")
    fitted = judge.search.model((breakaway,), judge.search.start)
    healthy = {f.name: judge.setting.reference.values[f.name] for f in breakaway.frees}
    shape = {**healthy, "stribeck_speed": 3.0 * healthy["stribeck_speed"], "stribeck_memory": 0.09}
    assert not judge.criteria.differs(breakaway, moved(fitted, values=shape))
    assert judge.criteria.differs(breakaway, moved(fitted, values={**shape, "stribeck_ratio": 2.0}))


def placed(judge: Judge, baseline: float, rival: float) -> SearchResult:
    """Return the search's result as if no effect left `baseline` of χ² more than the offset does, and slack `rival`."""
    best = judge.found.best

    def left(model: FittedEffects, more: float) -> FittedEffects:
        other = dataclasses.replace(model, fit=dataclasses.replace(model.fit, cost=best.fit.cost + 0.5 * more))
        friction = model.by_relation["friction"] + best.score + more - model.score
        return supposed(other, {**model.by_relation, "friction": friction})

    lesser = left(judge.found.baseline, baseline)
    slack = left(next(m for m in judge.found.models if m.names == ("slack",)), rival)
    return SearchResult(lesser, best, (best, slack, lesser))


@pytest.mark.parametrize(("rival", "pays", "stays"), [(30.0, True, True), (30.0, False, False), (50.0, True, False)])
def test_a_faint_find_has_rivals_that_pay_and_leave_less_than_what_says_something(
        judge: Judge, rival: float, pays: bool, stays: bool) -> None:
    found = placed(judge, 60.0, rival)
    assert ("slack" in verdict.rivals(found, lambda c, m: True, lambda lesser, m: pays)) == stays


@pytest.mark.parametrize(("rival", "differs", "stays"),
                         [(90.0, True, True), (90.0, False, False), (110.0, True, False)])
def test_an_experiment_takes_a_rival_away_by_what_an_effect_has_to_take(
        judge: Judge, rival: float, differs: bool, stays: bool) -> None:
    found = placed(judge, 500.0, rival)
    assert ("slack" in verdict.unsplit(found, 0.0, lambda c, m: differs)) == stays
    assert "slack" in verdict.unsplit(found, 2.0 * rival / verdict.STRUCTURE, lambda c, m: True)
