"""Posterior mode (Gauss–Newton) and evidence (Laplace) of one trial.

Constants and discrepancy have a Gaussian prior.

    cost(x) = Σ ρ((y − f(q0 + x) − Φc)/σ) + (x − μ)ᵀP⁻¹(x − μ)        ρ Huber's loss, x = (constants, c)
    ln p(y) = −½ cost(x̂) − ½ ln det(I + LᵀHᵀWHL),  P = LLᵀ,  H = [∂f/∂q, Φ]      up to a constant of the trial
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from estimation.forward_model import ForwardModel, jacobian, predicted
from estimation.likelihood_data import Recording
from physics.effects.hypotheses import Variant
from physics.forward.constant_table import ConstantTable
from physics.laws import Array

HUBER: Final = 5.0
"""Residual, σ, above which the loss grows linearly.

Such residuals occur in the 16 ms bins in which a loose rope snaps taut."""
CLOSE: Final = 0.3
"""Decrease of the cost in one step below which the mode counts as reached; 0.3 is 0.15 nats."""
LONGEST: Final = 2.0
"""Longest step of a constant, in σ of its prior; the model is about linear over that distance."""
SURROGATE: Final = 0.1
"""1σ of a parameter by systematic model error, relative to the parameter's change.

The model's friction and stretch equations differ from the bench's.  With this value the 95 % intervals cover 90 to
98 % on the development population; too small, they would be too narrow."""


class SessionDeparture(NamedTuple):
    """Squared departure of constants and discrepancy, in σ, in as many directions as the data determine.

    Its expected value is the number of these directions.
    """

    squared: float
    directions: float

    @property
    def rms(self) -> float:
        """RMS departure in one direction, σ; 0 without any."""
        return math.sqrt(self.squared / self.directions) if self.directions else 0.0


@dataclass(frozen=True)
class SessionData:
    """Data of the trials of one session, concatenated.

    `features`: Φ, shape (data, features).  `weight`: 1/σ², shape (data,).  `tau`: by output, the factor by which σ² is
    inflated for the autocorrelation of the residuals.  `cost`: mean cost per datum of the reference trials at their
    modes.  `growth`: factor, at least 1, on σ² by which a model of the measured signals may miss more than one of the
    reference condition's, shape (data,); it counts in the lack of fit alone.  `beyond`: by how much the motion
    exceeds the range of the reference trials', relative to it.  `own_misfit`: that of the reference trials, by output.
    `own_strain`: their RMS departure from the bench, in session σ, at least 1.
    """

    model: ForwardModel
    trials: tuple[Recording, ...]
    features: Array
    weight: Array
    tau: Array
    cost: float
    growth: Array
    beyond: float = 0.0
    own_misfit: Array | float = 1.0
    own_strain: float = 1.0

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs; all trials of a session have the same."""
        return self.trials[0].outputs

    @cached_property
    def count(self) -> int:
        """Number of data that count."""
        return int(np.count_nonzero(self.weight))

    @cached_property
    def data(self) -> Array:
        """Measured data of all trials."""
        return np.concatenate([trial.data for trial in self.trials])

    def predicted(self, q: Array) -> Array:
        """Return the predicted data of one coordinate vector."""
        return np.concatenate([predicted(self.model, q, trial) for trial in self.trials])

    def jacobian(self, q: Array, free: Sequence[int]) -> tuple[Array, Array]:
        """Return the predicted data at `q` and their derivatives by the coordinates `free`, shape (data, free)."""
        data, slopes = zip(*(jacobian(self.model, q, trial, free) for trial in self.trials), strict=True)
        return np.concatenate(data), np.concatenate(slopes)

    def each(self, values: Array) -> Iterator[tuple[Recording, Array]]:
        """Yield each trial with its rows of `values`, an array over the data of all trials."""
        at = 0
        for trial in self.trials:
            yield trial, values[at:at + trial.data.size]
            at += trial.data.size

    def misfit(self, residual: Array) -> Array:
        """Return the mean squared `residual` over its variance, by output, relative to that of the reference trials.

        Residuals are clipped at `HUBER` σ, so that outliers count little.
        """
        squares = residual**2 * self.weight / self.growth
        each = [tau * self.part(squares, k)[self.part(self.weight, k) > 0.0] for k, tau in enumerate(self.tau)]
        return np.array([np.mean(np.minimum(own, HUBER**2)) for own in each]) / self.own_misfit

    def part(self, values: Array, output: int) -> Array:
        """Return the rows of output number `output` from `values`, an array over the data of all trials."""
        return np.concatenate([trial.part(rows, output) for trial, rows in self.each(values)])


