"""Quasi-static force path of a simulated Bowden cable–fabric rig: rope, sheath, fabric and knee.

No node has a mass.  At each step of the imposed motion the tension of START is sought for which rope and fabric end at
their anchor on the shank.  Friction is the rate-and-state equation of Dieterich and Ruina in series with an elastic
shear of each contact.  SI units: m, N, s, rad; the rope's pull is positive, knee flexion is negative.
Rule of this file: numpy only, and nothing of the package is imported.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S: Final = 1e-3
REFERENCE_SPEED: Final = 0.03
"""Slip rate at which a fresh contact has its base friction coefficient, m/s."""
REFERENCE_N: Final = 40.0
"""Tension at which the power laws of sheath and fabric have their named shortening and stretch, N."""
FRICTION_LOAD_N: Final = 30.0
"""Tension at which the friction of the cable has its base coefficient, N."""
KELVIN_S: Final = (0.02, 0.15, 1.1, 8.0)
"""Retardation times of the fabric's Kelvin elements, s."""
SLACK_N: Final = 0.02
"""Smallest tension of START that is tried, N: the rope is slack below it."""
SETTLING: Final = 150, 0.05
"""Number of steps and their length, s, in which a rig settles at the first position before a recording begins."""


def _drawn(low: float, high: float, log: bool = False) -> Any:
    """Return a field of `Bench` that is drawn between two bounds for each rig, evenly or evenly in its logarithm."""
    return dataclasses.field(metadata={"range": (low, high), "log": log})


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Constants of one rig in one session.  A constant with a default has that value in the reference condition."""

    rate_hz: int
    bends: tuple[float, ...]  # share of each cable segment in the bends of the sheath
    lengths: tuple[float, ...]  # share of each cable segment in the shortening of the sheath
    contacts: tuple[float, ...]  # share of each fabric contact in the wrap
    strips: tuple[float, ...]  # share of each fabric strip in the stretch, one more than contacts
    cable_friction: float = _drawn(0.04, 0.11, log=True)  # base coefficient of the rope in its sheath
    cable_bend: float = _drawn(1.2, 3.4)  # rad, sum of the bends
    fabric_friction: float = _drawn(0.08, 0.22, log=True)  # base coefficient of the fabric on the knee
    wrap: float = _drawn(0.1, 0.5)  # rad, of the fabric on the extended knee
    wrap_gain: float = _drawn(0.5, 1.8)  # slope of the wrap over flexion at great flexion
    wrap_onset: float = _drawn(0.15, 0.5)  # rad, flexion from which the wrap grows
    surface_share: float = _drawn(0.3, 0.7)  # motion of the knee's surface over that of the shank
    direct_cable: float = _drawn(0.02, 0.045)  # growth of friction with the logarithm of slip rate (a)
    direct_fabric: float = _drawn(0.03, 0.06)
    evolution: float = _drawn(0.01, 0.03)  # growth of friction with the logarithm of contact age (b)
    cutoff_speed: float = _drawn(0.004, 0.02, log=True)  # m/s, slip rate above which age no longer matters
    critical_slip: float = _drawn(6e-5, 2.5e-4, log=True)  # m, slip that renews a contact
    cable_shear: float = _drawn(4e-5, 2e-4, log=True)  # m, elastic shear of a contact at its base friction
    fabric_shear: float = _drawn(4e-5, 3e-4, log=True)
    load_exponent: float = _drawn(-0.08, 0.03)  # of cable friction over tension
    stretch: float = _drawn(5.5e-3, 9e-3)  # m, of the whole fabric at `REFERENCE_N`, toe region added
    stretch_exponent: float = _drawn(0.5, 0.65)
    toe_n: float = _drawn(0.5, 1.5)  # N, shift of the power law: finite stiffness at rest
    creep_first: float = _drawn(0.003, 0.012)  # stretch of the fastest Kelvin element over the elastic stretch
    creep_exponent: float = _drawn(0.1, 0.3)  # growth of that share with retardation time
    sheath: float = _drawn(2e-5, 8e-5, log=True)  # m/N, shortening of the sheath's path
    sheath_exponent: float = _drawn(0.55, 0.8)
    sheath_power: float = _drawn(0.45, 0.65)  # share of the shortening that follows a power of the tension
    sheath_lag: float = _drawn(0.12, 0.25)  # share of the shortening that lags behind the tension by a backlash
    sheath_lag_n: float = _drawn(0.8, 2.5)  # N, half width of that backlash
    knee_radius: float = _drawn(0.0287, 0.0544)  # m, of the circle on which the fabric is wound
    circle_forward: float = _drawn(-0.22, 0.22)  # centre of the circle from the pivot, in radii
    circle_up: float = _drawn(-0.25, 0.25)
    thigh_forward: float = _drawn(1.0, 1.35)  # anchor on the thigh from the pivot, in radii
    thigh_up: float = _drawn(2.5, 4.0)
    shank_forward: float = _drawn(1.0, 1.35)  # anchor on the shank of the extended knee, in radii
    shank_down: float = _drawn(2.0, 3.5)
    drum_radius: float = _drawn(0.015, 0.025)  # m
    eccentricity: float = _drawn(1e-5, 5e-5)  # m, of the drum in the reference condition
    eccentricity_phase: float = _drawn(0.0, 2.0 * math.pi)
    servo_zero: float = _drawn(-0.05, 0.05)  # m
    end_lag_s: float = _drawn(0.0, 2e-3)  # time constant of the END load cell
    cross_talk: float = _drawn(-0.008, 0.008)  # of the sheath's thrust into END
    pink_share: float = _drawn(0.2, 0.4)  # rms of 1/f noise over that of white noise
    shank_tilt: float = _drawn(math.radians(-15.0), math.radians(15.0))
    stiffness: float = 1.0  # of the fabric over that of the reference condition
    gain_start: float = 1.0
    gain_end: float = 1.0
    offset_start: float = 0.0  # N
    offset_end: float = 0.0  # N
    stribeck: float = 0.0  # rise of cable friction at a tenth of `stribeck_speed`, times two
    stribeck_speed: float = 0.008  # m/s
    viscous: float = 0.0  # N·s/m
    knee_backlash: float = 0.0  # rad, full width
    creep: float = 0.0  # m/N, compliance of two more Kelvin elements
    creep_s: float = 1.0  # geometric mean of their retardation times
    ovality: float = 0.0  # m, eccentricity of the drum beyond the reference condition
    ovality_phase: float = 0.0
    moment_arm: float = 0.0  # m, displacement of the pivot
    bend_gain: float = 0.0  # bend of the far sheath over `cable_bend`, per rad of flexion
    friction_drift: float = 0.0  # growth of cable friction over the recording
    end_drift: float = 0.0  # N
    end_delay_s: float = 0.0
    end_filter_s: float = 0.0
    end_mass: float = 0.0  # kg
    slip: float = 0.0  # m, sudden slip of the anchor
    vibration: float = 0.0  # N
    vibration_phase: float = 0.0
    pulse: float = 0.0  # N, for 20 ms at one place of each stride
    gain_step: float = 0.0  # sudden change of the END gain
    place: float = 0.0  # 0 to 1: time of a sudden change, place of a pulse, frequency of a vibration in its range


class Motion(NamedTuple):
    """Imposed motion at 1 kHz: knee angle, rad, rope at the drum, m, desired force, N, and number of the stride."""

    knee: Array
    rope: Array
    desired: Array
    cycle: NDArray[np.int64]


def elastic_stretch(bench: Bench, tension: float) -> float:
    """Return the elastic stretch of the whole fabric at a tension, m: a power law with a toe region."""
    power, toe = bench.stretch_exponent, bench.toe_n / REFERENCE_N
    return float(bench.stretch * bench.stiffness**-0.7 * ((tension / REFERENCE_N + toe) ** power - toe**power))


def kelvin_shares(bench: Bench) -> list[float]:
    """Return the full stretch of each Kelvin element over the elastic stretch; their sum creeps as a power of time."""
    return [bench.creep_first * (time / KELVIN_S[0]) ** bench.creep_exponent for time in KELVIN_S]


def contact_load(shift: float, shear: float, slip: float) -> float:
    """Return the friction over its direct effect of a contact that is displaced by `shift` ≥ 0, m, in one step.

    Elastic shear and slip in series share the displacement: shear·y + slip·sinh(y) = shift.  The slip is that of the
    rate-and-state equation (Dieterich 1979, Ruina 1983), regularised at rest as by Rice and Ben-Zion 1996.
    """
    load = min(shift / shear, math.asinh(shift / slip))  # an upper bound, from which Newton's steps fall monotonically
    for _ in range(40):
        sinh = math.sinh(load)
        change = (shear * load + slip * sinh - shift) / (shear + slip * math.sqrt(1.0 + sinh * sinh))
        load -= change
        if abs(change) < 0.01:
            break
    return load


def contact_age(age: float, slip: float, critical_slip: float, dt: float) -> float:
    """Return the age of a contact, s, after `slip` metres in `dt`: ageing law dψ/dt = 1 − Vψ/D (Dieterich, Ruina)."""
    if slip < 1e-12 * dt:
        return age + dt
    steady = critical_slip * dt / slip
    return steady + (age - steady) * math.exp(-slip / critical_slip)


def knee_path(bench: Bench, knee: Array) -> Array:
    """Return the position of the shank's anchor along the rope, m, zero at the extended knee.

    The fabric is wound on a circle whose centre is beside the pivot, and lifts off where the arc vanishes.
    """
    def length(flexion: Array) -> Array:
        thigh = complex(bench.thigh_forward - bench.circle_forward, bench.thigh_up - bench.circle_up)
        shank = complex(bench.shank_forward, -bench.shank_down) * np.exp(-1j * flexion)
        shank = shank - complex(bench.circle_forward, bench.circle_up)
        distance = np.maximum(1.0, np.abs(shank))
        arc = (np.angle(thigh) - math.acos(1.0 / abs(thigh)) - np.angle(shank) % (2.0 * np.pi) + 2.0 * np.pi
               - np.arccos(1.0 / distance))
        wound = math.sqrt(abs(thigh) ** 2 - 1.0) + np.sqrt(distance**2 - 1.0) + arc
        return np.asarray(np.where(arc > 0.0, wound, np.abs(thigh - shank)))

    return np.asarray(bench.knee_radius * (length(np.zeros(1)) - length(-knee)))


def march(bench: Bench, motion: Motion) -> tuple[Array, Array]:
    """Return the tension of START and END, N, at each step of the motion."""
    time = np.asarray(STEP_S * np.arange(motion.knee.size), np.float64)
    leg = motion.knee
    if bench.knee_backlash > 0.0:  # three elements of unlike width
        leg = np.mean([_backlash(leg, share * bench.knee_backlash) for share in (0.8, 1.0, 1.2)], axis=0)
    after = (time - (0.3 + 0.4 * bench.place) * time[-1]) / 0.006
    anchor = (knee_path(bench, leg) + 2.0 * bench.moment_arm * (1.0 - np.cos(leg))
              + bench.slip / (1.0 + np.exp(-np.clip(after, -40.0, 40.0))))
    bent = np.maximum(0.0, -leg)
    wrap = bench.wrap + bench.wrap_gain * bent**2 / (bench.wrap_onset + bent)
    turn = motion.rope / bench.drum_radius
    oval = np.sin(turn + bench.ovality_phase) + 0.12 * np.sin(2.0 * turn + 3.0 * bench.ovality_phase)
    drum = motion.rope + bench.eccentricity * np.sin(turn + bench.eccentricity_phase) + bench.ovality * oval
    way = np.cumsum(np.abs(np.diff(motion.rope, prepend=motion.rope[0])))
    wear = 1.0 + bench.friction_drift * way / way[-1]
    rows = np.stack([drum, anchor, -leg, wrap, wear], axis=1).tolist()
    path = _ForcePath(bench, rows[0][1])
    for _ in range(SETTLING[0]):
        path.step(SETTLING[1], *rows[0])
    tensions = np.array([path.step(STEP_S, *row) for row in rows])
    return tensions[:, 0], tensions[:, 1]


class _ForcePath:
    """Memory of rope, sheath and fabric from one step to the next, and the equilibrium of a step.

    Contacts of the cable come first in each list, those of the fabric after them.
    """

    def __init__(self, bench: Bench, anchor: float) -> None:
        cable, fabric = len(bench.bends), len(bench.contacts)
        self.bench, self.anchor, self.tension, self.before, self.slope = bench, anchor, 8.0, 8.0, -3e-4
        self.direct = [bench.direct_cable] * cable + [bench.direct_fabric] * fabric
        self.shear = ([bench.cable_shear * bench.direct_cable] * cable
                      + [bench.fabric_shear * bench.direct_fabric] * fabric)
        self.position: list[float] = []  # m, of the rope at each contact
        self.sheared, self.age = [0.0] * (cable + fabric), [0.01] * (cable + fabric)
        self.lagging = [0.0] * cable  # N, tension that the lagging share of the sheath follows
        self.kelvin_full = kelvin_shares(bench)
        self.kelvin = [[0.0] * len(KELVIN_S) for _ in bench.strips]
        self.crept = [0.0, 0.0]  # m, of the added Kelvin elements
        far = [((i + 0.5) / cable) ** 3 for i in range(cable)]  # the knee bends the far end of the sheath
        self.bend = [(bench.cable_bend * share, bench.bend_gain * bench.cable_bend * end / sum(far))
                     for share, end in zip(bench.bends, far, strict=True)]
        self.now: list[float] = []
        self.load: list[float] = []
        self.lagged: list[float] = []
        self.elastic: list[float] = []

    def step(self, dt: float, drum: float, anchor: float, flexion: float, wrap: float, wear: float
             ) -> tuple[float, float]:
        """Return the tension of START and END, N, after `dt` seconds; `wear`: cable friction over its base."""
        bench = self.bench
        self.drum, self.surface, self.anchor = drum, bench.surface_share * (anchor - self.anchor), anchor
        cable = wear * bench.cable_friction
        self.capstan = [cable * max(0.0, bend + gain * flexion) for bend, gain in self.bend]
        self.capstan += [bench.fabric_friction * wrap * share for share in bench.contacts]
        self.slips = [2.0 * REFERENCE_SPEED * dt * math.exp(-self._strength(i, age) / self.direct[i])
                      for i, age in enumerate(self.age)]
        self.shares = [dt / (time + dt) for time in KELVIN_S]  # implicit Euler, as of all Kelvin elements
        self.growth = 1.0 + sum(full * share for full, share in zip(self.kelvin_full, self.shares, strict=True))
        self.kept = [sum(state * (1.0 - share) for state, share in zip(states, self.shares, strict=True))
                     for states in self.kelvin]
        self.added = [dt / (factor * bench.creep_s + dt) for factor in (1.0 / 1.6, 1.6)]
        self.drag = bench.viscous / len(self.bend) / dt
        start, end = self._solve(self.tension + (0.8 * (self.tension - self.before) if dt == STEP_S else 0.0))
        self.before, self.tension = self.tension, start
        self._advance(end, dt)
        return start, end

    def _strength(self, contact: int, age: float) -> float:
        """Return the friction at `REFERENCE_SPEED` of a contact of some age, over its base (Dieterich 1979)."""
        bench = self.bench
        strength = 1.0 + bench.evolution * math.log(1.0 + age * bench.cutoff_speed / bench.critical_slip)
        if bench.stribeck and contact < len(self.bend):  # by age: V < `stribeck_speed` makes old contacts
            gain = bench.stribeck / math.log(121.0)
            strength += gain * math.log(1.0 + age * bench.stribeck_speed / bench.critical_slip)
        return strength

    def _solve(self, guess: float) -> tuple[float, float]:
        """Return START and END tension, N, whose path ends at the anchor: secant steps inside a bracket."""
        low, high, start, last = 0.0, math.inf, max(guess, SLACK_N), (math.nan, math.nan)
        for _ in range(40):
            gap, end = self._gap(start)
            if abs(gap) < 1e-7 or high - low < 1e-5 or (gap < 0.0 and start <= SLACK_N):
                return start, end
            low, high = (start, high) if gap > 0.0 else (low, start)
            slope = (gap - last[1]) / (start - last[0]) if start != last[0] else math.nan
            self.slope = slope if slope < -1e-6 else self.slope
            last = start, gap
            start = min(start - gap / self.slope, start + 15.0)
            if not low < start < high:
                start = 0.5 * (low + high) if high < math.inf else low + 5.0
            start = max(start, SLACK_N)
        raise RuntimeError(f"no equilibrium: START in [{low}, {high}] N, gap {gap} m at the anchor")

    def _gap(self, tension: float) -> tuple[float, float]:
        """Return how far the path of a START tension ends beyond the anchor, m, and its END tension, N."""
        bench, position, cable = self.bench, self.drum, len(self.bend)
        self.now, self.load, self.lagged, self.elastic = [], [], [], []
        for i in range(cable):
            lagging = min(max(self.lagging[i], tension - bench.sheath_lag_n), tension + bench.sheath_lag_n)
            self.lagged.append(lagging)
            position -= bench.lengths[i] * bench.sheath * self._shortening(tension, lagging)
            friction, moved = self._friction(i, position, 0.0)
            # capstan equation (Euler, Eytelwein) with friction of a power of the tension, and viscous drag
            friction *= self.capstan[i] * (tension / FRICTION_LOAD_N) ** bench.load_exponent
            tension = max(0.01, tension * math.exp(-friction) - self.drag * moved)
        for j, share in enumerate(bench.strips):
            if j:
                friction, _ = self._friction(cable + j - 1, position, self.surface)
                tension *= math.exp(-self.capstan[cable + j - 1] * friction)
            elastic = elastic_stretch(bench, tension)
            self.elastic.append(elastic)
            position -= share * (elastic * self.growth + self.kept[j])
        if bench.creep:
            position -= sum(self._crept(tension))
        return position - self.anchor, tension

    def _shortening(self, tension: float, lagging: float) -> float:
        """Return the shortening of the sheath over its compliance, N: a power, a linear and a lagging share."""
        bench, power = self.bench, self.bench.sheath_exponent
        curved = REFERENCE_N ** (1.0 - power) * ((tension + 1.0) ** power - 1.0)
        linear = 1.0 - bench.sheath_power - bench.sheath_lag
        return float(bench.sheath_power * curved + linear * tension + bench.sheath_lag * lagging)

    def _friction(self, contact: int, position: float, surface: float) -> tuple[float, float]:
        """Return friction over its base and motion, m, of a contact at `position` whose counterpart moves `surface`."""
        moved = position - self.position[contact] - surface if self.position else 0.0
        shift = self.sheared[contact] + moved
        load = math.copysign(contact_load(abs(shift), self.shear[contact], self.slips[contact]), shift)
        self.now.append(position)
        self.load.append(load)
        return self.direct[contact] * load, moved

    def _crept(self, tension: float) -> list[float]:
        """Return the stretch of the added Kelvin elements after the step, m."""
        return [state + share * (0.5 * self.bench.creep * tension - state)
                for state, share in zip(self.crept, self.added, strict=True)]

    def _advance(self, end: float, dt: float) -> None:
        """Set the memory to the solved step."""
        self.position, self.lagging, self.crept = self.now, self.lagged, self._crept(end)
        for i, load in enumerate(self.load):
            self.sheared[i] = self.shear[i] * load
            slip = self.slips[i] * math.sinh(abs(load))
            self.age[i] = contact_age(self.age[i], slip, self.bench.critical_slip, dt)
        for states, elastic in zip(self.kelvin, self.elastic, strict=True):
            for c, (full, share) in enumerate(zip(self.kelvin_full, self.shares, strict=True)):
                states[c] += share * (full * elastic - states[c])


def _backlash(signal: Array, width: float) -> Array:
    """Return a signal behind a backlash of full `width`."""
    state, out = float(signal[0]), []
    for value in signal.tolist():
        state = min(max(state, value - 0.5 * width), value + 0.5 * width)
        out.append(state)
    return np.array(out)
