"""The plant that docs/plants.md shows runs as it stands."""

import re
from pathlib import Path

from physics.drive_loops import DRIVE_TICK_NS, KNEE_GAINS, SERVO_GAINS, loop, loop_state
from physics.plant.bench_plant import Outputs

PAGE = Path(__file__).parents[2] / "docs" / "plants.md"


def test_the_plant_on_the_page_runs_behind_the_loops() -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    space: dict[str, object] = {}
    exec(compile(blocks[-1], str(PAGE), "exec"), space)
    plant = space["create"]({"stiffness_scale": 1.0}, 0)  # type: ignore[operator]
    seen = plant.reset(0)
    servo, knee = loop_state(), loop_state()
    for k in range(1, 4001):
        pull = loop(servo, SERVO_GAINS.vector(), seen.servo_position_m, seen.servo_velocity_m_s, 0.035, 0.0, 250e-6)
        hold = loop(knee, KNEE_GAINS.vector(), seen.knee_motor_rad, seen.knee_motor_rad_s, 0.0, 0.0, 250e-6)
        seen = plant.advance(k * DRIVE_TICK_NS, pull, hold)
    assert isinstance(seen, Outputs)
    assert 25.0 < seen.end_n < 40.0
    assert plant.truth()["true_end_n"] == seen.end_n
