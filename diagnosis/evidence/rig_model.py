"""Forward model of a rig other than the bench; its outputs are chosen by the recorded columns.

    START force      ratio·END + offset + friction between the two + spring of position      if END is recorded
                     k·e·(1 + c·e²) + d·ė,  e = position − arm·joint angle − zero            else, with a joint angle
    drive force      START + friction + inertia + gravity of a turning axis + spring + offset
    joint angle      zero + ratio·position + compliance·START and END                        if END is recorded, too

Inputs are the measured motion and the measured END.  Friction is that of `physics.effects.rig_hypotheses`.  Priors are
wide and scale with the signals of the reference trials.  1σ between sessions is a share of the fitted constant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from diagnosis.data.table import TURNED_UNITS, Table
from diagnosis.evidence.likelihood_data import GRID_S, Recording
from diagnosis.evidence.outputs import dahl_states
from physics.constant_table import ConstantTable, ModelConstant
from physics.effects.hypotheses import SENSOR, Hypothesis, Read
from physics.effects.rig_hypotheses import (
    STRETCH_M_PER_N,
    drive_hypotheses,
    give_hypotheses,
    spring_hypotheses,
    tension_hypotheses,
)
from physics.laws import Array
from physics.parameters import RELATION_PARAMETERS

START, END, FORCE, JOINT = "tension_start_n", "tension_end_n", "servo_force_n", "knee_angle_rad"
MOTION_HZ: Final = 40.0
"""Cut-off, Hz, of the low-pass of the motion from which the friction states are computed."""
OUTPUT_HZ: Final = 20.0
"""Cut-off, Hz, of the low-pass of measured and predicted outputs; accelerations above it are noise."""
WIDTH: Final = 8
"""Samples of the time grid per datum: 32 ms, longer than the correlation time of the low-pass."""
TRAVELS: Final = (1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3)
"""Pre-sliding distances at which the first fit may start, relative to the stroke."""
STARTS: Final = 2
"""Number of pre-sliding distances at which the first fit starts."""
SETTLED: Final = 0.5
"""Distance travelled, relative to the stroke, after which friction no longer depends on the motion before the trial."""
ALIKE: Final = 1.25
"""Factor in load, speed and stroke within which two recordings are of the same condition."""
WHOLE: Final = 0.08
"""1σ between sessions of the logarithm of a rig's friction; measured on a rubber seal in five sessions."""
SHARE: Final = 0.1
"""1σ between sessions of the shares of friction that depend on load and on speed.

Each part of a rubber seal's friction differs by 18 % between five sessions; with 0.05 one of four repeats is named."""
FIRM: Final = 0.02
"""1σ between sessions of a mass, relative to its value."""
SPRING: Final = 0.03
"""1σ between sessions of a spring constant, relative to its value."""
ZERO: Final = 0.003
"""1σ between sessions of an offset, relative to the largest value of its signal."""
RATIO: Final = 0.005
"""1σ between sessions of the ratio of two sensors."""
ANGLE: Final = 0.02
"""1σ between sessions of the angle of a mass on a turning axis, rad; it depends on the zero of the encoder."""


class RigScale(NamedTuple):
    """Sizes of the signals over the reference trials, in the units of the signals.

    `stroke`: mean span of the position.  `speed`, `acceleration`, `end`: RMS.  `joint`: RMS of the joint angle about
    its mean.  `spread` and `peak`: standard deviation and largest absolute value by output.
    """

    stroke: float
    speed: float
    acceleration: float
    end: float
    joint: float
    spread: Mapping[str, float]
    peak: Mapping[str, float]


