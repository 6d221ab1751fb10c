"""Forward model of the bench's force path: START, END and servo force, N, from measured rope and knee motion."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from scipy.signal import lfilter

from estimation import likelihood_data, outputs
from estimation.data import integrity, scales, windows
from estimation.data.table import Table, with_locked_knee
from estimation.forward_model import ForwardModel
from estimation.likelihood_data import GRID_S, SIGNALS, TAUT_N, PathRecording
from parameters import InputError
from physics.effects.catalogue import CATALOGUE
from physics.effects.hypotheses import HYPOTHESES
from physics.forward import force_path
from physics.forward.path_constants import CONSTANTS, INDEX, named
from physics.laws import Array

UNRESOLVED: Final = 0.5
"""Share of the inertia force above 15 Hz that counts as noise of the servo force, since 200 Hz sampling aliases it."""
MODEL_ERROR_N: Final[Mapping[str, float]] = {"tension_end_n": 0.1, "tension_start_n": 0.1, "servo_force_n": 0.25}
"""Typical 1σ of the discrepancy, and of the model error of a bin, N, on the development population, by output."""


class PathModel(ForwardModel):
    """Forward model of the bench; its data are those of `PathRecording`."""

    constants = CONSTANTS
    hypotheses = HYPOTHESES
    signals: Mapping[str, str] = dict.fromkeys(SIGNALS, "N")
    judged = ("tension_start_n", "tension_end_n")
    least: Mapping[str, float] = {name: 0.4 * sd for name, sd in MODEL_ERROR_N.items()}
    """Least 1σ of the model error of a bin, N; every bench of the development population has a larger model error."""
    first_noise: Mapping[str, float] = {name: 4.0 * sd for name, sd in MODEL_ERROR_N.items()}
    regressed = ("zero", "arm", "stiffness")
    states = 9
    load_state = 4
    """Row of the logarithm of START tension among the states."""
    scattered = ("arm", "arm2", "arm3")
    """On some benches the geometry repeats, on others a garment that is put on anew changes it (decision 47)."""
    structural = (
        "curve2", "curve3", "cable_compliance", "fabric_share", "prompt", "slow", "creep_compliance", "creep_time",
        "bend", "load", "viscous", "dry", "wrap", "surface", "cable_travel", "fabric_travel", "breakaway",
        "fabric_breakaway", "stribeck_speed", "stribeck_memory", "sharpness")
    """No tolerance of like benches is published for these; some benches repeat them to a fifth of it (decision 55)."""
    surrogate_sd: Mapping[str, float] = {"start_gain": 0.02, "end_gain": 0.02}
    """On rigs of other structure a gain of 3 % absorbs model error; with the maker's class as 1σ, `end_gain` is named
    there in trials in the reference condition (decision 48)."""
    session_share = 0.35
    unseen = 7.0
    """Growth of the session deviation's σ by motion beyond the reference trials' range, per range (decision 29).

    With 0 an effect is named in a healthy gait of a higher peak than the only reference trial's.
    """
    extrapolated = force_path.NAMES
    session_shares = (0.0, 0.7, 1.4)
    unlike_share = 0.2
    amounts: Mapping[str, tuple[str, float]] = {"creep_time": ("creep_compliance", 1.5e-5)}
    relative = ("drive_coulomb", "drive_viscous", "drive_inertia")
    """Their session deviation is a share of the bench's own value: a drive of twice the friction differs by twice."""

    def session_at(self, q: Array) -> Array:
        """Return 1σ between sessions of each constant, in coordinates, of a bench at coordinates `q`."""
        sd, rows = self.constants.session_sd.copy(), [INDEX[name] for name in self.relative]
        own, middle = (self.constants.values(at)[rows] for at in (q, np.zeros_like(q)))
        sd[rows] *= np.maximum(1.0, np.abs(own / middle))
        return sd

    def lacking(self, table: Table) -> list[str]:
        """Return the needed columns that a trial does not have."""
        return likelihood_data.lacking(table)

    def limits(self, effect: str, parameter: str) -> tuple[float, float, str]:
        """Return the bounds and the unit of an effect's parameter from the catalogue."""
        told = next(p for p in CATALOGUE[effect].parameters if p.name == parameter)
        return told.low, told.high, told.unit

    def record(self, table: Table) -> PathRecording:
        """Return a trial of the bench on the time grid of the likelihood."""
        return PathRecording(table)

    def predict(self, q: Array, trial: PathRecording) -> Array:
        """Return the predicted data of each column of coordinates `q`, shape (sets, data)."""
        return outputs.predict(q, trial).data

    def simulated_states(self, q: Array, trial: PathRecording) -> Array:
        """Return the states that the discrepancy depends on, shape (states, bins), simulated at coordinates `q`."""
        path = outputs.predict(q[:, None], trial).path
        start = path.start[0]
        remembered = lfilter([GRID_S / 0.5], [1.0, GRID_S / 0.5 - 1.0], start)
        rate = np.gradient(start, GRID_S)
        return trial.binned(np.stack([
            trial.knee_rad / 0.4, np.gradient(trial.knee_rad, GRID_S) / 2.0, path.cable_slip[0], path.fabric_slip[0],
            np.log(start + 3.0), np.arcsinh(rate / 50.0), remembered / 15.0, np.arcsinh(trial.rope_m_s / 0.02),
            np.log(path.middle[0] + 3.0)]))

    def course(self, q: Array, trial: PathRecording) -> tuple[Array, Array, Array, Array, Array | None]:
        """Return position, m, speed, m/s, START and END tension as simulated at `q`, N, and knee angle, rad."""
        path = outputs.predict(q[:, None], trial).path
        return trial.rope_m, trial.rope_m_s, path.start[0], path.end[0], trial.knee_rad

    def motion(self, trial: PathRecording) -> Array:
        """Return knee angle, its rate, and the tension that is led along the gait: END, or START if it is not measured.
        """
        tension = trial.measured("tension_end_n" if "tension_end_n" in trial.outputs else "tension_start_n")
        return trial.binned(np.stack([trial.knee_rad, np.gradient(trial.knee_rad, GRID_S), tension]))

    def origin(self, trial: PathRecording) -> Array:
        """Return start coordinates: zero, lever arm and stiffness by regression of the rope on knee angle and load."""
        q = np.zeros(len(CONSTANTS))
        found = _regressed(trial)
        if found is not None:
            zero, arm, stretch = found
            q[INDEX["zero"]], q[INDEX["arm"]] = zero, arm - CONSTANTS.rows[INDEX["arm"]].middle
            q[INDEX["stiffness"]] = np.log(0.01 / (1.5 * max(stretch, 2e-3)))
        return q

    def pulls(self, table: Table) -> bool:
        """Return whether the rope position grows with tension at constant knee angle; True if the rope is hardly taut.
        """
        found = _regressed(self.record(table))
        return found is None or found[2] > 0.0

    def scanned(self, middle: Array, trial: PathRecording) -> list[Array]:
        """Return the best zero about `middle` of each stiffness and friction, the smallest error on the trial first.

        A scan is needed since the fit has no gradient at a rope zero at which the simulated rope is slack.
        """
        q, errors = self._scan(middle, trial)
        chosen: dict[tuple[float, float], int] = {}
        for k in np.argsort(errors):
            chosen.setdefault((q[INDEX["stiffness"], k], q[INDEX["cable"], k]), int(k))
        return [q[:, k] for k in chosen.values()]

    def scan_error(self, table: Table) -> float:
        """Return the smallest mean absolute error, N, of a trial on the grid of start points."""
        trial = self.record(table)
        return float(self._scan(self.origin(trial), trial)[1].min())

    def _scan(self, middle: Array, trial: PathRecording) -> tuple[Array, Array]:
        """Return the grid's coordinates about `middle`, shape (constants, points), and the mean absolute errors, N.

        Axes: departure of the rope zero from the regression's, m, in steps in which a slack rope is not missed, and
        logarithms of stiffness and friction over the population's middle.
        """
        zero, stiffness, friction = (axis.ravel() for axis in np.meshgrid(
            np.linspace(-24e-3, 12e-3, 25), np.linspace(-1.0, 1.0, 5), np.linspace(-0.6, 0.6, 3), indexing="ij"))
        q = np.repeat(middle[:, None], zero.size, axis=1)
        q[INDEX["zero"]] += zero
        q[INDEX["stiffness"]] = stiffness
        q[INDEX["cable"]] = q[INDEX["fabric"]] = friction
        # point by point of the other axes, since 375 simulations at once would be the peak of memory
        return q, np.concatenate([np.abs(self.predict(part, trial) - trial.data).mean(axis=1)
                                  for part in np.array_split(q, 15, axis=1)])

    def unpredicted(self, q: Array, trial: PathRecording, name: str) -> Array | float:
        """Return the variance of the servo force by aliased inertia forces, N², by bin; 0 for the other outputs."""
        if name != "servo_force_n":
            return 0.0
        return trial.binned((UNRESOLVED * named(q)["drive_inertia"] * trial.unresolved_m_s2) ** 2)

    def errors(self, trial: PathRecording, residual: Array) -> dict[str, Array]:
        """Return the error of each output signal, N, by output, from the residual of the data."""
        errors = super().errors(trial, residual)
        if "tension_end_n" in errors:  # its datum is END less the measured ratio times START
            errors["tension_end_n"] = errors["tension_end_n"] + trial.binned(trial.ratio) * errors["tension_start_n"]
        return errors

    def weighed(self, trial: PathRecording, errors: Mapping[str, Array]) -> Array:
        """Return the error of the data from the error of each output signal, N, by output, each of shape (bins,)."""
        told = dict(errors)
        if "tension_end_n" in told:
            told["tension_end_n"] = told["tension_end_n"] - trial.binned(trial.ratio) * told["tension_start_n"]
        return super().weighed(trial, told)


