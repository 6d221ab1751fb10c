"""The drives' own loops: PI position loop, PI velocity loop.

Compiled functions on flat float64 arrays, without a clock; the caller gives the elapsed time. Units are the axis's
own: m for the servo (rope at the drum), rad for the knee; torque in N·m.
"""

import math
from dataclasses import astuple, dataclass
from typing import Any, Final

import numpy as np
from numba import njit

from parameters import parameter
from physics.laws import Array
from physics.parameters import declared

DRIVE_TICK_NS: Final = 250_000
"""Period of a drive's control loops, ns."""


POSITION_INTEGRAL, VELOCITY_INTEGRAL, LIMITED, FOLLOWING_ERROR, VELOCITY_DEMAND, LOOP_STATES = range(6)
"""Places in the loops' memory; `LOOP_STATES` is its length."""
KP, KI, KV, KVI, TORQUE_LIMIT, VELOCITY_LIMIT, GAINS = range(7)
"""Places of `Gains` in the array that the loops read; `GAINS` is its length."""


@dataclass(frozen=True)
class Gains:
    """The gains and limits of one axis; [u] is m or rad."""

    position_gain: float = declared("servo_position_gain")
    position_integral: float = parameter(
        300.0, "1/s²", "position loop, integral", low=0.0, high=1e5, source="assumed: as position_gain")
    velocity_gain: float = parameter(
        31.0, "N·m·s/[u]", "velocity loop, proportional", low=0.0, high=1e4,
        source="assumed: 100 Hz on the nominal inertia")
    velocity_integral: float = parameter(
        2000.0, "N·m/[u]", "velocity loop, integral", low=0.0, high=1e6, source="assumed: a tenth of the crossover")
    torque_limit: float = parameter(6.0, "N·m", "torque limit", low=0.0, high=500.0, source="assumed: maker's class")
    velocity_limit: float = parameter(
        1.0, "[u]/s", "velocity limit", low=0.0, high=100.0, source="assumed: no-load speed of the motor")

    def vector(self) -> Array:
        """Return the gains as the flat array that `loop` reads, in the order of their declaration."""
        return np.array(astuple(self))


SERVO_GAINS: Final = Gains()
KNEE_GAINS: Final = Gains(
    position_gain=80.0, position_integral=200.0, velocity_gain=10.0, velocity_integral=200.0,
    torque_limit=17.0, velocity_limit=12.0,
)


def loop_state() -> Array:
    """Return the loops' memory at rest."""
    return np.zeros(LOOP_STATES)


@njit(inline="always")
def _torque(state: Any, gains: Any, demand: float, velocity: float, dt_s: float) -> float:
    """Return the torque demand, N·m, of the velocity loop: PI with anti-windup by clamping."""
    lag = demand - velocity
    wanted = gains[KV] * lag + state[VELOCITY_INTEGRAL]
    torque: float = min(gains[TORQUE_LIMIT], max(-gains[TORQUE_LIMIT], wanted))
    if torque == wanted or (wanted - torque) * lag < 0.0:
        state[VELOCITY_INTEGRAL] += gains[KVI] * lag * dt_s
    state[LIMITED] = 0.0 if torque == wanted else math.copysign(1.0, wanted)
    state[VELOCITY_DEMAND] = demand
    return torque


@njit(cache=True)
def loop(
    state: Any, gains: Any, position: float, velocity: float, target: float, target_velocity: float, dt_s: float
) -> float:
    """Return the torque demand, N·m: PI on position gives the velocity demand, PI on velocity the torque.

    `target_velocity` is fed forward.  Each integral stands still while its loop's limit is reached and the
    error would drive it further in: no wind-up.
    """
    error = target - position
    free = target_velocity + gains[KP] * error + state[POSITION_INTEGRAL]
    demand = min(gains[VELOCITY_LIMIT], max(-gains[VELOCITY_LIMIT], free))
    if demand == free or (free - demand) * error < 0.0:
        state[POSITION_INTEGRAL] += gains[KI] * error * dt_s
    state[FOLLOWING_ERROR] = error
    return _torque(state, gains, demand, velocity, dt_s)


@njit(cache=True)
def velocity_loop(state: Any, gains: Any, velocity: float, target_velocity: float, dt_s: float) -> float:
    """Return the torque demand, N·m, of the velocity loop alone (CSV, quick stop); memory and limits as in `loop`."""
    state[POSITION_INTEGRAL] = state[FOLLOWING_ERROR] = 0.0
    demand = min(gains[VELOCITY_LIMIT], max(-gains[VELOCITY_LIMIT], target_velocity))
    return _torque(state, gains, demand, velocity, dt_s)
