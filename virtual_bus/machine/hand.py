"""Hands at a simulated bench: one that moves a joint without a drive, one that does a set-up check.

The hand is no node. It reads the asked angle from the master's frame of targets, as an operator reads a display. It
follows with a first-order lag, and pushes the joint with the gains of a knee drive's position loop.
"""

import math
from collections.abc import Mapping
from typing import Final

from eds.bench.bench_network import WireLayout
from eds.cia301 import Frame
from parameters import InputError
from physics.drive_loops import DRIVE_TICK_NS, KNEE_GAINS, loop, loop_state
from virtual_bus.wire.station import Station

CHECK_LAG_S: Final = 0.2
"""Time constant of the hand that moves a knee to a goniometer's angle, s: 60 degrees at no more than 5 rad/s."""
HOLDS: Final = ("start_n", "end_n", "knee_rad")
PLACE: Final = 1
"""Index of the requested angle in the frame of targets."""


class Hand(Station):
    """Listens to the asked angle and gives the torque, N·m, at every drive tick; before the first frame it holds.

    `lag_s`: time constant of the lag behind the asked angle, s.
    """

    def __init__(self, wire: WireLayout, lag_s: float) -> None:
        super().__init__("hand", self._read, filters=frozenset({wire.targets.cob_id}), listen_only=True)
        self._plan = wire.targets
        self._asked_rad: float | None = None
        self._led_rad: float | None = None
        self._share = 1.0 - math.exp(-DRIVE_TICK_NS * 1e-9 / lag_s) if lag_s > 0.0 else 1.0
        self._state, self._gains = loop_state(), KNEE_GAINS.vector()

    def _read(self, frame: Frame, now_ns: int) -> None:
        if len(frame.data) >= self._plan.size:
            self._asked_rad = self._plan.unpack_si(frame.data)[PLACE]

    def push(self, angle_rad: float, speed_rad_s: float) -> float:
        """Return the torque at the joint, N·m, that leads it to the asked angle; called once in `DRIVE_TICK_NS`."""
        if self._led_rad is None:
            self._led_rad = angle_rad
        if self._asked_rad is not None:
            self._led_rad += self._share * (self._asked_rad - self._led_rad)
        return float(loop(self._state, self._gains, angle_rad, speed_rad_s, self._led_rad, 0.0, DRIVE_TICK_NS * 1e-9))


class CheckingHand:
    """Hand of a set-up check: hangs weights, N, on the load cells, or holds the leg at an angle, rad, by a goniometer.

    It measures the leg itself and never a device. `weights` are in the order of START and END.
    """

    def __init__(self, does: Mapping[str, float]) -> None:
        for name in does:
            if name not in HOLDS:
                raise InputError(f"hand: {name} is nothing that it does; expected one of {', '.join(HOLDS)}.")
        self.weights = does.get("start_n", 0.0), does.get("end_n", 0.0)
        self._angle_rad = does.get("knee_rad")
        self._led_rad: float | None = None
        self._share = 1.0 - math.exp(-DRIVE_TICK_NS * 1e-9 / CHECK_LAG_S)
        self._state, self._gains = loop_state(), KNEE_GAINS.vector()

    @property
    def leads(self) -> bool:
        """Return whether the hand holds the leg at an angle."""
        return self._angle_rad is not None

    def push(self, angle_rad: float, speed_rad_s: float) -> float:
        """Return the torque at the joint, N·m; called once in `DRIVE_TICK_NS`."""
        if self._angle_rad is None:
            return 0.0
        led = angle_rad if self._led_rad is None else self._led_rad
        self._led_rad = led + self._share * (self._angle_rad - led)
        return float(loop(self._state, self._gains, angle_rad, speed_rad_s, self._led_rad, 0.0, DRIVE_TICK_NS * 1e-9))
