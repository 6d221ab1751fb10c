"""Tables of the page of a diagnosis: errors, ambiguity set, fitted models and detection limits.

Figures are those of the diagnosis, each with its unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from diagnosis.evidence.decision import NAMED_NATS, SET_SHARE
from diagnosis.findings import Findings
from diagnosis.judgement.verdict import BENT, LEAST_FALL, RIVAL_GAIN, RIVAL_RMSE, STRUCTURE
from diagnosis.report.headline import healthy_value
from diagnosis.search.search import FittedEffects, SearchResult
from physics.effects.catalogue import CATALOGUE
from physics.effects.hypotheses import HYPOTHESES
from physics.effects.separating_experiments import EXPERIMENTS
from trial.report.page import Cell, Page

MODELS_SHOWN: Final = 40
"""Largest number of fitted models in the table."""


def relations(page: Page, found: Findings) -> None:
    """Add the table of errors by checked prediction equation; without gains if the causes are only candidates."""
    page.heading("Root mean square on cycles that no fit has seen")
    name = "signal" if found.evidence else "relation"
    checked = {key: f for key, f in found.relations.items() if f.checked}
    if found.candidates:
        page.table((name, "unit", "healthy floor", "simulated on the nominal calibration"),
                   [(key, f.unit, f.floor, f.rmse_before) for key, f in checked.items()])
        return
    page.table((name, "unit", "healthy floor", "before", "after", "gain (%)", "95 % low", "high", "held-out before",
                "after"), [(key, f.unit, f.floor, f.rmse_before, f.rmse_after, f.gain_percent, f.low, f.high,
                            f.holdout_before, f.holdout_after) for key, f in checked.items()])
    page.text("Before: the simulation as it was. After: with what was found. Floor: residual of trials of a healthy "
              "bench (a dash: none was given). Held out: trials given with --holdout, to which nothing was fitted.",
              "note")


def rivals(page: Page, found: Findings) -> None:
    """Add the table of the ambiguity set, if the set has more effects than the named causes."""
    chosen = {c["effect"] for c in found.causes}
    if len(found.rivals) <= len(chosen):
        return
    page.heading("The class: effects that these data cannot tell apart")
    page.table(("effect", "what it means", "experiment that would tell", "what to look at"), [
        (name + (" (chosen)" if name in chosen else ""), CATALOGUE[name].words,
         EXPERIMENTS[CATALOGUE[name].experiment].motion, EXPERIMENTS[CATALOGUE[name].experiment].reads)
        for name in found.rivals])


def ranking(page: Page, found: Findings) -> None:
    """Add the table of fitted models, with the gain of each and the reason why it was not selected."""
    page.section("What was tried")
    if found.evidence:
        _bayes_factors(page, found)
        return
    if found.found is None:
        page.text("Nothing was fitted.", "note")
        return
    tried, base, best = found.found.models, found.found.baseline, found.found.best
    whole = base.score - best.score
    if found.split:
        stays = (f"stays a rival while it leaves less than {BENT:g} of χ² more, or than {100.0 * STRUCTURE:g} % of "
                 "what the laws leave of healthy trials beyond noise")
    else:
        stays = (f"is a rival from {100.0 * RIVAL_GAIN:g} % on and within {100.0 * RIVAL_RMSE:g} % of its unseen RMSE, "
                 f"or where it pays and leaves less than {LEAST_FALL:g} of χ² more")
    page.text(f"{len(tried)} models were fitted in full, each judged on cycles it was not fitted on. 100 % is what the "
              f"chosen model gains over the simulation as it was; a model of as many effects {stays}.", "note")
    rows: list[tuple[Cell, ...]] = []
    for model in sorted(tried[:MODELS_SHOWN], key=lambda m: m.rank):
        share = 100.0 * (base.score - model.score) / whole if whole > 0.0 else None
        behind = 100.0 * (math.sqrt(max(model.score, 0.0) / best.score) - 1.0) if best.score > 0.0 else None
        rows.append((" + ".join(model.names) or "as simulated", _why(model, found.found, found.rivals), share, behind,
                     model.score))
    page.table(("model", "judged", "share of the gain (%)", "RMSE above (%)", "χ², unseen cycles"),
               rows, tall=len(rows) > 15)


def _bayes_factors(page: Page, found: Findings) -> None:
    """Add a table of the fitted effects' log Bayes factors, and a table of the constants on the bench and in the trial.
    """
    evidence = found.evidence or {}
    page.text("Log Bayes factor: by how many nats the trial is likelier with the effect than without any. An effect is "
              f"named from {NAMED_NATS:g} nats; all that reach {100 * SET_SHARE:g} % of the best are in the ambiguity "
              "set.", "note")
    page.table(("effect", "part of the bench", "log Bayes factor (nats)", "judged"), [
        (name, HYPOTHESES[name].part, gain, _judged(found, name))
        for name, gain in evidence["log_bayes_factors"].items()])
    page.heading("Constants of the force path: on the bench, and in this trial")
    page.table(("constant", "unit", "bench", "trial", "95 % low", "high", "change (session σ)"), [
        (name, row["unit"], row["from"], row["to"], row["low"], row["high"], row["sessions"])
        for name, row in evidence["shifts"].items()], tall=True)


def _judged(found: Findings, name: str) -> str:
    if name in {cause["effect"] for cause in found.causes}:
        return "named"
    return "in the ambiguity set" if name in found.rivals else "less likely"


def _why(model: FittedEffects, found: SearchResult, rivals: list[str]) -> str:
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


def limits(page: Page, found: Findings) -> None:
    """Add the table of detection limits: the smallest size of each effect that these trials would have shown.

    The limit of an effect that was found is never above the size found.
    """
    page.section("Detection limit")
    if not found.detection_limit:
        page.text("Not available: this rig's healthy state is not known, or nothing was searched.", "note")
        return
    page.text("The smallest departure from the healthy value that these trials would have shown, calculated from a "
              "straight line; below it an effect may be there and not be named. Where an effect was found, its size is "
              "the limit if that is smaller.", "note")
    rows = limit_rows(found)
    page.table(LIMIT_COLUMNS, rows, tall=len(rows) > 15)


LIMIT_COLUMNS: Final = ("effect", "parameter", "smallest", "unit", "likely range", "would be seen")
"""Header of the table of detection limits."""


def limit_rows(found: Findings) -> list[tuple[Cell, ...]]:
    """Return the rows of the table of detection limits, one per effect, with the columns `LIMIT_COLUMNS`."""
    sizes = {(c["effect"], name): abs(float(one["value"]) - old) for c in found.causes
             for name, one in c["parameters"].items() if (old := healthy_value(c, name)) is not None}
    named = {c["effect"] for c in found.causes}
    return [_limit(name, one, sizes.get((name, one["parameter"])), name in named)
            for name, one in (found.detection_limit or {}).items() if isinstance(one, Mapping)]


def _limit(name: str, one: Mapping[str, Any], size: float | None, named: bool) -> tuple[Cell, ...]:
    parameter = next((p for p in CATALOGUE[name].parameters if p.name == one["parameter"]), None)
    likely = "" if parameter is None else f"{parameter.likely[0]:.3g} … {parameter.likely[1]:.3g}"
    smallest = one["value"]
    if named and size is not None:
        smallest = size if smallest is None else min(smallest, size)
    seen = "yes: found" if named else _seen(smallest, parameter)
    return (name, one["parameter"], smallest, one["unit"], likely, seen)


def _seen(smallest: float | None, parameter: Any) -> str:
    """Return, in words, which of an effect's likely sizes lie above its detection limit `smallest`."""
    if smallest is None or parameter is None:
        return "no"
    low, high = parameter.likely
    if parameter.neutral is None:
        least, most = 0.0, high - low
    elif low < parameter.neutral < high:
        least, most = 0.0, max(parameter.neutral - low, high - parameter.neutral)
    else:
        least, most = sorted(abs(end - parameter.neutral) for end in parameter.likely)
    return "yes" if smallest <= least else "the larger ones" if smallest < most else "only beyond the likely range"
