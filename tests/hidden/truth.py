"""A bench written apart: rope and fabric as a chain of stop elements, solved quasi-statically from the leg.

The rule of this file: it shares no code, no discretisation and no friction law with the package.  Friction at
a node is a Prandtl–Ishlinskii sum of stop operators (return mapping, no differential equation); the chain is
massless and its tension is found by shooting from END to the drum; the stretch is an exponential or a power
law, not (10).  Units: m, N, s, rad; rope pulled positive, flexion negative.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

CABLE, FABRIC, STOPS = 12, 6, 3
NODES = CABLE + FABRIC

# indices of the flat parameter array
(CAP, MU2, WRAP0, KAPPA, BEND, LOAD, VISCOUS, RATIO, SPEED, DELTA, DELTA_F, DRIFT, LEAD, SHEATH, SOFT, STIFF_T,
 LINEAR, POWER, BEFORE, OVER, CREEP, CREEP_T, WARP, COUNT) = range(24)


@njit(cache=True)
def stretch(force, p):
    """Stretch of the whole fabric, m, at a force: A·(1 − e^(−T/T1)) + B·T, or a power law where POWER > 0."""
    if p[POWER] > 0.0:
        return p[SOFT] * ((1.0 + force / p[STIFF_T]) ** p[POWER] - 1.0) + p[LINEAR] * force
    return p[SOFT] * (1.0 - math.exp(-force / p[STIFF_T])) + p[LINEAR] * force


@njit(cache=True)
def node(force, travel, old, z, z_new, i, deltas, weights, delta, exponent):
    """Tension above node `i` that moved to `travel`: stop operators, then the capstan's exponential."""
    s = 0.0
    for j in range(STOPS):
        state = z[i, j] + (travel - old[i]) / (delta * deltas[j])
        state = min(1.0, max(-1.0, state))
        z_new[i, j] = state
        s += weights[j] * state
    return force * math.exp(s * exponent)


@njit(cache=True)
def shoot(end, w, theta, speed, p, scale, gamma, old, new, z, z_new, deltas, weights, slopes):
    """From END tension `end` to the drum: return (drum position, START tension)."""
    total = stretch(end, p) + gamma
    travel = (1.0 - p[BEFORE] - p[OVER]) * total
    force = end
    wrap = max(0.0, p[WRAP0] + p[KAPPA] * abs(theta) ** (1.0 + p[WARP]))
    calm = math.exp(-((speed / p[SPEED]) ** 2))
    stick = scale * (1.0 + (p[RATIO] - 1.0) * calm)
    for i in range(FABRIC):
        new[i] = travel
        here = stick * p[MU2] * wrap / FABRIC * max(0.05, 1.0 + p[LOAD] * (force / 40.0 - 1.0))
        force = node(force, travel, old, z, z_new, i, deltas, weights, p[DELTA_F], here)
        travel += p[OVER] / FABRIC * (stretch(force, p) + gamma)
    travel += p[BEFORE] * (stretch(force, p) + gamma) + w
    for i in range(FABRIC, NODES):
        new[i] = travel
        here = stick * p[CAP] * (1.0 + p[BEND] * abs(theta)) * slopes[i - FABRIC]
        here *= max(0.05, 1.0 + p[LOAD] * (force / 40.0 - 1.0))
        force = node(force, travel, old, z, z_new, i, deltas, weights, p[DELTA], here)
        travel += p[SHEATH] / CABLE * force
    start = max(0.0, force + (p[VISCOUS] * speed if force > 0.05 else 0.0))
    return travel + p[LEAD] * start, start


@njit(cache=True)
def solve(x, w, theta, speed, p, scale, gamma, old, new, z, z_new, deltas, weights, slopes, guess):
    """Find END tension for the drum at `x`: bracketed secant on a monotone function; zero where slack."""
    low = 0.0
    f_low = shoot(0.0, w, theta, speed, p, scale, gamma, old, new, z, z_new, deltas, weights, slopes)[0] - x
    if f_low >= 0.0:
        return 0.0, 0.0
    high = max(guess, 0.5)
    f_high = shoot(high, w, theta, speed, p, scale, gamma, old, new, z, z_new, deltas, weights, slopes)[0] - x
    while f_high < 0.0 and high < 500.0:
        low, f_low = high, f_high
        high = 1.05 * high + 0.2
        f_high = shoot(high, w, theta, speed, p, scale, gamma, old, new, z, z_new, deltas, weights, slopes)[0] - x
    start, end = 0.0, high
    for _ in range(40):
        end = high - f_high * (high - low) / (f_high - f_low)
        if end <= low or end >= high:
            end = 0.5 * (low + high)
        at, start = shoot(end, w, theta, speed, p, scale, gamma, old, new, z, z_new, deltas, weights, slopes)
        f = at - x
        if abs(f) < 2e-9 or high - low < 1e-7:
            break
        if f > 0.0:
            high, f_high = end, f
            f_low *= 0.5
        else:
            low, f_low = end, f
            f_high *= 0.5
    return end, start


@njit(cache=True)
def advance(x, w, theta, speed, time, dt, p, span, gamma, end, old, new, z, z_new, deltas, weights, slopes):
    """One step: return (END, START, creep) and move the chain's memory on."""
    scale = 1.0 + p[DRIFT] * min(1.0, time / span)
    end, start = solve(x, w, theta, speed, p, scale, gamma, old, new, z, z_new, deltas, weights, slopes, end)
    if end <= 0.0:
        z[:] = 0.0
        for i in range(FABRIC):
            old[i] = (1.0 - p[BEFORE] - p[OVER] + p[OVER] * i / FABRIC) * gamma
        for i in range(FABRIC, NODES):
            old[i] = gamma + w
    else:
        z[:] = z_new
        old[:] = new
    if p[CREEP] > 0.0:
        gamma += (p[CREEP] * end - gamma) * (1.0 - math.exp(-dt / p[CREEP_T]))
    return end, start, gamma


@njit(cache=True)
def run(x, w, theta, speed, time, p, span, deltas, weights, slopes):
    """Run the chain over imposed rope and knee motion; return (END, START) tension, N."""
    n = x.size
    end_out, start_out = np.zeros(n), np.zeros(n)
    z, z_new = np.zeros((NODES, STOPS)), np.zeros((NODES, STOPS))
    old, new = np.full(NODES, w[0]), np.zeros(NODES)
    gamma, end = 0.0, 0.0
    for k in range(n):
        dt = time[k] - time[k - 1] if k else 1e-3
        end, start, gamma = advance(
            x[k], w[k], theta[k], speed[k], time[k], dt, p, span, gamma, end, old, new, z, z_new, deltas, weights,
            slopes)
        end_out[k], start_out[k] = end, start
    return end_out, start_out
