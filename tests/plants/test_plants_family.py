"""The family's benches: plant protocol, physics that any such bench must have, and how they are drawn."""

from __future__ import annotations

import ast
import dataclasses
import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from tests.plants import bench_of, draws, effects, imposed, mechanics
from tests.plants.bench import IMPLEMENTATIONS, KNEE_AT_FIT, KNEES, STRETCHES, STRIBECKS, Bench, replaced
from tests.plants.imposed import DT, forced, run
from tests.plants.plant import FamilyPlant
from virtual_bus import build

EACH = pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
TICK_NS = 250_000


def plain(implementation: str, serial: int = 2, **changes: float) -> Bench:
    """A bench without what is not capstan: no grease, no breakaway, no creep, no load slope, no play."""
    none = dict.fromkeys(("viscous", "creep", "load_slope", "play", "loose_viscous", "eccentricity"), 0.0)
    bench = draws.draw(serial, 0, implementation)
    return replaced(bench, **{**none, "sheath_ratio": 1.0, "fabric_ratio": 1.0, "presliding": 5e-5,
                              "fabric_presliding": 5e-5, **changes})


def pulled(bench: Bench, *turns: float, speed: float = 0.03) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rope at a locked knee between depths in units of the stretch at 60 N; returns rope, START and END."""
    ways = bench.zero + bench.stretch_60 * np.array([-0.1, *turns])
    legs = [np.arange(0.0, abs(b - a), speed * DT) * np.sign(b - a) + a for a, b in itertools.pairwise(ways)]
    rope = np.concatenate(legs)
    start, end = run(bench, DT * np.arange(rope.size), rope, np.full(rope.size, KNEE_AT_FIT))
    return rope, start, end


def led(plant: FamilyPlant, cuts_ns: list[int], until_ns: int = 400_000_000) -> list[tuple[float, ...]]:
    """What a plant says at each drive tick while rope is wound in and let go; also asked at `cuts_ns` in between."""
    said = [tuple(plant.reset(0))]
    for tick in range(TICK_NS, until_ns + 1, TICK_NS):
        pull = 0.8 if tick < until_ns // 2 else -0.1
        for cut in cuts_ns:
            plant.advance(tick - TICK_NS + cut, pull, 0.2)
        said.append(tuple(plant.advance(tick, pull, 0.2)))
    return said


@pytest.mark.parametrize("implementation", [
    "dahl", "lugre", *(pytest.param(name, marks=pytest.mark.exhaustive) for name in ("maxwell", "fronts"))])
def test_the_same_whatever_way_time_is_cut(implementation: str) -> None:
    plant = FamilyPlant(draws.draw(1, 1, implementation))
    whole = led(plant, [])
    assert led(plant, [1, 30_000, 50_000, 199_999]) == whole
    assert led(FamilyPlant(draws.draw(1, 1, implementation)), []) == whole
    assert max(row[5] for row in whole) > 10.0


@EACH
def test_what_is_no_torque_or_time_is_refused(implementation: str) -> None:
    plant = FamilyPlant(draws.draw(1, 0, implementation))
    for bad in (math.nan, math.inf):
        with pytest.raises(ValueError, match="not finite"):
            plant.advance(TICK_NS, bad, 0.0)
    plant.advance(TICK_NS, 0.0, 0.0)
    with pytest.raises(ValueError, match="cannot go back"):
        plant.advance(0, 0.0, 0.0)
    assert "true_end_n" in plant.truth()


@EACH
def test_sliding_ropes_lose_what_the_capstan_says(implementation: str) -> None:
    bench = plain(implementation)
    e1 = bench.mu1 * bench.theta1
    e2 = bench.mu2 * (bench.wrap + bench.wrap_slope * abs(KNEE_AT_FIT))
    rope, start, end = pulled(bench, 1.0, 0.1)
    turn = int(np.argmax(rope))
    released = int(np.argmin(np.abs(end[turn:] - 20.0))) + turn
    assert math.log(start[turn - 1] / end[turn - 1]) == pytest.approx(e1 + e2, rel=0.03)
    assert math.log(start[released] / end[released]) == pytest.approx(-(e1 + e2), rel=0.05)


@EACH
def test_end_holds_while_start_falls_after_a_reversal(implementation: str) -> None:
    rope, start, end = pulled(plain(implementation), 0.9, 0.2)
    turn = int(np.argmax(rope))
    fallen = turn + int(np.argmax(start[turn:] < 0.85 * start[turn]))
    assert fallen > turn
    assert end[fallen] > 0.98 * end[turn]


@EACH
def test_closed_loops_only_take_energy(implementation: str) -> None:
    for depths in ((0.8, 0.3), (0.6, 0.5)):
        for serial in (3, 5):
            rope, start, _ = pulled(draws.draw(serial, 1, implementation), depths[0], *(depths[::-1] * 3)[:6])
            lows = np.flatnonzero(np.diff(np.sign(np.diff(rope))) > 0) + 1
            work = float(np.trapezoid(start[lows[0] : lows[1]], rope[lows[0] : lows[1]]))
            assert work > 0.0


@EACH
def test_slack_rope_carries_nothing(implementation: str) -> None:
    _, start, end = pulled(plain(implementation), 0.5, -0.1)
    assert start[0] == 0.0
    assert end.max() > 10.0
    assert abs(start[-1]) < 0.3
    assert abs(end[-1]) < 0.3


@EACH
def test_step_of_the_data_changes_little(implementation: str) -> None:
    bench = draws.draw(6, 1, implementation)
    time = DT * np.arange(1500)
    rope = bench.zero + bench.stretch_60 * (0.45 - 0.5 * np.cos(2.0 * math.pi * time / 0.75))
    knee = KNEE_AT_FIT + 0.05 * np.sin(2.0 * math.pi * time)
    fine = run(bench, time, rope, knee)
    coarse = run(bench, time[::5], rope[::5], knee[::5])
    for whole, part in zip(fine, coarse, strict=True):
        assert np.sqrt(np.mean((whole[::5] - part) ** 2)) < 0.01 * whole.max()


@pytest.mark.parametrize(("serial", "hidden"), [(14, "viscous_friction"), (51, "viscous_friction"), (97, "")])
def test_the_cycles_of_a_gait_are_alike(serial: int, hidden: str) -> None:
    """Where Newton's method goes to and fro over a kink, its last try would be a cycle of another friction."""
    bench, _ = effects.hide(draws.draw(serial), [hidden] if hidden else [], 0)
    trial = imposed.trial(bench, 1, 40.0, 1.3, 6)
    n = int((trial.motion.cycle == 0).sum())
    cycles = np.reshape([trial.true.start[n:], trial.true.end[n:]], (2, 5, n))
    # a rope that snaps tight rings by up to 0.65 N, never twice alike; steps that were not solved left 1.4 to 4 N
    assert np.abs(cycles - np.median(cycles, axis=1, keepdims=True)).max() < 1.0


