"""Every controller against a walk that was kept: a changed step is seen, wherever it comes from.

A controller that was changed on purpose: `python tests/replay/golden.py`, and look at what the goldens' change says.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bowden.replay.onto_controller import OUTPUTS, step_again, walked
from bowden.trials.recorded import experiment
from master.control.controller import CONTROLLERS
from trial import read

FOLDER = Path(__file__).parent / "golden"
TOLERANCE = 1e-9
"""Relative, and absolute in SI: exp, sin and FFT of another processor or library differ in their last bits, and what a
controller remembers adds them up; a count on the wire is 1e-6 m."""


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_every_controller_makes_the_steps_that_were_kept(controller: str) -> None:
    kept = read.open(FOLDER / f"{controller}.mcap")
    again = step_again(kept, experiment(kept))
    rows = walked(kept)
    assert len(again.made) == len(rows) > 2 * 120
    payloads = [row["data"][:row["dlc"]].tobytes() for row in kept.frames]
    different = [i for i, (then, now) in enumerate(zip(payloads, again.frames, strict=True)) if then != now]
    assert not different, f"row {different[0]}: frame {payloads[different[0]].hex(' ')} is now " \
                          f"{again.frames[different[0]].hex(' ')}"
    for name, column in zip(OUTPUTS, np.array(again.made).T, strict=True):
        assert name in kept.columns, f"{name} is new: make the goldens again"
        np.testing.assert_allclose(column, kept.columns[name][rows.start:rows.stop], rtol=TOLERANCE, atol=TOLERANCE,
                                   err_msg=name)


def test_the_goldens_are_of_different_controllers() -> None:
    targets = {name: read.open(FOLDER / f"{name}.mcap").columns["servo_target_m"] for name in CONTROLLERS}
    for name, column in targets.items():
        assert all(not np.array_equal(column, other) for one, other in targets.items() if one != name)
