"""Base of a forward model in the diagnosis by evidence: constants, recordings, predicted data, states, effects.

Implementations: the force path of the bench (`path_model`) and a rig of another kind (`rig_model`).
"""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import Any

import numpy as np

from estimation.data.table import Table
from estimation.likelihood_data import Recording
from physics.effects.hypotheses import Hypothesis
from physics.forward.constant_table import ConstantTable
from physics.laws import Array


class ForwardModel(ABC):
    """A forward model: `constants`, and `hypotheses`, the effects that change them, by name of the catalogue.

    `signals`: every output that the model can have, with its unit.  `judged`: outputs whose error the headline gives.
    `least`: least 1σ of the model error of a bin, by output.  `first_noise`: 1σ of the noise in the first fit, by
    output.  `regressed`: constants whose population middle is set to the first
    reference trial's value, since any value is equally likely.

    `states`: number of states of the discrepancy.  `load_state`: row of the state whose quartiles divide the data for
    the estimate of the model error.  `session_share`: 1σ of the discrepancy's change between sessions, relative to the
    discrepancy.  `scattered`: constants whose scatter between sessions is estimated from the reference trials, with
    `session_at` as prior.  `structural`: constants that scatter between sessions because the bench's equations are not
    the model's; how far is weighed by the reference trials (`session_priors`).  Of a rig all
    `scattered` ones are.  `surrogate_sd`: 1σ between benches, in a fit of reference trials, of constants that are
    surrogates for model error, too.

    `pools_sessions`: trials of unlike condition are one session.  `unseen`: growth of the session deviation, and of the
    detection threshold, with the motion that the reference trials do not have.  `extrapolated`: constants of equations
    that motion and load enter, whose session deviation grows so, as that of the judged outputs' discrepancy does.

    `session_shares`: 1σ of a further change of the discrepancy between sessions, relative to it, over which the
    evidence is averaged (`diagnosis.evidence.session_change`).

    `nats_factor`: detection threshold relative to the bench's.  `unlike_share`: largest error on the reference trials,
    relative to the spread of the first judged output; above it they are of another rig.  `amounts`: for a constant
    without effect while another constant is zero, name of that other constant and a value to add to its coordinate.
    """

    constants: ConstantTable
    hypotheses: Mapping[str, Hypothesis]
    signals: Mapping[str, str]
    judged: Sequence[str]
    least: Mapping[str, float]
    first_noise: Mapping[str, float]
    regressed: Sequence[str]
    states: int
    load_state: int
    scattered: Sequence[str] = ()
    structural: Sequence[str] = ()
    surrogate_sd: Mapping[str, float] = MappingProxyType({})
    pools_sessions: bool = False
    session_share: float
    unseen: float = 0.0
    extrapolated: Sequence[str] = ()
    session_shares: Sequence[float] = (0.0,)
    nats_factor: float = 1.0
    unlike_share: float
    amounts: Mapping[str, tuple[str, float]]

    @abstractmethod
    def lacking(self, table: Table) -> list[str]:
        """Return the columns that the likelihood needs and that a trial does not have."""

    @abstractmethod
    def limits(self, effect: str, parameter: str) -> tuple[float, float, str]:
        """Return the bounds and the unit of an effect's parameter."""

    @abstractmethod
    def record(self, table: Table) -> Any:
        """Return a trial as a `Recording` with the data of this model."""

    @abstractmethod
    def predict(self, q: Array, trial: Any) -> Array:
        """Return the predicted data of each column of coordinates `q`, shape (sets, data)."""

    @abstractmethod
    def simulated_states(self, q: Array, trial: Any) -> Array:
        """Return the states that the discrepancy depends on, shape (states, bins), simulated at coordinates `q`."""

    @abstractmethod
    def course(self, q: Array, trial: Any) -> tuple[Array, Array, Array, Array, Array | None]:
        """Return position, m, speed, m/s, loads at START and END, N, and joint angle, rad, at every time of the trial.

        A load is simulated with coordinates `q` if the model predicts it, else measured. A rig without a joint has no
        joint angle (None).
        """

    def motion(self, trial: Any) -> Array:
        """Return the signals whose range in the reference trials a trial should not exceed, shape (signals, bins)."""
        return np.zeros((0, 1))

    @abstractmethod
    def origin(self, trial: Any) -> Array:
        """Return start coordinates of the first fit, by regression."""

    @abstractmethod
    def scanned(self, middle: Array, trial: Any) -> list[Array]:
        """Return start coordinates of the first fit about `middle`, the one with the smallest error first."""

    def sessions(self, recordings: Sequence[Any]) -> list[Any]:
        """Return the reference recordings grouped by session; each trial is one session unless overridden."""
        return list(recordings)

    def session_at(self, q: Array) -> Array:
        """Return 1σ between sessions of each constant, in coordinates, of a bench at coordinates `q`."""
        return self.constants.session_sd

    def growth(self, trial: Any, name: str, signal: Array) -> float:
        """Return the factor, at least 1, on the model error's variance if the `signal` of an output, shape (bins,),
        exceeds that of the reference trials; 1 for a bench, whose gaits differ little in their peak forces."""
        return 1.0

    def changing(self, trial: Any, name: str, signal: Array) -> float:
        """Return the variance of the part of an output, shape (bins,), that the model error is proportional to.

        It is constant for a bench, since no change of the bench makes its forces several times as large.
        """
        return 1.0

    def unpredicted(self, q: Array, trial: Any, name: str) -> Array | float:
        """Return the variance of an output's data that no constant predicts, by bin or for all bins.

        It is infinite for a datum that does not count.
        """
        return 0.0

    def errors(self, trial: Any, residual: Array) -> dict[str, Array]:
        """Return the error of each output signal, by output, that corresponds to a residual of the data."""
        return {name: trial.part(residual, k) for k, name in enumerate(trial.outputs)}

    def weighed(self, trial: Any, errors: Mapping[str, Array]) -> Array:
        """Return the error of the data that corresponds to `errors` of the output signals, the inverse of `errors`."""
        return np.concatenate([errors[name] for name in trial.outputs])


