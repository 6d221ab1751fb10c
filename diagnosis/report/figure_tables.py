"""Tables of the page of a diagnosis: errors, ambiguity set, fitted models and detection limits.

Figures are those of the diagnosis, each with its unit.
"""

from collections.abc import Mapping
from typing import Any, Final

from diagnosis.evidence.decision import SET_SHARE
from diagnosis.findings import Findings
from diagnosis.report.headline import healthy_value
from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS
from trial.report.page import Cell, NamedText, Page
from trial.report.words import quantities, words


def errors(page: Page, found: Findings) -> None:
    """Add the errors of each compared signal: between reference trials, and of this trial under each model."""
    if not found.relations or found.candidates:
        return
    page.heading("Error of the simulation, RMS on cycles that no fit has seen")
    columns = ("signal", "unit", "reference trials", "this trial, reference condition", "session adapted",
               "with what is named")
    rows = [(NamedText(words(name), name), f.unit, f.floor, f.rmse_before, f.rmse_session, f.rmse_after)
            for name, f in found.relations.items()]
    count = len(columns) if found.causes else len(columns) - 1
    page.table(columns[:count], [row[:count] for row in rows])


def relations(page: Page, found: Findings) -> None:
    """Add the table of errors by compared signal; without gains if the causes are only candidates."""
    page.heading("Root mean square on cycles that no fit has seen")
    if found.candidates:
        page.table(("signal", "unit", "healthy floor", "simulated on the nominal calibration"),
                   [(NamedText(words(key), key), f.unit, f.floor, f.rmse_before) for key, f in found.relations.items()])
        return
    page.table(("signal", "unit", "healthy floor", "reference", "session", "named", "gain (%)", "95 % low", "high"), [
        (NamedText(words(key), key), f.unit, f.floor, f.rmse_before, f.rmse_session, f.rmse_after, f.gain_percent,
         f.low, f.high) for key, f in found.relations.items()])
    page.text("Reference: the reference condition as identified. Session: with its constants adapted. Named: with the "
              "named effects, too; the gain is that of named over session. Floor: what reference trials miss "
              "of each other.", "note")
    held_out = [(NamedText(words(key), key), f.unit, f.holdout_before, f.holdout_session, f.holdout_after)
                for key, f in found.relations.items() if f.holdout_before is not None]
    if held_out:
        page.heading("Root mean square on trials held out, to which nothing was fitted")
        page.table(("signal", "unit", "reference", "session", "named"), held_out)


def rivals(page: Page, found: Findings) -> None:
    """Add the table of the ambiguity set, if the set has more effects than the named causes."""
    chosen = {c["effect"] for c in found.causes}
    if len(found.rivals) <= len(chosen):
        return
    page.heading("Ambiguity set: effects that these data do not separate")
    page.table(("effect", "what it means", "experiment that would separate them", "what to look at"), [
        (NamedText(words(name) + (" (chosen)" if name in chosen else ""), name), CATALOGUE[name].words,
         *EXPERIMENTS[CATALOGUE[name].experiment].told(found.of_rig)) for name in found.rivals])


def ranking(page: Page, found: Findings) -> None:
    """Add the tables of fitted effects, by log Bayes factor, and of the constants on the bench and in the trial."""
    page.section("What was tried")
    evidence = found.evidence
    if not evidence:
        page.text("Nothing was fitted.", "note")
        return
    page.text("Log Bayes factor: by how many nats the trial is likelier with the effect than without any. An effect is "
              f"named from {evidence['named_nats']:g} nats; all that reach {100 * SET_SHARE:g} % of the best are in "
              "the ambiguity set.", "note")
    page.table(("effect", "site", "log Bayes factor (nats)", "judged"), [
        (NamedText(words(name), name), CATALOGUE[name].site, gain, _judged(found, name))
        for name, gain in evidence["log_bayes_factors"].items()])
    page.heading("Constants of the model: in the reference condition, and in this trial")
    page.table(("constant", "unit", "reference", "trial", "95 % low", "high", "change (session σ)"), [
        _constant(name, row) for name, row in evidence["shifts"].items()], tall=True)


def _constant(name: str, row: Mapping[str, Any]) -> tuple[Cell, ...]:
    texts, unit = quantities([row[key] for key in ("from", "to", "low", "high")], row["unit"])
    return NamedText(words(name), name), unit, *texts, row["sessions"]


def _judged(found: Findings, name: str) -> str:
    if name in {cause["effect"] for cause in found.causes}:
        return "named"
    return "in the ambiguity set" if name in found.rivals else "less likely"


def limits(page: Page, found: Findings) -> None:
    """Add the table of detection limits: the smallest size of each effect that these trials would have shown.

    The limit of an effect that was found is never above the size found.
    """
    page.section("Detection limit")
    if not found.detection_limit:
        page.text("Not available: nothing was searched.", "note")
        return
    page.text("The smallest departure from the healthy value that these trials would have shown, calculated from a "
              "straight line; below it an effect may be there and not be named. Where an effect was found, its size is "
              "the limit if that is smaller.", "note")
    rows = limit_rows(found)
    # the likely range is that of a bench
    columns = 4 if found.of_rig else len(LIMIT_COLUMNS)
    page.table(LIMIT_COLUMNS[:columns], [row[:columns] for row in rows], tall=len(rows) > 15)


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
    return (NamedText(words(name), name), NamedText(words(one["parameter"]), one["parameter"]), smallest, one["unit"],
            likely, seen)


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
