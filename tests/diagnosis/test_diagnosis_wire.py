"""Values that are late, lost or coarse are told from the columns alone, and healthy ones are left in peace."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis import wire_faults
from estimation.data.table import Table, table
from physics import sampling_laws
from physics.sampling_laws import Staleness

CYCLES = 12_000


def carried(seed: int, share: float = 0.0, most: int | None = None, step: float = 0.01, ages: bool = False) -> Table:
    """Tension at both ends as a master sees it when a share of the values comes `most` cycles late, or never."""
    rng = np.random.default_rng(seed)
    k = np.arange(CYCLES)
    columns: dict[str, np.ndarray] = {"time_s": k * 1e-3}
    for name in ("start", "end"):
        true = 20.0 + 15.0 * np.sin(2.0 * np.pi * k / 1300.0) + rng.normal(0.0, 0.15, k.size)
        true = np.round(true / step) * step
        arrival = np.where(rng.random(k.size) < share, CYCLES if most is None else k + most, k)
        newest = np.zeros(k.size, dtype=np.intp)
        np.maximum.at(newest, arrival[arrival < CYCLES], k[arrival < CYCLES])
        newest = np.maximum.accumulate(newest)
        columns[f"tension_{name}_n"] = true[newest]
        if ages:
            columns[f"{name}_pdo_age_ns"] = (k - newest) * 1e6
    return table("carried", columns)


@pytest.mark.parametrize("ages", [False, True])
@pytest.mark.parametrize("share", [0.03, 0.15])
def test_lost_values_are_told_and_cannot_be_told_from_values_that_come_much_later(share: float, ages: bool) -> None:
    told = wire_faults.examine([carried(1, share, ages=ages)], [carried(2)]).faults
    assert [t.effect.name for t in told] == ["lost_pdo", "late_pdo"]
    # four standard deviations of a share of 24 000 values are 0.01
    assert told[0].values["lost_share"] == pytest.approx(share, abs=0.012)


# repeats alone: what comes one cycle late with p and with 1 − p looks the same, so one cycle is asked with ages
@pytest.mark.parametrize(("most", "ages"), [(1, True), (3, True), (3, False)])
def test_late_values_are_told_with_their_delay(most: int, ages: bool) -> None:
    found = wire_faults.examine([carried(1, 0.4, most, ages=ages)], [carried(2)])
    assert [t.effect.name for t in found.faults] == ["late_pdo"]
    late = found.causes()[0]["parameters"]
    assert late["late"]["value"] == pytest.approx(1e-3 * most)
    assert late["late_share"]["value"] == pytest.approx(0.4, abs=0.02)


def test_a_coarse_grid_is_told_with_its_step_and_is_not_taken_for_lost_values() -> None:
    found = wire_faults.examine([carried(1, step=0.8)], [carried(2)])
    assert [t.effect.name for t in found.faults] == ["quantisation"]
    assert found.causes()[0]["parameters"]["quantum"]["value"] == pytest.approx(0.8)
    assert found.figures["start_sensor"].rmse_before == pytest.approx(0.8 / np.sqrt(12.0))


def test_healthy_values_are_left_in_peace() -> None:
    assert wire_faults.examine([carried(1)], [carried(2), carried(3)]).faults == []


def test_the_law_of_ages_counts_every_value_once() -> None:
    for law in (Staleness(0.3, 4), Staleness(0.1, np.inf)):
        assert sampling_laws.ages(law).sum() == pytest.approx(1.0)
        # what chance adds to the oldest runs is cut off
        assert sampling_laws.repeats(law, 0.02).sum() == pytest.approx(1.0, abs=1e-9)
