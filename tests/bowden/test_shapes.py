"""Every command on every packaged declaration: a refusal is one of physics."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bowden.shapes import SHAPES, answers

PHYSICS = {
    ("bench_start_only", "identify gait"): "needs END",
    ("bench_no_knee_drive", "identify gait"): "a knee drive",
}
"""Refusals that a bench's devices demand, by shape and command, with words of their sentence."""


@pytest.mark.exhaustive
@pytest.mark.parametrize("shape", SHAPES)
def test_no_command_refuses_a_declared_bench_but_for_physics(shape: str, tmp_path: Path) -> None:
    refused = {(shape, one.what): one.said for one in answers(shape, tmp_path) if one.refused}
    expected = {key: words for key, words in PHYSICS.items() if key[0] == shape}
    assert refused.keys() == expected.keys(), refused
    assert all(words in refused[key] for key, words in expected.items())
