"""Complete control cycles change nothing: files, outcomes and times are those of event by event, to the byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from physics.plant.bench_plant import BowdenPlant, Outputs, create
from tests.virtual_bus.steady_cases import CASES, Case, ran
from virtual_bus.compiled.compiled_cycles import SWITCH

FEW = {"lost inputs"}
"""Cases whose faults strike all the time: their cycles are run event by event."""

SHORT = ("gait", "script", "lost inputs", "two faults far apart", "deaf", "stop while the knee moves")
"""Cases of `make test`: each way into and out of compiled cycles; further faults, rates and models are exhaustive."""


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in SHORT else pytest.mark.exhaustive)
                                  for name in CASES])
def test_every_byte_is_the_same(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    for switch in ("1", "0"):
        monkeypatch.setenv(SWITCH, switch)
        (tmp_path / switch).mkdir()
        made.append(ran(CASES[name], tmp_path / switch))
    on, off = made
    assert on.digest == off.digest
    assert on.reason == off.reason
    assert off.complete_cycles == 0
    assert on.complete_cycles > 100 or name in FEW


class Plugged:
    """A plant of somebody else: not compiled into the cycle."""

    def __init__(self, plant: BowdenPlant) -> None:
        self.reset, self.truth, self._plant = plant.reset, plant.truth, plant

    def advance(self, until_ns: int, servo_torque_nm: float, knee_torque_nm: float) -> Outputs:
        return self._plant.advance(until_ns, servo_torque_nm, knee_torque_nm)


def plugged(parameters: dict[str, float], seed: int) -> Plugged:
    return Plugged(create(parameters, seed))


def test_a_plant_that_is_plugged_in_runs_event_by_event(tmp_path: Path) -> None:
    script = {30: lambda exchange: None}
    (tmp_path / "own").mkdir()
    (tmp_path / "other").mkdir()
    own = ran(Case(script=script, cycles=60), tmp_path / "own")
    other = ran(Case({"plant": f"{__name__}:plugged"}, script=script, cycles=60), tmp_path / "other")
    assert own.complete_cycles > 0 == other.complete_cycles
    assert own.reason is other.reason is None
