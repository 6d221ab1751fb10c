"""The desired motion and force of one gait cycle, periodic and without a step.

Everything is tabulated once, by phase, into piecewise cubics; a look-up is a multiplication and a Horner scheme in
plain floats, since the master makes one in every control cycle. A recorded cycle is closed by a quintic on each side of
its seam, which takes up the mismatch in value, slope and curvature; beyond ±`CLOSED_PERCENT` of it nothing changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from parameters import InputError
from physics import laws
from physics.laws import Array

CLOSED_PERCENT: Final = 10.0
CYCLE_POINTS: Final = 1000
_BENDING_WEIGHT: Final = 4.0
"""Weight of bending against departure, %²: a balance, not an equation. Larger: a smoother seam that departs further
from the recording."""


def _quintic(width: float, begin: Array, end: Array) -> Array:
    """Return ascending coefficients of the quintic over [0, width] with (value, slope, curvature) at both ends."""
    powers = np.arange(6)
    rows = [np.eye(6)[0], np.eye(6)[1], 2.0 * np.eye(6)[2]]
    rows.append(width**powers)
    rows.append(powers * width ** np.maximum(powers - 1, 0))
    rows.append(powers * (powers - 1) * width ** np.maximum(powers - 2, 0))
    solved: Array = np.linalg.solve(np.array(rows), np.concatenate([begin, end]))
    return solved


def _corrections(seam: Array, mismatch: Array) -> tuple[Array, Array]:
    """Return coefficients of the quintics that correct a curve before and after the seam from 100 % to 0 %.

    `seam`, `mismatch`: value, slope and curvature of the correction before the seam, and its jump there.
    """
    still = np.zeros(3)
    return _quintic(CLOSED_PERCENT, still, seam), _quintic(CLOSED_PERCENT, seam - mismatch, still)


def _cost(
    curve: Callable[[Array, int], Array], seam: Array, mismatch: Array
) -> Array:
    """Return samples of departure and of weighted bending over the window: the cost that the seam's state minimises."""
    u = np.linspace(0.0, CLOSED_PERCENT, 101)
    before, after = (np.polynomial.Polynomial(c) for c in _corrections(seam, mismatch))
    bend_before = before.deriv(2)(u) + curve(100.0 - CLOSED_PERCENT + u, 2)
    bend_after = after.deriv(2)(u) + curve(u, 2)
    bending = _BENDING_WEIGHT * np.concatenate([bend_before, bend_after])
    return np.concatenate([before(u), after(u), bending])


def closed(curve: Callable[[Array, int], Array]) -> Callable[[Array], tuple[Array, Array]]:
    """Return a periodic C2 curve: percent → (value, slope per %), equal to `curve` off the seam.

    `curve(percent, order)` gives the value (0) and derivatives (1, 2) per percent on 0…100.
    """
    mismatch = np.array([float(curve(np.array([0.0]), n)[0] - curve(np.array([100.0]), n)[0]) for n in range(3)])
    base = _cost(curve, np.zeros(3), mismatch)
    columns = [_cost(curve, unit, mismatch) - base for unit in np.eye(3)]
    fitted = np.linalg.lstsq(np.stack(columns, axis=1), -base, rcond=None)[0]
    seam = fitted.astype(np.float64)
    before, after = (np.polynomial.Polynomial(c) for c in _corrections(seam, mismatch))

    def evaluate(percent: Array) -> tuple[Array, Array]:
        t = np.mod(percent, 100.0)
        left = t - (100.0 - CLOSED_PERCENT)
        value, slope = curve(t, 0), curve(t, 1)
        value = value + np.where(left > 0.0, before(left), 0.0) + np.where(t < CLOSED_PERCENT, after(t), 0.0)
        slope = slope + np.where(left > 0.0, before.deriv()(left), 0.0)
        return value, slope + np.where(t < CLOSED_PERCENT, after.deriv()(t), 0.0)

    return evaluate


_PERCENT: Final = np.linspace(0.0, 100.0, CYCLE_POINTS + 1)
_STEP: Final = 100.0 / CYCLE_POINTS


class Desired(NamedTuple):
    """Desired motion and force at one instant: rad, rad/s, N, N/s."""

    knee_angle_rad: float
    knee_velocity_rad_s: float
    force_n: float
    force_rate_n_s: float