class RigRecording(Recording):
    """A trial of a rig on the time grid: position `x`, its derivatives `v` and `a`, and the other `inputs` by name.

    Inputs are START, END and joint angle, as far as recorded.
    """

    def __init__(self, table: Table, outputs: Sequence[str], coarsest: Mapping[str, float]) -> None:
        at = table["servo_position_m"]
        gone = np.cumsum(np.abs(np.diff(at, prepend=at[0])))
        time = table["time_s"]
        first = time[np.searchsorted(gone, SETTLED * np.ptp(at))] - time[0] if np.ptp(at) > 0.0 else 0.0
        super().__init__(table, outputs, GRID_S, OUTPUT_HZ, min(max(first, 0.2), 0.3 * (time[-1] - time[0])), coarsest,
                         WIDTH)
        self.position = self.sampled("servo_position_m", MOTION_HZ)
        self.x = self.position
        self.v = np.gradient(self.x, GRID_S)
        self.a = np.gradient(self.v, GRID_S)
        self.inputs = {name: self.sampled(name, MOTION_HZ) for name in (START, END, JOINT) if name in table}
        self.along = {"rope_m_s": self.v, "servo_position_m": self.position, **self.inputs}
        self._smoother = butter(2, OUTPUT_HZ, fs=1.0 / GRID_S, output="sos")
        self.data = np.concatenate([self.binned(self.measured(name)) for name in self.outputs])

    def smoothed(self, values: Array) -> Array:
        """Return predicted signals, low-passed as the outputs and averaged over bins, shape (…, bins)."""
        return self.binned(np.asarray(sosfiltfilt(self._smoother, values, axis=-1)))


class RigSession:
    """Several recordings of a rig in different conditions, such as loads or speeds, treated as one session.

    `data`: output by output, for each output recording by recording.
    """

    def __init__(self, recordings: Sequence[RigRecording]) -> None:
        self.recordings = tuple(recordings)
        first = recordings[0]
        self.outputs, self.source = first.outputs, ", ".join(r.source for r in recordings)
        self.x, self.v, self.a = (np.concatenate([getattr(r, name) for r in recordings]) for name in ("x", "v", "a"))
        self.inputs = {n: np.concatenate([r.inputs[n] for r in recordings]) for n in first.inputs}
        self.noise_n = {n: float(np.sqrt(np.mean([r.noise_n[n] ** 2 for r in recordings]))) for n in first.outputs}
        self.bins = sum(r.bins for r in recordings)
        self.data = self.joined([r.data for r in recordings])

    def joined(self, parts: Sequence[Array]) -> Array:
        """Return the data of the recordings, each of shape (…, data), in the order of the session's data."""
        return np.concatenate([r.part(part.T, k).T for k in range(len(self.outputs))
                               for r, part in zip(self.recordings, parts, strict=True)], axis=-1)

    def part(self, values: Array, output: int) -> Array:
        """Return the rows of output number `output` from `values`, an array over all data."""
        return np.asarray(values[output * self.bins:(output + 1) * self.bins])

    def measured(self, name: str) -> Array:
        """Return a measured output on the time grids of the recordings, concatenated."""
        return np.concatenate([r.measured(name) for r in self.recordings])

    def _each(self, values: Array) -> list[Array]:
        ends = np.cumsum([r.x.size for r in self.recordings])[:-1]
        return np.split(values, ends, axis=-1)

    def binned(self, values: Array) -> Array:
        """Return means over bins, shape (…, bins), of `values` on the concatenated time grids."""
        return np.concatenate([r.binned(v) for r, v in zip(self.recordings, self._each(values), strict=True)], axis=-1)

    def smoothed(self, values: Array) -> Array:
        """Return predicted signals, low-passed as the outputs and averaged over bins, shape (…, bins)."""
        parts = zip(self.recordings, self._each(values), strict=True)
        return np.concatenate([r.smoothed(v) for r, v in parts], axis=-1)


Taken = RigRecording | RigSession


