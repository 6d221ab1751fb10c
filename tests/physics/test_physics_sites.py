"""Sites of the effects: each is described once, and each but the bus is a part of the drawing of the bench."""

from __future__ import annotations

from physics.effects.carriers import SITES
from physics.effects.catalogue import CATALOGUE
from trial.report.bench_drawing import BENCH


def test_every_site_is_described_and_drawn() -> None:
    assert {effect.site for effect in CATALOGUE.values()} == set(SITES)
    assert set(SITES) - {"bus"} == {site for part in BENCH for site in part.sites}
    assert all(site.to_do.endswith(".") and not site.place.endswith(".") for site in SITES.values())
