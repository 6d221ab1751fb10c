"""Forward model of a rig other than the bench; its outputs are chosen by the recorded columns.

    START force      friction and spring between START and END, if END is recorded; else a spring to the joint.
    drive force      START or gravity, friction, inertia, spring.
    joint angle      zero + ratio·position + compliance·START and END, if END is recorded, too.

Equations: `physics.forward.rig_forces`.  Constants and priors: `physics.forward.rig_constants`.  Inputs are the
measured motion and the measured END.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import butter, sosfiltfilt

from estimation.data.table import Table
from estimation.forward_model import ForwardModel
from estimation.likelihood_data import GRID_S, LOWPASS_HZ, START_S, Recording
from parameters import InputError
from physics.effects.hypotheses import SENSOR, Hypothesis, Read
from physics.effects.rig_hypotheses import (
    STRETCH_M_PER_N,
    drive_hypotheses,
    give_hypotheses,
    spring_hypotheses,
    tension_hypotheses,
)
from physics.forward.rig_constants import (
    END,
    FORCE,
    JOINT,
    REPEATED,
    START,
    RigColumns,
    RigScale,
    gravity_of,
    is_of_friction,
    is_regressed,
    session_sd,
    table_of,
)
from physics.forward.rig_forces import RigMotion, dahl_states, drive_force, link_torques, spring_force, start_force
from physics.laws import Array
from physics.parameters import ESTIMATED


class RigRecording(Recording):
    """A trial of a rig on the time grid: position `x`, its derivatives `v` and `a`, and the other `inputs` by name.

    Inputs are START, END and joint angle, as far as recorded.  `motion_hz`: cut-off of the motion.  `stands`: bins in
    which the axis stands, none if it never moves.
    """

    def __init__(self, table: Table, outputs: Sequence[str], joints: Sequence[str] = ("",), joint: str = "",
                 motion_hz: float = LOWPASS_HZ) -> None:
        at = table["servo_position_m"]
        gone = np.cumsum(np.abs(np.diff(at, prepend=at[0])))
        # after half a stroke friction no longer depends on the motion before the trial
        time = table["time_s"] - table["time_s"][0]
        settled = max(time[np.searchsorted(gone, 0.5 * np.ptp(at))], 0.5 * START_S)
        super().__init__(table, outputs, 0.5 * LOWPASS_HZ, min(settled, 0.3 * time[-1]), motion_hz)
        self.x = self.sampled("servo_position_m", motion_hz)
        self.v = self.slope(self.x)
        self.a = self.slope(self.v)
        angles = np.cumsum([self.x if name == joint else self.sampled(f"{name}.servo_position_m", motion_hz)
                            for name in joints], axis=0)
        rates = np.stack([self.slope(angle) for angle in angles])
        self.links = np.stack([angles, rates, [self.slope(rate) for rate in rates]])
        self.motion = RigMotion(self.x, self.v, self.a, self.progress, self.links)
        self.inputs = {name: self.sampled(name, LOWPASS_HZ) for name in (START, END, JOINT) if name in table}
        self.along = {"rope_m_s": self.v, "servo_position_m": self.x, **self.inputs}
        self.encoder_step = _step(at, self.sampled("servo_position_m", LOWPASS_HZ), table["time_s"])
        # a servo that hunts about a point stands there, too: its motion is above the cut-off
        stands = self.binned(_stands(self.x, _step(at, self.x, table["time_s"]))) > 0.0
        self.stands = stands & ~stands.all()
        self._smoother = butter(2, self.lowpass_hz, fs=1.0 / GRID_S, output="sos")
        self.data = np.concatenate([self.binned(self.measured(name)) for name in self.outputs])

    def runs_on(self, other: RigRecording, steps: float = 5.0) -> bool:
        """Return whether one recording's clock continues the other's within `steps` rows: parts of one recording."""
        first, second = sorted((self._table["time_s"], other._table["time_s"]), key=lambda time: float(time[0]))
        return bool(0.0 < second[0] - first[-1] < steps / self.rate)

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
        self.x, self.v, self.a, self.links = (np.concatenate([getattr(r, name) for r in recordings], axis=-1)
                                              for name in ("x", "v", "a", "links"))
        self.inputs = {n: np.concatenate([r.inputs[n] for r in recordings]) for n in first.inputs}
        self.noise_n = {n: float(np.sqrt(np.mean([r.noise_n[n] ** 2 for r in recordings]))) for n in first.outputs}
        self.bins = sum(r.bins for r in recordings)
        self.stands = np.concatenate([r.stands for r in recordings])
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

    def on_all_bins(self, values: Array) -> Array:
        """Return an array over the bins of one output with NaN for those at starts and gaps, which do not count."""
        parts = [np.full(r.time_s.size // r.width, np.nan) for r in self.recordings]
        ends = np.cumsum([r.bins for r in self.recordings])[:-1]
        for part, r, own in zip(parts, self.recordings, np.split(values, ends), strict=True):
            part[r.rows] = own
        return np.concatenate(parts)

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


class RigModel(ForwardModel):
    """Forward model of the rig of the reference trials `tables`; the module lists its outputs.

    `sense`: −1 if friction lowers START as the position grows, else 1.  `rubbed`: outputs that friction changes.
    """

    amounts: Mapping[str, tuple[str, float]] = {"rest_speed": ("rest", 0.1), "drive_rest_speed": ("drive_rest", 0.1)}
    states = 6
    load_state = 3
    pools_sessions = True
    unseen = 1.0
    session_share = 0.7
    nats_factor = 0.4
    unlike_share = 0.7

    def __init__(self, tables: Sequence[Table], cutoffs_hz: Sequence[float] = (LOWPASS_HZ, 20.0, 10.0, 5.0),
                 alike: float = 0.05) -> None:
        """Choose outputs and constants by the columns of the reference trials.

        `cutoffs_hz`: of the motion of a drive, whose acceleration from a coarse encoder is noise above some frequency.
        Taken is the highest one whose first regression has a median error within the share `alike` of the least.
        """
        has = {name for name in (START, END, FORCE, JOINT) if all(name in t for t in tables)}
        self.has_end = {START, END} <= has
        self.sprung = {START, JOINT} <= has and not self.has_end
        self.angled = self.has_end and JOINT in has
        self.loaded = START in has
        self.outputs = tuple(name for name, there in (
            (START, self.has_end or self.sprung), (FORCE, FORCE in has), (JOINT, self.angled)) if there)
        self.turning = all(t.turning for t in tables)
        self.rig = RigColumns(self.outputs, self.turning, self.has_end, self.sprung, self.angled, self.loaded,
                              all(t.volts for t in tables), tables[0].joints, tables[0].joint)
        self.states = 5 + len(self.rig.joints)
        self.rubbed = tuple(name for name in self.outputs if name == FORCE or (name == START and self.has_end))
        self.signals = {name: "rad" if name == JOINT else self.rig.unit("N") for name in self.outputs}
        self.judged = tuple(name for name in self.outputs if name != JOINT)
        if not self.outputs:
            return
        offered = cutoffs_hz if FORCE in has else cutoffs_hz[:1]
        left = np.abs([self._size(tables, hz) for hz in offered])
        moves = np.isfinite(left).all(axis=0)
        # the median, since what is left at reversals says little of the rest
        median = np.median(left[:, moves], axis=1) if moves.any() else np.ones(len(offered))
        self._size(tables, offered[int(np.argmax(median <= (1.0 + alike) * median.min()))])

    def _size(self, tables: Sequence[Table], motion_hz: float) -> Array:
        """Set sizes, constants and first noise with a cut-off of the motion, Hz.

        Returns the error of the first regression relative to the spread of each output; NaN where no datum counts.
        """
        self.motion_hz = motion_hz
        self.scale = self._scaled(tables)
        self.least = {n: 0.003 * s for n, s in self.scale.spread.items()}
        self.constants = table_of(self.rig, self.scale)
        self.hypotheses = self._hypotheses()
        self.sense, every = 1.0, RigSession([self.record(t) for t in tables])
        if self.has_end:
            self.sense = self._sense(every)
        self.regressed = tuple(n for n in self.constants.names if is_regressed(n))
        origin = self.origin(every)
        # an inertia of about 0 is lifted in the prior of a trial, which a smaller 1σ than stated would contradict
        acts = self.constants.lifted(origin) == origin
        self.scattered = self.structural = tuple(
            n for n in self.constants.names if is_of_friction(n) or (n in REPEATED and acts[self.constants.index[n]]))
        left = self.errors(every, every.data - self.predict(origin[:, None], every)[0])
        left = {n: np.where(self.unpredicted(origin, every, n) < np.inf, left[n], np.nan) for n in self.outputs}
        self.first_noise = {n: max(float(np.nanstd(left[n])), self.least[n]) for n in self.outputs}
        return np.concatenate([every.on_all_bins(left[n]) / self.scale.spread[n] for n in self.outputs])

    # -- columns, sizes and constants of the rig ---------------------------------------------------------------------

    def lacking(self, table: Table) -> list[str]:
        """Return the columns of the reference trials that a trial does not have."""
        needed = ["servo_position_m", *self.outputs]
        needed += [END] if self.has_end else []
        needed += [JOINT] if self.sprung else []
        needed += [START] if self.loaded else []
        needed += [f"{name}.servo_position_m" for name in self.rig.joints if name != self.rig.joint]
        missing = [name for name in dict.fromkeys(needed) if name not in table]
        if table.volts != self.rig.volts:  # both are the signal servo_force_n
            missing.append("motor_voltage_v" if self.rig.volts else "servo_torque_nm")
        return missing

    def limits(self, effect: str, parameter: str) -> tuple[float, float, str]:
        """Return the bounds of an effect's parameter on rigs of any size, and its unit on this linear or turning axis.
        """
        row = ESTIMATED[parameter]
        low, high = row.rig_bounds
        return low, high, self.rig.unit(row.unit)

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
        return RigRecording(table, self.outputs, self.rig.joints, self.rig.joint, self.motion_hz)

    def _scaled(self, tables: Sequence[Table]) -> RigScale:
        made = [self.record(t) for t in tables]

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
                        rms([m.a for m in made]), rms(ends), rms(joints), max(m.encoder_step for m in made),
                        spread, peak)

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
        """Return recordings grouped by session; two recordings in the same condition belong to different sessions.

        Two conditions are the same if load and speed differ by less than a quarter.  Recordings whose clock
        runs on from one to the other are parts of one session.
        """
        made: list[list[RigRecording]] = []
        for one in recordings:
            rank = sum(any(self._alike(one, other) and not one.runs_on(other) for other in session)
                       for session in made)
            if rank == len(made):
                made.append([])
            made[rank].append(one)
        return [RigSession(session) for session in made]

    def _alike(self, one: RigRecording, other: RigRecording) -> bool:
        def condition(r: RigRecording) -> Array:
            load = np.abs(r.inputs[END]).mean() if self.has_end else 1.0
            return np.array([load, np.sqrt(np.mean(r.v**2))])
        ratio = condition(one) / (condition(other) + 1e-30)
        return bool(np.all((ratio > 0.8) & (ratio < 1.25)))

    def predict(self, q: Array, trial: Taken) -> Array:
        """Return the predicted data of each column of coordinates `q`, shape (sets, data)."""
        if isinstance(trial, RigSession):
            return trial.joined([self.predict(q, r) for r in trial.recordings])
        given = dict(zip(self.constants.names, self.constants.values(q)[:, :, None], strict=True))
        told, inputs, motion = {}, trial.inputs, trial.motion
        if self.has_end:
            told[START] = start_force(given, motion, inputs[END], self.sense, self.scale, GRID_S)
        if self.sprung:
            told[START] = spring_force(given, motion, inputs[JOINT], self.scale, GRID_S)
        if FORCE in self.outputs:
            told[FORCE] = drive_force(given, motion, inputs.get(START), self.rig, self.scale, GRID_S)
        if self.angled:
            told[JOINT] = (given["joint_zero"] + given["joint_ratio"] * trial.x + given["give"] * inputs[START]
                           + given["give_end"] * inputs[END])
        return np.concatenate([trial.smoothed(told[name]) for name in trial.outputs], axis=1)

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
        others = [angle for name, angle in zip(self.rig.joints, trial.links[0], strict=True) if name != self.rig.joint]
        return trial.binned(np.stack([
            trial.x - trial.x.mean(), np.arcsinh(3.0 * trial.v / self.scale.speed), slip,
            np.log(load + 0.1 * load.mean() + 1e-12), np.arcsinh(trial.a / self.scale.acceleration),
            joint - joint.mean(), *others]))

    def course(self, q: Array, trial: Taken) -> tuple[Array, Array, Array, Array, Array | None]:
        """Return position, m, speed, m/s, twice the force that loads the friction, N, and joint angle, rad."""
        load = np.abs(trial.inputs[END] if self.has_end else trial.inputs[START] if self.loaded else trial.a)
        return trial.x, trial.v, load, load, trial.inputs.get(JOINT)

    def motion(self, trial: Taken) -> Array:
        """Return speed and acceleration, whose range in the reference trials a trial should not exceed.

        A position depends on the encoder's zero, and of a motor that runs on, on the length of the recording.
        """
        return trial.binned(np.stack([trial.v, trial.a]))

    # -- start of the first fit --------------------------------------------------------------------------------------

    def origin(self, trial: Taken) -> Array:
        """Return start coordinates of the first fit, by least squares at the best pre-sliding distance."""
        return self.scanned(np.zeros(len(self.constants)), trial)[0]

    def scanned(self, middle: Array, trial: Taken) -> list[Array]:
        """Return coordinates of the first fit, one per pre-sliding distance, the smallest error on the trial first."""
        starts = [self._regressed(middle, trial, travel) for travel in self._travels()]
        data = self.predict(np.stack(starts, axis=1), trial)
        weight = np.repeat([1.0 / self.scale.spread[n] for n in trial.outputs], trial.bins)
        misses = np.abs((data - trial.data) * weight).mean(axis=1)
        return [starts[k] for k in np.argsort(misses)]

    def _travels(self) -> Array:
        """Return the pre-sliding distances at which the first fit may start: from 1e-4 to 0.3 of the stroke."""
        return np.asarray(np.geomspace(1e-4, 0.3, 7) * self.scale.stroke)

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
            # position and joint angle differ by the spring's stretch alone, a hundredth of a stroke or less
            k, damp, arm, zero = _fitted(trial, START, [trial.x, trial.v, -trial.inputs[JOINT], -one], least=1e-4)
            k = k if k > 0.0 else self.scale.spread[START] / self.scale.stroke
            return {"stiffness": k, "damping": 0.0 * damp, "arm": arm / k, "zero": zero / k}
        end = trial.inputs[END]
        rubs = self._friction_terms(trial, travel, np.abs(end) / self.scale.end)
        ratio, offset, spring, *own = _fitted(trial, START, [end, one, trial.x - trial.x.mean(), *rubs])
        if np.std(end) < 0.02 * np.abs(end).mean():  # with a constant load, ratio and offset are confounded
            ratio, offset, spring, *own = 1.0, *_fitted(trial, START, [one, trial.x - trial.x.mean(), *rubs], end)
        # ratio·e^(±c) is ratio·cosh c ± ratio·sinh c
        wraps = float(np.arctanh(np.clip(own[1] / (self.scale.end * ratio), -0.9, 0.9)))
        own[1] = self.scale.end * np.sinh(wraps)
        return {"ratio": ratio / np.cosh(wraps), "offset": offset, "spring": spring, "travel": travel,
                **self._sized("", own)}

    def _force_terms(self, trial: Taken, travel: float) -> dict[str, float]:
        columns = {"inertia": trial.a, "drive_offset": np.ones_like(trial.x)}
        moved = self.rig.moved
        if self.turning:
            columns |= link_torques(trial.links, self.rig)
            for name, angle in zip(moved, trial.links[0, -len(moved):], strict=True):
                columns |= {f"sin {name}": np.sin(angle), f"cos {name}": np.cos(angle)}
        else:
            columns["drive_spring"] = trial.x - trial.x.mean()
        rubs = self._friction_terms(trial, travel, None)
        less = trial.inputs[START] if self.loaded else None
        told = _fitted(trial, FORCE, [*columns.values(), *rubs], less)
        found = dict(zip(columns, told, strict=False))
        found["inertia"] = max(found["inertia"], 1e-3 * self.scale.spread[FORCE] / self.scale.acceleration)
        if self.turning:
            for name in moved:
                sin, cos = found.pop(f"sin {name}"), found.pop(f"cos {name}")
                weight, phase = gravity_of(name, self.rig)
                found |= {weight: max(float(np.hypot(sin, cos)), 1e-3 * self.scale.spread[FORCE]),
                          phase: float(np.arctan2(cos, sin))}
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
        for travel in self._travels():
            rubs = self._friction_terms(all_trials, travel, np.abs(end) / self.scale.end)
            columns = [*rubs, end, np.ones_like(end), position]
            told = _fitted(all_trials, START, columns)
            rest = all_trials.binned(all_trials.measured(START))
            rest = rest - np.array(told) @ all_trials.smoothed(np.stack(columns))
            misses.append((float(np.std(rest)), sum(told[:3])))
        return -1.0 if min(misses)[1] < 0.0 else 1.0

    # -- scatter between sessions and model error --------------------------------------------------------------------

    def session_at(self, q: Array) -> Array:
        """Return 1σ between sessions of each constant, in coordinates, of a rig at coordinates `q`."""
        return session_sd(self.constants, q)

    def unpredicted(self, q: Array, trial: Taken, name: str) -> Array:
        """Return infinity where the axis stands, for a force that friction changes, else 0.

        While an axis stands, its friction is anywhere up to the static value.
        """
        return np.where(trial.stands & (name in self.rubbed), np.inf, 0.0)

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


def _step(position: Array, smooth: Array, time_s: Array) -> float:
    """Return the step of an encoder whose rounding a low-pass takes off: √12 times the RMS of the difference.

    `position`: at the times `time_s`.  `smooth`: low-passed, on the time grid.
    """
    grid = time_s[0] + GRID_S * np.arange(smooth.size)
    rounding = (position - np.interp(time_s, grid, smooth))[time_s <= grid[-1]]
    return float(np.sqrt(12.0 * np.mean(rounding**2)))


def _stands(smooth: Array, step: float, window_s: float = 0.2) -> Array:
    """Return 1 where an axis moves by less than two of `step` in the `window_s` around, else 0."""
    size = round(window_s / GRID_S) | 1
    moved = maximum_filter1d(smooth, size) - minimum_filter1d(smooth, size)
    return np.asarray(moved < 2.0 * step, np.float64)


def _rest(signal: Array, columns: Sequence[Array]) -> Array:
    design = np.stack(columns, axis=1)
    return np.asarray(signal - design @ np.linalg.lstsq(design, signal, rcond=None)[0])


def _fitted(trial: Taken, output: str, columns: Sequence[Array], less: Array | None = None, least: float = 2e-2
            ) -> list[float]:
    """Return the coefficients of `columns` that fit an output, less a known signal, by least squares.

    A drive force is fitted where the axis moves.  `least`: singular value, relative to the largest one, below which a
    direction is left at 0.
    """
    signal = trial.binned(trial.measured(output) if less is None else trial.measured(output) - less)
    design = trial.smoothed(np.stack(columns))
    if output == FORCE:
        design, signal = design[:, ~trial.stands], signal[~trial.stands]
    size = np.sqrt(np.mean(design**2, axis=1)) + 1e-30
    found = np.linalg.lstsq((design / size[:, None]).T, signal, rcond=least)[0]
    return [float(value) for value in found / size]


def rig_model_of(reference: Sequence[Table], trials: Sequence[Table]) -> RigModel:
    """Return the model of another rig, built on the columns that all reference trials and trials have.

    Raises `InputError` if one of them has no position of the axis, or if they have no signal that can be predicted.
    """
    for given in (*reference, *trials):
        if "servo_position_m" not in given:
            raise InputError(f"{given.source}: has no column servo_position_m that moves; the simulation of a rig "
                             "needs it. Record the axis' position, in trials and reference trials alike.")
    kept = {n for n in reference[0].columns if all(n in t for t in [*reference, *trials])}
    model = RigModel([replace(t, columns={n: v for n, v in t.columns.items() if n in kept}) for t in reference])
    if not model.outputs:
        every = [*reference, *trials]
        signals = [name for name in (START, END, FORCE, JOINT) if any(name in t for t in every)]
        given = next((t for t in every if any(name not in t for name in signals)), every[0])
        missing = ", ".join(name for name in signals if name not in given)
        because = f"has no column {missing}, so " if missing else ""
        raise InputError(f"{given.source}: {because}no signal can be predicted; record servo_force_n, or "
                         "tension_start_n with tension_end_n or knee_angle_rad, beside "
                         f"servo_position_m{''.join(f'; {note}' for note in given.notes)}.")
    return model
