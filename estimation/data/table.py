"""Measured data in memory: columns under the names of the signal table, read from trials and from tables.

The diagnosis reads all trials here.  A missing column stays missing and is never filled with zeros.  Unknown columns of
a table are ignored and named in `Table.notes`.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from parameters import InputError
from parameters.files import refuse_special
from physics.laws import Array
from physics.plant.components import KNEE_AT_FIT
from trial import slow_columns
from trial.convert.csv_table import offer
from trial.convert.sheets import ENDINGS, sheet_of
from trial.read import TrialFile, one_path, open_file, path_names, refuse_unknown
from trial.signals import MOTION_AND_FORCE, of_path

UNITS: Final[Mapping[str, str]] = {signal.name: signal.unit for signal in MOTION_AND_FORCE}
"""Unit of each signal by its name in CSV headers, in the channel /cycle and on report axes."""

COUNTERS: Final = ("time_s", "gait_percent", "cycle")
"""Columns that are counters, no signals: they are never filtered."""
AGE_SUFFIX: Final = "_age_ns"
"""Suffix of a column with the staleness of a signal, ns."""
NOMINAL: Final = "nominal"
"""Name of the packaged calibration in the metadata of a trial; it was measured on no bench."""
WORDS: Final = ("servo_statusword", "knee_statusword")
"""Columns that show whether a drive moves the servo and the knee."""
DEGREE_ALIAS: Final = "knee_angle_deg"
"""Column that is read as `knee_angle_rad`, converted from degrees."""
Rows = NDArray[np.intp]
RowChoice = Callable[[Array], "Rows | None"]
"""Function from time stamps, s, to the row numbers to read; None: all."""
TURNING: Final[Mapping[str, tuple[str, str]]] = {
    "servo_position_rad": ("servo_position_m", "rad"), "servo_target_rad": ("servo_target_m", "rad"),
    "servo_velocity_rad_s": ("servo_velocity_m_s", "rad/s"), "servo_torque_nm": ("servo_force_n", "N·m"),
    "motor_voltage_v": ("servo_force_n", "V")}
"""By column of a turning axis: the equivalent signal on a lever of 1 m, and the unit of the column."""

@dataclass(frozen=True)
class Table:
    """One trial: float64 columns of equal length, by name.

    `digest`: hash of the columns, equal for equal data.  `calibration`: tables of the attached calibration (None: no
    calibration of a bench is attached).  `lowpass_hz`: cut-off of the filter that the signals have passed (None:
    unfiltered).  `turning`: the axis was recorded in rad and N·m and is represented on a lever of 1 m.  `volts`: the
    motor's voltage was recorded in place of its torque.  `experiment`: name of the experiment ("": unknown).
    `joints`: joints of a serial arm that were recorded together, from base to tip; `joint`: the one whose columns these
    are.  The other ones' angles are columns `<joint>.servo_position_m`.  `before`: rows before the first numbered
    cycle, such as homing.  `seams`: rows at which a window of a long trial begins (`windows.bounded`).
    """

    source: str
    columns: Mapping[str, Array]
    digest: str
    calibration: Mapping[str, Any] | None = None
    lowpass_hz: float | None = None
    notes: tuple[str, ...] = field(default=())
    turning: bool = False
    volts: bool = False
    experiment: str = ""
    joints: tuple[str, ...] = ("",)
    joint: str = ""
    before: Mapping[str, Array] = field(default_factory=dict)
    seams: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.columns["time_s"])

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]


def read(path: str | Path, joint: str | None = None, choose: RowChoice | None = None) -> Table:
    """Read a trial (.mcap) or a table (CSV, .gz, Parquet, .mat, .mf4) with a subset of the canonical headers.

    `joint`: of a trial of several force paths, or a table whose columns are `<joint>.<header>`, the one to read.
    `choose`: rows of a trial to read, from the time stamps of its numbered cycles; those before them are read, too.
    Raises `InputError` for a file that is absent, unreadable, ragged, without `time_s` or without any signal.  It does
    so, too, for a table of several joints if none of them is named.
    """
    path = Path(path)
    refuse_special(path)
    if path.suffix.lower() == ".mcap":
        return _read_mcap(path, joint, choose)
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    if not set(suffixes) & {*ENDINGS, ""} and suffixes:
        raise InputError(f"{path}: is neither a trial nor a table; say bowden import {path} -o trial.mcap first.")
    return _read_sheet(path, joint)


def _read_sheet(path: Path, joint: str | None) -> Table:
    sheet = sheet_of(path)
    known = [name for name in sheet.names if _known(name) or _known(name.partition(".")[2])]
    if "time_s" not in known or not _signals(known):
        lacks = "no column time_s" if "time_s" not in known else "no signal among its columns"
        raise InputError(f"{path}: {lacks}; {offer(path)}.")
    for name in known:
        stated, unit = sheet.unit(name), _unit(name.partition(".")[2] or name)
        if stated and stated.replace("°", "deg") != unit:
            mend = f"write it in {unit}, as a map has no turning axis" if name.rpartition(".")[2] in TURNING \
                else offer(path)
            raise InputError(f"{path}: {name} is in {stated} by the row of units; {mend}.")
    made = table(str(path), {name: sheet.column(name) for name in known}, joint=joint)
    ignored = sorted(set(sheet.names) - set(known))
    notes = _unused(ignored)
    read_as = (f"read with {', '.join(sheet.remarks)}",) if sheet.remarks else ()
    return replace(made, notes=(*made.notes, *notes, *read_as))


def _unused(names: Sequence[str], most: int = 8) -> tuple[str, ...]:
    """Return a note on columns that are not used, with the names of the first `most`; none without any."""
    others = f" and {len(names) - most} more" if len(names) > most else ""
    return (f"columns not used: {', '.join(names[:most])}{others}",) if names else ()


def _known(name: str) -> bool:
    return name in UNITS or name in TURNING or name.endswith(AGE_SUFFIX) or name == DEGREE_ALIAS


def _unit(name: str) -> str:
    if name in TURNING:
        return TURNING[name][1]
    return "deg" if name == DEGREE_ALIAS else UNITS.get(name, "ns")


def _signals(names: Iterable[str]) -> list[str]:
    return [name for name in names if name not in COUNTERS and not name.endswith(AGE_SUFFIX)]


def table(
    source: str, columns: Mapping[str, Sequence[float] | Array], calibration: Mapping[str, Any] | None = None,
    joint: str | None = None,
) -> Table:
    """Return the known columns of `columns` as a trial, or those of a `joint`, as `read` does.

    Raises `InputError` without `time_s` or without a signal, and for another joint than the columns have.
    """
    joints = tuple(dict.fromkeys(first for first, dot, rest in (name.partition(".") for name in columns)
                                 if dot and _known(rest)))
    if joints or joint is not None:
        return _of_joint(source, columns, joints, joint)
    known: dict[str, Array] = {}
    for name, values in columns.items():
        if name == DEGREE_ALIAS:
            known["knee_angle_rad"] = np.deg2rad(np.asarray(values, dtype=np.float64))
        elif name in TURNING:
            known[TURNING[name][0]] = np.ascontiguousarray(values, dtype=np.float64)
        elif name in UNITS or name.endswith(AGE_SUFFIX):
            known[name] = np.ascontiguousarray(values, dtype=np.float64)
    if "time_s" not in known:
        raise InputError(f"{source}: no column time_s; name the time column time_s, in seconds.")
    if not _signals(known):
        raise InputError(f"{source}: no signal among its columns; expected some of {', '.join(UNITS)}.")
    turning = [name for name in columns if name in TURNING]
    if turning:
        _refuse_mixed(source, columns, turning)
    ignored = sorted(set(columns) - set(known) - {DEGREE_ALIAS, *TURNING})
    notes = _unused(ignored)
    whole, inside = known, _numbered(known)
    first = int(np.argmax(whole["cycle"] >= 0.0)) if inside is not whole else 0
    known, slow = _on_rows(inside)
    return Table(source, known, _digest(known), calibration, notes=(*notes, *slow), turning=bool(turning),
                 volts="motor_voltage_v" in columns,
                 before={n: v[:first].copy() for n, v in whole.items()} if first else {})


def _of_joint(source: str, columns: Mapping[str, Sequence[float] | Array], joints: tuple[str, ...],
              joint: str | None) -> Table:
    """Return the columns of one of several joints, with the angles of the other ones if the axes turn."""
    if joint is None:
        raise InputError(f"{source}: records {', '.join(joints)}; name one with --path.")
    refuse_unknown(source, joint, joints)
    own = table(source, {name: values for old, values in columns.items()
                         if (name := of_path(old, joint)) is not None})
    angles = {f"{other}.servo_position_m": np.ascontiguousarray(columns[f"{other}.servo_position_rad"], np.float64)
              for other in joints if other != joint and f"{other}.servo_position_rad" in columns}
    if not own.turning or len(angles) < len(joints) - 1:
        return own
    together = {**own.columns, **angles}
    return replace(own, columns=together, digest=_digest(together), joints=joints, joint=joint)


def _refuse_mixed(source: str, columns: Iterable[str], turning: Sequence[str]) -> None:
    """Raise `InputError` if a trial has columns of a turning axis and of a linear pull, or both torque and voltage."""
    if {"servo_torque_nm", "motor_voltage_v"} <= set(columns):
        raise InputError(f"{source}: has servo_torque_nm and motor_voltage_v; give one of them, the torque if it is "
                         "measured.")
    straight = [n for n in columns if n in {m for m, _ in TURNING.values()} or n.startswith("tension_")]
    if straight:
        raise InputError(f"{source}: {turning[0]} is of a turning axis, {straight[0]} of a straight pull; multiply "
                         "angles by the drum's radius and divide torques by it, and name the columns servo_position_m "
                         "and servo_force_n.")


def _numbered(columns: dict[str, Array]) -> dict[str, Array]:
    """Return the rows from the first to the last numbered cycle; outside, the zero of the encoder may differ.

    Rows between two numbered cycles get the number of the earlier cycle.
    """
    inside = np.flatnonzero(columns["cycle"] >= 0.0) if "cycle" in columns else np.zeros(0, dtype=np.intp)
    if not inside.size or inside.size == columns["cycle"].size:
        return columns
    kept = {name: values[inside[0]:inside[-1] + 1] for name, values in columns.items()}
    cycle = kept["cycle"]
    last = np.maximum.accumulate(np.where(cycle >= 0.0, np.arange(cycle.size), 0))
    return {**kept, "cycle": cycle[last]}


def _on_rows(columns: dict[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """Return signals recorded at a lower rate than the rows on every row, and a sentence on each of them."""
    made, sentences = dict(columns), []
    for name in _signals(columns):
        made[name], step = slow_columns.on_rows(columns["time_s"], columns[name])
        if step is not None:
            sentences.append(f"{name} is recorded every {step:.3g} s, the rows are closer: a line between two values")
    return made, sentences


def _digest(columns: Mapping[str, Array]) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(columns):
        digest.update(name.encode() + columns[name].tobytes())
    return digest.hexdigest()


def _read_mcap(path: Path, joint: str | None, choose: RowChoice | None) -> Table:
    trial: TrialFile = open_file(path)
    if joint is not None or path_names(trial):
        trial = one_path(trial, joint)
    words = [name for name in WORDS if name in trial.units]
    read = _columns(trial, [*(name for name in trial.units if name in UNITS or name.endswith(AGE_SUFFIX)), *words],
                    None if choose is None else _chosen(trial, choose))
    kept = recorded(read)
    if "time_s" not in kept and any(map(len, trial.frame_blocks())):
        raise InputError(f"{path}: holds CAN frames and no signal: no cycle of the bench's PDOs is among them; say "
                         f"bowden monitor {path} to see the frames, and import the log with --config of its bench.")
    made = table(str(path), kept, _carried_calibration(trial))
    return replace(made, experiment=trial.metadata.get("experiment", ""))


def recorded(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns of a trial's rows without empty ones, without statuswords, and without a request to a person.
    """
    servo, knee = (columns.get(name) for name in WORDS)
    kept = {name: values for name, values in columns.items() if name not in WORDS and not np.isnan(values).all()}
    if servo is not None and knee is not None and np.isnan(knee).all() and not np.isnan(servo).all():
        kept.pop("knee_target_rad", None)  # a request to a person who moves the knee; no drive follows it
    return kept


