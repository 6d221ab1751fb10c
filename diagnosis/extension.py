"""extended.toml: result of a diagnosis as a bench model that the simulator and the controller load.

`[parameters.NAME]`: constants of the bench from its calibration or its reference trials.  `[effects.NAME]`: effects
found.  `[[terms]]`: effects of a user's own, and terms beyond them.  `[found]`: verdict, trials and gains of the
diagnosis.  The format is that of `physics.bench_model`.

A diagnosis estimates a change.  Two models of one bench divide its friction differently between sheath and fabric, so
an effect's size is stated for the model that it extends (`moved`).
"""

import json
import math
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from diagnosis.findings import Findings
from estimation.data.table import Table
from parameters import InputError
from physics import bench_model, terms
from physics.bench_model import RIG, BenchModel
from physics.calibration import rows
from physics.conversions import RELATED, SIMULATED, UNRELATED, converted
from physics.effects.catalogue import CATALOGUE, EFFECTS_TABLE, EVIDENCE, apply
from physics.effects.own_effects import OWN
from physics.forward.force_path import KNEE_RAD
from physics.older_files import VERSION
from physics.parameters import PARAMETERS

HEAD: Final = (
    "# What a diagnosis found that the simulation lacks. The simulator loads it as --plant-model, the extended\n"
    "# controller as --controller-model; a value may be edited, its interval is evidence.\n")


def text(found: Findings, trials: Sequence[Table]) -> str:
    """Return `found` as the text of extended.toml; raises `InputError` if the diagnosis refused the trials."""
    if found.verdict == "refused":
        raise InputError(f"{trials[0].source if trials else 'diagnose'}: refused, so nothing was found to extend by; "
                         "mend the data first.")
    seconds = max((float(t["time_s"][-1] - t["time_s"][0]) for t in trials), default=math.nan)
    lines = [HEAD, *_bench(found), f"[{EVIDENCE}]", f"verdict = {_cell(found.verdict)}",
             f"on = {_cell([Path(t.source).name for t in trials])}", f"reference = {_cell(found.reference)}"]
    if found.lowpass_hz is not None:
        lines.append(f"lowpass_hz = {_cell(found.lowpass_hz)}")
    lines.append(f"class = {_cell(found.rivals)}")
    if found.experiment is not None:
        lines.append(f"experiment = {_cell(found.experiment)}")
    if found.causes:
        lines += [f"gain_percent = {_inline((c['effect'], round(c['gain_percent'], 2)) for c in found.causes)}"]
    modulated = [OWN[c["effect"]].term(c["parameters"]) for c in found.causes if c["effect"] in OWN]
    for cause in found.causes:
        lines += _effect(moved(cause, found.bench, found.bench), seconds) if cause["effect"] not in OWN else []
    lines += terms.rows([*modulated, *(() if found.laws is None else found.laws.terms)])
    return "\n".join(lines) + "\n"


def extended(model: BenchModel, found: Findings, trials: Sequence[Table]) -> BenchModel:
    """Return `model`, another one of the bench than that of `found`, with the effects and terms of `found`.

    The fabric's coefficient becomes that of the diagnosis at the exponents of `model`, so that a change of the wrap is
    within the bounds of its effect.  Raises `InputError` if the diagnosis refused the trials.
    """
    told = bench_model.from_tables(tomllib.loads(text(found, trials)), "extended.toml")
    known = {} if found.bench is None else found.bench.values
    if "phi0" in model.values and known.get("mu2", 0.0) > 0.0 and told.effects.keys() & {
            "fabric_friction", "fabric_wrap"}:
        share = model.values["mu2"] / known["mu2"]
        evidence = {name: told for name, told in model.evidence.items() if name not in ("mu2", "phi0", "fabric_wrap")}
        model = replace(model, evidence=evidence, values={**model.values, "mu2": known["mu2"], **{
            name: share * model.values[name] for name in ("phi0", "fabric_wrap")}})
    sizes = {cause["effect"]: moved(cause, found.bench, model)["parameters"] for cause in found.causes
             if cause["effect"] in told.effects}
    effects = {effect: {name: sizes[effect][name]["value"] if name in sizes[effect] else value
                        for name, value in values.items()} for effect, values in told.effects.items()}
    return replace(model, effects=effects, found=told.found, terms=told.terms)


