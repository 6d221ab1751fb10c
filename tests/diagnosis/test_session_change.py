"""What changes between sessions of a healthy bench: evidence averaged over it is that of the data's own covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.evidence.identical_motion import pair_of
from diagnosis.evidence.session_change import averaged, feature_sd, under
from estimation.path_model import PATH_MODEL
from estimation.posterior import Gaussian, PosteriorMode, SessionData, mode
from estimation.reference_fit import ReferenceFit
from tests.hidden.family import Case, Job, case

BENCH = Job(39, (), 9, cycles=3)
"""In the reference condition, with one or more reference trials of other gaits."""


@pytest.fixture(scope="module")
def alone() -> tuple[ReferenceFit, SessionData]:
    """A bench with one reference trial, and a trial of another motion."""
    made = case(BENCH)
    fit = EvidenceFinder(made.healthy[:1]).reference([made.trial])
    return fit, fit.observe(PATH_MODEL.record(made.trial))


def exact(at: PosteriorMode, observed: SessionData) -> Callable[[Gaussian, float], float]:
    """Return the log evidence of the linearised data, nats, by prior and by a further change of the discrepancy."""
    counted = at.weight > 0.0
    design, noise, measured = at.design[counted], np.diag(1.0 / at.weight[counted]), at.residual + at.design @ at.x

    def nats(prior: Gaussian, further: float = 0.0) -> float:
        wide = further * observed.features[counted]
        error = (measured - at.design @ prior.mean)[counted]
        covariance = noise + design @ prior.covariance @ design.T + wide @ wide.T
        return -0.5 * float(error @ np.linalg.solve(covariance, error) + np.linalg.slogdet(covariance)[1])

    return nats


def test_a_further_change_of_the_discrepancy_is_averaged_as_in_the_datas_own_covariance(
    alone: tuple[ReferenceFit, SessionData]
) -> None:
    fit, observed = alone
    prior, sd = fit.prior_of(observed), feature_sd(fit)
    at = mode(observed, prior, descends=False)
    nats = exact(at, replace(observed, features=observed.features * sd))
    assert averaged(at, sd, (0.0,)) == pytest.approx(at.log_evidence, abs=1e-9)
    assert averaged(at, sd, (1.4,)) - at.log_evidence == pytest.approx(nats(prior, 1.4) - nats(prior), rel=1e-3)
    both = np.logaddexp(averaged(at, sd, (0.0,)), averaged(at, sd, (1.4,))) - np.log(2.0)
    assert averaged(at, sd, (0.0, 1.4)) == pytest.approx(both, abs=1e-9)


def test_another_prior_has_the_evidence_of_the_datas_own_covariance(alone: tuple[ReferenceFit, SessionData]) -> None:
    fit, observed = alone
    prior = fit.prior_of(observed)
    other = replace(prior, mean=0.9 * prior.mean, covariance=0.3 * prior.covariance)
    at = mode(observed, prior, descends=False)
    nats, there = exact(at, observed), under(at, other, ())
    assert there.log_evidence - at.log_evidence == pytest.approx(nats(other) - nats(prior), rel=1e-3)
    assert under(there, prior, ()).log_evidence == pytest.approx(at.log_evidence, abs=1e-6)


def test_one_reference_trial_shows_no_scatter(alone: tuple[ReferenceFit, SessionData]) -> None:
    fit, observed = alone
    assert fit.session_priors_of(observed) == []
    # ln κ ~ N(0, 1), which one session changes by less than a third of the odds that exclude a scatter, ln 20 = 3
    stated, wider = (each.log_probability for each in fit.session_priors[-2:])
    assert wider - stated == pytest.approx(-0.5, abs=1.0)
    # so that a repeat of its motion departs by no more than the stated scatter, within which not any change is
    recording = observed.trials[0]
    assert len(pair_of(fit, recording, fit.observe(recording), 0, 0).session_priors) == 4


@pytest.fixture(scope="module")
def two() -> tuple[Case, ReferenceFit]:
    made = case(BENCH)
    return made, EvidenceFinder(made.healthy[:2]).reference([made.trial])


@pytest.mark.slow
def test_a_joint_minimum_is_the_same_when_it_is_asked_again(two: tuple[Case, ReferenceFit]) -> None:
    made, fit = two
    assert fit.joint_minimum is not None
    trial = PATH_MODEL.record(made.trial)
    first, again = (fit.joint_minimum(fit, trial, fit.prior.mean) for _ in range(2))
    assert first.nats == again.nats


@pytest.mark.slow
def test_two_reference_trials_weigh_the_scatter_of_structural_constants(two: tuple[Case, ReferenceFit]) -> None:
    made, fit = two
    *narrower, at_stated, wider = fit.session_priors
    assert [each.log_factor for each in fit.session_priors] == [-3.0, -2.0, -1.0, 0.0, 1.0]
    assert sum(np.exp(each.log_probability) for each in (*narrower, at_stated)) == pytest.approx(1.0)
    np.testing.assert_allclose(at_stated.prior.covariance, fit.prior.covariance, rtol=1e-6, atol=1e-15)
    # a trial of another motion has its larger scatter as overdispersion
    assert len(fit.session_priors_of(fit.observe(PATH_MODEL.record(made.trial)))) == 4
    names = [fit.model.constants.names[i] for i in fit.model.constants.free]
    scaled = [n in fit.model.structural for n in names]
    narrow, stated = (np.sqrt(each.session[:len(names)]) for each in (fit.session_priors[0], at_stated))
    np.testing.assert_allclose(narrow / stated, np.where(scaled, np.exp(-3.0), 1.0))
    # a pair of identical motion has a larger scatter, too, unless the reference trials exclude it
    recording = PATH_MODEL.record(made.healthy[0])
    for log_probability, count in ((-99.0, 4), (9.0, 5)):
        given = replace(fit, session_priors=(*narrower, at_stated, wider._replace(log_probability=log_probability)))
        pair = pair_of(given, recording, fit.observe(recording), 0, 0)
        assert len(pair.session_priors) == count
        assert sum(np.exp(nats) for nats, _ in pair.session_priors) == pytest.approx(1.0)
        np.testing.assert_allclose(pair.session_priors[3][1].covariance, pair.prior.covariance, rtol=1e-6)
