"""Selection of terms by evidence: screen of the library, refinement, joint refit, swaps, held-out errors.

Screens, refinements and folds are linear in constants and discrepancy (`linear_model`); fits with terms simulate.

A term is a candidate of a library of N; its prior probability is 1/N, which costs ln N nats.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diagnosis.evidence.decision import DOUBTED, NAMED_NATS, departure
from diagnosis.laws.library import VIBRATING, Candidates, candidates, carriers_of
from diagnosis.laws.linear_model import FoldedModel, LinearModel
from diagnosis.laws.model_error import ModelErrors
from estimation.likelihood_data import Recording
from estimation.modulated_recording import ModulatedRecording, modulated
from estimation.posterior import Gaussian, PosteriorMode, SessionData, begun, mode, screened
from estimation.reference_fit import ReferenceFit
from physics.effects.carriers import in_units
from physics.effects.hypotheses import Variant
from physics.laws import Array
from physics.terms import MODULATIONS, Carrier, Term

MOST_TERMS: Final = 3
"""Largest number of terms; a bench with four changes at once is better recorded again than explained."""
REFINED: Final = 6
"""Candidates of a screen whose nonlinear parameters are refined, each of another modulation or carrier."""
FOLDS: Final = 5
"""Folds of cycles for held-out errors; each fold is predicted by a fit to the others."""
WORSE: Final = 1.05
"""Largest held-out RMS error of an output with terms, relative to that with the session adapted."""


class Candidate(NamedTuple):
    """A candidate term with its linear evidence, nats, without the cost of the library's size."""

    nats: float
    carrier: str
    modulation: str
    parameters: Mapping[str, float]

    @property
    def shape(self) -> tuple[str, str]:
        """Carrier and modulation, whatever the parameters."""
        return self.carrier, self.modulation


