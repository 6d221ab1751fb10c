"""Effects of a user's own: files that declare a modulated constant of the bench with bounds and words.

The constant changes by size·expression, relative to it or in its unit (`physics.effects.carriers`); `docs/laws.md` has
an example.  In place of `expression` a `modulation` of `physics.terms` may stand, which the simulated bench follows,
too.  Such an effect is in the catalogue like a packaged one; it competes in the diagnoses that are given its name, that
of an installed package in all.  A diagnosis that names it writes a term.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from parameters import InputError, read_toml
from parameters.plugins import load as plugin
from physics import expressions
from physics.effects.carriers import PATH_CARRIERS, SITES, site_of
from physics.effects.catalogue import CATALOGUE, register
from physics.effects.effect import Effect, EffectParameter
from physics.effects.separating_experiments import EXPERIMENTS
from physics.terms import EXPRESSION, MODULATIONS, Course, Modulation, Term, modulation_of

GROUP: Final = "bowden.effects"
"""Entry points of installed packages: functions without arguments that return the path of such a file."""
SIZES: Final = ("size", "size_cosine")
"""Names of the coefficients of a modulation with one or two components."""
KEYS: Final = ("words", "carrier", "parameters")
CHOICES: Final = ("modulation", EXPRESSION, "site", "experiment")


@dataclass(frozen=True)
class OwnEffect:
    """A declared effect: its entry in the catalogue, the constant that it changes, and the modulation of it.

    `sizes`: its coefficients, by name.  `shape`: names of its nonlinear parameters.
    """

    effect: Effect
    carrier: str
    modulation: str
    expression: str
    sizes: tuple[str, ...]
    shape: tuple[str, ...]

    @property
    def function(self) -> Modulation:
        """Function by which the effect changes its constant, of load, motion, angle or time."""
        return modulation_of(self.modulation, self.expression, self.shape)

    def term(self, values: Mapping[str, Mapping[str, float]]) -> Term:
        """Return the effect as a term; `values`: value, low and high of each parameter, by name."""
        carrier = PATH_CARRIERS[self.carrier]
        return Term(self.carrier, self.modulation, {name: float(values[name]["value"]) for name in self.shape},
                    tuple(float(values[name]["value"]) for name in self.sizes),
                    tuple((float(values[name]["low"]), float(values[name]["high"])) for name in self.sizes),
                    carrier.unit, carrier.part, carrier.words, self.expression)


OWN: Final[dict[str, OwnEffect]] = {}
"""Every effect that was read from a file, by name."""


def read(path: str | Path) -> list[str]:
    """Add the effects of a file to the catalogue, and return their names.

    Raises `InputError` for a file that declares none, and for a name that the catalogue has with another declaration.
    """
    tables = read_toml(Path(path)).get("effects")
    if not isinstance(tables, Mapping) or not tables:
        raise InputError(f"{path}: declares no effect; write each as [effects.NAME] with {', '.join(KEYS)}.")
    made = {name: _declared(name, row, f"{path} [effects.{name}]") for name, row in tables.items()}
    for name, own in made.items():
        if name in CATALOGUE and OWN.get(name) != own:
            raise InputError(f"{path}: the catalogue has an effect {name}; give it another name.")
    for name, own in made.items():
        if name not in OWN:
            register(own.effect)
            OWN[name] = own
    return list(made)


def read_each(paths: Iterable[str | Path]) -> list[str]:
    """Add the effects of several files to the catalogue, and return their names; raises `InputError` as `read` does."""
    return [name for path in paths for name in read(path)]


@cache
def installed() -> list[str]:
    """Read the effect files of installed packages, once; returns their effects' names, raises `InputError` as `read`.
    """
    from importlib.metadata import entry_points

    return read_each(plugin("effects", entry.name, GROUP, {})() for entry in entry_points(group=GROUP))


def _declared(name: str, row: Any, where: str) -> OwnEffect:
    if not isinstance(row, Mapping) or not set(KEYS) <= set(row) <= {*KEYS, *CHOICES} or (
            ("modulation" in row) == (EXPRESSION in row)):
        raise InputError(f"{where}: expected {', '.join(KEYS)}, one of modulation and {EXPRESSION}, and no other key "
                         "but site and experiment.")
    if not name.isidentifier():
        raise InputError(f"{where}: {name!r} is no name; use letters, digits and underscores.")
    carrier = _one_of(PATH_CARRIERS, row["carrier"], f"{where} carrier")
    given = row["parameters"]
    if not isinstance(given, Mapping) or "size" not in given:
        raise InputError(f"{where}: parameters need size, which multiplies the {EXPRESSION}.")
    text = str(row.get(EXPRESSION, ""))
    modulation = EXPRESSION if text else _one_of(MODULATIONS, row.get("modulation"), f"{where} modulation")
    sizes = SIZES[:1] if text else SIZES[:MODULATIONS[modulation].components]
    shape = tuple(key for key in given if key not in sizes) if text else tuple(MODULATIONS[modulation].parameters)
    if text:
        unused = set(shape) - expressions.names_of(text, {*Course._fields, *shape}, f"{where} {EXPRESSION}")
        if unused:
            raise InputError(f"{where}: the {EXPRESSION} has no {', '.join(sorted(unused))}; remove the parameter.")
    if set(given) != {*sizes, *shape}:
        raise InputError(f"{where}: parameters {', '.join(given)}; expected {', '.join([*sizes, *shape])}.")
    units = {**dict.fromkeys(sizes, PATH_CARRIERS[carrier].unit),
             **modulation_of(modulation, text, shape).parameters}
    parameters = tuple(_parameter(key, given[key], units[key], key in sizes, f"{where} parameters.{key}")
                       for key in (*sizes, *shape))
    formula = modulation_of(modulation, text, shape).words.format(**{key: key for key in shape})
    law = f"{PATH_CARRIERS[carrier].words} {'× (1 + size' if PATH_CARRIERS[carrier].relative else '+ (size'}{formula})"
    effect = Effect(name, _one_of(SITES, row.get("site", site_of(carrier)), f"{where} site"), law, "own effect",
                    parameters, {}, str(row["words"]), str(row["words"]), (),
                    _one_of(EXPERIMENTS, row.get("experiment", "two_peaks"), f"{where} experiment"))
    return OwnEffect(effect, carrier, modulation, text, sizes, shape)


def _one_of(known: Iterable[str], value: Any, where: str) -> str:
    if value not in list(known):
        raise InputError(f"{where} = {value!r}; expected one of {', '.join(known)}.")
    return str(value)


def _parameter(name: str, row: Any, unit: str, neutral: bool, where: str) -> EffectParameter:
    """Return a parameter; a size is absent at 0, and its bounds contain it."""
    row = {"likely": [row.get("low"), row.get("high")], **row} if isinstance(row, Mapping) else {}
    likely = row.get("likely")
    numbers = [row.get("low"), row.get("high"), *(likely if isinstance(likely, list) else ())]
    if len(numbers) != 4 or set(row) != {"low", "high", "likely"} or any(
            isinstance(v, bool) or not isinstance(v, int | float) or not math.isfinite(v) for v in numbers):
        raise InputError(f"{where}: expected {{ low = …, high = …, likely = [… , …] }} with finite numbers.")
    low, high, first, last = (float(v) for v in numbers)
    if not low <= first < last <= high or (neutral and not low <= 0.0 <= high):
        raise InputError(f"{where}: expected low ≤ likely[0] < likely[1] ≤ high"
                         + (", and 0, where the effect is absent, within the bounds." if neutral else "."))
    return EffectParameter(name, unit, low, high, (first, last), 0.0 if neutral else None, name.replace("_", " "))


def promoted(terms: Sequence[Term]) -> str:
    """Return the text of a file that declares terms of a law as effects, about the values that were found.

    A size is likely within the term's own, or 1σ of its carrier; a nonlinear parameter within 30 % of its value.
    """
    lines = ["# Effects of your own, from a law: bowden diagnose --effects names them like those of the catalogue.",
             "# Words, bounds and likely ranges may be edited."]
    for term in terms:
        shape = MODULATIONS[term.modulation]
        scale = max(PATH_CARRIERS[term.carrier].sd, abs(term.size))
        cells = [f"{name} = {{ low = {-4.0 * scale!r}, high = {4.0 * scale!r}, likely = [{-scale!r}, {scale!r}] }}"
                 for name in SIZES[:shape.components]]
        for name, value in term.parameters.items():
            span = abs(value) or 1.0
            low, high = (value - span, value + span) if value <= 0.0 else (0.3 * value, 3.0 * value)
            cells.append(f"{name} = {{ low = {low!r}, high = {high!r}, "
                         f"likely = [{value - 0.3 * span!r}, {value + 0.3 * span!r}] }}")
        lines += ["", f"[effects.{term.carrier}_{term.modulation}]  # {term.equation}",
                  f"words = {json.dumps(f'{term.words}: it changes by {term.modulation}.'.replace('_', ' '))}",
                  f'carrier = "{term.carrier}"', f'modulation = "{term.modulation}"',
                  f"parameters = {{ {', '.join(cells)} }}"]
    return "\n".join(lines) + "\n"
