"""Effects of the catalogue as candidates of a search: the parameters that each frees, their bounds and starting points.

Everything comes from the declarations of `physics.effects.catalogue`; no effect is named here.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from diagnosis.problem.prior import Free
from physics.effects.catalogue import CATALOGUE
from physics.parameters import PARAMETERS, RELATION_PARAMETERS
from physics.relations import relation
from physics.relations.relation import RELATIONS

MAX_STARTS: Final = 8


@dataclass(frozen=True)
class Candidate:
    """One effect: the parameters that it frees, and starting points of its fits, each with the effect present.

    `likely`: range in which each value is expected on such a bench, empty on a rig of another kind. `level`: base
    coefficients freed with the effect. `rivals`: effects that the catalogue declares similar, in either direction.
    `counted`: number of parameters charged for the effect, None for the number of `frees`.
    """

    name: str
    site: str
    frees: tuple[Free, ...]
    starts: tuple[Mapping[str, float], ...]
    likely: Mapping[str, tuple[float, float]]
    level: tuple[str, ...] = ()
    rivals: frozenset[str] = frozenset()
    counted: int | None = None

    def unlikely(self, values: Mapping[str, float], margin: float = 0.0) -> int:
        """Return how many parameters lie outside their expected range, widened by `margin` of that range."""
        return sum(not low - margin * (high - low) <= values[f.name] <= high + margin * (high - low)
                   for f in self.frees if f.name in self.likely for low, high in (self.likely[f.name],))

    def on_bound(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Return the parameters that rest on a bound of the search: these are not measurements."""
        return tuple(f.name for f in self.frees if min(values[f.name] - f.low, f.high - values[f.name])
                     <= 1e-6 * min(f.scale, f.high - f.low))

    @property
    def parameters(self) -> frozenset[str]:
        return frozenset(f.name for f in self.frees)


def candidates(
    checked: Iterable[str], reference: Mapping[str, float], nuisance: Sequence[Free], any_rig: bool = False,
    blind: bool = False
) -> list[Candidate]:
    """Return the effects with a parameter that `checked` equations read and that `nuisance` does not free already.

    An effect is offered if the equation that shows it first is checked; with `blind`, if that equation is not checked.
    `any_rig`: bounds for rigs of any size; shapes identified from reference trials stay fixed; effects of this bench's
    geometry are omitted. Otherwise effects of an axis recorded in rad are omitted.
    """
    checked = tuple(checked)
    visible = frozenset().union(*(relation.uses(RELATIONS[name]) for name in checked))
    swallowed = {f.name for f in nuisance if math.isinf(f.sigma)}
    taught = {f.name for f in nuisance} - swallowed if any_rig else set()
    found = []
    for effect in CATALOGUE.values():
        if any_rig and any(PARAMETERS[p.name].bench_only for p in effect.parameters if p.name in PARAMETERS):
            continue
        if not any_rig and any(PARAMETERS[p.name].turning for p in effect.parameters if p.name in PARAMETERS):
            continue
        frees = [_free(p, reference, any_rig) for p in effect.parameters
                 if p.name in visible and p.name not in swallowed and (_moves(p, effect) or p.name not in taught)]
        if not any_rig and blind == (effect.relations[0] in checked or _drives_alone(effect, checked)):
            continue
        if frees and any(_moves(p, effect) for p in effect.parameters if p.name in {f.name for f in frees}):
            likely = {} if any_rig else {p.name: p.likely for p in effect.parameters}
            found.append(Candidate(effect.name, effect.site, tuple(frees), _starts(effect, frees, reference), likely,
                                   effect.level, _rivals(effect)))
    return found


def _rivals(effect: Any) -> frozenset[str]:
    return frozenset(effect.rivals) | {e.name for e in CATALOGUE.values() if effect.name in e.rivals}


def _drives_alone(effect: Any, checked: Iterable[str]) -> bool:
    """Whether an effect of the drive is detected in the drive's force because its target is not recorded."""
    return effect.relations[0] == "servo" and len(effect.relations) > 1 and effect.relations[1] in checked


def untold(checked: Iterable[str]) -> list[str]:
    """Return the effects that cannot be named because the equation that shows them first cannot be checked."""
    known = set(checked)
    return [e.name for e in CATALOGUE.values() if e.relations[0] in RELATIONS and e.relations[0] not in known
            and not _drives_alone(e, known) and known & set(e.relations)]


def _moves(parameter: Any, effect: Any) -> bool:
    """Whether a parameter gives the size of an effect: it has a neutral value, or no parameter of the effect has one.

    A shape parameter cannot be tested without the effect's size.
    """
    return parameter.neutral is not None or all(p.neutral is None for p in effect.parameters)


def _free(parameter: Any, reference: Mapping[str, float], any_rig: bool) -> Free:
    low, high = parameter.low, parameter.high
    if any_rig and parameter.name in RELATION_PARAMETERS:
        low, high = RELATION_PARAMETERS[parameter.name].rig_bounds
    at = reference[parameter.name]
    scale = max(abs(parameter.likely[1] - parameter.likely[0]) / 4.0, 1e-9)
    return Free(parameter.name, min(low, at), max(high, at), at, math.inf, scale)


def _starts(effect: Any, frees: Sequence[Free], reference: Mapping[str, float]) -> tuple[Mapping[str, float], ...]:
    names = {f.name for f in frees}
    points = [_points(p, reference[p.name], _moves(p, effect)) for p in effect.parameters if p.name in names]
    grid = [dict(zip([f.name for f in frees], point, strict=True)) for point in itertools.product(*points)]
    grid = [g for g in grid if any(g[f.name] != reference[f.name] for f in frees)]
    step = max(1, math.ceil(len(grid) / MAX_STARTS))
    return tuple(grid[::step])


def _points(parameter: Any, at: float, moves: bool) -> list[float]:
    low, high = parameter.likely
    if not moves:
        if low > 0.0:
            return [math.exp(math.log(low) + t * math.log(high / low)) for t in (0.1, 0.5, 0.9)]
        return [low + t * (high - low) for t in (0.125, 0.375, 0.625, 0.875)]
    if low < at < high:
        return [at + 0.5 * (low - at), at + 0.5 * (high - at)]
    if low > 0.0 and high / low > 10.0:
        return [math.exp(math.log(low) + t * math.log(high / low)) for t in (0.2, 0.6)]
    return [low + 0.4 * (high - low)]
