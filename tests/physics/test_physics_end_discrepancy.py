"""The discrepancy START → END: its file, its shrinkage, its ranges, and what it changes of a controller."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from parameters import InputError
from physics import bench_model, calibration, end_discrepancy
from physics.end_discrepancy import COUNT, EndDiscrepancy

SLID = (1.0,) * len(end_discrepancy.UNTURNED)
MEAN = (0.2, 0.1, -0.3, *(0.0,) * (COUNT - 3))


def known(sigma: float) -> EndDiscrepancy:
    """Return a discrepancy whose coefficients all have one standard deviation."""
    covariance = tuple(tuple(row) for row in (sigma**2 * np.eye(COUNT)).tolist())
    return EndDiscrepancy(MEAN, covariance, (5.0, 60.0), (0.2, 0.6), 0.2, 0.05, 0.01)


def at(table: EndDiscrepancy, force: float = 40.0, knee: float = -0.4, moved: float = 1e-5) -> tuple[float, float]:
    """Return the discrepancy with sheath and fabric sliding."""
    before, after = (0.99, 0.99, 0.0, 0.0, 0.0, 0.0), (1.0, 1.0, moved, moved, 0.0, 0.0)
    value, sigma, _slips = end_discrepancy.evaluate(
        table.packed(1e-3, 1e-4, 1e-4), SLID, force, knee, before, after, 0.0, 0.0)
    return float(value), float(sigma)


def test_a_known_discrepancy_is_the_posterior_mean_and_an_unknown_one_is_shrunk() -> None:
    assert at(known(1e-6))[0] == pytest.approx(-0.1, rel=1e-3)
    shrunk, sigma = at(known(0.1))
    assert sigma == pytest.approx(math.sqrt(0.1**2 * (3.0 + 0.05**2) + 0.01**2), rel=1e-3)
    assert shrunk == pytest.approx(-0.1 / 4.0, rel=0.01)


def test_outside_of_the_ranges_seen_it_is_zero_and_as_unknown_as_before_the_fit() -> None:
    table = known(1e-6)
    assert at(table)[1] == pytest.approx(0.01, rel=1e-3)
    for away in ({"force": 75.0}, {"knee": -1.0}, {"knee": 0.0}, {"moved": 1e-3}):
        value, sigma = at(table, **away)
        assert value == 0.0
        assert sigma > 0.05 * math.sqrt(3.0)
    force = 60.0 + 0.5 * end_discrepancy.BEYOND * 55.0
    whole = MEAN[0] + MEAN[1] * (force / 40.0 - 1.0) + MEAN[2]
    assert at(table, force=force)[0] == pytest.approx(0.5 * whole, rel=1e-2)


def test_a_calibration_with_a_discrepancy_is_read_back_and_one_without_opens(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    made = dataclasses.replace(calibration.nominal(), discrepancy=known(0.01), label=str(path))
    path.write_text(calibration.write(made), encoding="utf-8")
    assert calibration.read(path).discrepancy == known(0.01)
    assert bench_model.read(path).calibration.discrepancy == known(0.01)
    assert bench_model.read(path).text() == path.read_text(encoding="utf-8")
    path.write_text(calibration.write(calibration.nominal()), encoding="utf-8")
    assert "discrepancy" not in path.read_text(encoding="utf-8")
    assert calibration.read(path).discrepancy is None


@pytest.mark.parametrize(("was", "becomes", "says"), [
    ("mean = [0.2", "mean = [nan", "mean"), ("force_n = [5.0, 60.0]", "force_n = [5.0]", "force_n"),
    ('"level"', '"levels"', "features"), ("residual = 0.01", "residual = true", "residual"),
    ("covariance = [[0.0001", "covariance = [[-0.0001", "negative eigenvalue")])
def test_a_wrong_discrepancy_is_refused_by_file_and_key(tmp_path: Path, was: str, becomes: str, says: str) -> None:
    path = tmp_path / "own.toml"
    text = calibration.write(dataclasses.replace(calibration.nominal(), discrepancy=known(0.01)))
    assert was in text
    path.write_text(text.replace(was, becomes), encoding="utf-8")
    with pytest.raises(InputError, match=rf"own\.toml.*{says}.*identify again"):
        calibration.read(path)