def _chosen(trial: TrialFile, choose: RowChoice) -> Rows | None:
    """Return the rows before a trial's first numbered cycle, and those that `choose` takes of its cycles; None: all.
    """
    given = _columns(trial, [name for name in ("time_s", "cycle") if name in trial.units])
    numbered = np.flatnonzero(given["cycle"] >= 0.0) if "cycle" in given else np.zeros(0, np.intp)
    first, last = (numbered[0], numbered[-1] + 1) if numbered.size else (0, None)
    rows = choose(given["time_s"][first:last]) if "time_s" in given else None
    return None if rows is None else np.concatenate([np.arange(first), first + rows])


def _columns(trial: TrialFile, names: Sequence[str], rows: Rows | None = None) -> dict[str, Array]:
    """Return columns of a trial, of all rows or of the rising row numbers `rows`.

    They are read by block, since a long trial's other columns would fill the memory.
    """
    parts: dict[str, list[Array]] = {name: [] for name in names}
    first = 0
    for block in trial.blocks(names):
        last = first + block.time_ns.size
        of = slice(None) if rows is None else rows[slice(*np.searchsorted(rows, (first, last)))] - first
        for name, values in block.columns.items():
            parts[name].append(values[of].copy())
        first = last
    return {name: np.concatenate([np.zeros(0), *parts.pop(name)]) for name in names}