@dataclass
class LawSearch:
    """Search of terms in the trials of one session, from the fit `base` of constants and discrepancy.

    `blocks`: cycle number of each bin, by trial.  `references`: recordings of the reference trials.
    `variants`: effects of the catalogue that stand beside the terms.
    `departed`: departure of the session in `base`.  `errors`: errors of the model, which stand beside the terms, too.
    `first`: mode where the first term is sought, and whose courses modulate: the reference condition if the session's
    constants are outside their scatter, since they then hide the form of the change that they absorbed, else `base`.
    """

    observed: SessionData
    prior: Gaussian
    reference: ReferenceFit
    blocks: Sequence[NDArray[np.intp]]
    references: Sequence[Recording]
    variants: Sequence[Variant] = ()
    base: PosteriorMode = field(init=False)
    departed: float = field(init=False)
    first: PosteriorMode = field(init=False)
    errors: ModelErrors = field(init=False)
    carriers: dict[str, Carrier] = field(init=False)
    modulated: list[ModulatedRecording] = field(init=False)
    library: Candidates = field(init=False)

    def __post_init__(self) -> None:
        """Fit the session without terms, and lay out the library on the courses of its trials."""
        starts = [self.prior.mean, *self.reference.starts()]
        self.base = max((mode(self.observed, self.prior, start=at) for at in starts),
                        key=lambda m: m.log_evidence)
        for count, variant in enumerate(self.variants):
            sizes = screened(self.base, self.observed, variant)[1]
            start = begun(self.base, variant, sizes, self.variants[:count])
            self.base = mode(self.observed, self.prior, self.variants[:count + 1], start)
        self.departed = departure(self.observed, self.base)
        self.first = self.base if self.variants or self.departed <= DOUBTED else mode(
            self.observed, self.prior, start=self.prior.mean, descends=False)
        self.errors = ModelErrors(self.observed, self.prior, self.reference, self.blocks, self.references)
        model = self.observed.model
        self.modulated = [modulated(model, self.first.q, trial) for trial in self.observed.trials]
        self.carriers = carriers_of(model, self.observed.outputs)
        self.library = candidates(self.modulated[0].course)

    @property
    def size(self) -> int:
        """Number of candidates of the library."""
        return self.library.size(len(self.carriers), len(VIBRATING & self.carriers.keys()))

    # -- columns -----------------------------------------------------------------------------------------------------

    def sensitivities(self, at: PosteriorMode) -> dict[str, Array]:
        """Return ∂f/∂a of each carrier at a mode, shape (data,), per unit of a term's coefficient."""
        table, names = at.table, list(self.carriers)
        rows = [table.index[name] for name in names]
        q = at.q.copy()
        q[rows] = table.lifted(q)[rows]
        _, slopes = self.observed.jacobian(q, rows)
        return {name: slopes[:, k] * in_units(table, q, name, self.carriers[name]) for k, name in enumerate(names)}

    def shapes(self, carrier: str, name: str, grid: Sequence[Mapping[str, float]]) -> Array:
        """Return the components of a modulation of a carrier over all data, shape (data, sets · components).

        `grid`: sets of its parameters.
        """
        outputs = len(self.observed.outputs)
        return np.concatenate([np.tile(trial.bins(carrier, MODULATIONS[name], grid), (outputs, 1))
                               for trial in self.modulated])

    def columns(self, slopes: Mapping[str, Array], chosen: Sequence[Candidate]) -> tuple[Array, Array]:
        """Return the columns of terms, shape (data, components), and their prior 1σ, shape (components,)."""
        parts = [slopes[c.carrier][:, None] * self.shapes(c.carrier, c.modulation, [c.parameters]) for c in chosen]
        sds = [np.full(part.shape[1], self.carriers[c.carrier].sd) for c, part in zip(chosen, parts, strict=True)]
        empty = np.zeros((self.observed.data.size, 0))
        return np.concatenate([empty, *parts], axis=1), np.concatenate([np.zeros(0), *sds])

    # -- fits --------------------------------------------------------------------------------------------------------

    def fitted(self, chosen: Sequence[Candidate], at: PosteriorMode | None = None) -> PosteriorMode:
        """Return the joint mode of constants, discrepancy and the coefficients of terms, which are its last entries.

        `at`: mode where the fit starts and the terms' columns are linearised; its coefficients are of the first terms.
        None: the likelier of the fits from `base` and from `first`.
        """
        if at is None:
            starts = [self.base] if self.first is self.base else [self.base, self.first]
            return max((self.fitted(chosen, start) for start in starts), key=lambda m: m.log_evidence)
        columns, sds = self.columns(self.sensitivities(at), chosen)
        whole = replace(self.observed, features=np.concatenate([self.observed.features, columns], axis=1))
        start = np.zeros(self.base.x.size + sds.size)
        start[:at.x.size] = at.x
        return mode(whole, _extended(self.prior, sds), self.variants, start)

    def folded(self, at: PosteriorMode, chosen: Sequence[Candidate] = ()) -> FoldedModel:
        """Return the data linearised at a mode with the terms `chosen`, whose columns are left out."""
        fold = np.concatenate([np.tile(b % FOLDS, len(self.observed.outputs)) for b in self.blocks])
        return FoldedModel(at, fold, _components(chosen))

    # -- screen and refinement -----------------------------------------------------------------------------------------

    def screened(self, model: LinearModel, slopes: Mapping[str, Array]) -> list[Candidate]:
        """Return the candidates of the library by linear evidence, the best first; `slopes`: `sensitivities`."""
        rated: list[Candidate] = []
        for name, grid in self.library.grids.items():
            count = MODULATIONS[name].components
            for part in _chunks(grid):
                shapes = {}
                for carrier, slope in slopes.items():
                    if name == "time_sine" and carrier not in VIBRATING:
                        continue
                    end = carrier.startswith("end_") and MODULATIONS[name].depends == "tension_n"
                    if end not in shapes:
                        shapes[end] = self.shapes(carrier, name, part)
                    nats = model.evidence(slope[:, None] * shapes[end], self.carriers[carrier].sd, count)
                    rated += [Candidate(float(n), carrier, name, p) for n, p in zip(nats, part, strict=True)]
        return sorted(rated, key=lambda c: -c.nats)

    def refined(self, candidate: Candidate, model: LinearModel, slopes: Mapping[str, Array], close: float = 0.02,
                most: int = 15, tie: float = 0.05) -> Candidate:
        """Return a candidate with the nonlinear parameters of the largest evidence near its own.

        A pattern of points about the best one moves, and contracts where none at its edge is better (Hooke and Jeeves
        1961).  `close`: share of its first size at which it ends; `most`: rounds.  `tie`: difference, nats, below which
        the nearer point is better.
        """
        names, share, count = list(candidate.parameters), 1.0, MODULATIONS[candidate.modulation].components
        carrier, name = candidate.carrier, candidate.modulation
        scale = np.array([self._scale(candidate, one) for one in names])
        # the nearest point wins a tie: where no data are, the time of a step does not matter
        points = itertools.product((0.0, -0.5, 0.5, -1.0, 1.0), repeat=len(names))
        pattern = np.array(sorted(points, key=np.linalg.norm))
        signed = np.array([one in ("at_m", "at_rad", "phase") for one in names], np.bool_)
        best = candidate._replace(nats=-math.inf)
        for _ in range(most):
            middle = np.array([best.parameters[one] for one in names])
            near = middle + share * scale * pattern
            near = near[((near > 0.0) | signed).all(axis=1)]
            grid = [dict(zip(names, point, strict=True)) for point in near.tolist()]
            nats = model.evidence(slopes[carrier][:, None] * self.shapes(carrier, name, grid),
                                  self.carriers[carrier].sd, count)
            top = int(np.argmax(nats > nats.max() - tie))
            better = bool(nats[top] > best.nats + tie)
            far = better and (np.abs(near[top] - middle) > 0.7 * share * scale).any()
            best = candidate._replace(nats=float(nats[top]), parameters=grid[top]) if better else best
            share *= 1.0 if far else 0.4
            if not names or share <= close:
                break
        return best

    def _scale(self, candidate: Candidate, name: str) -> float:
        """Return the distance of the library's grid in a parameter, about which a refinement begins."""
        values = np.unique([p[name] for p in self.library.grids[candidate.modulation]])
        steps = np.diff(values)
        return 0.5 * float(steps.min()) if steps.size else 0.3 * candidate.parameters[name]

    def best_of(self, model: LinearModel, slopes: Mapping[str, Array], exclude: Sequence[Candidate] = ()
                ) -> list[Candidate]:
        """Return the foremost candidates, refined, the best first; `exclude`: terms already chosen."""
        rated = list[Candidate]()
        for candidate in self.screened(model, slopes):
            if candidate.shape not in {c.shape for c in (*rated, *exclude)}:
                rated.append(candidate)
            if len(rated) == REFINED:
                break
        return sorted((self.refined(c, model, slopes) for c in rated), key=lambda c: -c.nats)

    # -- selection -----------------------------------------------------------------------------------------------------

    def further(self, chosen: Sequence[Candidate], at: PosteriorMode) -> list[Candidate]:
        """Return the candidates for one more term whose evidence exceeds `NAMED_NATS` and the cost of the library."""
        slopes = self.sensitivities(at)
        offers = self.best_of(self._beside(at, chosen, chosen, slopes), slopes, chosen)
        return [c for c in offers if c.nats >= NAMED_NATS + math.log(self.size)]

    def swapped(self, chosen: list[Candidate], at: PosteriorMode, least: float = 2.0) -> list[Candidate]:
        """Return the terms after replacing the first one if a candidate beside the others exceeds it by `least` nats.

        `at`: mode with all terms but the last.
        """
        others, slopes = chosen[1:], self.sensitivities(at)
        beside = self._beside(at, chosen[:-1], others, slopes)
        own, offers = self.refined(chosen[0], beside, slopes), self.best_of(beside, slopes, others)
        if not offers or offers[0].shape == own.shape or offers[0].nats < own.nats + least:
            return chosen
        return [*others, offers[0]]

    def _beside(self, at: PosteriorMode, fitted: Sequence[Candidate], others: Sequence[Candidate],
                slopes: Mapping[str, Array]) -> LinearModel:
        """Return the linear model of all data at the mode `at`, which has the terms `fitted`, with the terms `others`.

        It has the model's errors, too: what they may be has little evidence.
        """
        columns, sds = self.columns(slopes, others)
        return self.folded(at, fitted).model(np.concatenate([columns * sds, self.errors.columns], axis=1))

    # -- held-out errors -----------------------------------------------------------------------------------------------

    def predicted(self, chosen: Sequence[Candidate], at: PosteriorMode, simulates: bool = False) -> Array:
        """Return the residual of the data on held-out cycles with terms, shape (data,).

        `at`: the mode with them.  The nonlinear parameters are refined for each fold without its data.  Constants,
        discrepancy and coefficients are then fitted to the model linearised at the mode, or to the model itself if it
        `simulates`: where the session is far from the reference condition, linear folds are off by some per cent.
        """
        folded, slopes = self.folded(at, chosen), self.sensitivities(at) if chosen else {}
        residual = np.zeros(self.observed.data.size)
        for number in folded.squares:
            columns, sds = self.columns(slopes, self._refined_for(chosen, folded, number, slopes))
            out = folded.fold == number
            if simulates:
                seen = replace(self.observed, features=np.concatenate([self.observed.features, columns], axis=1),
                               weight=np.where(out, 1e-9, self.observed.weight))
                whole = mode(seen, _extended(self.prior, sds), self.variants, at.x).residual
            else:
                whole = folded.model(columns * sds, number).residual
            residual[out] = whole[out]
        return residual

    def _refined_for(self, chosen: Sequence[Candidate], folded: FoldedModel, number: int, slopes: Mapping[str, Array]
                     ) -> list[Candidate]:
        """Return the terms with parameters refined on the data outside a fold, one after the other."""
        done = list(chosen)
        for k, candidate in enumerate(done):
            if candidate.parameters:
                columns, sds = self.columns(slopes, done[:k] + done[k + 1:])
                done[k] = self.refined(candidate, folded.model(columns * sds, number), slopes)
        return done

    def terms(self, chosen: Sequence[Candidate], at: PosteriorMode) -> list[Term]:
        """Return the chosen terms with the coefficients and 95 % intervals of the mode `at`."""
        place = at.x.size - _components(chosen)
        made = []
        for c in chosen:
            coefficients, intervals = [], []
            for _ in range(MODULATIONS[c.modulation].components):
                gradient = np.zeros(at.x.size)
                gradient[place] = 1.0
                value, half = float(at.x[place]), 1.96 * at.sd(gradient)
                coefficients.append(value)
                intervals.append((value - half, value + half))
                place += 1
            carrier = self.carriers[c.carrier]
            made.append(Term(c.carrier, c.modulation, dict(c.parameters), tuple(coefficients), tuple(intervals),
                             carrier.unit, carrier.part, carrier.words))
        return made


def _extended(prior: Gaussian, sds: Array) -> Gaussian:
    """Return a prior with further, independent entries of mean 0 and 1σ `sds`."""
    size = prior.mean.size
    covariance = np.zeros((size + sds.size, size + sds.size))
    covariance[:size, :size] = prior.covariance
    covariance[range(size, size + sds.size), range(size, size + sds.size)] = sds**2
    return replace(prior, mean=np.concatenate([prior.mean, np.zeros(sds.size)]), covariance=covariance)


def _components(chosen: Sequence[Candidate]) -> int:
    """Return the number of coefficients of terms."""
    return sum(MODULATIONS[c.modulation].components for c in chosen)


def _chunks(grid: Sequence[dict[str, float]], size: int = 128) -> Iterator[Sequence[dict[str, float]]]:
    """Yield a grid in parts, which bound the memory of a screen."""
    for first in range(0, len(grid), size):
        yield grid[first:first + size]
