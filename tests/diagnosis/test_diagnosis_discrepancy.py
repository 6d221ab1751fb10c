"""What the laws leave on healthy trials: the features that it is learnt on."""

from __future__ import annotations

import numpy as np

from diagnosis.problem.discrepancy import features
from physics.plant.leg import KNEE_AT_FIT
from physics.relations.measured import Signals

N = 200


def recorded(**columns: np.ndarray) -> Signals:
    time = 0.01 * np.arange(N)
    rope = 0.01 * np.sin(4.0 * time)
    held = {"time_s": time, "rope_m": rope, "rope_m_s": np.gradient(rope, time), "tension_end_n": 20.0 + 1e3 * rope}
    fresh = np.zeros(N, dtype=np.bool_)
    fresh[0] = True
    return Signals({**held, **columns}, fresh, np.linspace(0.0, 1.0, N))


def test_a_knee_that_is_not_recorded_is_a_locked_one() -> None:
    """Healthy trials of a gait say what the laws leave in an experiment without a knee, too."""
    given = {"presliding": 1e-4}
    told = features(recorded(), given)
    assert np.array_equal(told, features(recorded(knee_angle_rad=np.full(N, KNEE_AT_FIT)), given))
    moved = features(recorded(knee_angle_rad=np.linspace(-1.0, 0.0, N)), given)
    assert told.shape == moved.shape
    assert (told != moved).any(axis=0).sum() == 1
