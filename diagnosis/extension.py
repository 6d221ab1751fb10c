"""extended.toml: result of a diagnosis as a bench model that the simulator and the controller load.

`[parameters.NAME]`: constants of the bench from its calibration or its reference trials.  `[effects.NAME]`: effects
found.  `[[terms]]`: effects of a user's own, and terms beyond them.  `[found]`: verdict, trials and gains of the
diagnosis.  The format is that of `physics.bench_model`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from diagnosis.findings import Findings
from estimation.data.table import Table
from parameters import InputError
from physics import terms
from physics.bench_model import RIG
from physics.calibration import rows
from physics.effects.catalogue import CATALOGUE, EFFECTS_TABLE, EVIDENCE, apply
from physics.effects.own_effects import OWN
from physics.older_files import VERSION

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
        lines += _effect(cause, seconds) if cause["effect"] not in OWN else []
    lines += terms.rows([*modulated, *(() if found.laws is None else found.laws.terms)])
    return "\n".join(lines) + "\n"


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