@dataclass(frozen=True)
class Gaussian:
    """Gaussian prior of a trial's constants and discrepancy.

    `origin`: coordinates of all constants of the table.  `mean` and `covariance` are of one vector: the free constants'
    departures from the origin, followed by the feature weights.
    """

    origin: Array
    mean: Array
    covariance: Array

    def coordinates(self, table: ConstantTable, departure: Array | float = 0.0) -> Array:
        """Return the coordinates of all constants of `table` at a `departure` of the free ones from the mean."""
        q = self.origin.copy()
        q[list(table.free)] += self.mean[:len(table.free)] + departure
        return q


@dataclass(frozen=True)
class PosteriorMode:
    """Mode of a posterior, with the matrices of the linearisation there.

    `x`: departures of the constants `active` (rows of `table`), followed by the feature weights.  `q`: coordinates of
    all constants.  `log_evidence`: nats.  `factor`: Cholesky factor L of the prior covariance.  `inner`: Cholesky
    factor of I + LᵀHᵀWHL.  `slopes`, `features`: the two parts of H.  `weight`: W.  `residual`: y − f − Φc.
    `prior_mean`: μ.
    """

    table: ConstantTable
    q: Array
    x: Array
    active: tuple[int, ...]
    cost: float
    log_evidence: float
    factor: Array
    inner: Any
    slopes: Array
    features: Array
    weight: Array
    residual: Array
    prior_mean: Array

    @property
    def constants(self) -> int:
        """Number of active constants, which are the first entries of `x`."""
        return len(self.active)

    @property
    def design(self) -> Array:
        """H = [∂f/∂q, Φ]; it is not stored, since modes are many and share Φ."""
        return np.concatenate([self.slopes, self.features], axis=1)

    @cached_property
    def inward(self) -> Array:
        """HL."""
        return np.asarray(self.design @ self.factor)

    @cached_property
    def information(self) -> Array:
        """HᵀWH."""
        return np.asarray((self.design.T * self.weight) @ self.design)

    @cached_property
    def departure(self) -> SessionDeparture:
        """Departure from the prior's mean, in prior σ.

        The data determine n − tr (I + LᵀHᵀWHL)⁻¹ directions of n (MacKay 1992, effective number of parameters).
        """
        off = solve_triangular(self.factor, self.x - self.prior_mean, lower=True)
        determined = self.x.size - float(np.trace(cho_solve(self.inner, np.eye(self.x.size))))
        return SessionDeparture(float(off @ off), determined)

    def sd(self, gradient: Array) -> float:
        """Return 1σ of a scalar function of `x` from its `gradient` by `x`."""
        along = self.factor.T @ gradient
        return float(np.sqrt(along @ cho_solve(self.inner, along)))


def root_of(covariance: Array) -> Array:
    """Return the Cholesky factor L of a covariance, LLᵀ, also where rounding makes an eigenvalue hardly negative."""
    return np.asarray(np.linalg.cholesky(covariance + 1e-14 * np.diag(np.diag(covariance))), np.float64)


def between_sessions(off: Array, sd: Array, information: Sequence[Array], known: Sequence[Array]) -> SessionDeparture:
    """Return the departure of trials from their bench at a joint mode, over the directions that they determine.

    `off`: departures, shape (trials, n), each with the prior 1σ `sd`.  `information`: A = HᵀWH of each trial.  `known`:
    covariance P of the bench by the other trials.

    A trial determines n − tr (I + DBD)⁻¹ directions of its departure.  D is `sd` on a diagonal.  B = (A⁻¹ + P)⁻¹ is the
    information with the bench integrated out, as A − A(P⁻¹ + A)⁻¹A.
    """
    directions, eye = 0.0, np.eye(sd.size)
    for square, covariance in zip(information, known, strict=True):
        root = root_of(covariance)
        side = square @ root
        own = square - side @ np.linalg.solve(eye + root.T @ side, side.T)
        directions += sd.size - float(np.trace(np.linalg.inv(eye + sd[:, None] * own * sd)))
    return SessionDeparture(float(np.sum((off / sd) ** 2)), directions)