class RigModel:
    """Forward model of the rig of the reference trials `tables`; the module lists its outputs.

    `sense`: −1 if friction lowers START as the position grows, else 1.
    """

    regressed: tuple[str, ...]
    amounts: Mapping[str, tuple[str, float]] = {"rest_speed": ("rest", 0.1), "drive_rest_speed": ("drive_rest", 0.1)}
    states = 6
    load_state = 3
    pools_sessions = True
    session_share = 0.7
    nats_factor = 0.45
    unlike_share = 0.7

    def __init__(self, tables: Sequence[Table]) -> None:
        self.turning = all(t.turning for t in tables)
        has = {name for name in (START, END, FORCE, JOINT) if all(name in t for t in tables)}
        self.has_end = START in has and END in has
        self.sprung = START in has and JOINT in has and not self.has_end
        self.angled = self.has_end and JOINT in has
        self.outputs = tuple(name for name, there in (
            (START, self.has_end or self.sprung), (FORCE, FORCE in has), (JOINT, self.angled)) if there)
        self.loaded = START in has
        self.signals: Mapping[str, str] = {
            name: "rad" if name == JOINT else "N·m" if self.turning else "N" for name in self.outputs}
        self.judged = tuple(name for name in self.outputs if name != JOINT)
        if not self.outputs:
            return
        self.scale = self._scaled(tables)
        self.least: Mapping[str, float] = {n: 0.003 * s for n, s in self.scale.spread.items()}
        self.constants = ConstantTable(self._rows(), {
            "load_share": (-0.5, 1.5), "viscous_share": (-0.5, 1.5), "drive_load_share": (-0.5, 1.5),
            "drive_viscous_share": (-0.5, 1.5), "rest": (-0.7, 3.0), "drive_rest": (-0.7, 3.0),
            "drive_asymmetry": (-0.9, 0.9), "demand_gain": (0.3, 3.0), "drift": (-0.95, 3.0)})
        self.hypotheses: Mapping[str, Hypothesis] = self._hypotheses()
        self.sense, every = 1.0, RigSession([self.record(t) for t in tables])
        if self.has_end:
            self.sense = self._sense(every)
        self.regressed = tuple(n for n in self.constants.names if n in REGRESSED)
        left = every.data - self.predict(self.origin(every)[:, None], every)[0]
        rough = {n: max(float(np.std(every.part(left, k))), self.least[n]) for k, n in enumerate(self.outputs)}
        self.first_noise = ({n: 3.0 * s for n, s in rough.items()}, rough)

    # -- columns, sizes and constants of the rig ---------------------------------------------------------------------

    def lacking(self, table: Table) -> list[str]:
        """Return the columns of the reference trials that a trial does not have."""
        needed = ["servo_position_m", *self.outputs]
        needed += [END] if self.has_end else []
        needed += [JOINT] if self.sprung else []
        needed += [START] if self.loaded else []
        return [name for name in dict.fromkeys(needed) if name not in table]

    def limits(self, effect: str, parameter: str) -> tuple[float, float, str]:
        """Return the bounds of an effect's parameter on rigs of any size, and its unit on this linear or turning axis.
        """
        row = RELATION_PARAMETERS[parameter]
        low, high = row.rig_bounds
        return low, high, self.unit(row.unit)

    def unit(self, linear: str) -> str:
        """Return the unit on this linear or turning axis of a quantity that has the unit `linear` on a linear one."""
        return TURNED_UNITS.get(linear, linear) if self.turning else linear

    def stated(self) -> dict[str, Read]:
        """Return the parameters that a fit of the rig states, as functions of its constants."""
        relative = {"demand_gain", *(name for name, h in self.hypotheses.items() if h.part == SENSOR),
                    *(["stiffness"] if self.angled else [])}
        own = {n: r for name, h in self.hypotheses.items() if name not in relative for n, r in h.reads.items()}
        if self.sprung:
            own["rope_per_knee"] = lambda v, b: v["arm"]
        if self.angled:
            own |= {"rope_per_knee": lambda v, b: 1.0 / v["joint_ratio"],
                    "stiffness_scale": lambda v, b: -STRETCH_M_PER_N * v["joint_ratio"] / v["give"]}
        return own

    def record(self, table: Table) -> RigRecording:
        """Return a trial of this rig on the time grid of the likelihood."""
        return RigRecording(table, self.outputs, {n: 1e-4 * s for n, s in self.scale.spread.items()})

    def _scaled(self, tables: Sequence[Table]) -> RigScale:
        made = [RigRecording(t, self.outputs, {}) for t in tables]

        def rms(values: Sequence[Array]) -> float:
            return float(np.sqrt(np.mean(np.concatenate(values) ** 2))) or 1.0

        ends = [m.inputs[END] for m in made] if self.has_end else [np.ones(1)]
        joints = [m.inputs[JOINT] - m.inputs[JOINT].mean() for m in made] if JOINT in made[0].inputs else [np.ones(1)]
        spread, peak = {}, {}
        for name in self.outputs:
            own = [m.measured(name) for m in made]
            if name == START and self.has_end:
                end = np.concatenate(ends)
                own = [_rest(np.concatenate(own), [end, np.ones(end.size)])]
            if name == FORCE and self.loaded:
                own = [o - m.inputs[START] for o, m in zip(own, made, strict=True)]
            spread[name] = max(float(np.sqrt(np.mean([np.var(o) for o in own]))), 1e-9)
            peak[name] = max(float(np.abs(t[name]).max()) for t in tables)
        return RigScale(float(np.mean([np.ptp(m.x) for m in made])) or 1.0, rms([m.v for m in made]),
                        rms([m.a for m in made]), rms(ends), rms(joints), spread, peak)

    def _rows(self) -> list[ModelConstant]:
        """Return the constants that the outputs need, in units of rotation if the axis turns."""
        rows: list[ModelConstant] = []
        if START in self.outputs and self.has_end:
            rows += self._friction_rows("", START, True) + self._tension_rows()
        if self.sprung:
            rows += self._spring_rows()
        if FORCE in self.outputs:
            rows += self._friction_rows("drive_", FORCE, self.turning or self.loaded) + self._drive_rows()
        if self.angled:
            rows += self._joint_rows()
        return [row._replace(unit=self.unit(row.unit)) for row in rows]

    def _friction_rows(self, prefix: str, output: str, load: bool) -> list[ModelConstant]:
        row, size, stroke, speed = ModelConstant, self.scale.spread[output], self.scale.stroke, self.scale.speed
        unit = "N·m" if self.turning else "N"
        rows = [
            row(prefix + "friction", unit, size, "log", 1.5, WHOLE, "friction at the RMS of load and speed"),
            row(prefix + "load_share", "", 0.0, "linear", 0.4 if load else 0.0, SHARE, "share of it that load carries",
                step=0.02),
            row(prefix + "viscous_share", "", 0.0, "linear", 0.4, SHARE, "share of it that speed carries"),
            row(prefix + "travel", "m", 1e-2 * stroke, "log", 2.0, 0.2, "pre-sliding distance"),
            row(prefix + "rest", "", 0.0, "linear", 0.4, 0.04, "static over sliding friction, less 1"),
            row(prefix + "rest_speed", "m/s", 0.2 * speed, "log", 1.0, 0.1, "Stribeck speed"),
        ]
        if not prefix:  # between two tensions an asymmetry is confounded with ratio and offset
            return [*rows, row("drift", "", 0.0, "linear", 0.1, 0.05, "change over the recording")]
        return [*rows, *(row(prefix + name, "", 0.0, "linear", 0.1, 0.02, f"{kind} friction more one way")
                         for name, kind in (("asymmetry", "dry"), ("viscous_asymmetry", "viscous")))]

    def _tension_rows(self) -> list[ModelConstant]:
        row, size, peak = ModelConstant, self.scale.spread[START], self.scale.peak[START]
        return [
            row("ratio", "", 1.0, "linear", 0.2, RATIO, "START over END without friction"),
            row("offset", "N", 0.0, "linear", 0.1 * peak, ZERO * peak, "difference of the sensors' zeros"),
            row("spring", "N/m", 0.0, "linear", size / self.scale.stroke, 0.05 * size / self.scale.stroke,
                "force between the tensions by position"),
            row("start_lag", "s", 0.0, "linear", 5e-3, 5e-4, "lag of START behind motion and END"),
        ]

    def _spring_rows(self) -> list[ModelConstant]:
        row, size, stroke = ModelConstant, self.scale.spread[START], self.scale.stroke
        stiff = size / (0.3 * stroke)
        return [
            row("stiffness", "N/m", stiff, "log", 2.0, SPRING, "spring between drive and joint"),
            row("arm", "m/rad", 0.0, "linear", stroke / self.scale.joint, 0.002 * stroke / self.scale.joint,
                "position by joint angle at constant stretch"),
            row("zero", "m", 0.0, "linear", 10.0 * stroke, 10.0 * stroke, "position at which the spring is loose"),
            row("cubic", "", 0.0, "linear", 0.3, 0.02, "share of the cubic term at a tenth of the stroke"),
            row("damping", "N·s/m", 0.0, "linear", size / self.scale.speed, 0.1 * size / self.scale.speed,
                "damping of the spring"),
            row("start_lag", "s", 0.0, "linear", 5e-3, 5e-4, "lag of START behind motion"),
        ]

    def _drive_rows(self) -> list[ModelConstant]:
        row, size, peak = ModelConstant, self.scale.spread[FORCE], self.scale.peak[FORCE]
        heavy = size / self.scale.acceleration
        rows = [
            row("inertia", "kg", 0.0, "positive", 3.0 * heavy, FIRM * heavy, "mass that the drive moves", 0.01 * heavy),
            row("drive_offset", "N", 0.0, "linear", size, ZERO * peak, "constant force"),
            row("drive_lag", "s", 0.0, "linear", 5e-3, 5e-4, "lag of the force behind the motion"),
            row("demand_gain", "", 1.0, "linear", 0.0, 0.0, "force that the drive gives over what it reports",
                step=0.01),
        ]
        if self.turning:
            return [*rows, row("unbalance", "N·m", size, "log", 1.5, FIRM, "largest torque of gravity"),
                    row("unbalance_phase", "rad", 0.0, "linear", 2.0, ANGLE, "angle of the mass from below at 0")]
        stiff = size / self.scale.stroke
        return [*rows, row("drive_spring", "N/m", 0.0, "linear", stiff, 0.05 * stiff, "force by position")]

    def _joint_rows(self) -> list[ModelConstant]:
        row, spread, stroke = ModelConstant, self.scale.spread[JOINT], self.scale.stroke
        give = spread / max(self.scale.spread[START], 1e-9)
        return [
            row("joint_zero", "rad", 0.0, "linear", 10.0, 10.0, "joint angle at position 0 without load"),
            row("joint_ratio", "rad/m", 0.0, "linear", spread / stroke * 10.0, 0.002 * spread / stroke,
                "joint angle by position"),
            row("give", "rad/N", 0.0, "linear", give, SPRING * give, "joint angle by START"),
            row("give_end", "rad/N", 0.0, "linear", give, SPRING * give, "joint angle by END"),
        ]

    def _hypotheses(self) -> dict[str, Hypothesis]:
        made: dict[str, Hypothesis] = {}
        if START in self.outputs and self.has_end:
            made |= tension_hypotheses(self.scale.end, self.scale.speed, self.scale.peak[START])
        if self.sprung:
            made |= spring_hypotheses()
        if FORCE in self.outputs:
            made |= drive_hypotheses(self.scale.spread[FORCE], self.scale.speed, self.scale.peak[FORCE], self.turning)
        if self.angled:
            made |= give_hypotheses()
        return made

    # -- prediction --------------------------------------------------------------------------------------------------

    def sessions(self, recordings: Sequence[RigRecording]) -> list[RigSession]:
        """Return recordings grouped by session; two recordings in the same condition belong to different sessions."""
        made: list[list[RigRecording]] = []
        for one in recordings:
            rank = sum(self._alike(one, other) for session in made for other in session)
            if rank == len(made):
                made.append([])
            made[rank].append(one)
        return [RigSession(session) for session in made]

    def _alike(self, one: RigRecording, other: RigRecording) -> bool:
        def condition(r: RigRecording) -> Array:
            load = np.abs(r.inputs[END]).mean() if self.has_end else 1.0
            return np.array([load, np.sqrt(np.mean(r.v**2)), np.ptp(r.x)])
        ratio = condition(one) / (condition(other) + 1e-30)
        return bool(np.all((ratio > 1.0 / ALIKE) & (ratio < ALIKE)))

    def predict(self, q: Array, trial: Taken) -> Array:
        """Return the predicted data of each column of coordinates `q`, shape (sets, data)."""
        if isinstance(trial, RigSession):
            return trial.joined([self.predict(q, r) for r in trial.recordings])
        given = dict(zip(self.constants.names, self.constants.values(q)[:, :, None], strict=True))
        told = {}
        if START in self.outputs:
            told[START] = self._start(given, trial)
        if FORCE in self.outputs:
            told[FORCE] = self._force(given, trial)
        if self.angled:
            told[JOINT] = (given["joint_zero"] + given["joint_ratio"] * trial.x + given["give"] * trial.inputs[START]
                           + given["give_end"] * trial.inputs[END])
        return np.concatenate([trial.smoothed(told[name]) for name in trial.outputs], axis=1)

    def _start(self, given: Mapping[str, Array], trial: RigRecording) -> Array:
        if self.has_end:
            end = trial.inputs[END]
            signal = (given["ratio"] * end + given["offset"] + given["spring"] * (trial.x - trial.x.mean())
                      + self._rubbed(given, trial, "", np.abs(end) / self.scale.end))
        else:
            stretch = trial.x - given["arm"] * trial.inputs[JOINT] - given["zero"]
            reach = 0.1 * self.scale.stroke
            signal = given["stiffness"] * stretch * (1.0 + given["cubic"] * (stretch / reach) ** 2) + (
                given["damping"] * np.gradient(stretch, GRID_S, axis=-1))
        return _late(signal, given["start_lag"])

    def _force(self, given: Mapping[str, Array], trial: RigRecording) -> Array:
        load = np.zeros_like(trial.x)
        if self.turning:
            load = given["unbalance"] * np.sin(trial.x + given["unbalance_phase"])
        elif self.loaded:
            load = trial.inputs[START]
        force = load + given["inertia"] * trial.a + given["drive_offset"] + self._rubbed(
            given, trial, "drive_", np.abs(load) / self.scale.spread[FORCE])
        if not self.turning:
            force = force + given["drive_spring"] * (trial.x - trial.x.mean())
        return _late(force, given["drive_lag"]) / given["demand_gain"]

    def _rubbed(self, given: Mapping[str, Array], trial: RigRecording, prefix: str, load: Array) -> Array:
        """Return the friction force, shape (sets, samples); `load`: relative to its RMS or scale."""
        travels, row = np.unique(given[prefix + "travel"][:, 0], return_inverse=True)
        slip = dahl_states(trial.x, travels)[row.ravel()]
        a, b = given[prefix + "load_share"], given[prefix + "viscous_share"]
        dry = 1.0 - a - b
        dry = 0.5 * (dry + np.sqrt(dry * dry + 4e-4))
        speed = trial.v / self.scale.speed
        slow = given[prefix + "rest_speed"]
        # the Stribeck curve is 1 at the RMS speed, so that `friction` is the sliding friction of these trials
        settled = np.exp(-((self.scale.speed / slow) ** 2))
        curve = 1.0 + given[prefix + "rest"] * (np.exp(-((trial.v / slow) ** 2)) - settled)
        if not prefix:
            drift = 1.0 + given["drift"] * (trial.progress - 0.5)
            return np.asarray(self.sense * given["friction"] * drift * ((dry + a * load) * slip * curve + b * speed))
        dry_part = (dry * (1.0 + given["drive_asymmetry"] * slip) + a * load) * slip * curve
        return np.asarray(given["drive_friction"] * (
            dry_part + b * (speed + given["drive_viscous_asymmetry"] * np.abs(speed))))

    def simulated_states(self, q: Array, trial: Taken) -> Array:
        """Return the states that the discrepancy depends on, shape (states, bins), simulated at coordinates `q`."""
        if isinstance(trial, RigSession):
            return np.concatenate([self.simulated_states(q, r) for r in trial.recordings], axis=1)
        given = self.constants.named(q)
        travel = given.get("travel", given.get("drive_travel", 1e-2 * self.scale.stroke))
        slip = dahl_states(trial.x, np.array([travel]))[0]
        load = np.abs(trial.inputs[END]) if self.has_end else np.abs(trial.inputs[START]) if self.loaded else (
            np.abs(trial.v))
        joint = trial.inputs[JOINT] if self.sprung else trial.v * 0.0
        return trial.binned(np.stack([
            trial.x - trial.x.mean(), np.arcsinh(3.0 * trial.v / self.scale.speed), slip,
            np.log(load + 0.1 * load.mean() + 1e-12), np.arcsinh(trial.a / self.scale.acceleration),
            joint - joint.mean()]))

    # -- start of the first fit --------------------------------------------------------------------------------------

    def origin(self, trial: Taken) -> Array:
        """Return start coordinates of the first fit, by least squares at the best pre-sliding distance."""
        return self.scanned(np.zeros(len(self.constants)), trial)[0]

    def scanned(self, middle: Array, trial: Taken) -> list[Array]:
        """Return the `STARTS` coordinates with the smallest error on the trial, one per pre-sliding distance."""
        starts = [self._regressed(middle, trial, travel * self.scale.stroke) for travel in TRAVELS]
        data = self.predict(np.stack(starts, axis=1), trial)
        weight = np.repeat([1.0 / self.scale.spread[n] for n in trial.outputs], trial.bins)
        misses = np.abs((data - trial.data) * weight).mean(axis=1)
        return [starts[k] for k in np.argsort(misses)[:STARTS]]

    def _regressed(self, middle: Array, trial: Taken, travel: float) -> Array:
        q = middle.copy()
        found: dict[str, float] = {}
        if START in self.outputs:
            found |= self._start_terms(trial, travel)
        if FORCE in self.outputs:
            found |= self._force_terms(trial, travel)
        if self.angled:
            found |= dict(zip(("joint_zero", "joint_ratio", "give", "give_end"), _fitted(trial, JOINT, [
                np.ones_like(trial.x), trial.x, trial.inputs[START], trial.inputs[END]]), strict=True))
        for name, value in found.items():
            q[self.constants.index[name]] = self.constants.coordinate(name, value)
        return q

    def _start_terms(self, trial: Taken, travel: float) -> dict[str, float]:
        one = np.ones_like(trial.x)
        if not self.has_end:
            k, damp, arm, zero = _fitted(trial, START, [trial.x, trial.v, -trial.inputs[JOINT], -one])
            k = k if k > 0.0 else self.scale.spread[START] / self.scale.stroke
            return {"stiffness": k, "damping": 0.0 * damp, "arm": arm / k, "zero": zero / k}
        end = trial.inputs[END]
        rubs = self._friction_terms(trial, travel, np.abs(end) / self.scale.end)
        ratio, offset, spring, *own = _fitted(trial, START, [end, one, trial.x - trial.x.mean(), *rubs])
        if np.std(end) < 0.02 * np.abs(end).mean():  # with a constant load, ratio and offset are confounded
            ratio, offset, spring, *own = 1.0, *_fitted(trial, START, [one, trial.x - trial.x.mean(), *rubs], end)
        return {"ratio": ratio, "offset": offset, "spring": spring, "travel": travel, **self._sized("", own)}

    def _force_terms(self, trial: Taken, travel: float) -> dict[str, float]:
        columns = {"inertia": trial.a, "drive_offset": np.ones_like(trial.x)}
        if self.turning:
            columns |= {"sin": np.sin(trial.x), "cos": np.cos(trial.x)}
        else:
            columns["drive_spring"] = trial.x - trial.x.mean()
        rubs = self._friction_terms(trial, travel, None)
        less = trial.inputs[START] if self.loaded else None
        told = _fitted(trial, FORCE, [*columns.values(), *rubs], less)
        found = dict(zip(columns, told, strict=False))
        found["inertia"] = max(found["inertia"], 1e-3 * self.scale.spread[FORCE] / self.scale.acceleration)
        if self.turning:
            sin, cos = found.pop("sin"), found.pop("cos")
            found |= {"unbalance": max(float(np.hypot(sin, cos)), 0.02 * self.scale.spread[FORCE]),
                      "unbalance_phase": float(np.arctan2(cos, sin))}
        dry, viscous = told[len(columns):]
        return {**found, "drive_travel": travel, **self._sized("drive_", (dry, 0.0, viscous))}

    def _friction_terms(self, trial: Taken, travel: float, load: Array | None) -> list[Array]:
        slip = dahl_states(trial.x, np.array([travel]))[0]
        return [slip, *([] if load is None else [slip * load]), trial.v / self.scale.speed]

    def _sized(self, prefix: str, own: Sequence[float]) -> dict[str, float]:
        """Return size and shares of friction from its dry, load and viscous parts `own`, by name of the constant."""
        dry, load, viscous = own if prefix else [self.sense * part for part in own]
        output = FORCE if prefix else START
        size = max(dry + load + viscous, 0.05 * self.scale.spread[output])
        shares = {prefix + "load_share": load / size, prefix + "viscous_share": viscous / size}
        return {prefix + "friction": size, **{n: float(np.clip(s, -0.3, 1.3)) for n, s in shares.items()}}

    def _sense(self, all_trials: RigSession) -> float:
        """Return −1 if friction lowers START as the position grows, else 1, by regression of START."""
        end, position = all_trials.inputs[END], all_trials.x - all_trials.x.mean()
        misses = []
        for travel in TRAVELS:
            rubs = self._friction_terms(all_trials, travel * self.scale.stroke, np.abs(end) / self.scale.end)
            columns = [*rubs, end, np.ones_like(end), position]
            told = _fitted(all_trials, START, columns)
            rest = all_trials.binned(all_trials.measured(START))
            rest = rest - np.array(told) @ all_trials.smoothed(np.stack(columns))
            misses.append((float(np.std(rest)), sum(told[:3])))
        return -1.0 if min(misses)[1] < 0.0 else 1.0

    # -- scatter between sessions and model error --------------------------------------------------------------------

    def session_at(self, q: Array) -> Array:
        """Return 1σ between sessions of each constant, in coordinates, of a rig at coordinates `q`."""
        sd, given, index = self.constants.session_sd.copy(), self.constants.named(q), self.constants.index
        own = {"inertia": FIRM * abs(given.get("inertia", 0.0)), "give": SPRING * abs(given.get("give", 0.0)),
               "give_end": SPRING * abs(given.get("give_end", 0.0)), "joint_ratio": 0.005 * abs(given.get(
                   "joint_ratio", 0.0)), "arm": 0.005 * abs(given.get("arm", 0.0))}
        for name, width in own.items():
            if name in index:
                sd[index[name]] = max(width, 1e-3 * self.constants.bench_sd[index[name]])
        return sd

    def growth(self, trial: Taken, name: str, signal: Array) -> float:
        """Return the factor, at least 1, by which the model error's variance grows with the `signal` of an output."""
        if name == JOINT:
            return 1.0
        if name == START and self.has_end:
            signal = _rest(signal, [trial.binned(trial.inputs[END]), np.ones(signal.size)])
        elif name == FORCE and self.loaded:
            signal = signal - trial.binned(trial.inputs[START])
        return max(1.0, float(np.var(signal)) / self.scale.spread[name] ** 2)

    def changing(self, trial: Taken, name: str, signal: Array) -> float:
        """Return the variance of the part of an output that the trial's constants explain: START less END, for START.
        """
        if name == START and self.has_end:
            signal = signal - trial.binned(trial.inputs[END])
        elif name == FORCE and self.loaded:
            signal = signal - trial.binned(trial.inputs[START])
        return 1.0 if name == JOINT else float(np.var(signal))

    def aliased(self, q: Array, trial: Taken, name: str) -> Array | float:
        """Return 0: the low-pass of the outputs removes aliased frequencies."""
        return 0.0

    def errors(self, trial: Taken, residual: Array) -> dict[str, Array]:
        """Return the error of each output signal, by output: its rows of `residual`."""
        return {name: trial.part(residual, k) for k, name in enumerate(trial.outputs)}


