"""One axis of a drive: the arrays of `nodes.drives.axis_law`, kept in step with the drive's objects.

The rule of this file: every object is turned into SI here, once, when it is written; nothing is converted at a tick.
"""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any, Final

import numpy as np

from eds import scale_factors
from eds.datatype import Value
from eds.dictionary import Dictionary, key
from nodes.drives import axis_law as law

NO_WINDOW: Final = 0xFFFFFFFF
"""Value of 0x6065 that switches the monitoring of the following error off."""
STOP_MARGIN_S: Final = 0.5
"""Time, s, beyond a ramp's own duration after which a stop counts as completed although the axis moves."""


class Units:
    """Conversion of counts to SI at the axis, from the unit objects of a dictionary."""

    def __init__(self, dictionary: Dictionary) -> None:
        self.position = scale_factors.position_unit(dictionary)
        self.velocity = scale_factors.velocity_unit(dictionary)
        self.resolution = self.position / scale_factors.increments_per_unit(dictionary)
        gear = scale_factors.gear_ratio(dictionary)
        feed = dictionary.initial(0x6092, 1) / dictionary.initial(0x6092, 2) * self.position
        self.motor_speed = feed / gear / 60.0
        """Axis speed, m/s or rad/s, per 1/min of the motor."""
        self.torque = scale_factors.torque_unit(dictionary) * gear
        """Torque at the output, N·m, per ‰ of 0x6076."""
        self.arm_m = feed / (2.0 * math.pi)
        """Drum radius of a linear axis; 1 of a rotary one."""
        self.apart = law.APART_SHARE * dictionary.initial(0x6065) * self.position
        """Largest permitted difference of the distances by position and by velocity, m or rad."""


