"""First lines of a diagnosis: the fault and its size, its cost in N, and the next step.

They are complete for an engineer who reads nothing else: each figure has its unit and its reference.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from diagnosis.findings import Findings
from diagnosis.judgement.verdict import Figures
from diagnosis.report.plots import MEANING
from diagnosis.report.words import refused_because
from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS
from trial.report.page import number

AGAINST: Final = {"calibration": "the bench's calibration", "nominal": "the nominal bench",
                  "healthy": "its healthy trials", "none": "an ideal transmission"}
TENSIONS: Final = {"tension_start_n": "START", "tension_end_n": "END"}
WRITTEN: Final = {"m": (1e3, "mm"), "s": (1e3, "ms")}
"""By SI unit: factor and symbol of the unit in which values below `LARGE` are written."""
LARGE: Final = 0.1
"""Value, in the SI unit, from which a parameter is written in that unit."""
UNSEEN: Final = "on cycles that the fit has not seen"


class Headline(NamedTuple):
    """Sentences on the fault, its cost and the next step; an empty string if a sentence does not apply."""

    wrong: str
    cost: str
    todo: str


UNMEASURED: Final = (
    "Run bowden identify first: the trial ran on the packaged nominal calibration, so what this bench is by itself "
    "cannot be told from what is wrong with it, and no cause is named on this footing.")


def headline(found: Findings) -> Headline:
    """Return the sentences on the fault, its cost in N and the next step."""
    if found.candidates:
        return Headline(UNMEASURED, _cost(found), "bowden identify all -o calibration.toml, then record again or "
                        "diagnose with --calibration calibration.toml; --healthy trials are a footing, too.")
    return Headline(_wrong(found), _cost(found), _todo(found))


def _wrong(found: Findings) -> str:
    if found.verdict == "refused":
        return f"{refused_because(found).rstrip('.')}: " + (
            found.warnings[0] if found.warnings else "no reason was given.")
    if found.verdict == "unexplained":
        return "Something is wrong that no effect of the catalogue explains; no cause is named."
    if not found.causes:
        within = "" if found.session is None else ", within what two sessions differ by"
        return f"Nothing is wrong that these trials show: the bench agrees with {_against(found)}{within}."
    told = " ".join(_cause(found, cause) for cause in found.causes)
    others = [name for name in found.rivals if name not in {c["effect"] for c in found.causes}]
    if found.undecided is not None:
        return f"{found.undecided[0].upper()}{found.undecided[1:]} {told}"
    return told + (f" These trials cannot tell it from: {', '.join(others)}." if others else "")


def _cause(found: Findings, cause: Mapping[str, Any]) -> str:
    effect = CATALOGUE[cause["effect"]]
    changes = [change(found, cause, name) for name in cause["parameters"]]
    return f"{effect.words.rstrip('.')} ({effect.name}): {'; '.join(changes)}."


def change(found: Findings, cause: Mapping[str, Any], name: str) -> str:
    """Return a parameter as text: name old → new unit (95 %: low … high), without an unknown old value."""
    one, old = cause["parameters"][name], healthy_value(cause, name)
    scale, symbol = WRITTEN.get(one["unit"], (1.0, one["unit"]))
    if max(abs(one[key]) for key in ("value", "low", "high")) >= LARGE:
        scale, symbol = 1.0, one["unit"]
    value, low, high = (number(scale * one[key], 3) for key in ("value", "low", "high"))
    before = "" if old is None else f"{number(scale * old, 3)} → "
    return (f"{name} {before}{value}{f' {symbol}' if symbol else ''} (95 %: {low} … {high}"
            f"{'' if old is None else f'; old: {_against(found)}'})")


def healthy_value(cause: Mapping[str, Any], name: str) -> float | None:
    """Return the value of a parameter in the simulation before the diagnosis; None if it is unknown.

    The source is the key `was` of the cause, else the neutral value of the catalogue, as for bus and converter faults.
    """
    if "was" in cause:
        return float(cause["was"][name])
    return next((p.neutral for p in CATALOGUE[cause["effect"]].parameters if p.name == name), None)


def _against(found: Findings) -> str:
    if found.found is None and found.causes:
        return "a sound wire and converter"
    return AGAINST.get(found.reference, found.reference)


def strongest(found: Findings, unit: str | None = None) -> tuple[str, Figures] | None:
    """Return name and figures of the prediction equation with the largest gain; None if none was checked.

    `unit`: only equations in this unit count (None: all).
    """
    told = [(name, f) for name, f in found.relations.items()
            if f.checked and f.rmse_before is not None and f.rmse_after is not None and unit in (None, f.unit)]
    if not told:
        return None
    return max(told, key=lambda one: one[1].gain_percent if one[1].gain_percent is not None else 0.0)


def _cost(found: Findings) -> str:
    simulated: Mapping[str, Any] | None = getattr(found, "simulation", None)
    lines = []
    if simulated is not None:
        before, left = simulated["before_rms_n"], simulated["after_rms_n"]
        after = f", {number(left, 3)} N with what was found" if found.causes else ""
        if found.causes and before is not None and left is not None and left >= before:
            after = ", which what was found does not lower: the name rests on the relations, not on this figure"
        own = simulated.get("healthy_rms_n")
        beside = "" if own is None else f" (its healthy trials by {number(own, 3)} N)"
        missed = " and ".join(TENSIONS[name] for name in simulated["signals"])
        lines.append(f"The simulation of this bench misses {missed} by {number(before, 3)} N RMS{beside}{after}.")
    one = strongest(found, "N")
    if one is None:
        return " ".join(lines)
    name, f = one
    if found.session is not None:
        lines.append(f"The model of its healthy trials, as it was, misses these by "
                     f"{number(found.session['as_identified'][name], 3)} N RMS ({name}).")
    floor = f"; healthy trials leave {number(f.floor, 3)} N" if f.floor is not None else ""
    if not found.causes:
        fitted = " with constants fitted within what sessions differ by" if found.session is not None else ""
        lines.append(f"The force is predicted to {number(f.rmse_before, 3)} N RMS{fitted} ({name}, {UNSEEN}{floor}).")
        return " ".join(lines)
    first, left = f.rmse_before or 0.0, f.rmse_after or 0.0
    if f.gain_percent is None or f.gain_percent < 1.0:
        lines.append(f"It costs no force that these trials show ({name} stays at {number(left, 3)} N RMS).")
    else:
        lines.append(f"It costs {number(max(first**2 - left**2, 0.0) ** 0.5, 3)} N RMS of predicted force: "
                     f"{number(first, 3)} N before, {number(left, 3)} N with it in the model ({name}: "
                     f"{MEANING.get(name, name)}; {UNSEEN}{floor}).")
    return " ".join(lines)


def _todo(found: Findings) -> str:
    if found.verdict == "refused":
        return "Mend the data and record again."
    if found.experiment is not None and found.experiment in EXPERIMENTS:
        chosen = EXPERIMENTS[found.experiment]
        runs = "" if found.reference == "none" or chosen.by_hand else f" (bowden trial --experiment {chosen.name})"
        hands = f"; {chosen.by_hand}" if chosen.by_hand else ""
        return f"To tell them apart, run {chosen.name}: {chosen.motion}{hands}{runs}. Look at {chosen.reads}."
    if found.found is None and found.causes:
        return "Mend the wire or the converter, record again, and diagnose that."
    if found.verdict == "unexplained":
        return "Look at where the residual lies, then record that part of the gait again with more sensors."
    if found.causes and all(cause["site"] == "END sensor" for cause in found.causes):
        return "Mend the END sensor: it only verifies, so the controller has nothing to be told."
    if found.causes:
        return ("Mend it, or tell the controller: bowden diagnose … -o extended.toml, then bowden trial "
                "--controller-model extended.toml.")
    if found.reference == "nominal":
        return "Compared with the nominal bench only; run bowden identify on this bench, then diagnose again."
    return "Nothing to do."
