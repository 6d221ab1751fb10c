"""A reference trial of the trial's own motion: recognised with any lag, and only the difference counts."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.evidence.identical_motion import cycle_variance, pair_of, paired, search_trial
from diagnosis.finder import diagnose
from estimation.data.table import Table, table
from estimation.forward_model import predicted
from estimation.path_model import PATH_MODEL
from estimation.posterior import mode
from estimation.reference_fit import ReferenceFit
from physics.forward.path_constants import CONSTANTS, INDEX
from tests.hidden.family import Job, case

BENCH = Job(39, (), 9, cycles=3)
"""In the reference condition, with one or more reference trials of other gaits."""


def again(given: Table, end_gain: float = 1.0, shift_s: float = 0.0, noise_n: float = 0.05) -> Table:
    """Return a trial once more: another noise of the sensors, END with a gain, and the first `shift_s` cut off."""
    random = np.random.default_rng(5)
    keep = given["time_s"] >= given["time_s"][0] + shift_s
    columns = {name: values[keep] for name, values in given.columns.items()}
    for name, gain in (("tension_start_n", 1.0), ("tension_end_n", end_gain)):
        columns[name] = gain * columns[name] + noise_n * random.normal(size=columns[name].size)
    return table("again.csv", columns)


@pytest.fixture(scope="module")
def bench() -> tuple[EvidenceFinder, ReferenceFit, Table]:
    """The diagnosis of a bench with its reference fit, and a trial of another motion than the reference trial's."""
    made = case(BENCH)
    finder = EvidenceFinder(made.healthy[:1])
    return finder, finder.reference([made.trial]), made.trial


@pytest.mark.slow
def test_the_motion_is_recognised_with_a_lag_and_no_other_motion_is(
    bench: tuple[EvidenceFinder, ReferenceFit, Table]
) -> None:
    finder, fit, other = bench
    reference = finder._tables[0]
    known = [PATH_MODEL.record(reference)]
    for shift_s in (0.0, 0.6):
        found = paired(fit, known, fit.observe(PATH_MODEL.record(again(reference, shift_s=shift_s))))
        assert found is not None
        assert found.reference == 0
    assert paired(fit, known, fit.observe(PATH_MODEL.record(other))) is None


def test_what_the_model_misses_is_gone_from_the_difference(bench: tuple[EvidenceFinder, ReferenceFit, Table]) -> None:
    finder, fit, _ = bench
    reference = finder._tables[0]
    made = paired(fit, [PATH_MODEL.record(reference)], fit.observe(PATH_MODEL.record(again(reference, noise_n=0.0))))
    assert made is not None
    q, c = fit.identified[0]
    left = made.observed.data - made.observed.predicted(q) - made.observed.features @ c
    assert float(np.abs(left[made.observed.weight > 0.0]).max()) < 1e-6


def test_a_repeat_departs_by_what_reference_trials_leave_of_both_sessions(
    bench: tuple[EvidenceFinder, ReferenceFit, Table]
) -> None:
    finder, fit, _ = bench
    known = PATH_MODEL.record(finder._tables[0])
    pair = pair_of(fit, known, fit.observe(known), 0, 0)
    session = np.diag(fit.prior.covariance - fit.bench.covariance)
    # joint precision of bench b and session x = b + s, the bench's own from its posterior, which has this session
    data, seen = fit.observe(known), list(fit.model.constants.free)
    design = np.hstack([data.jacobian(fit.identified[0][0], seen)[1], data.features])
    scale = np.sqrt(session)
    information = scale[:, None] * ((design.T * data.weight) @ design) * scale
    one = np.eye(scale.size)
    bench_alone = np.linalg.inv(fit.bench.covariance / np.outer(scale, scale)) - (
        information - information @ np.linalg.solve(one + information, information))
    joint = np.linalg.inv(np.block([[bench_alone + one, -one], [-one, one + information]]))
    half = scale.size
    between = one + joint[:half, :half] + joint[half:, half:] - joint[:half, half:] - joint[half:, :half]
    names = [fit.model.constants.names[i] for i in seen]
    plain = [k for k, name in enumerate(names) if name not in fit.model.surrogate_sd]
    found = pair.prior.covariance / np.outer(scale, scale)
    np.testing.assert_allclose(found[np.ix_(plain, plain)], between[np.ix_(plain, plain)], atol=1e-4)
    np.testing.assert_allclose(found[half - 1, half - 1], 2.0)  # a feature's weight absorbs model error


@pytest.mark.exhaustive
def test_an_effect_is_named_from_the_difference_and_a_repeat_names_nothing(
    bench: tuple[EvidenceFinder, ReferenceFit, Table]
) -> None:
    finder, _, _ = bench
    reference = finder._tables[0]
    assert finder.diagnose([again(reference)]).verdict == "none"
    changed = finder.diagnose([again(reference, end_gain=1.04)])
    assert "end_gain" in changed.rivals
    assert any("has the motion of the trial" in warning for warning in changed.warnings)


def test_a_bench_that_is_moved_costs_the_reference_trials_at_least_what_their_posterior_says(
    bench: tuple[EvidenceFinder, ReferenceFit, Table]
) -> None:
    fit = bench[1]
    assert fit.bench_nats is not None
    free = list(fit.model.constants.free)
    shift = np.zeros(len(free))
    assert abs(fit.bench_nats(shift)) < 1.0  # the fit ended within that of the mode
    k = free.index(INDEX["cable"])
    shift[k] = 3.0 * np.sqrt(fit.bench.covariance[k, k])
    # 4.5 nats if all other constants followed; they are held
    assert fit.bench_nats(shift) < -4.5