def _carried_calibration(trial: TrialFile) -> Mapping[str, Any] | None:
    """Return the calibration attached to a trial; None without one, and for the packaged nominal calibration."""
    import tomllib

    if trial.metadata.get("calibration") == NOMINAL:
        return None
    raw = trial.attachments.get("calibration.toml")
    try:
        return None if raw is None else tomllib.loads(bytes(raw).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{trial.path}: the attached calibration.toml is damaged ({_first_line(error)}); give the "
                         "calibration with --calibration and a trial without it.") from None


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


def low_passed(given: Table, cutoff_hz: float) -> Table:
    """Return `given` with each signal low-passed at `cutoff_hz` by the same zero-phase second-order Butterworth filter.

    The filter runs forward and backward and so shifts no phase; counters and staleness columns are unchanged.
    Raises `InputError` for a cut-off that is not below half the sampling rate.
    """
    rate = 1.0 / float(np.median(np.diff(given["time_s"])))
    if not 0.0 < cutoff_hz < rate / 2.0:
        raise InputError(f"{given.source}: a low-pass of {cutoff_hz:g} Hz on {rate:g} Hz data; expected above 0 and "
                         f"below {rate / 2.0:g} Hz, give another cut-off.")
    sos = butter(2, cutoff_hz, fs=rate, output="sos")
    filtered = {name: values if name in COUNTERS or name.endswith(AGE_SUFFIX) else sosfiltfilt(sos, values)
                for name, values in given.columns.items()}
    return replace(given, columns=filtered, lowpass_hz=cutoff_hz)


def with_locked_knee(given: Table) -> Table:
    """Return a trial in which a knee angle that is not recorded is the constant angle of a locked knee."""
    if "knee_angle_rad" in given:
        return given
    still = np.full(len(given), KNEE_AT_FIT)
    return replace(given, columns={**given.columns, "knee_angle_rad": still},
                               notes=(*given.notes, "knee_angle_rad is not recorded, or constant: a locked knee."))
