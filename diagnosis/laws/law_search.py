"""Selection of terms by evidence: screen of the library, refinement, joint refit, swaps, held-out errors.

    ln B = ½ gᵀ(σ⁻²I + G)⁻¹g − ½ ln det(I + σ²G),   g = XᵀC⁻¹e,  G = XᵀC⁻¹X.

e: residual of the fit.  C: covariance of the data under it.  X: columns of a term.  σ: prior 1σ of its coefficients.

    C⁻¹ = W − W A(I + AᵀWA)⁻¹AᵀW,   A = HL    (Woodbury's identity).

A term is a candidate of a library of N; its prior probability is 1/N, which costs ln N nats.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize

from diagnosis.evidence.decision import DOUBTED, NAMED_NATS, departure
from diagnosis.laws.library import VIBRATING, Candidates, candidates, carriers_of
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

    `blocks`: cycle number of each bin, by trial.  `variants`: effects of the catalogue that stand beside the terms.
    `departed`: departure of the session in `base`.  `first`: mode where the first term is sought, and whose courses
    modulate: the reference condition if the session's constants are outside their scatter, since they then hide the
    form of the change that they absorbed, else `base`.
    """

    observed: SessionData
    prior: Gaussian
    reference: ReferenceFit
    blocks: Sequence[NDArray[np.intp]]
    variants: Sequence[Variant] = ()
    base: PosteriorMode = field(init=False)
    departed: float = field(init=False)
    first: PosteriorMode = field(init=False)
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

    def shapes(self, carrier: str, name: str, parameters: Mapping[str, float]) -> Array:
        """Return the components of a modulation of a carrier over all data, shape (data, components)."""
        parts = []
        for trial in self.modulated:
            rows = np.stack(trial.bins(carrier, MODULATIONS[name], parameters), axis=1)
            parts.append(np.tile(rows, (len(self.observed.outputs), 1)))
        return np.concatenate(parts)

    def columns(self, slopes: Mapping[str, Array], chosen: Sequence[Candidate]) -> tuple[Array, Array]:
        """Return the columns of terms, shape (data, components), and their prior 1σ, shape (components,)."""
        parts = [slopes[c.carrier][:, None] * self.shapes(c.carrier, c.modulation, c.parameters)
                 for c in chosen]
        sds = [np.full(part.shape[1], self.carriers[c.carrier].sd) for c, part in zip(chosen, parts, strict=True)]
        empty = np.zeros((self.observed.data.size, 0))
        return np.concatenate([empty, *parts], axis=1), np.concatenate([np.zeros(0), *sds])

    # -- fits --------------------------------------------------------------------------------------------------------

    def fitted(self, chosen: Sequence[Candidate], observed: SessionData | None = None, at: PosteriorMode | None = None,
               passes: int = 2) -> PosteriorMode:
        """Return the joint mode of constants, discrepancy and the coefficients of terms, which are its last entries.

        `at`: mode where the fit starts and its columns are linearised; each of the `passes` linearises them anew.
        None: the likelier of the fits from `base` and from `first`.
        """
        observed = observed or self.observed
        if at is None:
            starts = [self.base] if self.first is self.base else [self.base, self.first]
            return max((self.fitted(chosen, observed, start, passes) for start in starts),
                       key=lambda m: m.log_evidence)
        plain = self.base.x.size
        for _ in range(passes if chosen else 1):
            columns, sds = self.columns(self.sensitivities(at), chosen)
            whole = replace(observed, features=np.concatenate([self.observed.features, columns], axis=1))
            prior = _extended(self.prior, sds)
            start = np.concatenate([at.x[:plain], np.zeros(sds.size)])
            start[plain:][:at.x.size - plain] = at.x[plain:][:sds.size]
            at = mode(whole, prior, self.variants, start)
        return at

    # -- screen and refinement -----------------------------------------------------------------------------------------

    def screened(self, at: PosteriorMode) -> list[Candidate]:
        """Return the candidates of the library by linear evidence at the mode `at`, the best first."""
        metric, slopes = _Metric(at), self.sensitivities(at)
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
                        shapes[end] = np.concatenate([self.shapes(carrier, name, p) for p in part], axis=1)
                    nats = metric.evidence(slope[:, None] * shapes[end], self.carriers[carrier].sd, count)
                    rated += [Candidate(float(n), carrier, name, p) for n, p in zip(nats, part, strict=True)]
        return sorted(rated, key=lambda c: -c.nats)

    def refined(self, candidate: Candidate, at: PosteriorMode, slopes: Mapping[str, Array]) -> Candidate:
        """Return a candidate with the nonlinear parameters of the largest evidence near its own (Nelder and Mead 1965).
        """
        names = list(candidate.parameters)
        if not names:
            return candidate
        metric, count = _Metric(at), MODULATIONS[candidate.modulation].components
        first = np.array([candidate.parameters[name] for name in names])
        scale = np.array([self._scale(candidate, name) for name in names])

        def cost(move: Array) -> float:
            parameters = dict(zip(names, (first + move * scale).tolist(), strict=True))
            if any(value <= 0.0 and name not in ("at_m", "at_rad", "phase") for name, value in parameters.items()):
                return 1e9
            columns = slopes[candidate.carrier][:, None] * self.shapes(
                candidate.carrier, candidate.modulation, parameters)
            return -float(metric.evidence(columns, self.carriers[candidate.carrier].sd, count)[0])

        simplex = np.concatenate([np.zeros((1, scale.size)), np.eye(scale.size)])
        best = minimize(cost, np.zeros(scale.size), method="Nelder-Mead",
                        options={"initial_simplex": simplex, "maxfev": 30 * scale.size, "xatol": 0.02, "fatol": 0.05})
        if -best.fun <= candidate.nats:
            return candidate
        moved = dict(zip(names, (first + best.x * scale).tolist(), strict=True))
        return candidate._replace(nats=-float(best.fun), parameters=moved)

    def _scale(self, candidate: Candidate, name: str) -> float:
        """Return the distance of the library's grid in a parameter, about which a refinement begins."""
        values = np.unique([p[name] for p in self.library.grids[candidate.modulation]])
        steps = np.diff(values)
        return 0.5 * float(steps.min()) if steps.size else 0.3 * candidate.parameters[name]

    def best_of(self, at: PosteriorMode, exclude: Sequence[Candidate] = ()) -> list[Candidate]:
        """Return the foremost candidates at a mode, refined, the best first; `exclude`: terms already chosen."""
        slopes, rated = self.sensitivities(at), list[Candidate]()
        for candidate in self.screened(at):
            if candidate.shape not in {c.shape for c in rated} and candidate.shape not in {c.shape for c in exclude}:
                rated.append(candidate)
            if len(rated) == REFINED:
                break
        return sorted((self.refined(c, at, slopes) for c in rated), key=lambda c: -c.nats)

    # -- selection -----------------------------------------------------------------------------------------------------

    def further(self, chosen: Sequence[Candidate], at: PosteriorMode) -> list[Candidate]:
        """Return the candidates for one more term whose evidence exceeds `NAMED_NATS` and the cost of the library."""
        return [c for c in self.best_of(at, chosen) if c.nats >= NAMED_NATS + math.log(self.size)]

    def swapped(self, chosen: list[Candidate], least: float = 2.0) -> list[Candidate]:
        """Return the terms after replacing the first one if a candidate beside the others exceeds it by `least` nats.
        """
        others = chosen[1:]
        beside = self.fitted(others, passes=1)
        own = self.refined(chosen[0]._replace(nats=-math.inf), beside, self.sensitivities(beside))
        offers = self.best_of(beside, others)
        if not offers or offers[0].shape == own.shape or offers[0].nats < own.nats + least:
            return chosen
        return [*others, offers[0]]

    # -- held-out errors -----------------------------------------------------------------------------------------------

    def held_out(self) -> Array:
        """Return the residual of the data on held-out cycles with the session adapted and no term, shape (data,)."""
        return self.by_fold(lambda seen: mode(seen, self.prior, self.variants, self.base.x))

    def predicted(self, chosen: Sequence[Candidate], at: PosteriorMode) -> Array:
        """Return the residual of the data on held-out cycles with terms, shape (data,).

        `at`: the mode with them.  The nonlinear parameters are refined for each fold without its data.
        """
        return self.by_fold(lambda seen: self.fitted(self._refined_for(chosen, at, seen), seen, at, passes=1))

    def by_fold(self, fit: Callable[[SessionData], PosteriorMode]) -> Array:
        """Return the residual of the data, shape (data,), where each fold is predicted by a `fit` to the others."""
        fold = np.concatenate([np.tile(b % FOLDS, len(self.observed.outputs)) for b in self.blocks])
        residual = np.zeros(self.observed.data.size)
        for number in np.unique(fold):
            out = fold == number
            at = fit(replace(self.observed, weight=np.where(out, 1e-9, self.observed.weight)))
            whole = self.observed.data - self.observed.predicted(at.q) - at.features @ at.x[at.constants:]
            residual[out] = whole[out]
        return residual

    def _refined_for(self, chosen: Sequence[Candidate], at: PosteriorMode, seen: SessionData) -> list[Candidate]:
        """Return the terms with parameters refined on the data of `seen`, one after the other."""
        slopes, done = self.sensitivities(at), list(chosen)
        for k, candidate in enumerate(done):
            if candidate.parameters:
                beside = self.fitted(done[:k] + done[k + 1:], seen, self.base, passes=1)
                done[k] = self.refined(candidate._replace(nats=-math.inf), beside, slopes)
        return done

    def terms(self, chosen: Sequence[Candidate], at: PosteriorMode) -> list[Term]:
        """Return the chosen terms with the coefficients and 95 % intervals of the mode `at`."""
        place = at.x.size - sum(MODULATIONS[c.modulation].components for c in chosen)
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


