"""A tension sensor's bridge and converter: from the applied force to 24-bit counts.

A sample depends on the force's history, the instant and the seed only, never on the caller. The noise of one instant
is drawn from a counter, so that leaving a sample out changes no other.
"""

import math
from dataclasses import astuple, dataclass
from typing import Any, Final

import numpy as np
from numba import njit

from physics.laws import Array
from physics.parameters import declared

FULL_COUNTS: Final = 2**23
RING: Final = 1024
"""Samples kept for a delayed sensor: at 4 kHz more than the longest delay."""


LAST_S, FILTERED, LAGGED, SAMPLES, BEGUN_S, HISTORY = range(6)
"""Places in a converter's history: time of the last sample, its force after either low-pass, number, begin of drift."""
FULL_SCALE, CUTOFF, NOISE, GAIN, OFFSET, DRIFT, DRIFT_S, DELAY, LAG, QUANTUM, SKEW, SENSOR = range(12)
"""Places of `SensorParameters` in the array that `convert` reads; `SENSOR` is its length."""


@dataclass(frozen=True)
class SensorParameters:
    """Parameters of the HYLY-019 bridge and the AD7192 converter; the last eight are errors, neutral by default."""

    full_scale_n: float = declared("full_scale")
    cutoff_hz: float = declared("sensor_cutoff")
    noise_n: float = declared("start_noise")
    gain: float = declared("start_gain")
    offset_n: float = declared("start_offset")
    drift_n: float = declared("start_drift")
    drift_s: float = declared("drift_time")
    delay_s: float = declared("end_delay")
    lag_s: float = declared("end_filter")
    quantum_n: float = declared("quantum")
    skew_s: float = declared("timestamp_skew")


@njit
def _mix(z: Any) -> Any:
    """Return 64 well-mixed bits (splitmix64's finaliser)."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True)
def normal(seed: Any, counter: int) -> float:
    """Return the standard normal number of (`seed`, `counter`): uint64 and int64, the same in any order of calls."""
    z = _mix(np.uint64(counter) * np.uint64(0x9E3779B97F4A7C15) + _mix(seed))
    u = float((z >> np.uint64(11)) + np.uint64(1)) * 2.0**-53
    w = float(_mix(z + np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(11)) * 2.0**-53
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * w)


@njit
def _delayed(ring: Any, count: int, at_s: float) -> float:
    """Return the ring's signal at `at_s`, s, linear between its samples; the oldest where it does not reach."""
    later = (count - 1) % RING
    for back in range(1, min(count, RING)):
        earlier = (count - 1 - back) % RING
        if ring[earlier, 0] <= at_s:
            span = ring[later, 0] - ring[earlier, 0]
            part = min(1.0, (at_s - ring[earlier, 0]) / span)
            between: float = ring[earlier, 1] + part * (ring[later, 1] - ring[earlier, 1])
            return between
        later = earlier
    oldest: float = ring[later, 1]
    return oldest


@njit(cache=True)
def convert(state: Any, ring: Any, p: Any, seed: Any, time_ns: int, force_n: float) -> float:
    """Return the counts of one sample; `state`: `HISTORY`; `p`: `SENSOR`."""
    now = time_ns * 1e-9
    count = int(state[SAMPLES])
    if count == 0:
        state[FILTERED], state[LAGGED] = force_n, force_n
    else:
        dt = now - state[LAST_S]
        state[FILTERED] += -math.expm1(-2.0 * math.pi * p[CUTOFF] * dt) * (force_n - state[FILTERED])
        # both low-passes are exact for an input that is constant over a sample: y += (1 − e^(−Δt/τ))·(u − y)
        filtered, lagged = state[FILTERED], state[LAGGED]
        state[LAGGED] = filtered if p[LAG] <= 0.0 else lagged - math.expm1(-dt / p[LAG]) * (filtered - lagged)
    state[LAST_S] = now
    ring[count % RING, 0], ring[count % RING, 1] = now, state[LAGGED]
    state[SAMPLES] = count + 1
    late = p[DELAY] + p[SKEW]
    signal = state[LAGGED] if late <= 0.0 else _delayed(ring, count + 1, now - late)
    drift = p[DRIFT] * (now - state[BEGUN_S]) / p[DRIFT_S]
    signal = signal * p[GAIN] + p[OFFSET] + drift + p[NOISE] * normal(seed, time_ns)
    if p[QUANTUM] > 0.0:
        signal = p[QUANTUM] * round(signal / p[QUANTUM])
    counts: float = round(signal / p[FULL_SCALE] * FULL_COUNTS)
    return min(FULL_COUNTS - 1.0, max(-float(FULL_COUNTS), counts))


class Converter:
    """One sensor's bridge and converter; the same parameters, seed, times and forces give the same counts."""

    __slots__ = ("_p", "_ring", "_seed", "_state", "parameters")

    def __init__(self, parameters: SensorParameters, seed: int, time_ns: int = 0) -> None:
        self.parameters = parameters
        self._p: Array = np.array(astuple(parameters))
        self._seed = np.uint64(seed & 0xFFFF_FFFF_FFFF_FFFF)
        self.reset(time_ns)

    def reset(self, time_ns: int) -> None:
        """Reset the signal's history; drift counts from `time_ns`."""
        self._state: Array = np.array([0.0, 0.0, 0.0, 0.0, time_ns * 1e-9])
        self._ring: Array = np.zeros((RING, 2))

    @property
    def seed(self) -> int:
        """Return the seed of the noise."""
        return int(self._seed)

    def adopt(self, state: Array, ring: Array, p: Array) -> None:
        """Move history and parameters into this memory; shapes as in `convert`."""
        state[:], ring[:], p[:] = self._state, self._ring, self._p
        self._state, self._ring, self._p = state, ring, p

    def sample(self, time_ns: int, force_n: float) -> int:
        """Return the counts, −2²³ … 2²³ − 1, of the force felt at `time_ns`, N; times must not fall."""
        return int(convert(self._state, self._ring, self._p, self._seed, time_ns, force_n))
