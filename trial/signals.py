"""Names of all signals of one control cycle: measured, desired and commanded.

A signal has one name, one unit and one meaning, in `/cycle`, in a CSV header and on a report's axis. The order is
that of `/cycle`; a name is never reused for something else. A value that is unknown in a cycle is NaN; a column that
a trial does not have is missing, never zeros.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eds.declaration import DeclaredBench


class Signal(NamedTuple):
    """A column of `/cycle`: SI unit ("1" for a pure number) and meaning; `derived` where no PDO carries it."""

    name: str
    unit: str
    text: str
    derived: bool = False


MOTION_AND_FORCE = (
    Signal("time_s", "s", "time of the SYNC that latched this cycle's inputs, from the trial's first cycle"),
    Signal("gait_percent", "%", "phase of the gait cycle, 0 … 100"),
    Signal("servo_target_m", "m", "rope position commanded at the drum, pulling positive"),
    Signal("servo_position_m", "m", "rope position at the drum, pulling positive"),
    Signal("servo_velocity_m_s", "m/s", "rope velocity at the drum, from successive positions", derived=True),
    Signal("servo_force_n", "N", "rope force at the drum: torque actual value by drum radius"),
    Signal("knee_target_rad", "rad", "knee angle commanded, flexion negative"),
    Signal("knee_angle_rad", "rad", "knee angle by the knee drive's encoder, flexion negative"),
    Signal("tension_start_n", "N", "tension at the START sensor: the feedback"),
    Signal("tension_end_n", "N", "tension at the END sensor: verification only, never in the loop"),
    Signal("desired_force_n", "N", "desired END force, equation (2) or the desired-force file"),
    Signal("estimated_end_force_n", "N", "END force estimated from START tension and knee angle", derived=True),
    Signal("cycle", "1", "number of the gait cycle, from 0"),
)

FORCE_FIGURES = (
    Signal("relative_rmse_percent", "%", "relative RMSE of END"),
    Signal("relative_rmse_window_percent", "%", "relative RMSE of END, 10…30 % of gait"),
    Signal("max_idle_tension_n", "N", "largest END at idle"),
    Signal("peak_jump_n", "N", "jump of END at the peak"),
)
"""Figures of a trial's force, which `trial.metrics` computes; no columns of `/cycle`."""

PDO_NAMES = ("servo", "knee", "start", "end")

PDO_TIMING = (
    *(Signal(f"{name}_pdo_age_ns", "ns", f"age of the {name} inputs at the step, from the SYNC that latched them")
      for name in PDO_NAMES),
    *(Signal(f"{name}_pdo_arrival_ns", "ns", f"arrival of the {name} TPDO after this cycle's SYNC")
      for name in PDO_NAMES),
)

STATUS = (
    Signal("servo_statusword", "1", "statusword 0x6041 of the servo drive"),
    Signal("knee_statusword", "1", "statusword 0x6041 of the knee drive"),
    Signal("missed_inputs", "1", "input PDOs of this cycle that were not there by the deadline"),
    Signal("missed_outputs", "1", "1 where the targets left too late to be taken over at the next SYNC"),
    Signal("held", "1", "1 where this cycle held its targets and the controller made no step"),
    Signal("sync_jitter_ns", "ns", "SYNC against its nominal time"),
    Signal("step_duration_ns", "ns", "wall time of the controller's step; unknown in virtual time"),
)

# The controller's trace: extend here, and only at the end.
TRACE = (
    Signal("feedforward_m", "m", "stretch and swing compensation, equations (10) and (11)", derived=True),
    Signal("impedance_dx_m", "m", "position correction of the impedance law, equations (12)–(15)", derived=True),
    Signal("friction_ratio", "1", "START by END force that the friction model expects", derived=True),
    Signal("rope_direction", "1", "sign of rope motion in the friction model, −1 … 1", derived=True),
    Signal("strain_direction", "1", "sign of the fabric's strain rate in the friction model, −1 … 1", derived=True),
    Signal("estimated_end_half_n", "N", "half the width of the 95 % interval of estimated_end_force_n", derived=True),
)


def with_observers(bench: DeclaredBench) -> tuple[Signal, ...]:
    """Return the columns of `/cycle` on a bench: `SIGNALS`, those of its observers before the controller's trace."""
    observed = tuple(Signal(f"{device.name}_{one.ending}", one.unit, one.text)
                     for device in bench.observers for one in device.type.observed)
    return (*SIGNALS[:-len(TRACE)], *observed, *TRACE)