class Axis:
    """One axis: settings from the objects, counts to them, and the motions of the state machine."""

    def __init__(self, dictionary: Dictionary) -> None:
        law.prepare()
        self.units = Units(dictionary)
        self.s, self.g = law.arrays()
        self.out = np.zeros(law.COUNTS, np.int64)
        self.origin = 0.0
        """The axis position, m or rad, at which the position object reads zero."""
        self._sign = 1.0
        self.state: Any = memoryview(self.s)
        self.settings: Any = memoryview(self.g)
        """Memory view of `g` for access to single numbers: a third of the cost of indexing an array."""

    def configure(self, values: Mapping[int, Value]) -> None:
        """Read every setting from its object."""
        number = partial(_number, values)
        units, g = self.units, self.g
        self._sign = -1.0 if int(number(0x607E)) & 0x80 else 1.0
        g[law.KP], g[law.KI] = 1e-3 * number(0x60FB, 1), 1e-3 * number(0x60FB, 2)
        g[law.KV], g[law.KVI] = 1e-3 * number(0x60F9, 1), 1e-3 * number(0x60F9, 2)
        g[law.FEED_FORWARD] = 1e-3 * number(0x60FB, 3)
        g[law.TORQUE_MAX] = number(0x6072) * units.torque
        g[law.TORQUE_HIGH], g[law.TORQUE_LOW] = number(0x60E0) * units.torque, -number(0x60E1) * units.torque
        g[law.SPEED_MAX] = min(number(0x6080) * units.motor_speed, number(0x607F) * units.velocity)
        g[law.PERIOD_S] = number(0x60C2, 1) * 10.0 ** number(0x60C2, 2)
        g[law.RESOLUTION] = units.resolution
        g[law.STILL_SPEED], g[law.STILL_FOR_S] = number(0x606F) * units.velocity, 1e-3 * number(0x6070)
        window = number(0x6065)
        g[law.WINDOW] = math.inf if window == NO_WINDOW else window * units.position
        g[law.APART_LIMIT] = math.inf if window == NO_WINDOW else units.apart
        g[law.WINDOW_S] = 1e-3 * number(0x6066)
        g[law.SEARCH_SPEED], g[law.ZERO_SPEED] = number(0x6099, 1) * units.velocity, number(0x6099, 2) * units.velocity
        g[law.HOMING_ACCELERATION] = number(0x609A) * units.velocity
        g[law.RAW_PER_SI], g[law.MILLE_PER_NM] = self._sign / units.position, 1.0 / units.torque
        self._limit(number(0x607D, 1), number(0x607D, 2))
        self.offset_velocity(int(number(0x60B1)))
        g[law.TORQUE_OFFSET] = number(0x60B2) * units.torque

    def _limit(self, low: float, high: float) -> None:
        """Set the software position limits; 0 and 0 mean none."""
        ends = sorted((self.position(low), self.position(high))) if low or high else (-math.inf, math.inf)
        self.g[law.ORIGIN], (self.g[law.LOW], self.g[law.HIGH]) = self.origin, ends

    def position(self, raw: float) -> float:
        """Return the axis position, SI, of a position object's count."""
        return self._sign * raw * self.units.position + self.origin

    @property
    def unit(self) -> float:
        """Return m or rad per count of the position object, with the sign of 0x607E."""
        return self._sign * self.units.position

    def adopt(self, s: Any, g: Any, out: Any) -> None:
        """Move state, settings and counts into this memory."""
        s[:], g[:], out[:] = self.s, self.g, self.out
        self.s, self.g, self.out = s, g, out
        self.state, self.settings = memoryview(s), memoryview(g)

    def home(self, raw: int) -> None:
        """Set the zero so that the present position reads `raw`; call `configure` afterwards, since the limits move
        with it."""
        self.origin = 0.0
        self.origin = self.state[law.POSITION] - self.position(raw)

    # ---- cyclic set-points ----

    def target_position(self, raw: int) -> None:
        """Begin a straight line to a new position target."""
        law.target(self.s, self.unit, self.origin, raw)

    def step_to(self, raw: int) -> float:
        """Return the distance, in counts, from the last target to a new one."""
        return float((self.position(raw) - self.state[law.TARGET]) / self.units.position)

    def target_velocity(self, raw: int) -> None:
        """Set the target velocity from its object's raw value."""
        self.settings[law.TARGET_VELOCITY] = self._velocity(raw)

    def target_torque(self, raw: int) -> None:
        """Set the target torque from ‰."""
        self.settings[law.TARGET_TORQUE] = raw * self.units.torque

    def offset_velocity(self, raw: int) -> None:
        """Set the velocity offset from its object's raw value."""
        self.settings[law.VELOCITY_OFFSET] = self._velocity(raw)

    def offset_torque(self, raw: int) -> None:
        """Set the torque offset from ‰."""
        self.settings[law.TORQUE_OFFSET] = raw * self.units.torque

    def _velocity(self, raw: int) -> float:
        return self._sign * raw * self.units.velocity

    # ---- motions ----

    @property
    def on(self) -> bool:
        """Switch the drive function on: the controller produces torque."""
        return bool(self.settings[law.MODE] != law.OFF)

    def off(self) -> None:
        """Switch the torque off."""
        self.s[[law.POSITION_INTEGRAL, law.VELOCITY_INTEGRAL, law.TORQUE, law.LIMITED, law.EVENTS]] = 0.0
        self.settings[law.MODE] = law.OFF

    def hold(self) -> None:
        """Hold the present position until a target arrives."""
        state = self.state
        state[law.DEMAND] = state[law.TARGET] = state[law.POSITION]
        state[law.FRESH] = state[law.SEGMENT_LEFT_S] = state[law.SEGMENT_VELOCITY] = 0.0
        self._begin(law.FOLLOW)

    def speed(self) -> None:
        """Control velocity; the set-point is 0 until the first target arrives."""
        self.settings[law.TARGET_VELOCITY] = 0.0
        self._begin(law.SPEED)

    def push(self) -> None:
        """Control torque; the set-point is 0 until the first target arrives."""
        self.settings[law.TARGET_TORQUE] = 0.0
        self._begin(law.PUSH)

    def brake(self, deceleration: float) -> None:
        """Decelerate to rest by `deceleration`, velocity units per second."""
        slower = deceleration * self.units.velocity
        state = self.state
        state[law.RAMP] = state[law.VELOCITY]
        state[law.STOP_LEFT_S] = abs(state[law.VELOCITY]) / slower + STOP_MARGIN_S
        self.settings[law.DECELERATION] = slower
        self._begin(law.STOP)

    def tighten(self) -> None:
        """Wind the rope in until the homing preload is reached."""
        self.state[law.START] = self.state[law.POSITION]
        self.state[law.RAMP] = 0.0
        self._begin(law.TIGHTEN)

    def _begin(self, mode: int) -> None:
        self.state[law.STILL_S] = self.state[law.FOLLOWING_S] = self.state[law.POSITION_INTEGRAL] = 0.0
        self.settings[law.MODE] = mode


def _number(values: Mapping[int, Value], index: int, subindex: int = 0) -> float:
    value = values.get(key(index, subindex), 0)
    return 0.0 if isinstance(value, bytes) else float(value)
