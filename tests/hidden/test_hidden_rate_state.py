"""Rig with rate-and-state friction: its independence of the package, its physics, and cases of the diagnosis."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from tests.hidden import rate_state, truths, truths_run
from tests.hidden.rate_state_path import Bench, Motion, march
from tests.hidden.truths import Question

MODULES = ("rate_state", "rate_state_path")
LIBRARIES = {"__future__", "collections", "dataclasses", "math", "numpy", "typing"}


def rig(seed: int = 2) -> tuple[Bench, Motion]:
    """Return a rig and a motion of one stride."""
    bench = rate_state.draw_bench(np.random.default_rng(seed))
    return bench, rate_state.draw_motion(bench, np.random.default_rng(seed), 1)


@pytest.mark.parametrize("module", MODULES)
def test_the_rig_imports_nothing_of_the_package(module: str) -> None:
    nodes = list(ast.walk(ast.parse((Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8"))))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    own = {f"tests.hidden.{name}" for name in MODULES}
    assert {name.split(".")[0] for name in names - own} <= LIBRARIES


def test_start_exceeds_end_where_the_rope_pulls_in() -> None:
    bench, motion = rig()
    start, end = march(bench, motion)
    assert min(start.min(), end.min()) > 0.0
    inward = np.gradient(motion.rope, 1e-3) > 0.03
    steady = inward & np.roll(inward, 30)  # pulled in for 30 ms: beyond pre-sliding
    assert steady.sum() > 50
    assert np.all(start[steady] > end[steady])


def test_one_seed_gives_one_recording() -> None:
    first, second = (rate_state.measured(rate_state.simulate(*rig()), rig()[0], 0.1, np.random.default_rng(3))
                     for _ in range(2))
    assert all(np.array_equal(first[name], second[name]) for name in first)


def test_each_effect_of_the_catalogue_has_a_size_and_changes_the_rig() -> None:
    assert set(rate_state.SIZES) == {*truths.EFFECTS, *truths.OUTSIDE}
    bench, _ = rig()
    assert rate_state.altered(bench, ["null"], np.random.default_rng(1)) == bench
    assert all(rate_state.altered(bench, [name], np.random.default_rng(1)) != bench
               for name in ("null_alt", *rate_state.SIZES))


@pytest.mark.exhaustive
def test_a_case_is_drawn_alike_twice() -> None:
    first, second = (truths.draw(Question("rate_state", ("vis",), 5)) for _ in range(2))
    assert first.separation == second.separation > truths.SEPARABLE
    assert np.array_equal(first.clean, second.clean)
    assert all(np.array_equal(first.trial[name], second.trial[name]) for name in first.trial)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("hidden", "seed"), [("blash", 1), ("mass", 2), ("delay", 3)])
def test_an_effect_is_in_the_ambiguity_set(hidden: str, seed: int) -> None:
    answer = truths_run.answer(Question("rate_state", (hidden,), seed))
    assert answer.separation > truths.SEPARABLE
    assert answer.right, truths_run.said(answer)


@pytest.mark.exhaustive
def test_a_trial_in_the_reference_condition_gets_no_name() -> None:
    answer = truths_run.answer(Question("rate_state", ("null",), 4))
    assert answer.among == (), truths_run.said(answer)