@EACH
def test_sixty_newton_are_within_reach(implementation: str) -> None:
    for serial in range(8):
        bench = draws.draw(serial, 1, implementation)
        _, start, end = pulled(bench, 2.2, speed=0.06)
        assert end.max() > 60.0
        assert start[int(np.argmax(end > 60.0))] < draws.MOST_STUCK_N + bench.loose_drag_n(0.06)


def test_structure_is_drawn_apart_from_constants() -> None:
    many = [draws.draw(serial) for serial in range(600)]
    for names, field in ((IMPLEMENTATIONS, "implementation"), (STRETCHES, "stretch"), (STRIBECKS, "stribeck"),
                         (KNEES, "knee"), ((1, 2), "drive_order"), ((2, 3, 4), "cells")):
        drawn = [getattr(bench.structure, field) for bench in many]
        assert {drawn.count(name) > 0.6 * len(drawn) / len(names) for name in names} == {True}
        for constant in ("exponent", "presliding", "stretch_60", "zero", "moment_arm"):
            values = np.argsort(np.argsort([getattr(bench, constant) for bench in many])) / len(many)
            for name in names:
                chosen = values[[one == name for one in drawn]]
                # standard error of a mean of ranks: 0.29/√n
                assert abs(chosen.mean() - 0.5) < 4.0 * 0.29 / math.sqrt(chosen.size), (field, name, constant)
    assert {draws.draw(7, 0, one).mu1 for one in IMPLEMENTATIONS} == {draws.draw(7).mu1}


