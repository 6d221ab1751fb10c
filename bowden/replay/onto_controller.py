"""The controller run again over a recorded trial, with a comparison of its outputs.

The steps are those of the gait itself (`experiment.Planned.walk`), fed with recorded inputs from its first row on, so
that the controller's memory is rebuilt; every output is compared bit for bit.
"""

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bowden.replay import Comparison
from eds.bench.bench_network import WireLayout, wire
from estimation.transfer.homing_fit import HomingFit
from master.control.controller import Kind
from master.cycle.inputs import NOTHING, CycleAnnotations, Inputs
from master.cycle.safety import StopError
from master.motion.experiment_run import ExperimentSetup, PreparedExperiment
from master.motion.home import HomingResult
from parameters import InputError
from trial.read import Trial
from trial.signals import PDO_NAMES, TRACE

INPUTS = ("servo_statusword", "servo_position_m", "servo_force_n", "knee_statusword", "knee_angle_rad",
          "tension_start_n", "tension_end_n")
"""Columns of `Inputs` between the time stamp and the bits of missing inputs."""
ANSWERS = ("gait_percent", "servo_target_m", "knee_target_rad", "desired_force_n", "estimated_end_force_n", "cycle",
           "held")
OUTPUTS = (*ANSWERS, *(signal.name for signal in TRACE))
"""Compared columns of a controller step, if the trial has them; the controller's own columns are compared, too."""
TARGETS_FRAME, ROWS = "targets_frame", "rows"
EVERY = 500

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class OutputDifference:
    """One output that is not as recorded: its row in the trial, when (s), where in the gait, and both values."""

    row: int
    time_s: float
    cycle: float
    gait_percent: float
    signal: str
    recorded: float | str
    replayed: float | str


@dataclass(frozen=True, kw_only=True)
class ControllerComparison(Comparison[OutputDifference]):
    """Steps run again: rows, and frames of targets compared; rows that differ by signal."""

    controller: str
    rows: int
    frames: int


class EndedError(Exception):
    """The recording has no further row."""


class RecordedInputs:
    """A recorded trial as the control cycle of a gait; `made` and `frames` are the controller's outputs, by row.

    It begins at the first row of the gait and raises `EndedError` after its last.
    """

    def __init__(
        self, recorded: Trial, described: WireLayout, rows: range, progress: Callable[[float], None],
        own: tuple[str, ...]
    ) -> None:
        columns = recorded.columns
        ages = [columns[f"{name}_pdo_age_ns"][rows.start:rows.stop] > 0 for name in PDO_NAMES]
        missing = sum(late.astype(np.int64) << i for i, late in enumerate(ages))
        given = [columns[name][rows.start:rows.stop] for name in INPUTS]
        if described.path.knee not in described.drives:  # an encoder has no statusword
            given[INPUTS.index("knee_statusword")] = np.zeros(len(rows))
        table = np.array(given).T.tolist()
        stamps = recorded.time_ns[rows.start:rows.stop].tolist()
        self._inputs = [
            Inputs(stamp, int(servo), position, force, int(knee), angle, start, end, late)
            for stamp, (servo, position, force, knee, angle, start, end), late
            in zip(stamps, table, np.asarray(missing).tolist(), strict=True)
        ]
        before = max(rows.start - 1, 0)
        self.targets = float(columns["servo_target_m"][before]), float(columns["knee_target_rad"][before])
        self.inputs = self._inputs[0]
        self.made: list[tuple[float, ...]] = []
        self.frames: list[bytes] = []
        self._pack, self._progress = described.targets.pack_si, progress
        self.outputs = (*OUTPUTS, *own)

    def advance(self, servo_m: float, knee_rad: float, annotations: CycleAnnotations = NOTHING) -> Inputs:
        """Store the targets that answer `inputs`, and return the next row's inputs."""
        answers = {**annotations._asdict(), "servo_target_m": servo_m, "knee_target_rad": knee_rad}
        lacks = (math.nan,) * (len(self.outputs) - len(OUTPUTS) - len(annotations.own))
        self.made.append((*(answers[name] for name in OUTPUTS), *annotations.own, *lacks))
        finite = math.isfinite(servo_m) and math.isfinite(knee_rad)
        self.frames.append(self._pack(servo_m, knee_rad) if finite else b"")
        self.targets = servo_m, knee_rad
        done = len(self.made)
        if not done % EVERY:
            self._progress(done / len(self._inputs))
        if done == len(self._inputs):
            raise EndedError
        self.inputs = self._inputs[done]
        return self.inputs


def replay(
    recorded: Trial, experiment: ExperimentSetup, progress: Callable[[float], None] = lambda share: None
) -> ControllerComparison:
    """Step the controller of `experiment` over the inputs of a recorded trial, and compare the outputs.

    Raises `InputError` if the trial lacks a needed signal.
    """
    recording = step_again(recorded, experiment, progress)
    cob_id = wire(experiment.network).targets.cob_id
    return compare(recorded, walked(recorded), cob_id, experiment.gait.controller, recording)


