"""The converter: noise of the stated size, drawn by instant; filter, delay, drift and quantisation as declared."""

import math
from dataclasses import replace

import numpy as np
import pytest

from physics.converter import FULL_COUNTS, Converter, SensorParameters

MS = 1_000_000
QUIET = SensorParameters(noise_n=0.0)
NEWTON_PER_COUNT = QUIET.full_scale_n / FULL_COUNTS


def _newtons(converter: Converter, forces: list[float], start_ns: int = 0) -> np.ndarray:
    counts = [converter.sample(start_ns + k * MS, force) for k, force in enumerate(forces)]
    return np.array(counts) * NEWTON_PER_COUNT


def test_noise_has_the_declared_rms_and_is_white() -> None:
    read = _newtons(Converter(SensorParameters(), 7), [20.0] * 20_000)
    # 20 000 samples: the rms is known to 0.5 %, mean and lag-one correlation to 0.007 (1σ); four of those
    assert read.std() == pytest.approx(0.15, rel=0.02)
    assert read.mean() == pytest.approx(20.0, abs=0.15 * 0.028)
    assert abs(np.corrcoef(read[1:], read[:-1])[0, 1]) < 0.028


def test_noise_is_normal() -> None:
    read = (_newtons(Converter(SensorParameters(), 3), [0.0] * 20_000)) / 0.15
    for sigma, share in ((1.0, 0.3173), (2.0, 0.0455), (3.0, 0.0027)):
        # binomial, four standard deviations
        assert np.mean(np.abs(read) > sigma) == pytest.approx(share, abs=4 * math.sqrt(share / 20_000))


def test_noise_belongs_to_the_instant_not_to_the_call() -> None:
    every = _newtons(Converter(SensorParameters(cutoff_hz=1e4), 5), [10.0] * 200)
    second = Converter(SensorParameters(cutoff_hz=1e4), 5)
    skipping = np.array([second.sample(k * MS, 10.0) for k in range(0, 200, 2)]) * NEWTON_PER_COUNT
    np.testing.assert_array_equal(every[::2], skipping)


def test_seeds_differ_and_repeat() -> None:
    one, same, other = (_newtons(Converter(SensorParameters(), seed), [5.0] * 50) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.1


def test_low_pass_is_first_order_whatever_the_step() -> None:
    tau = 1 / (2 * math.pi * 200.0)
    for step_ns in (MS // 4, MS):
        converter = Converter(QUIET, 0)
        converter.sample(0, 0.0)
        for k in range(1, 4 * MS // step_ns + 1):
            counts = converter.sample(k * step_ns, 50.0)
        # one count of 24 bits
        assert counts * NEWTON_PER_COUNT == pytest.approx(50 * (1 - math.exp(-4e-3 / tau)), abs=2.4e-5)


def test_gain_offset_drift() -> None:
    wrong = replace(QUIET, gain=1.05, offset_n=-2.0, drift_n=3.0, drift_s=10.0)
    converter = Converter(wrong, 0, time_ns=2_000 * MS)
    converter.sample(2_000 * MS, 40.0)
    read = converter.sample(7_000 * MS, 40.0) * NEWTON_PER_COUNT
    assert read == pytest.approx(40.0 * 1.05 - 2.0 + 1.5, abs=2.4e-5)


def test_delay_and_lag() -> None:
    ramp = [0.01 * k for k in range(300)]
    prompt = _newtons(Converter(QUIET, 0), ramp)
    late = _newtons(Converter(replace(QUIET, delay_s=7.5e-3), 0), ramp)
    lagged = _newtons(Converter(replace(QUIET, lag_s=20e-3), 0), ramp)
    # a ramp of 10 N/s; a held sample adds half a millisecond to the lag, 5 mN
    assert prompt[-1] - late[-1] == pytest.approx(0.075, abs=5e-5)
    assert prompt[-1] - lagged[-1] == pytest.approx(0.2, abs=6e-3)


def test_quantisation_and_full_scale() -> None:
    coarse = Converter(replace(QUIET, quantum_n=0.5), 0)
    read = _newtons(coarse, [k * 0.013 for k in range(500)])
    assert np.abs(read / 0.5 - np.round(read / 0.5)).max() < 1e-4
    assert Converter(QUIET, 0).sample(0, 1e6) == FULL_COUNTS - 1
    assert Converter(QUIET, 0).sample(0, -1e6) == -FULL_COUNTS


def test_skew_adds_to_the_delay() -> None:
    ramp = [0.01 * k for k in range(300)]
    late = _newtons(Converter(replace(QUIET, delay_s=4e-3), 0), ramp)
    both = _newtons(Converter(replace(QUIET, delay_s=4e-3, skew_s=3e-3), 0), ramp)
    assert late[-1] - both[-1] == pytest.approx(0.03, abs=5e-5)