def extra_constants(table: ConstantTable, variants: Sequence[Variant]) -> list[int]:
    """Return the constants that `variants` set free and that are fixed in the reference condition, by row number."""
    return sorted(set(freed(table, variants)) - set(table.free))


def widened(table: ConstantTable, prior: Gaussian, variants: Sequence[Variant]
            ) -> tuple[Array, Array, Array, list[int]]:
    """Return origin, mean, covariance and active constants of `prior` after `variants` of effects have widened it."""
    extra = extra_constants(table, variants)
    active = [*table.free, *extra]
    place = {i: k for k, i in enumerate(active)}
    size = len(active) + prior.mean.size - len(table.free)
    kept = [*range(len(table.free)), *range(len(active), size)]
    covariance, mean = np.zeros((size, size)), np.zeros(size)
    covariance[np.ix_(kept, kept)], mean[kept] = prior.covariance, prior.mean
    for i in extra:
        covariance[place[i], place[i]] = (1e-6 * table.step[i]) ** 2
    origin = prior.origin.copy()
    for variant in variants:
        for name, value in variant.at.items():
            origin[table.index[name]] = table.coordinate(name, value)
            if table.index[name] in place:
                mean[place[table.index[name]]] = 0.0
        for direction in variant.directions:
            along = np.zeros(size)
            for name, share in direction.along.items():
                along[place[table.index[name]]] = share
            covariance += direction.sd**2 * np.outer(along, along)
    return origin, mean, covariance, active


def loss(residual: Array, root: Array) -> float:
    """Return Σ ρ(residual·root) with Huber's loss ρ; `root`: 1/σ of each datum."""
    # ρ(u) = u² below k, 2k·u − k² above (Huber 1964), so that a bin that snaps taut does not decide a fit
    scaled = np.abs(residual) * root
    return float(np.where(scaled < HUBER, scaled**2, 2.0 * HUBER * scaled - HUBER**2).sum())


def bounded(residual: Array, weight: Array) -> Array:
    """Return weights with which the squared residuals have the gradient of Huber's loss."""
    # iteratively reweighted least squares: ρ′(u)/(2u) times the weight
    scaled = np.abs(residual) * np.sqrt(weight)
    return np.asarray(np.where(scaled < HUBER, 1.0, HUBER / np.maximum(scaled, 1e-9)) * weight)


class _Linearised(NamedTuple):
    """A posterior linearised at a point: ∂f/∂q, weights, I + LᵀHᵀWHL with its Cholesky factor, and downhill slope."""

    slopes: Array
    weight: Array
    square: Array
    inner: Any
    pull: Array


def descended(x: Any, cost: Callable[[Any], float], linearised: Callable[[Any], Any],
              stepped: Callable[[Any, Any, float], Any], close: float, tries: int = 7) -> tuple[Any, float, Any]:
    """Return the minimum of `cost` from `x` by damped Gauss–Newton steps, its cost, and the last linearisation.

    `stepped`: point after a step on a linearisation with a damping, which changes by Marquardt's (1963) factor of ten.
    `close`: decrease in one step below which the minimum counts as reached.  `tries`: largest number of steps from one
    linearisation.
    """
    now, damping = cost(x), 0.0
    while True:
        before, here = now, linearised(x)
        for _ in range(tries):
            # far from the data rounding may leave a system that only damping makes positive definite
            with contextlib.suppress(np.linalg.LinAlgError):
                moved = stepped(x, here, damping)
                then = cost(moved)
                if np.isfinite(then) and then < now:
                    x, now = moved, then
                    break
            damping = max(10.0 * damping, 1.0)
        damping = damping / 10.0 if damping > 1.0 else 0.0
        if before - now < close:
            return x, now, here


