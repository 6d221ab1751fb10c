"""Card of a law: its terms, errors on held-out cycles, and the residual against the variable of each term."""

from collections.abc import Mapping
from typing import Final

from diagnosis.laws.law_result import Laws, Picture
from diagnosis.report.headline import law_sentences
from diagnosis.report.plots import AFTER, BEFORE
from trial.report.page import NamedText, Page
from trial.report.plot import Plot, Series
from trial.report.words import display_unit, words

AXES: Final[Mapping[str, tuple[str, str]]] = {
    "time_s": ("time", "s"), "position_m": ("rope position", "m"), "speed_m_s": ("rope speed", "m/s"),
    "tension_n": ("tension of the model", "N"), "knee_rad": ("knee angle", "rad"), "phase": ("gait phase", "1")}
"""Name and unit of each variable that a term may depend on."""


def section(page: Page, laws: Laws) -> None:
    """Add the card of the law that was sought beyond the catalogue."""
    page.section("A law beyond the catalogue")
    for sentence in law_sentences(laws):
        page.text(sentence)
    if laws.terms:
        page.table(("signal", "unit", "reference", "session adapted", "with the law", "gain (%)", "95 % low", "high"), [
            (NamedText(words(name), name), f.unit, f.rmse_before, f.rmse_session, f.rmse_after, f.gain_percent, f.low,
             f.high) for name, f in laws.errors.items()])
    for picture in laws.pictures:
        page.plot(term_plot(picture))


def term_plot(picture: Picture) -> Plot:
    """Return the mean residual without a term, and the term, over the variable that it depends on."""
    axis, si = AXES[picture.variable]
    unit, factor = display_unit(si)
    at, residual, term = picture.means()
    return Plot(f"{words(picture.output)}: residual over {axis}", factor * at, [
        Series("measured less model without the term", residual, BEFORE, width=2.2, tip=picture.output),
        Series("the term", term, AFTER, width=2.2, tip=picture.output)], f"{axis} ({unit})", picture.unit, height=280)