class ForceSurface(NamedTuple):
    """Desired force by phase and knee angle: N at the phases of a cycle (rows) and rising knee angles, rad (columns).

    Forces between are interpolated linearly; beyond the first or last angle the force of that angle holds.
    """

    knee_rad: Array
    force_n: Array

    def at(self, percent: Array, knee_rad: Array) -> Array:
        """Return the force, N, at each phase, %, and knee angle, rad."""
        row, column = np.mod(percent, 100.0) / _STEP, np.interp(knee_rad, self.knee_rad, np.arange(self.knee_rad.size))
        i, j = row.astype(np.intp), np.minimum(column.astype(np.intp), self.knee_rad.size - 2)
        u, v, f = row - i, column - j, self.force_n
        return np.asarray((1.0 - u) * ((1.0 - v) * f[i, j] + v * f[i, j + 1])
                          + u * ((1.0 - v) * f[i + 1, j] + v * f[i + 1, j + 1]))


class Reference:
    """One desired motion and force, periodic in `period_s`; `phase` counts cycles and may exceed 1."""

    __slots__ = ("_angle", "_force", "_rate", "_sum_rad", "departs_from_eq1_rad", "peak_n", "period_s", "surface")

    def __init__(
        self, period_s: float, angle: tuple[Array, Array], force: tuple[Array, Array, Array] | ForceSurface
    ) -> None:
        """Tabulate one cycle at `CYCLE_POINTS` + 1 equal phases.

        `angle`: value (rad) and slope (rad per %) at each point. `force`: value (N), and slope (N per %)
        leaving and reaching each point, which differ where the curve has a corner; or the force by phase and angle,
        which is tabulated along `angle`.
        """
        self.surface = force if isinstance(force, ForceSurface) else None
        if isinstance(force, ForceSurface):
            force = recorded_force(_PERCENT, force.at(_PERCENT, angle[0]))
        self.period_s = period_s
        self._sum_rad: float | None = None
        self._rate = CYCLE_POINTS / period_s
        self._angle = _cubics(angle[0], angle[1], angle[1])
        self._force = _cubics(*force)
        self.peak_n = float(np.max(force[0] if self.surface is None else self.surface.force_n))
        self.departs_from_eq1_rad = float(np.max(np.abs(angle[0] - laws.knee_angle(_PERCENT))))

    def mirrored(self, sum_rad: float, share: float) -> Reference:
        """Return this motion as an antagonist counts it, `sum_rad` less the angle, with `share` of the force.

        The subtraction is that of the running cycle, which counts the joint's angle so, to the last bit.
        """
        made = object.__new__(Reference)
        made.period_s, made._rate, made.peak_n = self.period_s, self._rate, share * self.peak_n
        made._angle, made._sum_rad = self._angle, sum_rad
        made._force = tuple((share * a, share * b, share * c, share * d) for a, b, c, d in self._force)
        made.departs_from_eq1_rad = self.departs_from_eq1_rad
        made.surface = self.surface and ForceSurface(
            sum_rad - self.surface.knee_rad[::-1], share * self.surface.force_n[:, ::-1])
        return made

    def knee_angle(self, phase: float) -> float:
        """Return the knee angle, rad, at `phase` (cycles)."""
        a, b, c, d, u = self._cell(self._angle, phase)
        angle = a + u * (b + u * (c + u * d))
        return angle if self._sum_rad is None else self._sum_rad - angle

    def knee_velocity(self, phase: float) -> float:
        """Return the knee velocity, rad/s, at `phase` (cycles)."""
        _, b, c, d, u = self._cell(self._angle, phase)
        speed = (b + u * (2.0 * c + u * 3.0 * d)) * self._rate
        return speed if self._sum_rad is None else -speed

    def desired_force(self, phase: float) -> float:
        """Return the desired END force, N, at `phase` (cycles)."""
        a, b, c, d, u = self._cell(self._force, phase)
        return a + u * (b + u * (c + u * d))

    def at(self, phase: float) -> Desired:
        """Return motion and force at `phase` (cycles)."""
        p, q, r, s, u = self._cell(self._force, phase)
        return Desired(self.knee_angle(phase), self.knee_velocity(phase), p + u * (q + u * (r + u * s)),
                       (q + u * (2.0 * r + u * 3.0 * s)) * self._rate)

    @staticmethod
    def _cell(
        table: tuple[tuple[float, float, float, float], ...], phase: float
    ) -> tuple[float, float, float, float, float]:
        x = (phase - math.floor(phase)) * CYCLE_POINTS
        i = int(x)
        return *table[i], x - i


def _cubics(value: Array, leaving: Array, reaching: Array) -> tuple[tuple[float, float, float, float], ...]:
    """Return Hermite cubics over each step, u in 0…1; one more cell catches a phase that rounds up to 1."""
    p, q = value[:-1], value[1:]
    m, n = leaving[:-1] * _STEP, reaching[1:] * _STEP
    cells = np.stack([p, m, 3.0 * (q - p) - 2.0 * m - n, 2.0 * (p - q) + m + n], axis=1)
    return tuple(tuple(map(float, cell)) for cell in [*cells, cells[0]])  # type: ignore[misc]


