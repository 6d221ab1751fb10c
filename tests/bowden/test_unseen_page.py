"""docs/unseen.md: what its table says, and the benches of the last run apart from those that were developed with."""

from __future__ import annotations

from pathlib import Path

from benchmarks import family_page, family_walks
from tests.plants.draws import set_aside

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_in_the_docs_is_what_its_table_says() -> None:
    text = family_page.page(list(family_walks.read(DOCS / "unseen.csv").values()))
    assert (DOCS / "unseen.md").read_text(encoding="utf-8") == text


def test_nothing_is_developed_on_a_serial_that_is_set_aside() -> None:
    assert not any(map(set_aside, family_walks.DEVELOPMENT))
    assert all(map(set_aside, family_walks.SET_ASIDE))
    assert len(family_walks.SET_ASIDE) + len(family_walks.DEVELOPMENT) >= 40


def test_the_loaded_part_leaves_out_what_end_is_at_idle() -> None:
    """Three quarters of the squares at idle: of a whole RMSE of 2 % one is loaded; of another's √7 % it is 2 %."""
    walk = {family_walks.TRUE: 2.0, family_walks.WINDOW: (1.0 / family_page.LOADED) ** 0.5, "paper": 7.0**0.5}
    assert family_page.loaded(walk) == 1.0
    assert abs(family_page.loaded(walk, "paper") - 2.0) < 1e-12