def _chunks(grid: Sequence[dict[str, float]], size: int = 128) -> Iterator[Sequence[dict[str, float]]]:
    """Yield a grid in parts, which bound the memory of a screen."""
    for first in range(0, len(grid), size):
        yield grid[first:first + size]


class _Metric:
    """C⁻¹ of the data under the model at a mode, and C⁻¹e of its residual."""

    def __init__(self, at: PosteriorMode) -> None:
        self.weight, inward = at.weight, at.inward
        lower = np.tril(at.inner[0]) if at.inner[1] else np.triu(at.inner[0]).T
        self.across = solve_triangular(lower, (inward * self.weight[:, None]).T, lower=True)
        off = at.x - at.prior_mean
        error = at.residual + at.slopes @ off[:at.constants] + at.features @ off[at.constants:]
        light = self.weight * error
        self.applied = light - self.weight * (inward @ cho_solve(at.inner, inward.T @ light))

    def evidence(self, columns: Array, sd: float, count: int) -> Array:
        """Return the linear evidence, nats, of each group of `count` columns with the prior 1σ `sd`."""
        pull = (columns.T @ self.applied).reshape(-1, count)
        through = self.across @ columns
        groups, inner = columns.reshape(columns.shape[0], -1, count), through.reshape(through.shape[0], -1, count)
        square = np.einsum("nka,n,nkb->kab", groups, self.weight, groups, optimize=True)
        square -= np.einsum("nka,nkb->kab", inner, inner, optimize=True)
        whole = np.eye(count) / sd**2 + square
        size = np.linalg.solve(whole, pull[:, :, None])[:, :, 0]
        return np.asarray(0.5 * (pull * size).sum(axis=1) - 0.5 * np.linalg.slogdet(sd**2 * whole)[1])