def paper_angle() -> tuple[Array, Array]:
    """Return (1) closed over ±10 % of the seam, exact to it in between: rad and rad per %, by phase."""
    return closed(lambda percent, order: laws.knee_angle(percent, order))(_PERCENT)


def paper_force(peak_n: float) -> tuple[Array, Array, Array]:
    """Return (2) in N and its slopes, N per %, leaving and reaching each point: corners at 10 and 30 %."""
    start, peak, end = laws.FORCE_START_PERCENT, laws.FORCE_PEAK_PERCENT, laws.FORCE_END_PERCENT
    rise = np.pi / (2.0 * (peak - start))
    fall = np.pi / (2.0 * (end - peak))
    rising = peak_n * rise * np.cos(rise * (_PERCENT - start))
    falling = -peak_n * fall * np.cos(fall * (end - _PERCENT))
    i, j, k = (round(p / _STEP) for p in (start, peak, end))
    points = np.arange(_PERCENT.size)
    leaving = np.where((points >= i) & (points < j), rising, np.where((points >= j) & (points < k), falling, 0.0))
    reaching = np.where((points > i) & (points <= j), rising, np.where((points > j) & (points <= k), falling, 0.0))
    force = laws.desired_force(_PERCENT, peak_n)
    force[[i, k]] = 0.0
    return force, leaving, reaching


def paper_reference(peak_n: float, period_s: float) -> Reference:
    """Return the paper's experiment: (1), closed, and (2) with the peak `peak_n`, over `period_s`."""
    return Reference(period_s, paper_angle(), paper_force(peak_n))


def recorded_angle(percent: Array, angle_rad: Array) -> tuple[Array, Array]:
    """Return a recorded knee cycle at `CYCLE_POINTS` + 1 phases for `Reference`: rad, and rad per %.

    The cycle is closed in angle, slope and curvature. `percent` rises and reaches into both ±10 % windows around the
    seam; raises `InputError` if not.
    """
    t, y = np.asarray(percent, dtype=np.float64), np.asarray(angle_rad, dtype=np.float64)
    _check_cycle(t, y)
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(t, y)

    def curve(at: Array, order: int) -> Array:
        inside = np.clip(at, t[0], t[-1])
        value: Array = spline(inside, order)
        if order == 0:
            value = value + (at - inside) * spline(inside, 1)
        return value

    return closed(curve)(_PERCENT)


def recorded_force(percent: Array, force_n: Array) -> tuple[Array, Array, Array]:
    """Return a desired-force curve for `Reference`, N and N per %: monotone between its points, periodic."""
    t, y = np.asarray(percent, dtype=np.float64), np.asarray(force_n, dtype=np.float64)
    _check_cycle(t, y)
    from scipy.interpolate import PchipInterpolator

    around = PchipInterpolator(
        np.concatenate([t[-3:] - 100.0, t, t[:3] + 100.0] if t[-1] - t[0] < 100.0 else [t]),
        np.concatenate([y[-3:], y, y[:3]] if t[-1] - t[0] < 100.0 else [y]),
    )
    value, slope = around(_PERCENT), around(_PERCENT, 1)
    return value, slope, slope


def recorded_surface(percent: Array, knee_rad: Array, force_n: Array) -> ForceSurface:
    """Return a desired force, N by percent (rows) and rising knee angle (columns), at the phases of a cycle."""
    columns = [recorded_force(percent, column)[0] for column in np.asarray(force_n).T]
    return ForceSurface(np.asarray(knee_rad, dtype=np.float64), np.stack(columns, axis=1))


def _check_cycle(t: Array, y: Array) -> None:
    if t.shape != y.shape or t.ndim != 1 or t.size < 8:
        raise InputError(f"gait cycle: {t.size} phases and {y.size} values, expected at least 8 of each; add points.")
    for name, column in (("gait_percent", t), ("value", y)):
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise InputError(f"gait cycle: {name} in row {bad[0] + 1} is not a number; fill or drop the row.")
    back = np.flatnonzero(np.diff(t) <= 0.0)
    if back.size:
        row = int(back[0]) + 2
        raise InputError(f"gait cycle: gait_percent = {t[row - 1]:g} in row {row} does not rise; sort the rows.")
    if not (0.0 <= t[0] <= CLOSED_PERCENT and 100.0 - CLOSED_PERCENT <= t[-1] <= 100.0):
        raise InputError(
            f"gait cycle: gait_percent runs from {t[0]:g} to {t[-1]:g}, expected 0 to 100; give one whole cycle."
        )
