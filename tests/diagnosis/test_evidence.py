"""Diagnosis by evidence: the forward model obeys its equations; effects of plants of other structure are named."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve

from bowden.cli.app import run
from diagnosis.evidence.decision import SET_SHARE, probabilities, threshold
from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.finder import diagnose
from estimation.data.table import Table, table
from estimation.forward_model import jacobian
from estimation.likelihood_data import GRID_S
from estimation.path_model import PATH_MODEL
from estimation.posterior import PosteriorMode, between_sessions
from physics.effects.catalogue import CATALOGUE
from physics.effects.hypotheses import ELSEWHERE, HYPOTHESES, PARTS
from physics.forward import force_path
from physics.forward.path_constants import FREE, INDEX, NAMES, PATH_ROWS, TABLE, coordinates_of, named, values
from physics.forward.path_parameters import simulation_values, stretch_m
from physics.parameters import PARAMETERS
from tests.hidden.family import Job, case
from tests.plants.draws import set_aside, structure

HIDDEN = (Job(60, ("friction_drift",), 18), Job(27, ("end_gain",), 26))
HEALTHY = Job(39, (), 9)
AT_REST = Job(103, (), 5021)
"""In the reference condition: a bench whose Stribeck speed the reference trial leaves at 2 mm/s."""
BESIDE_A_DRIFT = Job(43, ("cable_friction", "start_drift"), 52)
DRIFT = Job(63, ("friction_drift",), 18)
OUTSIDE_BOUNDS = Job(171, (), 5031)
"""In the reference condition: the best effect is a wrap that no fabric has."""
HIGHER = Job(226, (), 5036)
"""In the reference condition: a trial at 50 N with one reference trial, at 40 N."""


def path(**given: float) -> np.ndarray:
    """The path's parameters, shape (names, 1), with the population's middle where none is given."""
    middle = dict(zip(NAMES, values(np.zeros(len(TABLE))), strict=True)) | given
    return np.array([[middle[name]] for name in force_path.NAMES])


def ramp() -> tuple[np.ndarray, np.ndarray]:
    """Pull 12 mm in 2 s and let go again at a knee held at the reference angle."""
    up = np.linspace(-2e-3, 10e-3, 500)
    return np.concatenate([up, up[::-1]]), np.full(1000, force_path.KNEE_RAD)


def test_sliding_friction_is_the_capstans_both_ways() -> None:
    rope, knee = ramp()
    told = force_path.simulate(path(cable=0.2, fabric=0.1, load=0.0, viscous=0.0, dry=0.0, breakaway=0.0,
                                    fabric_breakaway=0.0), rope, knee, GRID_S)
    ratio = told.start[0] / told.end[0]
    # (1 + x)/(1 − x) with x = exponent/2 stands for e^exponent: third order, 0.1 % here; light drag adds 0.1 N of 40
    assert ratio[499] == pytest.approx(math.exp(0.3), rel=0.01)
    assert ratio[700] == pytest.approx(math.exp(-0.3), rel=0.01)


def test_a_slack_rope_carries_nothing_and_a_taut_one_follows_the_stretch() -> None:
    rope, knee = ramp()
    told = force_path.simulate(path(), rope, knee, GRID_S)
    assert np.all(told.start[0][rope < -1e-3] < 0.2)
    assert np.all(np.diff(told.end[0][100:499]) >= -1e-9)


def test_a_batch_is_its_members_one_by_one() -> None:
    rope, knee = ramp()
    sets = np.concatenate([path(), path(cable=0.3), path(fabric_share=0.6, play=0.01)], axis=1)
    whole = force_path.simulate(sets, rope, knee, GRID_S)
    for j in range(3):
        alone = force_path.simulate(sets[:, j:j + 1], rope, knee, GRID_S)
        # each balance is solved to `CLOSE_N`, from another first guess; each of the nodes hands its error on
        assert np.abs(alone.end[0] - whole.end[j]).max() < force_path.NODES * force_path.CLOSE_N


def test_a_surface_that_is_the_legs_own_slides_under_no_fabric() -> None:
    # rope and leg move alike: where the surface does too, friction stays; with a few per cent less it turns over
    knee = -0.5 + 0.4 * np.sin(np.arange(0.0, 8.0, GRID_S))
    rope = 0.04 * (knee + 0.5) + 8e-3
    turned = []
    for surface in (1.0, 0.957):
        told = force_path.simulate(path(cable=1e-3, fabric=0.3, dry=1e-3, viscous=0.0, prompt=1e-9, slow=1e-9,
                                        play=1e-9, gap=1e-9, surface=surface), rope, knee, GRID_S)
        turned.append(float(np.ptp((told.start[0] - told.end[0])[500:])))
    assert turned[0] < 0.1 * turned[1]


def test_sharp_friction_turns_over_half_way_as_soon_and_is_full_after_a_finite_distance() -> None:
    # a rope that does not stretch before the sheath's end moves its nodes as the drum does
    up, travel = np.linspace(-2e-3, 10e-3, 4000), 1e-3
    rope, knee, back = np.concatenate([up, up[::-1]]), np.full(8000, force_path.KNEE_RAD), up[-1] - up[::-1]
    slip = {share: force_path.simulate(path(sharpness=share, cable_travel=travel, cable=1e-3, cable_compliance=1e-8),
                                       rope, knee, GRID_S).cable_slip[0][4000:] for share in (0.0, 1.0)}
    half = [float(np.interp(0.0, -each, back)) for each in slip.values()]
    # `FINITE` has two digits
    assert half[0] == pytest.approx(half[1], rel=0.01)
    beyond = back > 1.05 * math.sqrt(2.0) * travel / force_path.FINITE
    assert slip[1.0][beyond][0] == pytest.approx(-1.0)
    assert slip[0.0][beyond][0] > -0.9


def test_half_the_step_changes_little() -> None:
    rope, knee = ramp()
    fine = np.interp(np.arange(0.0, 4.0, GRID_S / 2), np.arange(0.0, 4.0, GRID_S), rope)
    coarse = force_path.simulate(path(), rope, knee, GRID_S).end[0]
    half = force_path.simulate(path(), fine, np.full(fine.size, knee[0]), GRID_S / 2).end[0][::2]
    # first order in the step: the difference is the error, below the noise of a bin
    assert np.abs(coarse - half).max() < 0.25


def test_a_rope_that_is_taut_at_hardly_more_than_one_knee_angle_has_its_zero_near_the_rope() -> None:
    # two blocks of pulls 27 mrad apart, with 1 mm of friction: least squares alone have a zero 1.2 m away
    time = np.arange(8000) / 1000.0
    pull = 0.5 * (1.0 - np.cos(2.0 * np.pi * time / 2.0))
    knee = np.where(time < 4.0, -0.497, -0.524)
    rope = 7e-3 + 0.04 * (knee + 0.5) + 12e-3 * np.sqrt(pull) + 1e-3 * np.sign(np.gradient(pull)) * (1.0 - 0.5 * pull)
    q = PATH_MODEL.origin(PATH_MODEL.record(table("made.csv", {
        "time_s": time, "servo_position_m": rope, "knee_angle_rad": knee, "tension_start_n": 50.0 * pull})))
    assert q[INDEX["zero"]] == pytest.approx(7e-3, abs=5e-3)
    assert abs(q[INDEX["arm"]]) < 10e-3


@pytest.mark.slow
def test_an_experiment_by_itself_is_not_judged_by_gaits() -> None:
    made = case(HEALTHY)
    columns = {name: 1.2 * values if name == "tension_end_n" else values
               for name, values in made.trial.columns.items() if name != "gait_percent"}
    alone = replace(made.trial, columns=columns)
    found = diagnose([alone], healthy=list(made.healthy))
    assert (found.verdict, found.causes) == ("none", [])
    assert any("has no gait_percent, and all reference trials have" in said for said in found.warnings)
    assert not EvidenceFinder(list(made.healthy)).unlike_motion([made.trial, alone])
    assert not EvidenceFinder([*made.healthy, alone]).unlike_motion([alone])


def test_derivatives_are_those_of_a_central_difference() -> None:
    # ten times the step misses the surface's by 3.2 % here, and descents stop nats above the mode (decision 64); a
    # tenth of it, the simulation's rounding is 1.6 % of arm3's
    trial, free = PATH_MODEL.record(case(replace(HEALTHY, cycles=3)).trial), list(FREE)
    q = PATH_MODEL.scanned(PATH_MODEL.origin(trial), trial)[0]
    _, slopes = jacobian(PATH_MODEL, q, trial, free)
    moved, step = np.repeat(q[:, None], 2 * len(free), axis=1), 0.1 * PATH_MODEL.constants.step[free]
    moved[free, np.arange(len(free))] += step
    moved[free, np.arange(len(free), 2 * len(free))] -= step
    ahead, behind = np.split(PATH_MODEL.predict(moved, trial), 2)
    central = ((ahead - behind) / (2.0 * step[:, None])).T
    assert float((np.linalg.norm(slopes - central, axis=0) / np.linalg.norm(central, axis=0)).max()) < 0.02


def test_every_effect_is_a_hypothesis_or_says_why_not() -> None:
    assert set(HYPOTHESES) | set(ELSEWHERE) == set(CATALOGUE)
    assert not set(HYPOTHESES) & set(ELSEWHERE)
    for name, hypothesis in HYPOTHESES.items():
        assert hypothesis.part in PARTS
        assert set(hypothesis.reads) <= {p.name for p in CATALOGUE[name].parameters}
        for variant in hypothesis.variants(dict(zip(NAMES, values(np.zeros(len(TABLE))), strict=True))):
            assert all(set(d.along) <= set(INDEX) for d in variant.directions)


def test_coordinates_and_values_are_each_others_inverse() -> None:
    q = np.full(len(TABLE), 1e-3)
    assert coordinates_of(values(q)) == pytest.approx(q, abs=1e-9)
    assert PATH_ROWS.size == len(force_path.NAMES)


def test_the_hidden_effects_are_on_benches_of_several_implementations() -> None:
    assert len({structure(job.serial).implementation for job in HIDDEN}) == len(HIDDEN)
    assert not any(set_aside(job.serial) for job in HIDDEN)


@pytest.fixture(scope="module", params=[pytest.param(job, marks=pytest.mark.exhaustive) for job in HIDDEN],
                ids=lambda job: job.hidden[0])
def told(request: pytest.FixtureRequest) -> tuple[Job, dict]:
    """A hidden effect and the answer to it."""
    made = case(request.param)
    return request.param, diagnose([made.trial], healthy=made.healthy).as_json()


def test_the_hidden_effect_is_in_the_ambiguity_set_and_its_part_is_right(told: tuple[Job, dict]) -> None:
    job, said = told
    assert job.hidden[0] in said["class"], said["evidence"]["log_bayes_factors"]
    assert said["part"] == HYPOTHESES[job.hidden[0]].part


def test_what_is_named_predicts_cycles_that_no_fit_has_seen(
    told: tuple[Job, dict], request: pytest.FixtureRequest,
) -> None:
    job, said = told
    if job.hidden == ("end_gain",):
        request.applymarker(pytest.mark.xfail(strict=True, reason="the session's constants predict an END gain of "
                                              "+ 8.5 % within the noise, too: 0.064 N, named 0.062"))
    error = said["evidence"]["error_n"]
    # half of the error at least: the effects hidden here are all beyond ten times the noise
    assert error["after"] < 0.5 * error["session"]
    for cause in said["causes"]:
        assert all(p["low"] <= p["value"] <= p["high"] for p in cause["parameters"].values())


@pytest.fixture(scope="module")
def healthy() -> tuple[tuple[Table, ...], Table]:
    made = case(HEALTHY)
    return made.healthy, made.trial


@pytest.fixture(scope="module")
def nothing(healthy: tuple[tuple[Table, ...], Table]) -> dict:
    """Diagnose a trial in the reference condition beside one reference trial."""
    reference, trial = healthy
    return diagnose([trial], healthy=reference[:1]).as_json()


@pytest.mark.exhaustive
def test_a_trial_in_the_reference_condition_names_nothing(nothing: dict) -> None:
    assert nothing["verdict"] == "none"
    assert nothing["class"] == []


@pytest.mark.exhaustive
def test_beside_three_reference_trials_nothing_is_named_twice_alike(
    healthy: tuple[tuple[Table, ...], Table]
) -> None:
    reference, trial = healthy
    said = [json.dumps(diagnose([trial], healthy=reference).as_json()) for _ in range(2)]
    assert said[0] == said[1]
    assert json.loads(said[0])["class"] == []


@pytest.mark.exhaustive
def test_motion_that_no_reference_trial_has_widens_the_session_deviation(
        healthy: tuple[tuple[Table, ...], Table]) -> None:
    known = healthy[0][0]
    fit = EvidenceFinder([known]).reference([healthy[1]])
    inside = fit.observe(PATH_MODEL.record(known))
    assert inside.beyond == 0.0
    higher = {**known.columns, "tension_end_n": 1.25 * known["tension_end_n"]}
    outside = fit.observe(PATH_MODEL.record(replace(known, columns=higher)))
    assert outside.beyond > 0.1
    grown = math.hypot(1.0, PATH_MODEL.unseen * outside.beyond)
    session, wide = (np.diag(fit.prior_of(each).covariance - fit.bench.covariance)[:len(FREE)]
                     for each in (inside, outside))
    of_path = np.array([NAMES[i] in force_path.NAMES for i in FREE])
    assert wide[of_path] == pytest.approx(session[of_path] * grown**2)
    assert wide[~of_path] == pytest.approx(session[~of_path])


@pytest.mark.exhaustive
def test_a_gait_of_a_higher_peak_than_the_only_reference_trial_names_nothing_and_says_which_to_record() -> None:
    made = case(HIGHER)
    told = diagnose([made.trial], healthy=list(made.healthy))
    assert told.verdict == "none"
    assert "Record a reference trial (--healthy) with the motion and peak of the trial." in " ".join(told.warnings)


@pytest.mark.exhaustive
def test_rest_friction_is_sought_at_speeds_of_its_own() -> None:
    made = case(AT_REST)
    # no effect is named; the cost per datum is 2.003 times that of the only reference trial, a lack of fit from 2 on
    assert diagnose([made.trial], healthy=list(made.healthy)).rivals == []


@pytest.mark.exhaustive
def test_a_second_effect_is_named_beside_one_of_a_hundred_times_the_evidence() -> None:
    made = case(BESIDE_A_DRIFT)
    told = diagnose([made.trial], healthy=list(made.healthy))
    assert set(BESIDE_A_DRIFT.hidden) <= set(told.rivals)


@pytest.mark.exhaustive
def test_what_an_effects_equation_leaves_gets_no_name() -> None:
    made = case(DRIFT)
    assert diagnose([made.trial], healthy=list(made.healthy)).rivals == ["friction_drift"]


@pytest.mark.exhaustive
@pytest.mark.xfail(strict=True, reason="fabric friction has 18.8 nats in a trial of the reference condition, where the "
                                       "reference fit has two minima")
def test_an_effect_outside_its_bounds_is_no_candidate() -> None:
    made = case(OUTSIDE_BOUNDS)
    told = diagnose([made.trial], healthy=list(made.healthy))
    assert told.verdict == "none"
    assert told.evidence is not None
    assert "fabric_wrap would explain the trial" in " ".join(told.warnings)
    assert "fabric_wrap" not in told.evidence["log_bayes_factors"]


def test_probabilities_are_those_that_set_and_threshold_stand_for() -> None:
    least = threshold(PATH_MODEL)
    assert probabilities({"end_gain": -1.0}, least) == {}
    alone = probabilities({"end_gain": least, "stiffness": -2.0}, least)
    assert alone == {"end_gain": pytest.approx(0.937, abs=0.001)}
    assert probabilities({"end_gain": 2.0 * least}, least)["end_gain"] > 0.999
    both = probabilities({"end_gain": 80.0, "stiffness": 80.0, "slack": 80.0 * SET_SHARE}, least)
    assert both["end_gain"] == both["stiffness"]
    assert both["slack"] / both["end_gain"] == pytest.approx(np.exp(-0.5 * 1.96**2), rel=0.01)
    assert sum(both.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_the_stiffness_is_told_as_the_simulation_reads_it(scale: float) -> None:
    q = coordinates_of(np.array(list(bench_values(cable_compliance=1e-9, prompt=1e-9, slow=1e-9).values())))
    stiffness = HYPOTHESES["stiffness"]
    for name, share in stiffness.variants(named(q))[0].directions[0].along.items():
        q[INDEX[name]] += math.log(scale) * share
    read = stiffness.reads["stiffness_scale"]
    before, after = (read(at, at) for at in (bench_values(cable_compliance=1e-9, prompt=1e-9, slow=1e-9), named(q)))
    # the direction is the tangent of a stretch that is 1/s as long
    assert after / before == pytest.approx(scale, rel=0.03)
    assert after == simulation_values(named(q))["stiffness_scale"]


def test_the_zero_that_homing_fixes_moves_with_the_stiffness() -> None:
    before = bench_values(prompt=1e-9, slow=1e-9)
    q = coordinates_of(np.array(list(before.values())))
    for name, share in HYPOTHESES["stiffness"].variants(before)[1].directions[0].along.items():
        q[INDEX[name]] += 0.05 * share
    after = named(q)
    preload = PARAMETERS["home_preload"].nominal
    homed, stays = (v["zero"] + float(stretch_m(v, preload)) for v in (before, after))
    assert after["zero"] - before["zero"] > 0.2e-3
    # the encoder reads the same at the preload, but for the second order of 5 % of 6 mm
    assert stays == pytest.approx(homed, abs=0.02e-3)


def bench_values(**given: float) -> dict[str, float]:
    """Constants of the population's middle, by name, with those that are given."""
    return dict(zip(NAMES, values(np.zeros(len(TABLE))), strict=True)) | given


