"""Effects, motions, recorded columns and the oracle of the family: each changes what it says, the oracle judges."""

from __future__ import annotations

import numpy as np
import pytest

from physics.effects import catalogue
from tests.plants import draws, effects, oracle
from tests.plants.bench import IMPLEMENTATIONS, Bench
from tests.plants.imposed import Motion, felt, forced, gait, knee_motion, run, trial

EACH = pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
LATER = {"drive_viscous_asymmetry", "drive_presliding", "demand_gain"}
"""Effects that the catalogue is to get."""


@pytest.fixture(scope="module")
def walked() -> tuple[Bench, Motion]:
    """A bench and its gait of three cycles."""
    bench = draws.draw(4, 1, "dahl")
    return bench, gait(bench, 40.0, 1.3, 3)


@pytest.mark.parametrize("implementation", [
    pytest.param(name, marks=() if name in ("maxwell", "lugre") else pytest.mark.slow) for name in IMPLEMENTATIONS])
def test_end_follows_the_desired_force(implementation: str) -> None:
    bench = draws.draw(3, 1, implementation)
    motion = gait(bench, 50.0, 1.5, 3)
    _, end = run(bench, motion.time, motion.rope, motion.knee)
    loaded = (motion.desired > 0.0) & (motion.cycle > 0)
    assert np.sqrt(np.mean((end - motion.desired)[loaded] ** 2)) < 0.03 * 50.0
    assert end.max() == pytest.approx(50.0, rel=0.03)


def test_preload_is_kept_and_the_knee_closes() -> None:
    bench = draws.draw(3, 0, "maxwell")
    motion = gait(bench, 40.0, 1.5, 3, preload_n=15.0)
    _, end = run(bench, motion.time, motion.rope, motion.knee)
    assert end[motion.cycle > 0].min() > 8.0
    knee = knee_motion(np.array([0.0, 1e-3, 50.0, 100.0 - 1e-3, 100.0 - 1e-9]))
    assert knee[-1] == pytest.approx(knee[0], abs=1e-6)
    assert knee[1] - knee[0] == pytest.approx(knee[-1] - knee[-2], rel=1e-2)


def test_every_effect_shows_where_it_should(walked: tuple[Bench, Motion]) -> None:
    bench, motion = walked
    before = (*felt(bench, motion, forced(bench, motion.time, motion.rope, motion.knee)),)
    blind = {"end": (0,), "start": (1,), "drive": (0, 1), "demand": (0, 1)}
    for name in [*effects.PATH, *effects.SENSOR, *effects.DRIVE, "end_delay", "timestamp_skew", *effects.OUTSIDE]:
        changed, _ = effects.hide(bench, [name], 1)
        after = felt(changed, motion, forced(changed, motion.time, motion.rope, motion.knee))
        moved = [float(np.abs(b - a).max()) for a, b in zip(before, after, strict=True)]
        assert max(moved) > 0.1, name
        for signal in blind.get(name.split("_")[0], ()):
            assert moved[signal] == 0.0, (name, signal)


def test_slack_is_rope_to_be_wound_up_before_the_tension_rises(walked: tuple[Bench, Motion]) -> None:
    bench, motion = walked
    slack = effects.replaced(bench, slack=1e-3)
    tight, loose = (forced(b, motion.time, motion.rope, motion.knee).end for b in (bench, slack))
    shifted = forced(slack, motion.time, motion.rope + 1e-3, motion.knee).end
    assert loose.max() < tight.max() - 1.0
    assert shifted == pytest.approx(tight, abs=1e-6)


def test_truth_is_said_in_the_catalogue_s_names() -> None:
    bench = draws.draw(4)
    for name in effects.EFFECTS:
        changed, values = effects.hide(bench, [name], 2)
        assert changed != bench
        assert all(np.isfinite(list(values.values())))
        if name not in LATER:
            declared = {parameter.name for parameter in catalogue.CATALOGUE[name].parameters}
            assert set(values) <= declared, (name, values, declared)
    assert set(catalogue.CATALOGUE) - set(effects.EFFECTS) == set(effects.ABSENT)


def test_pairs_are_both_there() -> None:
    bench = draws.draw(4)
    both, values = effects.hide(bench, ["end_offset", "fabric_friction"], 5)
    one, first = effects.hide(bench, ["end_offset"], 5)
    other, second = effects.hide(bench, ["fabric_friction"], 5)
    assert (both.end_offset, both.mu2) == (one.end_offset, other.mu2)
    assert values == first | second


def test_a_trial_is_what_its_seed_says(walked: tuple[Bench, Motion]) -> None:
    bench, motion = walked
    one, again, other = (trial(bench, seed, motion=motion) for seed in (1, 1, 2))
    assert all(np.array_equal(one.columns[name], again.columns[name]) for name in one.columns)
    assert one.bench.noise != other.bench.noise
    quiet = trial(bench, 1, motion=motion, noise_n=0.2, rate_hz=500)
    start = felt(quiet.bench, motion, quiet.true)[0][::2]
    assert np.std(quiet.columns["tension_start_n"] - start) == pytest.approx(0.2, rel=0.05)
    assert np.allclose(np.diff(quiet.columns["time_s"]), 2e-3)
    assert {0.05 <= trial(bench, seed, motion=motion).bench.noise <= 0.4 for seed in range(3)} == {True}


def test_the_wire_repeats_what_it_lost(walked: tuple[Bench, Motion]) -> None:
    bench, motion = walked
    lost, values = effects.hide(bench, ["lost_pdo"], 3)
    columns = trial(lost, 1, motion=motion, rate_hz=1000, noise_n=0.2).columns
    assert np.mean(np.diff(columns["tension_start_n"]) == 0.0) > 0.8 * values["lost_share"]


@pytest.mark.exhaustive
def test_the_oracle_counts_what_shows_and_nothing_else(walked: tuple[Bench, Motion]) -> None:
    bench, motion = walked
    assert oracle.separation(bench, bench, motion, 0.15, 250) < 1e-9
    like = oracle._moved(bench, {"mu1": 1.0, "mu2": -1.0, "zero": 1.0, "end_offset": 0.5, "stiffness": -0.7})
    assert not oracle.counts(bench, like, motion, 0.15, 250)
    plain = effects.hide(bench, ["end_filter"], 1)[0]
    assert oracle.counts(bench, plain, motion, 0.15, 250)
    loud, quiet = (oracle.separation(bench, plain, motion, noise, 250, rounds=3) for noise in (0.4, 0.1))
    assert oracle.COUNTS_FROM < loud < quiet