def _regressed(trial: PathRecording, off_m: float = 2e-3) -> tuple[float, float, float] | None:
    """Return zero, m, lever arm, m/rad, and stretch at 40 N, m, by regression of the taut rope beside a prior.

    None if fewer than 50 samples are taut.  Without the prior, zero and lever arm could not be separated where the rope
    is taut at hardly more than one knee angle.  `off_m`: 1σ by which friction and fabric displace the rope, as a whole
    like 50 samples without correlation.
    """
    taut = trial.start_n > TAUT_N
    load = trial.start_n[taut]
    if load.size < 50:
        return None
    on = trial.knee_rad[taut] + 0.5
    design = np.stack([np.ones(load.size), on, on**2, load / 40.0, np.log1p(load / 3.0) / np.log1p(40.0 / 3.0)], axis=1)
    # 1σ of zero, m, lever arm, m/rad and m/rad², and of the linear and the curved stretch at 40 N, m
    spread, weight = np.array([1.0, 0.01, 0.01, 0.02, 0.02]), np.sqrt(50.0 / load.size) / off_m
    middle = CONSTANTS.rows[INDEX["arm"]].middle
    zero, arm, _, linear, curved = np.linalg.lstsq(
        np.concatenate([weight * design, np.diag(1.0 / spread)]),
        np.append(weight * (trial.rope_m[taut] - middle * on), np.zeros(spread.size)), rcond=None)[0]
    return float(zero), float(middle + arm), float(linear + curved)