def test_trials_from_the_prior_depart_by_one_sigma_in_the_directions_that_they_determine() -> None:
    random = np.random.default_rng(3)
    design, factor = random.normal(size=(40, 12)) * np.geomspace(3.0, 1e-3, 12), np.eye(12)
    inner = cho_factor(np.eye(12) + design.T @ design)
    squares = []
    for _ in range(400):
        data = design @ random.normal(size=12) + random.normal(size=40)
        x = cho_solve(inner, design.T @ data)
        none = np.zeros(0)
        at = PosteriorMode(PATH_MODEL.constants, none, x, (), 0.0, 0.0, factor, inner, design, design[:, :0], none,
                           none, np.zeros(12))
        squares.append(at.departure.squared / at.departure.directions)
    # the mean of 400 draws of about seven squares each scatters by 2·√(2/7)/√400 = 5 % at two sigma
    assert np.mean(squares) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("trials", [2, 3])
def test_reference_trials_depart_by_one_sigma_in_the_directions_that_they_determine(trials: int) -> None:
    random, sd, size = np.random.default_rng(5), np.geomspace(1.0, 0.1, 8), 8
    designs = [random.normal(size=(30, size)) * np.geomspace(3.0, 1e-2, size) for _ in range(trials)]
    information = [design.T @ design for design in designs]
    # bench and departures as one vector, the bench with unit prior σ
    whole = np.concatenate([np.hstack([design, *(design if i == k else 0.0 * design for i in range(trials))])
                            for k, design in enumerate(designs)])
    prior = np.concatenate([np.ones(size), np.tile(sd, trials)])
    gain = np.linalg.solve(whole.T @ whole + np.diag(prior**-2), whole.T)
    known = [np.linalg.inv(np.eye(size) + sum(np.linalg.inv(np.linalg.inv(information[i]) + np.diag(sd**2))
                                              for i in range(trials) if i != k)) for k in range(trials)]
    found = [between_sessions((gain @ (whole @ (prior * random.normal(size=prior.size))
                                       + random.normal(size=whole.shape[0])))[size:].reshape(trials, size),
                              sd, information, known) for _ in range(400)]
    # about six squares in each of 400 draws: 2·√(2/6)/√400 = 6 % at two sigma
    assert np.mean([each.squared / each.directions for each in found]) == pytest.approx(1.0, abs=0.06)


