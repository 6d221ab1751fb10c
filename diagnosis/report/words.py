"""Summary of a diagnosis in one paragraph: causes in the words of the catalogue, gain, ambiguity set, next experiment.

The paragraph only reports the findings and adds no judgement.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diagnosis.findings import Findings
from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS
from trial.report.page import number


def paragraph(found: Findings) -> str:
    """Return the findings of a diagnosis as one paragraph."""
    if found.candidates:
        return ("The simulation of the nominal bench leaves more than a healthy bench would; which of several effects "
                "that is, an identification has to narrow down first.")
    opening = {
        "none": "Nothing was found that the simulation gets wrong: no effect of the catalogue pays on cycles it was "
                "not fitted on.",
        "refused": refused_because(found),
        "unexplained": "The simulation leaves out something that no effect of the catalogue explains.",
    }.get(found.verdict, "")
    sentences = [opening, *(_cause(cause) for cause in found.causes), _gain(found), _class(found), _next(found),
                 _unchecked(found)]
    return " ".join(sentence for sentence in sentences if sentence)


def refused_because(found: Findings) -> str:
    """Return why trials were refused: missing columns, trials too short, or data that contradict themselves."""
    reason = found.warnings[0] if found.warnings else ""
    if "no relation can be checked" in reason:
        return "Columns are missing, so nothing can be checked about the bench."
    if "; expected at least " in reason:
        return "The trials are too short, so nothing can be checked about the bench."
    return "These data contradict themselves, so nothing is said about the bench."


def _cause(cause: Mapping[str, Any]) -> str:
    effect = CATALOGUE[cause["effect"]]
    told = ", ".join(f"{name} = {interval(one)}" for name, one in cause["parameters"].items())
    return f"{effect.words} ({effect.name}, at the {effect.site}: {told}.)"


def interval(parameter: Mapping[str, Any]) -> str:
    """Return a parameter as text: value, unit and 95 % interval."""
    unit = f" {parameter['unit']}" if parameter["unit"] else ""
    return (f"{number(parameter['value'], 3)}{unit} (95 %: {number(parameter['low'], 3)} … "
            f"{number(parameter['high'], 3)})")


def _gain(found: Findings) -> str:
    gains = [(f.gain_percent, name, f) for name, f in found.relations.items()
             if f.checked and f.gain_percent is not None and f.low is not None and f.low > 0.0]
    if not gains or not found.causes:
        return ""
    most, name, figures = max(gains, key=lambda one: one[0])
    text = (f"With {'it' if len(found.causes) == 1 else 'them'} in the model the residual of {name} falls by "
            f"{number(most, 3)} % (95 %: {number(figures.low, 3)} … {number(figures.high, 3)} %), from "
            f"{number(figures.rmse_before, 3)} to {number(figures.rmse_after, 3)} {figures.unit} on cycles that the "
            "fit has not seen")
    if figures.holdout_before is not None and figures.holdout_after is not None:
        text += (f", and from {number(figures.holdout_before, 3)} to {number(figures.holdout_after, 3)} "
                 f"{figures.unit} on the trials held out")
    return text + "."


def _class(found: Findings) -> str:
    others = [name for name in found.rivals if name not in {c["effect"] for c in found.causes}]
    if not others:
        return ""
    meant = "; ".join(f"{name} ({_clause(CATALOGUE[name].words)})" for name in others)
    return f"These data cannot tell this from {meant}."


def _clause(sentence: str) -> str:
    acronym = sentence[:2].isupper()
    return (sentence[0] if acronym else sentence[0].lower()) + sentence[1:].rstrip(".")


def _next(found: Findings) -> str:
    if found.experiment is None or found.experiment not in EXPERIMENTS:
        return ""
    chosen = EXPERIMENTS[found.experiment]
    here = f" (bowden trial --experiment {chosen.name})" if found.reference != "none" else ""
    by_hand = f"; {chosen.by_hand}" if chosen.by_hand else here
    return f"To tell them apart: {chosen.motion}{by_hand}. Look at {chosen.reads}."


def _unchecked(found: Findings) -> str:
    if found.found is None and found.causes:
        return "The bench's own relations were not searched: mend the wire, record again, and diagnose that."
    blind = [name for name, figures in found.relations.items() if not figures.checked]
    return f"Not checked, for want of columns: {', '.join(blind)}." if blind else ""
