"""Forward model with the effects of a user's own beside those of the catalogue.

    y = f(q) + Σ a·∂f/∂q_carrier·m(t; p).

The size a and the nonlinear parameters p of each own effect are further constants, fixed at a = 0 in the reference
condition, so that an own effect is a hypothesis like any other.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from estimation.forward_model import ForwardModel
from estimation.likelihood_data import PathRecording
from estimation.modulated_recording import modulated
from estimation.path_model import PathModel
from physics.effects import own_effects
from physics.effects.carriers import PATH_CARRIERS, in_units, needed
from physics.effects.effect import EffectParameter
from physics.effects.hypotheses import Direction, Hypothesis, Variant
from physics.effects.own_effects import OwnEffect
from physics.forward.constant_table import ConstantTable, ModelConstant
from physics.laws import Array


def with_own_effects(model: ForwardModel, names: Sequence[str] = ()) -> ForwardModel:
    """Return the bench's model with the own effects `names` and those of installed packages; any other model as it is.
    """
    own = dict.fromkeys([*own_effects.installed(), *names])
    return OwnEffectsModel([own_effects.OWN[name] for name in own]) if own and isinstance(
        model, PathModel) else model


class OwnEffectsModel(PathModel):
    """The bench's model with the effects `own`; their constants follow the bench's."""

    def __init__(self, own: Sequence[OwnEffect]) -> None:
        self.own, self._count = {each.effect.name: each for each in own}, len(PathModel.constants)
        parameters = [(f"{each.effect.name}.{p.name}", p) for each in own for p in each.effect.parameters]
        self.constants = ConstantTable(
            [*PathModel.constants.rows, *(ModelConstant(name, p.unit, _middle(p), "linear", 0.0, 0.0, p.text,
                                                        step=0.02 * _sd(p)) for name, p in parameters)],
            {**PathModel.constants.bounds, **{name: (p.low, p.high) for name, p in parameters}})
        self.hypotheses = {**PathModel.hypotheses, **{name: _hypothesis(each) for name, each in self.own.items()}}
        self.amounts = {**PathModel.amounts, **{
            f"{each.effect.name}.{name}": (f"{each.effect.name}.size", _sd(each.effect.parameters[0]))
            for each in own for name in each.shape}}

    def predict(self, q: Array, trial: PathRecording) -> Array:
        """Return the predicted data of each column of coordinates `q`, shape (sets, data)."""
        plain = super().predict(q[:self._count], trial)
        for name, each in self.own.items():
            sizes = np.stack([self._value(q, f"{name}.{size}") for size in each.sizes])
            acting = np.flatnonzero(np.any(sizes != 0.0, axis=0))
            if acting.size:
                shape = {key: self._value(q, f"{name}.{key}")[acting] for key in each.shape}
                plain = plain.copy() if plain.base is not None else plain
                plain[acting] += self._added(each, q[:self._count, acting], sizes[:, acting], shape, trial)
        return np.asarray(plain)

    def _value(self, q: Array, name: str) -> Array:
        i = self.constants.index[name]
        low, high = self.constants.bounds[name]
        return np.asarray(np.clip(self.constants.rows[i].middle + q[i], low, high))

    def _added(self, own: OwnEffect, q: Array, sizes: Array, shape: Mapping[str, Array], trial: PathRecording) -> Array:
        """Return the change of the data by one own effect, shape (sets, data); the course is that of the first set."""
        table, row = PathModel.constants, self.constants.index[own.carrier]
        ahead = q.copy()
        ahead[row] += table.step[row]
        both = super().predict(np.concatenate([q, ahead], axis=1), trial)
        units = np.array([in_units(table, column, own.carrier, PATH_CARRIERS[own.carrier]) for column in q.T])
        slopes: Array = (both[q.shape[1]:] - both[:q.shape[1]]) / table.step[row] * units[:, None]
        course, function = modulated(self, q[:, 0], trial), own.function
        if function.depends != "nothing" and getattr(course.course, function.depends) is None:
            return np.zeros_like(slopes)  # a trial without the signal does not show the effect
        known: dict[tuple[float, ...], Array] = {}
        out: Array = np.empty_like(slopes)
        for k in range(q.shape[1]):
            parameters = {key: float(values[k]) for key, values in shape.items()}
            key = tuple(parameters.values())
            if key not in known:
                known[key] = np.tile(course.bins(own.carrier, function, [parameters]).T, len(trial.outputs))
            out[k] = slopes[k] * (sizes[:, k] @ known[key])
        return out

    def simulated_states(self, q: Array, trial: PathRecording) -> Array:
        """Return the states that the discrepancy depends on, without own effects."""
        return super().simulated_states(q[:self._count], trial)

    def course(self, q: Array, trial: PathRecording) -> tuple[Array, Array, Array, Array, Array | None]:
        """Return position, speed, START, END and knee angle on the time grid, without own effects."""
        return super().course(q[:self._count], trial)

    def origin(self, trial: PathRecording) -> Array:
        """Return start coordinates of the first fit; own effects are absent."""
        return np.concatenate([super().origin(trial), np.zeros(len(self.constants) - self._count)])

    def unpredicted(self, q: Array, trial: PathRecording, name: str) -> Array | float:
        """Return the variance of an output's data that no constant predicts."""
        return super().unpredicted(q[:self._count], trial, name)


def _middle(p: EffectParameter) -> float:
    return sum(p.likely) / 2.0 if p.neutral is None else p.neutral


def _sd(p: EffectParameter) -> float:
    """Return the prior 1σ of a parameter: half of its likely range; of a size, the larger end of that range."""
    return (p.likely[1] - p.likely[0]) / 2.0 if p.neutral is None else max(map(abs, p.likely))


def _hypothesis(own: OwnEffect) -> Hypothesis:
    name = own.effect.name
    variant = Variant(tuple(Direction({f"{name}.{p.name}": 1.0}, _sd(p)) for p in own.effect.parameters), {})

    def read(key: str) -> Any:
        return lambda values, bench: values[f"{name}.{key}"]

    return Hypothesis(PATH_CARRIERS[own.carrier].part, lambda values: (variant,),
                      {p.name: read(p.name) for p in own.effect.parameters}, needed(own.carrier))