def mode(observed: SessionData, prior: Gaussian, variants: Sequence[Variant] = (), start: Array | None = None,
         descends: bool = True) -> PosteriorMode:
    """Return the posterior mode of trials; `variants` of effects widen the `prior`.

    `start`: departures at which the descent begins (None: the prior's mean).  `descends`: if false, the linearisation
    at `start` is returned.
    Raises `numpy.linalg.LinAlgError` if the problem is numerically singular.
    """
    table = observed.model.constants
    origin, mean, covariance, active = widened(table, prior, variants)
    factor = root_of(covariance)
    measured, features, weight = observed.data, observed.features, observed.weight
    count, root = len(active), np.sqrt(weight)
    discrepancy, eye = features @ factor[count:], np.eye(mean.size)
    spread = np.sqrt(np.diag(covariance)[:count])

    def at(x: Array) -> Array:
        q = origin.copy()
        q[active] += x[:count]
        return q

    def off(x: Array) -> Array:
        return np.asarray(solve_triangular(factor, x - mean, lower=True))

    def residual(x: Array) -> Array:
        return np.asarray(measured - observed.predicted(at(x)) - features @ x[count:])

    def cost(x: Array) -> float:
        return loss(residual(x), root) + float(off(x) @ off(x))

    def linearised(x: Array) -> _Linearised:
        data, slopes = observed.jacobian(at(x), active)
        missed = measured - data - features @ x[count:]
        inward, weights = discrepancy.copy(), bounded(missed, weight)
        inward[:, :count] += slopes @ factor[:count, :count]
        scaled = inward * np.sqrt(weights)[:, None]
        square = eye + scaled.T @ scaled
        return _Linearised(slopes, weights, square, cho_factor(square), inward.T @ (weights * missed) - off(x))

    def stepped(x: Array, here: _Linearised, damping: float) -> Array:
        step = factor @ cho_solve(here.inner if damping == 0.0 else cho_factor(here.square + damping * eye), here.pull)
        return np.asarray(x + step / max(1.0, float(np.abs(step[:count] / spread).max()) / LONGEST))

    x = mean if start is None else start
    x, now, here = descended(x, cost, linearised, stepped, CLOSE) if descends else (x, cost(x), linearised(x))
    # the curvature is that of the last linearisation, at a cost within `CLOSE` of the mode's
    # Laplace's approximation, Rasmussen and Williams (2006), eq. 3.32: the factor's diagonal gives ½ ln det
    evidence = -0.5 * now - float(np.log(np.diag(here.inner[0])).sum())
    return PosteriorMode(table, at(x), x, tuple(active), now, evidence, factor, here.inner, here.slopes, features,
                         here.weight, residual(x), mean)


def screened(null: PosteriorMode, observed: SessionData, variant: Variant, error: Array | None = None
             ) -> tuple[float, Array]:
    """Return the linear log Bayes factor of a variant at the mode `null`, nats, and the sizes along its directions.

    ln B = ½ gᵀ(I + G)⁻¹g − ½ ln det(I + G), g = EᵀC⁻¹e, G = EᵀC⁻¹E, e the error of the null.  `error`: columns of a
    further Gaussian error of the data, shape (data, columns).
    """
    effect, applied = response(null, observed, variant, error)
    return bayes_factor(effect.T @ applied[:, 1:], effect.T @ applied[:, 0])


def bayes_factor(square: Array, pull: Array) -> tuple[float, Array]:
    """Return the log Bayes factor, nats, of sizes with the prior N(0, 1) from their information, and their mean."""
    # ½ gᵀ(I + G)⁻¹g − ½ ln det(I + G): the Gaussian integral over the sizes
    whole = np.eye(pull.size) + square
    size: Array = np.asarray(np.linalg.solve(whole, pull), np.float64)
    return float(0.5 * pull @ size - 0.5 * np.linalg.slogdet(whole)[1]), size


def response(null: PosteriorMode, observed: SessionData, variant: Variant, further: Array | None = None
             ) -> tuple[Array, Array]:
    """Return E and C⁻¹[e, E] of a variant at the mode `null`, shapes (data, directions) and (data, directions + 1).

    E: the effect's slopes times their σ, e: the error of the null, C: covariance of the data under the null, plus
    that of the columns `further`.
    """
    names = sorted({n for d in variant.directions for n in d.along})
    _, slopes = observed.jacobian(slope_point(observed.model, null.q, variant, names),
                                  [null.table.index[n] for n in names])
    column = {name: slopes[:, k] for k, name in enumerate(names)}
    effect = np.stack([d.sd * sum(share * column[n] for n, share in d.along.items()) for d in variant.directions], 1)
    off = null.x - null.prior_mean
    error = null.residual + null.slopes @ off[:null.constants] + null.features @ off[null.constants:]
    applied = whitened(null, np.concatenate([error[:, None], effect], axis=1))
    if further is not None:
        # the same identity for C + FFᵀ, F the columns of the further error
        spread = whitened(null, further)
        applied -= spread @ np.linalg.solve(np.eye(further.shape[1]) + further.T @ spread, further.T @ applied)
    return effect, applied