REGRESSED: Final = frozenset({
    "friction", "drive_friction", "ratio", "offset", "spring", "stiffness", "arm", "zero", "inertia", "drive_offset",
    "unbalance", "unbalance_phase", "drive_spring", "joint_zero", "joint_ratio", "give", "give_end"})
"""Constants without a typical value; their prior is centred at the regression of the first reference trial."""


def _late(signals: Array, lag_s: Array) -> Array:
    return np.asarray(signals - lag_s * np.gradient(signals, GRID_S, axis=-1))


def _rest(signal: Array, columns: Sequence[Array]) -> Array:
    design = np.stack(columns, axis=1)
    return np.asarray(signal - design @ np.linalg.lstsq(design, signal, rcond=None)[0])


def _fitted(trial: Taken, output: str, columns: Sequence[Array], less: Array | None = None) -> list[float]:
    """Return the coefficients of `columns` that fit an output, less a known signal, by least squares."""
    signal = trial.measured(output) if less is None else trial.measured(output) - less
    design = trial.smoothed(np.stack(columns))
    size = np.sqrt(np.mean(design**2, axis=1)) + 1e-30
    found = np.linalg.lstsq((design / size[:, None]).T, trial.binned(signal), rcond=2e-2)[0]
    return [float(value) for value in found / size]