def _written(folder: Path, name: str, given: Table) -> Path:
    file = folder / name
    columns = list(given.columns)
    np.savetxt(file, np.stack([given[c] for c in columns], axis=1), delimiter=",", header=",".join(columns),
               comments="", fmt="%.17g")
    return file


@pytest.mark.exhaustive
def test_the_command_gives_the_same_diagnosis_again(
    healthy: tuple[tuple[Table, ...], Table], nothing: dict, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reference, trial = healthy
    good, bad = _written(tmp_path, "good.csv", reference[0]), _written(tmp_path, "trial.csv", trial)
    assert run(["diagnose", str(bad), "--healthy", str(good)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"reference trials miss each other by {nothing['evidence']['error_n']['reference']:.2f} N" in said
    assert "Verdict: none" in said
    for signal, row in nothing["relations"].items():
        assert f"{signal} │ N │ {row['floor']:.4f} │ {row['rmse_before']:.4f} │ {row['rmse_session']:.4f} │" in said


def test_a_gait_without_the_knee_is_refused_with_the_column(healthy: tuple[tuple[Table, ...], Table]) -> None:
    reference, trial = healthy
    blind = table("blind.csv", {n: v for n, v in trial.columns.items() if n != "knee_angle_rad"})
    said = diagnose([blind], healthy=reference)
    assert said.verdict == "refused"
    assert "blind.csv: has no column knee_angle_rad" in said.warnings[0]


@pytest.mark.exhaustive
def test_end_is_left_out_where_the_reference_trials_do_not_have_it(healthy: tuple[tuple[Table, ...], Table]) -> None:
    reference, trial = healthy
    blind = table("blind.csv", {n: v for n, v in reference[0].columns.items() if n != "tension_end_n"})
    said = diagnose([trial], healthy=[blind])
    assert "tension_end_n" not in said.relations
    assert any("With tension_end_n recorded" in warning for warning in said.warnings)


@pytest.mark.slow
def test_a_gain_that_every_reference_trial_has_is_the_benchs() -> None:
    made, ratio = case(HEALTHY), []
    for gain in (1.0, 1.03):
        given = [replace(t, columns={**t.columns, "tension_end_n": gain * t["tension_end_n"]})
                 for t in (*made.healthy, made.trial)]
        fit = EvidenceFinder(given[:-1]).reference(given[-1:])
        bench = named(fit.bench_coordinates())
        ratio.append(bench["end_gain"] / bench["start_gain"])
    # with the maker's class of 0.3 % between benches it was 0.8 %, and the sessions of the bench made up for the rest;
    # one reference trial alone determines it to 1.1 %, so that the prior of 2 % keeps a third
    assert ratio[1] - ratio[0] == pytest.approx(0.03, abs=0.01)


def _jerking(given: Table) -> Table:
    """Return a recording whose servo pushes by 10 N for an instant at each reversal, which no constant describes."""
    speed = np.gradient(given["servo_position_m"], given["time_s"])
    turns = np.abs(np.gradient(speed, given["time_s"])) > 0.2
    return replace(given, columns={**given.columns, "servo_force_n": given["servo_force_n"] + 10.0 * turns * np.exp(
        -(speed / 2e-3) ** 2)})


@pytest.mark.slow
def test_what_the_model_misses_in_the_reference_trials_too_is_no_lack_of_fit() -> None:
    given = [_jerking(t) for t in case(HEALTHY).healthy[:2]]
    fit = EvidenceFinder(given).reference(given[:1])
    misfit = []
    for trial, (q, weights) in zip(given, fit.identified, strict=True):
        observed = fit.observe(PATH_MODEL.record(trial))
        misfit.append(observed.misfit(observed.data - observed.predicted(q) - observed.features @ weights))
    force = fit.outputs.index("servo_force_n")
    # without it the jerk was a misfit of 1.5 in each trial of this bench, where 1.6 is `unexplained`
    assert fit.misfit[force] > 1.3
    assert np.mean(misfit, axis=0)[force] == pytest.approx(1.0, abs=1e-6)
    # 1 with a scatter of 2·√(2/57) = 0.4 at two sigma, since the sessions are drawn within the published tolerances
    assert fit.departure.rms**2 < 1.5