def whitened(null: PosteriorMode, given: Array) -> Array:
    """Return C⁻¹ times columns `given`, shape (data, columns); C: covariance of the data under the mode `null`."""
    # Woodbury's identity: C⁻¹ = W − W·HL·(I + LᵀHᵀWHL)⁻¹·LᵀHᵀ·W
    light, inward = null.weight[:, None] * given, null.inward
    return np.asarray(light - null.weight[:, None] * (inward @ cho_solve(null.inner, inward.T @ light)))


def slope_point(model: ForwardModel, q: Array, variant: Variant, names: Sequence[str]) -> Array:
    """Return the coordinates at which the slopes of a variant by the constants `names` are taken, for a mode at `q`."""
    table, at = model.constants, q.copy()
    for name, value in variant.at.items():
        at[table.index[name]] = table.coordinate(name, value)
    for name, (amount, size) in model.amounts.items():
        if name in names:
            at[table.index[amount]] += size
    moved = [table.index[n] for n in names]
    at[moved] = table.lifted(at)[moved]
    return at


def freed(table: ConstantTable, variants: Sequence[Variant]) -> list[int]:
    """Return the constants along which `variants` of effects act, by row number."""
    return sorted({table.index[name] for v in variants for d in v.directions for name in d.along})


def response_error(at: PosteriorMode, observed: SessionData, prior: Gaussian, rows: Sequence[int]) -> Array:
    """Return columns of an error of the response to constants `rows` at a mode: `SURROGATE` of it times each feature.

    Shape (data, features), 1σ.  The simulated response differs from the bench's by a share of it that depends on motion
    and load.
    """
    table, without = at.table, at.q.copy()
    without[list(rows)] = prior.coordinates(table)[list(rows)]
    return np.asarray(SURROGATE * (observed.predicted(at.q) - observed.predicted(without))[:, None] * observed.features)


def error_factor(at: PosteriorMode, error: Array) -> float:
    """Return the log Bayes factor, nats, of a mode with a further Gaussian `error` against the mode without it.

    `error`: columns of 1σ, shape (data, columns).
    """
    off = at.residual + at.design @ (at.x - at.prior_mean)
    applied = whitened(at, np.concatenate([off[:, None], error], axis=1))
    return bayes_factor(error.T @ applied[:, 1:], error.T @ applied[:, 0])[0]


def begun(base: PosteriorMode, variant: Variant | None, sizes: Array | None = None, kept: Sequence[Variant] = ()
          ) -> Array:
    """Return the start of a fit with `kept` and `variant`: the mode `base`, moved by `sizes` along the variant.

    `sizes`: in prior σ of the effect along each direction of the variant, clipped to ±2.5.  Constants that are not
    active in `base`, and those that the variants set to another value than `base` had, start at 0.
    """
    variants = [*kept, variant] if variant is not None else list(kept)
    table = base.table
    active = [*table.free, *extra_constants(table, variants)]
    old = {i: base.x[k] for k, i in enumerate(base.active)}
    for name, value in (item for each in variants for item in each.at.items()):
        i = table.index[name]
        if i in old and abs(base.q[i] - old[i] - table.coordinate(name, value)) > 1e-9:
            del old[i]
    x = np.array([old.get(i, 0.0) for i in active])
    if variant is not None and sizes is not None:
        for direction, size in zip(variant.directions, sizes, strict=True):
            for name, share in direction.along.items():
                step, i = float(np.clip(size, -2.5, 2.5)) * direction.sd * share, table.index[name]
                x[active.index(i)] += step + (float(table.lifted(base.q)[i] - base.q[i]) if step > 0.0 else 0.0)
    return np.concatenate([x, base.x[base.constants:]])


def named_change(mode_of: PosteriorMode, prior: Gaussian) -> dict[str, tuple[float, float]]:
    """Return each free constant's departure from the prior's mean, in coordinates and in prior σ, by name."""
    free = mode_of.table.free
    sd = np.sqrt(np.diag(prior.covariance)[:len(free)])
    return {mode_of.table.names[i]: (float(mode_of.x[k] - prior.mean[k]),
                                     float((mode_of.x[k] - prior.mean[k]) / sd[k])) for k, i in enumerate(free)}