PATH_MODEL: Final = PathModel()


def usable_table(path: Path, force_path: str | None, motion: Sequence[str] = ()) -> Table:
    """Read the table of a trial and return it without the columns that a fit cannot use, such as a constant one.

    `force_path` selects one path of a bench that has several; columns in `motion` may be constant. Without a knee angle
    the knee is locked if the trial can be of a bench. Raises `InputError` if columns contradict each other, or if a
    needed one is missing.
    """
    given = windows.read(path, force_path)
    refused = [f.text for f in (*integrity.examine(given), *scales.contradictions(given)) if f.refuses]
    if refused:
        raise InputError(refused[0])
    plain = integrity.usable(given, motion)
    if "knee_angle_rad" not in plain and can_be_of_bench([plain]):
        plain = with_locked_knee(plain)
    missing = PATH_MODEL.lacking(plain)
    if missing == ["knee_angle_rad"]:
        raise InputError(f"{path}: has no column knee_angle_rad, and START and END without a knee are of a cable or a "
                         "seal, which this model cannot follow; record the angle, or compare a rig of another kind by "
                         "bowden diagnose --healthy.")
    if missing:
        raise InputError(f"{path}: has no column {', '.join(missing)}; record it, or compare a rig of another kind by "
                         "bowden diagnose --healthy.")
    return plain


def can_be_of_bench(trials: Sequence[Table], compressed: float = 0.1) -> bool:
    """Return whether trials, as recorded, can be of a rope over a knee, by their columns.

    A gait is always of a bench.  Other trials can be of a bench if all have rope motion and START, and no axis turns.
    START has no compression beyond the share `compressed` of its largest tension.  A trial without a knee angle is of a
    bench whose knee is locked if it is a bench's own experiment, or if END is not recorded either: START over END
    alone is a cable or a seal.
    """
    if any("gait_percent" in t for t in trials):
        return True
    return all(not t.turning and {"servo_position_m", "tension_start_n"} <= set(t.columns)
               and ("knee_angle_rad" in t or "tension_end_n" not in t or bool(t.experiment))
               and np.nanmin(t["tension_start_n"]) > -compressed * np.nanmax(t["tension_start_n"]) for t in trials)


def is_of_bench(trials: Sequence[Table], unlike: Callable[[], str]) -> bool:
    """Return whether reference trials, as recorded, are of a rope over a knee, and not of a rig of another kind.

    `unlike`: function that fits the bench's model and returns why it does not predict the trials ("": it does).  A
    gait is of a bench even so.
    """
    return any("gait_percent" in t for t in trials) or (can_be_of_bench(trials) and not unlike())
