"""Result of a law search: terms with their equations, three errors by signal, runners-up, and the confirming motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diagnosis.evidence.decision import SET_SHARE
from diagnosis.evidence.held_out import blocks_of
from diagnosis.laws.law_search import EXPLAINED, MOST_TERMS, WORSE, Candidate, LawSearch
from estimation.data.table import Table
from estimation.likelihood_data import Recording
from estimation.posterior import Observed, PosteriorMode
from estimation.reference_fit import ReferenceFit
from physics.laws import Array
from physics.terms import MODULATIONS, Term

CLOSE_CALL: Final = 0.8
"""Evidence, relative to the best candidate's, from which held-out cycles decide: it is linear, and off by as much."""
TRIED: Final = 3
"""Candidates for one term that are fitted and tested on held-out cycles; each costs about a second."""


class HeldOutErrors(NamedTuple):
    """Residuals of the data, shape (data,), with the session adapted and with the terms, each on held-out cycles."""

    session: Array
    terms: Array


@dataclass(frozen=True)
class SignalErrors:
    """RMS errors of one signal on held-out cycles, in `unit`: reference condition, session adapted, with the terms.

    `gain_percent`: of the terms over the session, with its 95 % `interval` from whole cycles.
    """

    unit: str
    reference: float
    session: float
    named: float
    gain_percent: float
    gain_interval: tuple[float, float]

    def as_json(self) -> dict[str, Any]:
        """Return the errors as JSON values."""
        return {"unit": self.unit, "reference": self.reference, "session": self.session, "named": self.named,
                "gain_percent": self.gain_percent, "gain_interval": list(self.gain_interval)}


@dataclass(frozen=True)
class Picture:
    """Residual of one output against the variable of a term's modulation, each of shape (bins,).

    `residual`: without the term.  `law`: the term's part of the output.
    """

    variable: str
    output: str
    unit: str
    at: Array
    residual: Array
    law: Array


