"""The stretch over force: (10) where nothing departs from it, other shapes by two terms more, and its inverse."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from physics import inverse, laws, stretch
from physics.calibration import nominal

FORCE = np.linspace(0.0, 60.0, 121)


def test_without_departure_it_is_ten() -> None:
    np.testing.assert_allclose(stretch.position(nominal(), FORCE), laws.stiffness_displacement(FORCE), atol=1e-15)


def test_the_parabola_of_a_stretch_that_departs_is_still_the_nearest() -> None:
    """(10) keeps its meaning: a least-squares parabola over 0…60 N finds a, b and c."""
    of = dataclasses.replace(nominal(), stretch_short=3e-4, stretch_wide=-1e-4)
    force = np.linspace(0.0, stretch.FITTED_N, 601)
    found = np.polyfit(force, stretch.position(of, force), 2)
    np.testing.assert_allclose(found, (of.stiffness_a, of.stiffness_b, of.rope_zero), rtol=1e-6)


@pytest.mark.parametrize("shape", [
    lambda f: 14e-3 * (1.0 - np.exp(-f / 45.0)), lambda f: 2e-3 * np.sqrt(f),
    lambda f: 3e-3 * (1.0 - np.exp(-f / 5.0)) + 1e-4 * f, lambda f: 3e-4 * f - 1.7e-6 * f**2])
def test_five_scalars_hold_the_shapes_of_a_strap(shape) -> None:  # type: ignore[no-untyped-def]
    """Exponential, root, toe and line, parabola: within 0.12 mm over 2…60 N."""
    force = np.linspace(2.0, 60.0, 200)
    columns = np.column_stack([np.ones_like(force), force, force**2, *(
        stretch.saturating(force, scale) for scale in (stretch.SHORT_N, stretch.WIDE_N))])
    found = np.linalg.lstsq(columns, shape(force), rcond=None)[0]
    assert np.abs(columns @ found - shape(force)).max() < 1.2e-4


def test_newton_undoes_the_stretch_also_beyond_what_was_identified() -> None:
    law = inverse.law(dataclasses.replace(
        nominal(), stretch_short=3e-4, stretch_wide=1e-4, identified_to=70.0), 1e-3)
    for force in (0.5, 5.0, 30.0, 69.0, 90.0):
        whole, slope = inverse.elongation(law, force)
        assert slope > 0.0
        assert inverse.tensed(law, whole, 1.0) == pytest.approx(force, abs=1e-6)
        assert inverse.tensed(law, whole, 100.0) == pytest.approx(force, abs=1e-6)
    assert inverse.tensed(law, -1e-3, 10.0) == 0.0