@pytest.mark.slow
def test_a_pair_finds_the_bench_that_made_its_data(bench: tuple[EvidenceFinder, ReferenceFit, Table]) -> None:
    finder, fit, _ = bench
    free = list(fit.model.constants.free)
    root = np.linalg.cholesky(fit.bench.covariance[:len(free), :len(free)])
    there = fit.identified[0][0].copy()
    there[free] += root @ np.random.default_rng(4).normal(size=len(free))
    moved = there.copy()
    moved[INDEX["zero"]] -= 1e-3  # m, as after homing anew on a rope that was exchanged
    known, trial = PATH_MODEL.record(finder._tables[0]), PATH_MODEL.record(finder._tables[0])
    known.data, trial.data = predicted(fit.model, there, known), predicted(fit.model, moved, trial)
    found, pair = search_trial(fit, [known], fit.observe(trial))
    assert pair is not None
    assert found.other_minimum is not None
    other = found.other_minimum(found)
    at = mode(other.modes.observed, other.modes.prior, start=other.start)
    # the data have no noise, so that the right bench misses nothing; 28 nats here, and 12 decide
    assert at.log_evidence + other.nats > found.null.log_evidence + 12.0
    assert other.modes.observed.misfit(at.residual).max() < 0.5 * found.observed.misfit(found.null.residual).max()


def test_a_drive_of_twice_the_friction_differs_by_twice_between_sessions() -> None:
    q = np.zeros(len(CONSTANTS))
    q[INDEX["drive_viscous"]], q[INDEX["drive_coulomb"]] = 15.0, -1.0  # 30 N·s/m, 1 N
    ratio = PATH_MODEL.session_at(q) / CONSTANTS.session_sd.clip(1e-300)
    changed = {CONSTANTS.names[i]: ratio[i] for i in np.flatnonzero(CONSTANTS.session_sd) if ratio[i] != 1.0}
    assert changed == {"drive_viscous": 2.0}  # a drive of less friction keeps the stated deviation


def test_the_variance_between_cycles_stands_where_cycles_differ() -> None:
    time = np.arange(4000) / 500.0
    phase = time % 1.0
    wave = np.sin(2.0 * np.pi * phase)
    trial = PATH_MODEL.record(table("made.csv", {
        "time_s": time, "gait_percent": 100.0 * phase, "servo_position_m": 0.01 * wave, "knee_angle_rad": 0.5 * wave,
        "tension_start_n": 20.0 + 10.0 * wave}))
    assert trial.phase is not None
    at, random = trial.binned(trial.time_s), np.random.default_rng(3)
    snaps = np.exp(-0.5 * ((trial.phase - 0.5) / 0.03) ** 2) * (np.floor(at) % 2.0)  # in each second cycle
    each = 3.0 * np.exp(-0.5 * ((trial.phase - 0.8) / 0.03) ** 2)  # in every cycle alike
    variance = cycle_variance(trial, 0.1 * random.normal(size=at.size) + snaps + each)
    assert variance[np.abs(trial.phase - 0.5) < 0.02].min() > 0.1  # 0.25 at the peak, less the mean over phases
    # 7 cycles and the mean over five phases: 1σ of a variance is a quarter of it
    assert np.median(variance[np.abs(trial.phase - 0.5) > 0.15]) == pytest.approx(0.01, rel=0.5)
    assert variance[np.abs(trial.phase - 0.8) < 0.03].max() < 0.03
    rest = np.abs(at - 3.0) < 0.5
    trial.phase = np.where(rest, np.nan, trial.phase)
    around = cycle_variance(trial, snaps)
    assert (around[rest] == 0.0).all()
    assert (around[~rest & (np.abs(trial.phase - 0.5) < 0.02)] > 0.1).all()


@pytest.mark.exhaustive
def test_a_healthy_pair_on_a_bench_that_snaps_at_another_moment_in_each_cycle_has_no_name() -> None:
    # 35 nats of `stribeck` where a snap counts as repeated (decision 66)
    made = case(Job(165, (), 5031))
    assert diagnose([made.trial], healthy=list(made.healthy)).causes == []


@pytest.mark.exhaustive
def test_a_second_bench_takes_a_false_name_and_keeps_a_true_one() -> None:
    # 40.6 nats of `stribeck` about the reference trial's own mode (decision 65)
    made = case(Job(147, (), 5027))
    assert diagnose([made.trial], healthy=list(made.healthy)).causes == []
    # at ½·bᵀB⁻¹b another bench would take this one
    made = case(Job(201, ("stribeck",), 12201))
    assert "stribeck" in diagnose([made.trial], healthy=list(made.healthy)).rivals


@pytest.mark.exhaustive
def test_a_healthy_pair_of_a_drive_with_much_friction_has_no_name() -> None:
    # 17.9 nats of `stribeck` where the drive may differ by 10 % of a typical one only (decision 63)
    made = case(Job(33, (), 5003))
    assert diagnose([made.trial], healthy=list(made.healthy)).causes == []


@pytest.mark.exhaustive
def test_what_the_session_changes_is_known_to_a_tenth() -> None:
    # 20.5 nats of `stribeck` where the response to the session's constants is exact (decision 68)
    made = case(Job(196, (), 12596))
    assert diagnose([made.trial], healthy=list(made.healthy)).causes == []
    made = case(Job(459, ("start_gain",), 12859))
    assert diagnose([made.trial], healthy=list(made.healthy)).rivals == ["start_gain"]