COMMON: frozenset[str] = frozenset({"time_s", "missed_outputs", "sync_jitter_ns", "step_duration_ns"})
"""Columns that a bench of several force paths has once; each of the others it has for each path, `<path>.<name>`."""


def of_bench(bench: DeclaredBench, own: Sequence[Signal] = ()) -> tuple[Signal, ...]:
    """Return the columns of `/cycle` on a bench, with the controller's `own` ones.

    One force path: `with_observers`.  Several: `COMMON`, the observers' columns, then those of each path.
    """
    if len(bench.force_paths) == 1:
        return (*with_observers(bench), *own)
    observed = with_observers(bench)[len(SIGNALS) - len(TRACE):-len(TRACE)]
    each = [signal for signal in (*SIGNALS, *own) if signal.name not in COMMON]
    return (*(signal for signal in SIGNALS if signal.name in COMMON), *observed,
            *(signal._replace(name=f"{path.name}.{signal.name}") for path in bench.force_paths for signal in each))


SIGNALS: tuple[Signal, ...] = (*MOTION_AND_FORCE, *PDO_TIMING, *STATUS, *TRACE)
COLUMNS: tuple[str, ...] = tuple(signal.name for signal in SIGNALS)
INDEX: dict[str, int] = {name: position for position, name in enumerate(COLUMNS)}
UNITS: dict[str, str] = {signal.name: signal.unit for signal in SIGNALS}
_FIRST_TRACE = len(SIGNALS) - len(TRACE)
_COMMON_PLACES = tuple(i for i, signal in enumerate(SIGNALS) if signal.name in COMMON)
_PATH_PLACES = tuple(i for i, signal in enumerate(SIGNALS) if signal.name not in COMMON)


class CycleRow(NamedTuple):
    """One row of `/cycle`: a field for each of `SIGNALS`, in its unit; NaN where the value is not known.

    Every field is required and given by its name; a test compares the fields with `SIGNALS`.
    """

    time_s: float
    gait_percent: float
    servo_target_m: float
    servo_position_m: float
    servo_velocity_m_s: float
    servo_force_n: float
    knee_target_rad: float
    knee_angle_rad: float
    tension_start_n: float
    tension_end_n: float
    desired_force_n: float
    estimated_end_force_n: float
    cycle: float
    servo_pdo_age_ns: float
    knee_pdo_age_ns: float
    start_pdo_age_ns: float
    end_pdo_age_ns: float
    servo_pdo_arrival_ns: float
    knee_pdo_arrival_ns: float
    start_pdo_arrival_ns: float
    end_pdo_arrival_ns: float
    servo_statusword: float
    knee_statusword: float
    missed_inputs: float
    missed_outputs: float
    held: float
    sync_jitter_ns: float
    step_duration_ns: float
    feedforward_m: float
    impedance_dx_m: float
    friction_ratio: float
    rope_direction: float
    strain_direction: float
    estimated_end_half_n: float

    def values(self, observed: Sequence[float], own: Sequence[float]) -> tuple[float, ...]:
        """Return the row in the order of `with_observers`, then the controller's own columns.

        `observed` are the values of the bench's observers, in the order of `with_observers`.
        """
        if not observed:
            return (*self, *own) if own else self
        return (*self[:_FIRST_TRACE], *observed, *self[_FIRST_TRACE:], *own)


def joined(rows: Sequence[CycleRow], observed: Sequence[float], own: Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Return the row of several force paths in the order of `of_bench`; `own` are the controllers' columns by path."""
    common = (rows[0][i] for i in _COMMON_PLACES)
    each = (value for row, more in zip(rows, own, strict=True) for value in (*(row[i] for i in _PATH_PLACES), *more))
    return (*common, *observed, *each)


def of_paths(paths: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return the names of signals in a row of each path; the path "" of a bench of a single one has no prefix."""
    return [f"{path}.{name}" if path else name for path in paths for name in names]


def of_path(name: str, path: str) -> str | None:
    """Return the name that a column of several paths has in the table of one of them; None for another path's."""
    prefix, dot, rest = name.partition(".")
    return rest if dot and prefix == path else None if dot else name