_STEP: ContextVar[Callable[[], None] | None] = ContextVar("_STEP", default=None)


@contextmanager
def steps_counted(report: Callable[[int], None]) -> Iterator[None]:
    """Report progress of every fit in this context: each step calls `report` with the number of steps taken so far.

    The total is unknown beforehand, since a fit ends when it converges. `step_taken` defines a step.
    """
    numbers = itertools.count(1)
    token = _STEP.set(lambda: report(next(numbers)))
    try:
        yield
    finally:
        _STEP.reset(token)


def step_taken() -> None:
    """Count one step of a fit: a linearised trial, or one simulation of all trials."""
    tell = _STEP.get()
    if tell is not None:
        tell()


def predicted(model: ForwardModel, q: Array, trial: Recording) -> Array:
    """Return the predicted data of one coordinate vector."""
    return np.asarray(model.predict(q[:, None], trial)[0])


def jacobian(model: ForwardModel, q: Array, trial: Recording, free: Sequence[int], most: int = 250_000
             ) -> tuple[Array, Array]:
    """Return the predicted data at `q` and their derivatives by the coordinates `free`, shape (data, free).

    `most`: data of all sets that are simulated at once, which bounds the memory to some ten times their 2 MB.
    """
    step_taken()
    step, count = model.constants.step[list(free)], max(8, most // trial.data.size)
    # the unmoved set comes first: the others differ from it by one constant each, which makes a good first guess
    sets = np.repeat(q[:, None], len(free) + 1, axis=1)
    sets[list(free), np.arange(1, sets.shape[1])] += step
    data, *moved = np.concatenate([model.predict(sets[:, at:at + count], trial)
                                   for at in range(0, sets.shape[1], count)])
    return data, np.ascontiguousarray(((np.stack(moved) - data) / step[:, None]).T)
