"""What healthy trials teach: what like benches have in common, not where each one of them stands."""

from __future__ import annotations

import dataclasses

from threadpoolctl import threadpool_limits

from diagnosis.data import table
from diagnosis.setting import Setting, settle
from tests.hidden.bench import Bench
from tests.hidden.walk import trial

BENCH = Bench(drive_coulomb=1.0, drive_viscous=10.0, drive_inertia=2.5)
ZERO_M = 2e-4


def learnt(*zeros: float) -> Setting:
    """What healthy benches teach that differ in the encoder's zero alone."""
    walked = [trial(dataclasses.replace(BENCH, zero=zero), seed=i, cycles=4) for i, zero in enumerate((0.0, *zeros))]
    first, *rest = [table(f"{i}.csv", columns) for i, columns in enumerate(walked)]
    with threadpool_limits(1, user_api="blas"):
        return settle([first], rest, None)


def test_benches_that_differ_raise_no_floor() -> None:
    alike, apart = learnt(0.0, 0.0), learnt(ZERO_M, -ZERO_M)
    assert alike.floors is not None
    assert apart.floors is not None
    for name in ("friction", "elasticity", "kinematics"):
        # two like benches fitted as one would leave 0.2 mm: 0.005 rad, and some 0.7 N
        assert apart.floors[name] < 1.3 * alike.floors[name]