@dataclass(frozen=True)
class Laws:
    """Terms found in the trials of one session; none if no term passes.

    `nats`: linear evidence of each term without the cost of the library.  `nearly`: other candidates for the first
    term, with nats.  `library`: number of candidates.  `rejected`: why found terms were not kept, "" if they were.
    """

    terms: Sequence[Term]
    nats: Sequence[float]
    errors: Mapping[str, SignalErrors]
    nearly: Sequence[tuple[str, float]]
    library: int
    rejected: str = ""
    pictures: Sequence[Picture] = field(default_factory=tuple)

    @property
    def experiment(self) -> str | None:
        """Motion that would confirm the first term: the one in which its modulation shows most."""
        return MODULATIONS[self.terms[0].modulation].confirm if self.terms else None

    def as_json(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        return {"verdict": "law" if self.terms else "none", "terms": [term.as_json() for term in self.terms],
                "nats": list(self.nats), "errors": {name: e.as_json() for name, e in self.errors.items()},
                "nearly": [{"term": name, "nats": nats} for name, nats in self.nearly], "library": self.library,
                "rejected": self.rejected, "experiment": self.experiment}


def discover(reference: ReferenceFit, observed: Observed, tables: Sequence[Table]) -> Laws:
    """Return the terms that extend the model of `reference` in trials of one session.

    `observed`: the trials' data; `tables`: the same trials.  A term is kept if it gains on held-out cycles and worsens
    no signal there by more than `WORSE`; the first one that is not ends the search.
    """
    search = LawSearch(observed, reference.prior_of(observed), reference, blocks_of(tables, observed.trials),
                       _phases(tables, observed.trials))
    chosen, at, errors, runners, rejected = _selected(search)
    return Laws(search.terms(chosen, at), [c.nats for c in chosen], _signal_errors(search, errors),
                _nearly(runners) if chosen else [], search.size, rejected,
                [_picture(search, chosen, at, k) for k in range(len(chosen))])


class _Selected(NamedTuple):
    """Terms that held-out cycles confirm, the mode with them, errors, runners-up of the first, and why no more."""

    terms: list[Candidate]
    at: PosteriorMode
    errors: HeldOutErrors
    runners: list[Candidate]
    fault: str


def _selected(search: LawSearch) -> _Selected:
    """Add terms one after the other while evidence and held-out cycles confirm each.

    Held-out cycles decide between candidates of nearly the same evidence, which is linear and of all cycles.
    """
    chosen: list[Candidate] = []
    at, session, fault = search.base, search.held_out(), ""
    residual, runners = session, list[Candidate]()
    while len(chosen) < MOST_TERMS and not (chosen and _small(search, residual)):
        offers = search.further(chosen, at)
        tried: list[tuple[float, int, list[Candidate], PosteriorMode, Array]] = []
        for offer in [c for c in offers if c.nats >= CLOSE_CALL * offers[0].nats][:TRIED]:
            more = search.swapped([*chosen, offer]) if chosen else [offer]
            there = search.fitted(more)
            then = search.predicted(more, there)
            fault = _fault(search, residual, then, further=bool(chosen))
            if not fault:
                tried.append((float(_weighed(search, then).sum()), len(tried), more, there, then))
        if not tried:
            break
        _, _, more, there, residual = min(tried)
        runners = runners or [c for c in offers if c.shape != more[0].shape and c.nats > SET_SHARE * offers[0].nats]
        chosen, at, fault = more, there, ""
    return _Selected(chosen, at, HeldOutErrors(session, residual), runners, fault)


def _judged(search: LawSearch) -> list[str]:
    return [n for n in search.observed.model.judged if n in search.observed.outputs]


def _small(search: LawSearch, residual: Array) -> bool:
    """Return whether every judged signal's error is below that between reference trials, so that no term can gain it.
    """
    return all(_rms(_squares(search, residual, n)) < search.reference.scatter_n[n] for n in _judged(search))


def _nearly(runners: Sequence[Candidate]) -> list[tuple[str, float]]:
    return [(f"{c.carrier} × {c.modulation}", c.nats) for c in runners]


def _fault(search: LawSearch, before: Array, after: Array, *, further: bool) -> str:
    """Return why a term is not kept, by the residuals on held-out cycles `before` and `after` it; "" if it is.

    A first term must explain a share `EXPLAINED` of a judged signal's error.  A `further` one must lower a squared
    error by that between reference trials.
    """
    sides = {name: [_rms(_squares(search, r, name)) for r in (before, after)] for name in search.observed.outputs}
    worse = [name for name, (first, last) in sides.items() if last > WORSE * first]
    if worse:
        return f"{worse[0]} is predicted worse on held-out cycles"
    if _gain_interval(_weighed(search, before), _weighed(search, after))[0] <= 0.0:
        return "no gain on held-out cycles that whole cycles confirm"
    gains = [(sides[n], search.reference.scatter_n[n]) for n in _judged(search)]
    if further and all(first**2 - last**2 < scatter**2 for (first, last), scatter in gains):
        return "a further term gains less than reference trials miss of each other"
    if not further and all(last > (1.0 - EXPLAINED) * first for (first, last), _ in gains):
        return f"the best term explains less than {100.0 * EXPLAINED:.0f} % of the error"
    return ""


def _rms(squares: Array) -> float:
    total, count = squares.sum(axis=0)
    return float(np.sqrt(total / count))


def _weighed(search: LawSearch, residual: Array) -> NDArray[np.float64]:
    """Return sums of squared errors in noise units of the judged signals, by cycle, shape (cycles, 1)."""
    return np.asarray(sum(_squares(search, residual, n)[:, :1] / _scale(search, n) ** 2 for n in _judged(search)))


def _scale(search: LawSearch, name: str) -> float:
    return max(search.reference.scatter_n[name], 1e-12)


def _squares(search: LawSearch, residual: Array, name: str) -> Array:
    """Return the sum of squared errors of a signal and the number of bins of each cycle, shape (cycles, 2)."""
    rows = []
    for (trial, part), block in zip(search.observed.each(residual), search.blocks, strict=True):
        squares = search.observed.model.errors(trial, part)[name] ** 2
        rows += [(float(squares[block == n].sum()), float((block == n).sum())) for n in np.unique(block)]
    return np.array(rows)


def _gain_interval(before: Array, after: Array, draws: int = 400) -> tuple[float, float]:
    """Return the 95 % interval of the gain, percent, by a bootstrap of whole cycles with so many `draws`."""
    draw = np.random.default_rng(0).integers(0, len(before), (draws, len(before)))
    gains = 100.0 * (1.0 - np.sqrt(after[draw, 0].sum(axis=1) / before[draw, 0].sum(axis=1)))
    low, high = np.percentile(gains, [2.5, 97.5])
    return float(low), float(high)


def _signal_errors(search: LawSearch, errors: HeldOutErrors) -> dict[str, SignalErrors]:
    missed, made = search.reference.missed(search.observed), dict[str, SignalErrors]()
    for name in search.observed.outputs:
        sides = [_squares(search, r, name) for r in (missed, errors.session, errors.terms)]
        rms = [_rms(s) for s in sides]
        gain = 100.0 * (1.0 - rms[2] / rms[1]) if rms[1] > 0.0 else 0.0
        made[name] = SignalErrors(search.observed.model.signals[name], rms[0], rms[1], rms[2], gain,
                                  _gain_interval(sides[1], sides[2]))
    return made


def _picture(search: LawSearch, chosen: Sequence[Candidate], at: PosteriorMode, k: int) -> Picture:
    """Return residual and law of term `k` for the judged output that it changes most."""
    slopes = search.sensitivities(at)
    columns, _ = search.columns(slopes, chosen)
    counts = np.cumsum([0, *(MODULATIONS[c.modulation].components for c in chosen)])
    weights = at.x[at.x.size - counts[-1]:]
    part = columns[:, counts[k]:counts[k + 1]] @ weights[counts[k]:counts[k + 1]]
    trial = search.observed.trials[0]
    first = next(rows for _, rows in search.observed.each(part))
    rest = next(rows for _, rows in search.observed.each(at.residual + part))
    laws, left = (search.observed.model.errors(trial, rows) for rows in (first, rest))
    name = max((n for n in search.observed.model.judged if n in laws), key=lambda n: float(np.std(laws[n])))
    depends = MODULATIONS[chosen[k].modulation].depends
    values = getattr(search.modulated[0].of(chosen[k].carrier), depends if depends != "nothing" else "time_s")
    return Picture(depends if depends != "nothing" else "time_s", name, search.observed.model.signals[name],
                   trial.binned(values), left[name], laws[name])


def _phases(tables: Sequence[Table], trials: Sequence[Recording]) -> list[Array] | None:
    """Return the gait phase of each bin, 0 … 1, by trial; None if the trials have no gait cycles."""
    if not all("cycle" in table or "gait_percent" in table for table in tables):
        return None
    return [_phase(table, trial) for table, trial in zip(tables, trials, strict=True)]


def _phase(table: Table, trial: Recording) -> Array:
    time = table["time_s"]
    if "gait_percent" in table:
        phase = np.asarray(table["gait_percent"] / 100.0 % 1.0)
    else:
        number = np.floor(np.nan_to_num(table["cycle"]))
        _, first, count = np.unique(number, return_index=True, return_counts=True)
        phase = np.concatenate([np.arange(n) / n for n in count[np.argsort(first)]])
    at = np.searchsorted(time, trial.binned(trial.time_s) + time[0])
    return np.asarray(phase[np.minimum(at, time.size - 1)])
