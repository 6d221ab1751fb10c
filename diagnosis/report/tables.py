"""What a diagnosis' page tells in tables: relations, the class, what was tried, what could have been seen.

The rule of this file: figures as the diagnosis gives them, each with its unit, and what was decided by them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from diagnosis.finder import Diagnosis
from diagnosis.judgement.verdict import RIVAL_GAIN, RIVAL_RMSE, SPLIT_GAIN, SPLIT_RMSE
from diagnosis.search.search import Found, Model
from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS
from trial.report.page import Cell, Page

MODELS_SHOWN: Final = 40


def relations(page: Page, found: Diagnosis) -> None:
    """Tell every relation, those that could not be checked with a dash."""
    page.heading("Relations, root mean square on cycles that no fit has seen")
    page.table(("relation", "unit", "healthy floor", "before", "after", "gain (%)", "95 % low", "high",
                "held-out before", "after"), [_figures(name, f) for name, f in found.relations.items()])
    page.text("The healthy floor is what healthy trials leave (a dash: none was given). Held-out trials are fitted by "
              "nothing.", "note")


def _figures(name: str, f: Any) -> tuple[Cell, ...]:
    if not f.checked:
        return (name, f.unit, *[None] * 8)
    return (name, f.unit, f.floor, f.rmse_before, f.rmse_after, f.gain_percent, f.low, f.high, f.holdout_before,
            f.holdout_after)


def rivals(page: Page, found: Diagnosis) -> None:
    """Tell what these data cannot tell apart."""
    chosen = {c["effect"] for c in found.causes}
    if len(found.rivals) <= len(chosen):
        return
    page.heading("The class: what these data cannot tell apart")
    page.table(("effect", "what it means", "experiment that would tell", "what to look at"), [
        (name + (" (chosen)" if name in chosen else ""), CATALOGUE[name].words,
         EXPERIMENTS[CATALOGUE[name].experiment].motion, EXPERIMENTS[CATALOGUE[name].experiment].reads)
        for name in found.rivals])


def ranking(page: Page, found: Diagnosis) -> None:
    """Tell every model that was fitted, what it gains, and why it was not chosen."""
    page.section("What was tried")
    if found.found is None:
        page.text("Nothing was fitted.", "note")
        return
    tried, base, best = found.found.models, found.found.baseline, found.found.best
    whole = base.score - best.score
    gain, rmse = (SPLIT_GAIN, SPLIT_RMSE) if found.split else (RIVAL_GAIN, RIVAL_RMSE)
    page.text(f"{len(tried)} models were fitted in full, each judged on cycles it was not fitted on. 100 % is what the "
              f"chosen model gains over the simulation as it was; a model of as many effects is a rival from "
              f"{100.0 * gain:g} % on and within {100.0 * rmse:g} % of its unseen RMSE.", "note")
    rows: list[tuple[Cell, ...]] = []
    for model in sorted(tried[:MODELS_SHOWN], key=lambda m: m.rank):
        share = 100.0 * (base.score - model.score) / whole if whole > 0.0 else None
        behind = 100.0 * (math.sqrt(max(model.score, 0.0) / best.score) - 1.0) if best.score > 0.0 else None
        rows.append((" + ".join(model.names) or "as simulated", _why(model, found.found, found.rivals), share, behind,
                     model.score))
    page.table(("model", "judged", "share of the gain (%)", "RMSE above (%)", "χ², unseen cycles"),
               rows, tall=len(rows) > 15)


def _why(model: Model, found: Found, rivals: list[str]) -> str:
    mine, chosen = set(model.names), set(found.best.names)
    if mine == chosen:
        return "chosen"
    if not mine:
        return "the simulation as it was"
    if chosen < mine:
        return "rejected: what it adds does not pay"
    if len(mine) == len(chosen) and mine - chosen <= set(rivals):
        return "in the class: not to be told from the chosen"
    return "rejected: leaves more" if model.score > found.best.score else "rejected: needs more effects than it gains"


def limits(page: Page, found: Diagnosis) -> None:
    """Tell the smallest size of each effect that these data could have shown."""
    page.section("Detection limit")
    if not found.detection_limit:
        page.text("Not available: this rig's healthy state is not known, or nothing was searched.", "note")
        return
    page.text("The smallest departure from the healthy value that these trials would have shown; below it an effect "
              "may be there and not be named.", "note")
    rows = [_limit(name, one) for name, one in found.detection_limit.items() if isinstance(one, Mapping)]
    page.table(("effect", "parameter", "smallest", "unit", "likely range", "would be seen"), rows, tall=len(rows) > 15)


def _limit(name: str, one: Mapping[str, Any]) -> tuple[Cell, ...]:
    parameter = next((p for p in CATALOGUE[name].parameters if p.name == one["parameter"]), None)
    likely = "" if parameter is None else f"{parameter.likely[0]:.3g} … {parameter.likely[1]:.3g}"
    return (name, one["parameter"], one["value"], one["unit"], likely, _seen(one["value"], parameter))


def _seen(smallest: float | None, parameter: Any) -> str:
    """Say whether the likely sizes lie above the limit."""
    if smallest is None or parameter is None:
        return "no"
    low, high = parameter.likely
    if parameter.neutral is None or low < parameter.neutral < high:
        least, most = 0.0, high - low
    else:
        least, most = sorted(abs(end - parameter.neutral) for end in parameter.likely)
    return "yes" if smallest <= least else "the larger ones" if smallest < most else "no"
