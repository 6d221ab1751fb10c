"""First lines of a diagnosis: error of the simulation, changed part and causes, ambiguity set, next step.

They are complete for an engineer who reads nothing else: each figure has its unit and its reference.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from diagnosis.compared_signals import Figures
from diagnosis.evidence.decision import SET_SHARE
from diagnosis.findings import Findings
from diagnosis.laws.law_result import Laws
from physics.effects.carriers import SITES
from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS
from trial.report.page import number
from trial.report.words import quantities, words

NAMES: Final = {"tension_start_n": "START", "tension_end_n": "END", "servo_force_n": "the drive's force"}
"""Outputs whose error the first sentence gives, in words."""
UNMEASURED: Final = (
    "Run bowden identify first: the trial ran on the packaged nominal calibration, so what this bench is by itself "
    "cannot be told from what is wrong with it, and no cause is named on this footing.")



class Errors(NamedTuple):
    """Errors on held-out cycles, RMS in `unit`, that the sentences depend on.

    `reference`: the reference condition's model; `session`: with the session's constants adapted; `named`: with the
    named effects, None without one.  `reference_rmse`: None without reference trials.  `gain`: of
    `named` over `session`, %, with its 95 % interval.  `sigma`: largest change of a constant of the adapted session, in
    σ between sessions.
    """

    reference: float
    session: float
    named: float | None = None
    reference_rmse: float | None = None
    gain: tuple[float, float, float] | None = None
    sigma: float = 0.0
    unit: str = "N"

    def agree(self, error: float) -> bool:
        """Return whether an error is at most 1.5 times the reference RMSE, which is a mean over several trials."""
        return self.reference_rmse is not None and error <= 1.5 * self.reference_rmse

    def within_scatter(self) -> bool:
        """Return whether no constant of the session changed by more than 3 σ, about the largest of forty draws."""
        return self.sigma <= 3.0


CONTRADICTORY: Final = "These data contradict themselves, so nothing is said about the bench."


def headline(found: Findings) -> Iterator[str]:
    """Yield the first sentences of a diagnosis, most important first."""
    if found.candidates:
        yield UNMEASURED
        yield from _error(found)
        yield ("bowden identify all -o calibration.toml, then record again or diagnose with --calibration "
               "calibration.toml; --healthy trials are a footing, too.")
    elif found.verdict == "refused":
        yield f"{refused_because(found).rstrip('.')}: " + (
            found.warnings[0] if found.warnings else "no reason was given.")
        if refused_because(found) == CONTRADICTORY:
            yield "Mend the data and record again."
    elif found.part == "wire":
        yield " ".join(_cause(cause) for cause in found.causes)
        yield from _set(found)
        yield "Mend the wire or the converter, record again, and diagnose that."
    else:
        yield from _by_evidence(found)


def _by_evidence(found: Findings) -> Iterator[str]:
    if found.undecided is not None:
        yield f"{found.undecided[0].upper()}{found.undecided[1:]}"
    yield from _error(found)
    errors = _errors(found)
    if found.causes:
        yield f"Changed: {found.part}. " + " ".join(_cause(cause) for cause in found.causes)
        if errors is not None:
            yield gain_sentence(errors)
        yield to_do(found)
        if found.unexplained:
            yield f"Something else differs, too: {_places(found.unexplained, errors)}."
    elif found.verdict == "unexplained":
        yield ("The trial departs from the model in a way that no effect of the catalogue explains: "
               f"{_places(found.unexplained, errors)}; no cause is named.")
    elif errors is not None:
        yield none_sentence(errors, found.of_rig)
        if found.of_rig:
            yield from _limits(found)
    if not found.causes and found.evidence is not None:
        yield from likeliest_sentence(found.evidence["log_bayes_factors"], found.evidence["named_nats"])
    if found.laws is not None:
        yield from law_sentences(found.laws)
    elif found.unexplained or found.verdict == "unexplained":
        yield "bowden discover, with the same trials, seeks a law for it."
    yield from _set(found)
    listed = _shifts((found.evidence or {}).get("shifts", {}))
    if listed:
        yield f"Constants that moved most: {'; '.join(listed)}."


def likeliest_sentence(nats: Mapping[str, float], least: float) -> Iterator[str]:
    """Yield a sentence on the likeliest effects if their log Bayes factor is near `least`, from which one is named.

    Near is the share of it above which an effect is in the ambiguity set of a named one.
    """
    best = max(nats.values(), default=0.0)
    if SET_SHARE * least <= best < least:
        among = [words(name) for name, each in nats.items() if each >= SET_SHARE * best]
        yield (f"Likeliest, but not named: {', '.join(among)} ({best:.1f} of {least:g} nats). Further reference trials "
               "of this motion show smaller changes.")


def law_sentences(laws: Laws) -> Iterator[str]:
    """Yield the equation of each term, the gain, the runners-up, and the motion that would confirm it."""
    if not laws.terms:
        yield f"No law: {laws.rejected or 'no term has the evidence'}."
        return
    for term, nats in zip(laws.terms, laws.nats, strict=True):
        yield f"Law: {term.equation} ({term.part}; {nats:.0f} nats)."
    gained = [f"{NAMES.get(name, name)} {f.rmse_session:.3g} → {f.rmse_after:.3g} {f.unit} ({f.gain_percent:.0f} %, "
              f"95 %: {f.low:.0f} … {f.high:.0f})" for name, f in laws.errors.items()]
    yield f"Error on held-out cycles, session adapted → with the law: {', '.join(gained)}."
    if laws.nearly:
        yield f"Nearly as likely: {', '.join(f'{words(name)} ({nats:.0f} nats)' for name, nats in laws.nearly[:3])}."
    yield f"To confirm: {laws.experiment}."


def _error(found: Findings) -> Iterator[str]:
    """Yield the sentence on the error of the simulation before and after, beside that of reference trials."""
    errors = _errors(found)
    if errors is not None and found.simulation is not None:
        yield error_sentence(errors, [NAMES[name] for name in found.simulation["signals"]], found.of_rig)


def _errors(found: Findings) -> Errors | None:
    """Return the errors over the judged outputs; None if nothing was simulated."""
    told = found.simulation
    if told is None:
        return None
    unit = next((found.relations[n].unit for n in told["signals"] if n in found.relations), "N")
    gain = None if told["gain_percent"] is None else (told["gain_percent"], *told["gain_interval"])
    return Errors(told["before_rms_n"], told["session_rms_n"], told["after_rms_n"] if found.causes else None,
                  told["healthy_rms_n"], gain if found.causes else None, told["session_sigma"], unit)


def _amount(value: float, unit: str) -> str:
    """Return an error in its unit, with two decimals; a small one, of another rig, with two significant digits."""
    return f"{value:.2f} {unit}" if value >= 0.015 or value == 0.0 else f"{value:.2g} {unit}"


def error_sentence(errors: Errors, signals: Sequence[str], of_rig: bool = False) -> str:
    """Return the sentence on the error by the models reference, session and named, and on that of reference trials."""
    unit = errors.unit
    steps = [f"{_amount(errors.reference, unit)} in the reference condition",
             f"{_amount(errors.session, unit)} with this session's constants adapted"]
    if errors.named is not None:
        steps.append(f"{_amount(errors.named, unit)} with what is named below")
    own = errors.reference_rmse
    beside = "" if own is None else f"; reference trials miss each other by {_amount(own, unit)}"
    return (f"The simulation of this {'rig' if of_rig else 'bench'} misses {' and '.join(signals)} by "
            f"{', '.join(steps[:-1])} and {steps[-1]}, on cycles that no fit has seen{beside}.")


def gain_sentence(errors: Errors) -> str:
    """Return the sentence on the gain of the named effects over the adapted session."""
    percent, low, high = errors.gain or (0.0, 0.0, 0.0)
    interval_text = f"95 %: {round(low)} … {round(high)}"
    if low > 0.0:
        return f"It removes {round(percent)} % ({interval_text}) of the error with the session adapted."
    moved = (f"the session's constants predict them as well, but only {errors.sigma:.0f} σ outside their scatter"
             if not errors.within_scatter() else "the session's constants, within their scatter, predict them as well")
    return f"It gains nothing on cycles that no fit has seen ({round(percent)} %, {interval_text}): {moved}."


def none_sentence(errors: Errors, of_rig: bool = False) -> str:
    """Return the sentence on a trial in which no effect is named, by its errors and the reference RMSE."""
    unit, what = errors.unit, "rig" if of_rig else "bench"
    if errors.reference_rmse is None:
        return (f"No effect is named: a {what} of the population, its constants within their spread, predicts the "
                f"trial to {_amount(errors.session, unit)}.")
    if errors.agree(errors.reference):
        return ("The trial agrees with the reference trials within what they differ by: no change of the "
                f"{what} is needed to explain it.")
    differs = f"The trial differs from the reference condition by {_amount(errors.reference, unit)}"
    if errors.agree(errors.session):
        moved = ("within their scatter" if errors.within_scatter() else
                 f"of which one changed by {errors.sigma:.0f} σ of their scatter")
        return f"{differs}, which is the session's: its constants, {moved}, explain it."
    return (f"{differs}; the session's constants leave {_amount(errors.session, unit)} of it, which no effect of the "
            "catalogue explains.")


def _places(unexplained: Mapping[str, Mapping[str, float]], errors: Errors | None) -> str:
    """Return where the best model has a lack of fit: each output with its error and that of reference trials.

    If the session's constants reach the error of reference trials, but far outside their scatter, the text states that.
    """
    unit = "N" if errors is None else errors.unit
    strained = errors is not None and not errors.within_scatter()
    return ", ".join(
        f"{NAMES.get(name, name)} is missed by {_amount(row['rms'], unit)}, "
        + (f"but only with constants up to {errors.sigma:.0f} σ outside their scatter between sessions"
           if strained and errors is not None and row["rms"] <= row["floor"] else
           f"where reference trials miss each other by {_amount(row['floor'], unit)}")
        for name, row in unexplained.items())


def _limits(found: Findings) -> Iterator[str]:
    shown = {name: one for name, one in (found.detection_limit or {}).items() if one["value"] is not None}
    if shown:
        yield "Smallest change that this trial would show: " + ", ".join(
            f"{words(name)} by {number(one['value'], 2)} {one['unit']}".rstrip()
            for name, one in shown.items()) + "."


def _set(found: Findings) -> Iterator[str]:
    """Yield the sentences on the other effects of the ambiguity set, and on the experiment that separates them."""
    among = [name for name in found.rivals if name not in {cause["effect"] for cause in found.causes}]
    if among:
        yield f"These data do not separate it from: {', '.join(map(words, among))}."
    if found.experiment is not None:
        motion, reads = EXPERIMENTS[found.experiment].told(found.of_rig)
        named = "" if found.of_rig else f"{found.experiment}: "
        yield f"To separate them, record {named}{motion}. Look at {reads}."


def refused_because(found: Findings) -> str:
    """Return why trials were refused: missing columns or trials, trials too short, or contradictory data."""
    reason = found.warnings[0] if found.warnings else ""
    if "has no column" in reason:
        return "Columns are missing, so nothing can be checked about the bench."
    if "--healthy" in reason:
        return "Reference trials of this rig are missing, so nothing can be checked about it."
    if "; expected at least " in reason:
        return "The trials are too short, so nothing can be checked about the bench."
    return CONTRADICTORY


def _cause(cause: Mapping[str, Any]) -> str:
    effect = CATALOGUE[cause["effect"]]
    values = ", ".join(change(cause, name) for name in cause["parameters"])
    peak = " and ".join(f"{NAMES[name]} by {value:+.2f} N" for name, value in cause.get("at_peak_n", {}).items())
    sure = f", probability {100.0 * cause['probability']:.0f} %" if "probability" in cause else ""
    return (f"{words(effect.name)} at {effect.site} ({effect.law}){sure}: {values}."
            + (f" At the peak of START it changes {peak}." if peak else ""))


def to_do(found: Findings) -> str:
    """Return where the first cause sits and what to do there; of a rig of another kind its site alone."""
    site = found.causes[0]["site"]
    if found.of_rig:
        return f"Look at the {site}, and record again after the repair."
    return f"It is at {SITES[site].place}. {SITES[site].to_do}"


def change(cause: Mapping[str, Any], name: str) -> str:
    """Return a parameter as text: name in words, old → new unit (95 %: low … high), without an unknown old value.

    Lengths and times below 0.1 m or s are in mm and ms.
    """
    one, old = cause["parameters"][name], healthy_value(cause, name)
    small = one["unit"] in ("m", "s") and max(abs(one[key]) for key in ("value", "low", "high")) < 0.1
    scale, symbol = (1e3, f"m{one['unit']}") if small else (1.0, one["unit"])
    value, low, high = (number(scale * one[key], 3) for key in ("value", "low", "high"))
    before = "" if old is None else f"{number(scale * old, 3)} → "
    return f"{words(name)} {before}{value}{f' {symbol}' if symbol else ''} (95 %: {low} … {high})"


def interval(parameter: Mapping[str, Any]) -> str:
    """Return a parameter as text: value, unit and 95 % interval."""
    unit = f" {parameter['unit']}" if parameter["unit"] else ""
    return (f"{number(parameter['value'], 3)}{unit} (95 %: {number(parameter['low'], 3)} … "
            f"{number(parameter['high'], 3)})")


def healthy_value(cause: Mapping[str, Any], name: str) -> float | None:
    """Return the value of a parameter in the simulation before the diagnosis; None if it is unknown.

    The source is the key `was` of the cause, else the neutral value of the catalogue, as for bus and converter faults.
    """
    if "was" in cause:
        return float(cause["was"][name])
    return next((p.neutral for p in CATALOGUE[cause["effect"]].parameters if p.name == name), None)


def strongest(found: Findings) -> tuple[str, Figures] | None:
    """Return name and figures of the output with the largest gain; None if none was compared."""
    told = [(name, f) for name, f in found.relations.items() if f.rmse_before is not None and f.rmse_last is not None]
    return max(told, key=lambda one: one[1].gain_percent or 0.0, default=None)


def _shifts(shifts: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the three constants that changed most, of those that changed by 3 session σ or more, in words."""
    rated = sorted(((abs(row["sessions"]), name) for name, row in shifts.items()
                    if row["sessions"] is not None and abs(row["sessions"]) >= 3.0), reverse=True)
    texts = []
    for _, name in rated[:3]:
        (before, after), unit = quantities((shifts[name]["from"], shifts[name]["to"]), shifts[name]["unit"])
        texts.append(f"{words(name)} {before} → {after} {unit}".rstrip())
    return texts