def step_again(
    recorded: Trial, experiment: ExperimentSetup, progress: Callable[[float], None] = lambda share: None
) -> RecordedInputs:
    """Step the controller of `experiment` over a trial's rows; return its outputs by row."""
    planned = PreparedExperiment(experiment)
    planned.homed = HomingResult(math.nan, _day(recorded, experiment, planned.kind))
    recording = RecordedInputs(recorded, wire(experiment.network), walked(recorded), progress,
                               tuple(signal.name for signal in planned.own_signals))
    with contextlib.suppress(EndedError, StopError):
        planned.walk(recording)
    return recording


def walked(recorded: Trial) -> range:
    """Return the rows in which the controller made a step: from the run-in to the end of the run-out, or to the stop.
    """
    needed = (*INPUTS, *ANSWERS, *(f"{name}_pdo_age_ns" for name in PDO_NAMES), "missed_outputs")
    lacking = [name for name in needed if name not in recorded.columns]
    if lacking:
        raise InputError(f"{recorded.path}: has no column {lacking[0]}, which the controller's steps need; "
                         "give a trial that bowden trial recorded.")
    rows = np.flatnonzero(~np.isnan(recorded.columns["gait_percent"]))
    rows = rows[rows < whole_rows(recorded)]
    if not len(rows):
        raise InputError(f"{recorded.path}: the controller made no step in it; give a trial that reached its gait.")
    if recorded.lost_cycles or len(rows) != rows[-1] + 1 - rows[0]:
        raise InputError(f"{recorded.path}: control cycles are missing, and a controller remembers them; "
                         "give a whole trial.")
    return range(int(rows[0]), int(rows[-1]) + 1)


def whole_rows(recorded: Trial) -> int:
    """Return how many rows are whole: of a recovered trial those whose frames survived up to the next SYNC."""
    if recorded.recovered is None or not len(recorded.frames):
        return len(recorded.time_ns)
    return int(np.searchsorted(recorded.time_ns, recorded.frames["time_ns"].max(), side="right")) - 1


def _day(recorded: Trial, experiment: ExperimentSetup, kind: Kind) -> HomingFit:
    """Return the homing fit; the default for a controller that does not use it."""
    found = (recorded.result or {}).get("day")
    if isinstance(found, list) and 4 <= len(found) <= len(HomingFit._fields):
        return HomingFit(*map(float, found))
    if kind.uses_homing_fit and not experiment.dry_run:
        raise InputError(f"{recorded.path}: its result has no day, which the controller {experiment.gait.controller} "
                         "needs; give a trial that was closed.")
    return HomingFit()


def compare(
    recorded: Trial, rows: range, targets_cob_id: int, controller: str, recording: RecordedInputs
) -> ControllerComparison:
    """Compare the steps' outputs with the recorded ones, bit for bit; NaN equals NaN."""
    count = len(recording.made)
    stepped = slice(rows.start, rows.start + count)
    then = {name: recorded.columns[name][stepped] for name in recording.outputs if name in recorded.columns}
    again = dict(zip(recording.outputs, np.array(recording.made).T, strict=True))
    frames = _frames_by_row(recorded, targets_cob_id)[stepped]
    told = _sent_rows(recorded, stepped)
    marks = {name: _unlike(column, again[name]) for name, column in then.items()}
    marks[TARGETS_FRAME] = [i for i in told if frames[i] != recording.frames[i]]
    marks[ROWS] = [count - 1] if count < len(rows) else []
    differing = {name: len(where) for name, where in marks.items() if where}
    if not differing:
        return ControllerComparison(controller=controller, rows=count, frames=len(told), differing={}, first=None)
    at, name = min(((marks[name][0], name) for name in differing), key=lambda mark: mark[0])
    values: tuple[float | str, float | str]
    if name == TARGETS_FRAME:
        values = (frames[at] or b"").hex(" "), recording.frames[at].hex(" ")
    elif name == ROWS:
        values = float(len(rows)), float(count)
    else:
        values = float(then[name][at]), float(again[name][at])
    row = rows.start + at
    time_s, cycle, percent = (float(recorded.columns[key][row]) for key in ("time_s", "cycle", "gait_percent"))
    first = OutputDifference(row, time_s, cycle, percent, name, *values)
    return ControllerComparison(controller=controller, rows=count, frames=len(told), differing=differing, first=first)


def _unlike(one: Floats, other: Floats) -> list[int]:
    bits = np.ascontiguousarray(one).view(np.uint64) != np.ascontiguousarray(other).view(np.uint64)
    return np.flatnonzero(bits & ~(np.isnan(one) & np.isnan(other))).tolist()


def _sent_rows(recorded: Trial, stepped: slice) -> list[int]:
    """Return the rows whose targets were sent in time, from the first of `stepped`; none without recorded frames."""
    if not len(recorded.frames):
        return []
    return np.flatnonzero(recorded.columns["missed_outputs"][stepped] == 0).tolist()


def _frames_by_row(recorded: Trial, cob_id: int) -> list[bytes | None]:
    """Return by row the payload of the last frame `cob_id` between its SYNC and the next one, None without one."""
    frames = recorded.frames
    frames = frames[(frames["can_id"] == cob_id) & (frames["flags"] == 0)]
    found: list[bytes | None] = [None] * len(recorded.time_ns)
    row = np.searchsorted(recorded.time_ns, frames["time_ns"], side="left") - 1
    for place, dlc, data in zip(row.tolist(), frames["dlc"].tolist(), frames["data"], strict=True):
        if place >= 0:
            found[place] = data[:dlc].tobytes()
    return found
