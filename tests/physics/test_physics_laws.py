"""The paper's printed and derived figures, and the laws' own identities."""

import math

import numpy as np
import pytest

from physics import laws, path_laws

# Printed to 0.01°, so half a unit of the last place.
ROUNDING_DEG = 0.005


@pytest.mark.parametrize(
    ("percent", "degrees"),
    [(0, -6.91), (10, -25.52), (13, -28.44), (20, -30.47), (30, -24.63), (70, -72.30), (100, -10.10)],
)
def test_knee_angle_eq1(percent: float, degrees: float) -> None:
    assert math.degrees(laws.knee_angle(percent)) == pytest.approx(degrees, abs=ROUNDING_DEG)


def test_knee_angle_least_value_and_open_seam() -> None:
    angles = np.degrees(laws.knee_angle(np.linspace(0.0, 100.0, 10_001)))
    assert angles.min() == pytest.approx(-73.54, abs=ROUNDING_DEG)
    assert math.degrees(laws.knee_angle(0.0, 1)) == pytest.approx(-2.44, abs=ROUNDING_DEG)
    assert math.degrees(laws.knee_angle(100.0, 1)) == pytest.approx(-0.16, abs=ROUNDING_DEG)


@pytest.mark.parametrize("order", [1, 2])
def test_knee_angle_derivative_is_the_derivative(order: int) -> None:
    h = 1e-3
    t = np.linspace(1.0, 99.0, 50)
    difference = (laws.knee_angle(t + h, order - 1) - laws.knee_angle(t - h, order - 1)) / (2 * h)
    # central difference: h²/6·θ''' < 1e-9 rad
    np.testing.assert_allclose(laws.knee_angle(t, order), difference, atol=1e-8)


@pytest.mark.parametrize("peak", [40.0, 50.0, 60.0])
def test_desired_force_eq2(peak: float) -> None:
    t = np.array([0.0, 9.999, 10.0, 15.0, 20.0, 25.0, 29.9999, 30.0, 70.0])
    expected = peak * np.array([0, 0, 0, math.sqrt(0.5), 1, math.sqrt(0.5), 0, 0, 0])
    np.testing.assert_allclose(laws.desired_force(t, peak), expected, atol=2e-3)
    assert laws.desired_force(20.0, peak) == peak


def test_losses_are_those_of_a_capstan_and_turn_with_the_motion() -> None:
    for loss in (laws.cable_loss, laws.fabric_loss):
        for way in (-0.1, 0.0, 0.1):
            held = path_laws.capstan(40.0, 0.157 * math.copysign(1.0, way) if way else 0.0)
            assert 40.0 + loss(40.0, 0.157, way) == pytest.approx(held, rel=1e-14)


def test_losses_added_drop_the_product_term() -> None:
    series = laws.series_input(1.0, 0.157, 1.0, 0.1, 1.0)
    added = 1.0 + laws.cable_loss(1.0, 0.157, 1.0) + laws.fabric_loss(1.0, 0.1, 1.0)
    assert series - added == pytest.approx(0.018, abs=0.0005)
    assert series == pytest.approx(path_laws.capstan(path_laws.capstan(1.0, 0.1), 0.157), rel=1e-14)


@pytest.mark.parametrize(("force", "mm"), [(20.0, 15.02), (40.0, 18.98), (60.0, 21.58)])
def test_stiffness_eq10(force: float, mm: float) -> None:
    assert laws.stiffness_displacement(force) == pytest.approx(mm * 1e-3, abs=1e-12)


def test_swing_eq11_and_the_zeros_that_differ() -> None:
    at_fit = laws.knee_angle(13.0)
    assert laws.swing_displacement(at_fit) == pytest.approx(2.09e-3, abs=0.005e-3)
    turned = laws.swing_displacement(at_fit + math.radians(1.0)) - laws.swing_displacement(at_fit)
    assert turned == pytest.approx(0.706e-3, abs=1e-12)