def moved(cause: Mapping[str, Any], bench: BenchModel | None, model: BenchModel | None) -> Mapping[str, Any]:
    """Return a cause, found on `bench`, whose size (its first parameter) is stated for `model`.

    Coefficients of friction change by the exponents' change on `bench`; another size by its difference if it is absent
    at 0, else by its ratio.  A size that `model` does not contain departs from where the effect is absent.
    """
    name, size = next(iter(cause["parameters"])), CATALOGUE[cause["effect"]].parameters[0]
    was = cause.get("was", {}).get(name)
    if bench is None or model is None or was is None or name != size.name:
        return cause
    own, base = (converted(RELATED, converted(SIMULATED, converted(UNRELATED, each.values))) for each in (bench, model))
    before = base.get(name, size.neutral)
    if before is None:
        return cause

    def stated(value: float) -> float:
        share = value / was if was else 1.0
        if name == "mu1" and name in own:
            there = before + own[name] * (share - 1.0)
        elif name == "mu2" and name in own:
            there = before * (1.0 + _on_knee(own) * (share - 1.0) / _on_knee(base))
        elif name == "fabric_wrap" and own.get("mu2"):
            there = before + own["mu2"] * (value - was) / base["mu2"]
        else:
            there = before + value - was if size.neutral == 0.0 else before * share
        return min(max(there, size.low), size.high)

    return resized(cause, stated)


def resized(cause: Mapping[str, Any], size: Callable[[float], float]) -> Mapping[str, Any]:
    """Return a cause whose size, its first parameter, has value and interval changed by the function `size`."""
    name, row = next(iter(cause["parameters"].items()))
    changed = {key: size(row[key]) for key in ("value", "low", "high") if key in row}
    return {**cause, "parameters": {**cause["parameters"], name: {**row, **changed}}}


def _on_knee(values: Mapping[str, float]) -> float:
    """Return the exponent of the fabric's friction at the loaded knee."""
    mu2, phi0, wrap = (values.get(name, PARAMETERS[name].nominal) for name in ("mu2", "phi0", "fabric_wrap"))
    return max(mu2 * (phi0 + wrap * abs(KNEE_RAD)), 1e-6)


def _bench(found: Findings) -> list[str]:
    """Return the constants of the bench as lines of a bench model; [] without a calibration, and for another rig."""
    if found.bench is None or not found.bench.values:
        return []
    return [f"version = {VERSION}", f"bench = {_cell(found.bench.bench)}",
            *rows(found.bench.values, found.bench.evidence), ""]


def _effect(cause: Mapping[str, Any], seconds: float) -> list[str]:
    name = cause["effect"]
    lines = ["", f"[{EFFECTS_TABLE}.{name}]  # {CATALOGUE[name].words}"]
    own = {p.name for p in CATALOGUE[name].parameters}
    lines += [f"{key} = {_inline(told.items())}" for key, told in cause["parameters"].items() if key in own]
    if math.isfinite(seconds) and _relative(name, {k: t["value"] for k, t in cause["parameters"].items()}):
        lines.append(f"trial_s = {_cell(seconds)}")
    # further friction parameters of another rig are written as constants of that rig
    lines += [f"\n[{RIG}.{key}]\n" + "\n".join(f"{word} = {_cell(value)}" for word, value in told.items())
              for key, told in cause["parameters"].items() if key not in own]
    return lines


def _relative(name: str, values: Mapping[str, float]) -> bool:
    """Return whether the size of the effect is stated per length of the trial."""
    try:
        return apply({name: {**values, "trial_s": 1.0}}) != apply({name: {**values, "trial_s": 2.0}})
    except InputError:
        return False


def _inline(pairs: Iterable[tuple[str, Any]]) -> str:
    return "{ " + ", ".join(f"{key} = {_cell(value)}" for key, value in pairs) + " }"


def _cell(value: Any) -> str:
    return repr(float(value)) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)
