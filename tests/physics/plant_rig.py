"""A plant with its two drives closed around it in plain calls, for tests that need no bus."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from physics import laws
from physics.drive_loops import DRIVE_TICK_NS, KNEE_GAINS, SERVO_GAINS, loop, loop_state
from physics.plant.bench_plant import BowdenPlant, Outputs, create

TICK_S = DRIVE_TICK_NS * 1e-9
FIT_KNEE = float(laws.knee_angle(13.0))
Target = Callable[[float], tuple[float, float]]


class Rig:
    """Servo and knee drive hold their targets; `run` records one row of `Outputs` and the truth a tick."""

    def __init__(self, knee_rad: float = FIT_KNEE, slack_m: float = 0.0, **parameters: float) -> None:
        self.plant: BowdenPlant = create(
            {"start_knee_rad": knee_rad, "start_slack_m": slack_m, **parameters}, 0)
        self.seen: Outputs = self.plant.reset(0)
        self.now_ns = 0
        self.rope, self.knee = self.seen.servo_position_m, knee_rad
        self._servo, self._held = loop_state(), loop_state()
        self._gains = SERVO_GAINS.vector(), KNEE_GAINS.vector()

    def run(self, seconds: float, rope_m_s: float = 0.0, knee_rad_s: float = 0.0) -> np.ndarray:
        """Move both targets at constant speed; return columns of `Outputs`, then true END."""
        rows = []
        for _ in range(round(seconds / TICK_S)):
            self.rope += rope_m_s * TICK_S
            self.knee += knee_rad_s * TICK_S
            self.tick(rope_m_s, knee_rad_s)
            rows.append((*self.seen, self.plant.truth()["true_end_n"]))
        return np.array(rows)

    def tick(self, rope_m_s: float = 0.0, knee_rad_s: float = 0.0) -> None:
        """Advance by one drive tick towards the present targets."""
        seen = self.seen
        torque = loop(
            self._servo, self._gains[0], seen.servo_position_m, seen.servo_velocity_m_s, self.rope, rope_m_s, TICK_S)
        hold = loop(
            self._held, self._gains[1], seen.knee_motor_rad, seen.knee_motor_rad_s, self.knee, knee_rad_s, TICK_S)
        self.now_ns += DRIVE_TICK_NS
        self.seen = self.plant.advance(self.now_ns, torque, hold)

    def pull_to(self, start_n: float, rope_m_s: float) -> np.ndarray:
        """Move the rope at constant speed until START reaches `start_n`; same columns as `run`."""
        rows = []
        while (self.seen.start_n < start_n) == (rope_m_s > 0.0):
            rows.append(self.run(TICK_S, rope_m_s)[0])
            assert len(rows) < 40_000
        return np.array(rows)
