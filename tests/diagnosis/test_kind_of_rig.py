"""`fit` and `diagnose` take the same files for the same bench or rig, by `path_model.is_of_bench`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import pytest

from diagnosis.finder import Finder
from estimation import bench_fit
from estimation.data.table import Table, table
from estimation.path_model import can_be_of_bench
from estimation.rig_model import RigModel
from tests.diagnosis import rigs
from tests.diagnosis.test_rig_evidence import by_voltage, numbered, on_a_cam, seal

Columns = dict[str, np.ndarray]


def without(columns: Columns, *names: str) -> Columns:
    return {name: values for name, values in columns.items() if name not in names}


def arm(seed: int) -> Table:
    return table("arm", rigs.two_link_arm(seed), joint="elbow")


KINDS: Final[dict[str, Callable[[int], Table]]] = {
    "cable between two load cells": lambda k: table("cable", rigs.cable(k)),
    "cable, paid out where the position grows": lambda k: table("cable", {
        **(made := rigs.cable(k)), "servo_position_m": -made["servo_position_m"]}),
    "seal between two forces": lambda k: seal(numbered(k)),
    "rod on a cam": on_a_cam,
    "seal with force at one end": lambda k: table("seal", rigs.seal(k)),
    "drive axis": lambda k: table("axis", rigs.drive_axis(k)),
    "pendulum": lambda k: table("pendulum", rigs.pendulum(k)),
    "motor at steady speeds": lambda k: table("motor", rigs.motor(k)),
    "motor by its voltage": by_voltage,
    "joint of an arm": arm,
    "series-elastic actuator": lambda k: table("elastic", rigs.series_elastic(k)),
    "spring with its joint locked": lambda k: table("elastic", without(
        rigs.series_elastic(k, locked=True), "knee_angle_rad", "tension_start_n")),
}
"""A trial of each kind by its number; none is of a rope over a knee."""


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", KINDS)
def test_fit_and_diagnose_take_a_rig_for_the_same(kind: str) -> None:
    trials = [KINDS[kind](number) for number in (1, 2)]
    assert bench_fit.fit(trials).rig is not None
    finder = Finder().examine(trials)
    core = finder._core([KINDS[kind](3)])
    assert isinstance(core.model, RigModel)


def test_a_cable_without_a_knee_is_no_bench_and_a_locked_knee_or_an_own_experiment_is() -> None:
    plain = rigs.cable(1)
    locked = {**plain, "knee_angle_rad": np.full_like(plain["time_s"], -0.4)}
    assert not can_be_of_bench([table("cable", plain)])
    assert can_be_of_bench([table("bench", locked)])
    assert can_be_of_bench([table("bench", without(plain, "tension_end_n"))])