def test_constants_keep_their_ranges() -> None:
    for serial in range(300):
        bench = draws.draw(serial)
        whole = bench.stretch_60 + 60.0 * (bench.lead + bench.sheath)
        assert 0.06 < bench.exponent <= 0.45
        assert 4.9e-3 <= whole <= 25e-3
        assert abs(bench.zero) <= 50e-3
        assert bench.play <= math.radians(0.2)
        assert bench.play == 0.0 or bench.structure.knee != "none"
        assert bench.end_drift == bench.eccentricity == bench.torn == 0.0
        later = draws.draw(serial, 1)
        assert abs(later.mu1 / bench.mu1 - 1.0) <= 0.1
        assert abs(later.stiffness - 1.0) <= 0.03
        assert abs(later.zero - bench.zero) <= 1e-4
        assert later.structure == bench.structure
        assert later.play == pytest.approx(bench.play + (math.radians(0.3) if bench.structure.knee != "none" else 0.0))


def test_names_say_serial_day_and_method() -> None:
    assert bench_of("bench_17_day_1") == draws.draw(17, 1)
    assert bench_of("family", 5) == draws.draw(5)
    assert bench_of("lugre_3").structure.implementation == "lugre"
    assert bench_of("bench_4_day_2+end_offset", 1).end_offset != draws.draw(4, 2).end_offset
    plant = build.factory("tests.plants:dahl_2_day_1")({"mu1": 0.3}, 9)
    assert dataclasses.replace(plant.bench) == draws.draw(2, 1, "dahl")
    for name in ("nothing", "bench", "bench_2+gremlin", "bench_1_day_"):
        if name != "bench":
            with pytest.raises(AttributeError):
                bench_of(name)


def test_the_family_shares_no_code_with_the_bench_model() -> None:
    taken: set[str] = set()
    for path in Path(__file__).parent.glob("*.py"):
        if path.name.startswith("test_"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                taken |= {f"{node.module}.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.Import):
                taken |= {alias.name for alias in node.names}
    rooms = ("physics", "master", "diagnosis", "nodes", "trial", "virtual_bus", "parameters", "eds", "bowden")
    assert {name for name in taken if name.split(".")[0] in rooms} == {"physics.plant.Outputs"}


def test_a_gap_follows_the_load_and_play_the_motion() -> None:
    gap, play = (replaced(draws.draw(1), play=0.01) for _ in range(2))
    gap = dataclasses.replace(gap, structure=gap.structure._replace(knee="gap"))
    play = dataclasses.replace(play, structure=play.structure._replace(knee="play"))
    for bench, sought in ((gap, 0.005), (play, 0.0)):
        k = mechanics.parameters(bench)
        leg = 0.0
        for _ in range(1000):
            leg = mechanics.follow(k, leg, 0.0, 5.0, 1e-4)
        assert leg == pytest.approx(sought, abs=1e-5)
    assert mechanics.follow(mechanics.parameters(play), 0.0, 0.02, 0.0, 1e-4) == pytest.approx(0.015)


def test_a_loose_rope_is_led_without_force() -> None:
    bench = plain("maxwell")
    time = DT * np.arange(800)
    knee = KNEE_AT_FIT + 0.3 * np.sin(2.0 * math.pi * time)
    k = mechanics.parameters(bench)
    rope = np.array([mechanics.anchor(k, angle) for angle in knee.tolist()]) + bench.zero - 2e-3
    assert forced(bench, time, rope, knee).end.max() == 0.0
