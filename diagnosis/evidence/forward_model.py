"""What the evidence core needs of a forward model: constants, recordings, predicted data, states, effects.

One instance is the bench's force path (`path_model`).  Everything above this module reads the model that it is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from diagnosis.data.table import Table
from diagnosis.evidence.likelihood_data import Recording
from physics.constant_table import ConstantTable
from physics.effects.hypotheses import Hypothesis
from physics.laws import Array


class ForwardModel(Protocol):
    """A forward model: its table of constants and the effects that move them, by name of the catalogue.

    `signals`: every output that the model can have, with its unit.  `judged`: outputs whose error the headline gives.
    `least`: least 1σ of the model error of a bin by output.  `first_noise`: noise of the coarse and of the fine stage
    of the first fit, by output.  `regressed`: constants whose population middle is taken from the first reference
    trial itself, since any value is as likely.  `states`: number of states of the discrepancy; `load_state`: row of
    that by whose quarters the model error is estimated.  `session_share`: 1σ of the discrepancy's change between
    sessions, of the discrepancy.  `pools_sessions`: the reference trials estimate how far sessions lie apart, beside
    `session_at`.  `nats_factor`: of the bench's detection threshold.  `unlike_share`: share of the first judged
    output's spread that the model may miss of reference trials; beyond, they are of another rig.  `amounts`: for a
    constant that moves nothing where another one is zero, that one's name and a value.
    """

    @property
    def constants(self) -> ConstantTable: ...
    @property
    def hypotheses(self) -> Mapping[str, Hypothesis]: ...
    @property
    def signals(self) -> Mapping[str, str]: ...
    @property
    def judged(self) -> Sequence[str]: ...
    @property
    def least(self) -> Mapping[str, float]: ...
    @property
    def first_noise(self) -> tuple[Mapping[str, float], Mapping[str, float]]: ...
    @property
    def regressed(self) -> Sequence[str]: ...
    @property
    def states(self) -> int: ...
    @property
    def load_state(self) -> int: ...
    @property
    def pools_sessions(self) -> bool: ...
    @property
    def session_share(self) -> float: ...
    @property
    def nats_factor(self) -> float: ...
    @property
    def unlike_share(self) -> float: ...
    @property
    def amounts(self) -> Mapping[str, tuple[str, float]]: ...

    def lacking(self, table: Table) -> list[str]:
        """Return the columns without which no likelihood can be formed and that a trial does not have."""

    def limits(self, effect: str, parameter: str) -> tuple[float, float, str]:
        """Return the bounds and the unit of an effect's parameter."""

    def record(self, table: Table) -> Any:
        """Return the trial as this model reads it, a `Recording`."""

    def sessions(self, recordings: Any) -> Any:
        """Return the reference recordings by session, each as one recording."""

    def predict(self, q: Array, trial: Any) -> Array:
        """Return the predicted data of each column of coordinates `q`, shape (sets, data)."""

    def simulated_states(self, q: Array, trial: Any) -> Array:
        """Return the states that the discrepancy depends on, shape (states, bins), simulated at coordinates `q`."""

    def origin(self, trial: Any) -> Array:
        """Return coordinates to start from, by regression."""

    def scanned(self, middle: Array, trial: Any) -> list[Array]:
        """Return coordinates about `middle` at which the first fit starts."""

    def session_at(self, q: Array) -> Array:
        """Return 1σ between sessions by constant, in coordinates, of a bench whose coordinates are `q`."""

    def growth(self, trial: Any, name: str) -> float:
        """Return the factor of the model error's variance of a trial whose signals are larger than the reference's."""

    def aliased(self, q: Array, trial: Any, name: str) -> Array | float:
        """Return the variance of an output's data that sampling has made noise of."""

    def errors(self, trial: Any, residual: Array) -> dict[str, Array]:
        """Return by output the errors of the signals that a residual of the data means."""


def predicted(model: ForwardModel, q: Array, trial: Recording) -> Array:
    """Return the predicted data of one coordinate vector."""
    return np.asarray(model.predict(q[:, None], trial)[0])


def jacobian(model: ForwardModel, q: Array, trial: Recording, free: Sequence[int]) -> tuple[Array, Array]:
    """Return the predicted data at `q` and their derivatives by the coordinates `free`, shape (data, free)."""
    sets = np.repeat(q[:, None], len(free) + 1, axis=1)
    step = model.constants.step[list(free)]
    sets[list(free), np.arange(1, len(free) + 1)] += step
    data = model.predict(sets, trial)
    return data[0], np.ascontiguousarray(((data[1:] - data[0]) / step[:, None]).T)
