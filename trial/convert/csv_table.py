"""Tables of files as columns of `/cycle`.

A column is taken under its canonical name, or under the name, unit, factor and offset that a map gives it; other
columns are left out and named. An empty cell or NaN is an unknown value; a cell that is not a number is an error with
its row.

A map can be guessed from names, units and ranges, to be checked by an engineer of that bench; each guess states its
grounds. A stated unit is never dropped: a column with an unsupported unit is not assigned. Every column that is not
assigned is listed with the reason. Words of English, German, French, Spanish and romanised Chinese laboratories are
recognised.
"""

import json
import math
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from parameters import InputError, from_table, parameter, read_toml
from trial.convert.csv_file import DEGREE_ALIAS, Dialect, reserved
from trial.convert.lab_table import TO_SI, Floats, LabTable, unit_of
from trial.convert.sheets import sheet_of
from trial.signals import MOTION_AND_FORCE, UNITS

CSV_TABLE = "csv"  # of a map: how the file is written


@dataclass(frozen=True)
class SignalSource:
    """Source of a signal: value = (number in the file × scale) in `unit`, converted, plus `offset`."""

    column: str = parameter("", "", "header of the file's column", source="the map file")
    unit: str = parameter("", "", "unit of the file's numbers; the signal's own where empty", source="the map file")
    scale: float = parameter(1.0, "1", "factor on the file's numbers, −1 to turn a sign", source="the map file")
    offset: float = parameter(0.0, "", "added to the converted value, in the signal's unit", source="the map file")

    def factor(self, signal: str, where: str) -> float:
        """Return the factor to the signal's unit; raises `InputError` where the units do not fit."""
        si, factor = TO_SI.get(self.unit or UNITS[signal], ("", 0.0))
        if self.unit and si != UNITS[signal] and not (si == "s" and UNITS[signal] == "ns"):
            known = ", ".join(unit for unit, (to, _) in TO_SI.items() if to == UNITS[signal])
            raise InputError(f"{where}: unit = {self.unit!r} does not fit {signal}; expected one of {known}.")
        return factor * self.scale * (1e9 if si == "s" and UNITS[signal] == "ns" else 1.0)


class Map(dict[str, SignalSource]):
    """Sources by signal; `dialect` is the file's format, if the map gives it."""

    dialect: Dialect | None = None


@dataclass
class Columns:
    """Columns by signal name, counts, and the headers left out; `rows` number the rows as the file does.

    `remarks` lists how the file was read; `begins_ns` is the time since 1970 at which `time_s` is 0, if the file gives
    it; `questions` are, by signal, about a range beyond a rope bench.
    """

    columns: dict[str, Floats]
    counts: dict[str, int]
    left_out: list[str] = field(default_factory=list)
    rows: np.ndarray[tuple[int], np.dtype[np.int64]] | range = range(0)
    remarks: list[str] = field(default_factory=list)
    begins_ns: int | None = None
    questions: dict[str, str] = field(default_factory=dict)


def read_map(path: Path) -> Map:
    """Read a map: one TOML table a signal, `column`, `unit`, `scale` and `offset` in it, and perhaps [csv]."""
    mapped = Map()
    for signal, table in read_toml(path).items():
        where = f"{path} [{signal}]"
        if signal not in UNITS and signal != CSV_TABLE:
            raise InputError(f"{where}: is no signal; expected one of {', '.join(UNITS)}.")
        if not isinstance(table, dict):
            raise InputError(f"{where}: is no table; write [{signal}] and column = \"…\" below it.")
        if signal == CSV_TABLE:
            mapped.dialect = from_table(Dialect, table, where=where)
            continue
        mapped[signal] = from_table(SignalSource, table, where=where)
        mapped[signal].factor(signal, where)
    return mapped


def read(path: Path, mapped: Mapping[str, SignalSource] | None = None) -> Columns:
    """Read the signals of a table; `mapped` gives the sources of those that do not have their own names in the file.

    Raises `InputError` without time, for units that do not fit and bad cells.
    """
    sheet = sheet_of(path, getattr(mapped, "dialect", None))
    sources = dict(_canonical(sheet, mapped)) | dict(mapped or {})
    columns: dict[str, Floats] = {}
    for signal, source in sources.items():
        if source.column not in sheet:
            raise InputError(f"{path}: the map takes {signal} from {source.column!r}, which is no column of the file; "
                             f"expected one of {', '.join(sheet.names[:30])}"
                             + (f" and {len(sheet.names) - 30} more." if len(sheet.names) > 30 else "."))
        unit = source.unit or sheet.unit(source.column)
        factor = SignalSource(source.column, unit, source.scale).factor(signal, f"{path}: {source.column}")
        columns[signal] = sheet.column(source.column) * factor + source.offset
    if "time_s" not in columns:
        raise InputError(f"{path}: " + (
            "the map names no column for time_s; add [time_s] and column = a column whose values rise." if mapped else
            f"has no column time_s; {offer(path)}."))
    sources_used = {source.column for source in sources.values()}
    unknown = int(sum(np.isnan(column).sum() for column in columns.values()))
    return Columns(
        columns, {"rows": len(sheet), "unknown_values": unknown, **sheet.counts},
        [*(name + (f" (row {sheet.faults[name][0]} has no number: {sheet.faults[name][1]!r})"
                   if reserved(name) and name in sheet.faults else f" ({OF_AXIS})" if AXIS.fullmatch(name) else "")
           for name in sheet.names if name not in sources_used),
         *(f"{name} ({why})" for name, why in sheet.left_out.items())], sheet.rows, sheet.remarks,
        sheet.begins_ns.get(sources["time_s"].column), _questions(columns))


def _questions(columns: Mapping[str, Floats], slow_s: float = 0.5) -> dict[str, str]:
    """Return the questions about columns in their signals' units; `slow_s`: longest usual step of time, s."""
    usual = float(np.median(np.diff(columns["time_s"]))) if len(columns["time_s"]) > 1 else 0.0
    slow = {"time_s": f"advances {usual:.4g} s a row, so that motion is not seen: is it in milliseconds?"}
    asked = {name: _question(UNITS[name], UNITS[name], True, values[np.isfinite(values)])
             for name, values in columns.items() if UNITS[name] in MOST and np.isfinite(values).any()}
    asked |= {name: PUSHES for name, values in columns.items() if _pushes(name, values)}
    asked |= {name: "has no value in any row" for name, values in columns.items() if not np.isfinite(values).any()}
    return {name: question for name, question in ((slow if usual > slow_s else {}) | asked).items() if question}


def offer(path: Path) -> str:
    """Return the advice for a table whose columns are not named as signals: the commands that map them."""
    return (f"rename its columns, or say bowden import {path} --guess -o map.toml, check that map, and say "
            f"bowden import {path} --map map.toml -o trial.mcap")


def _canonical(sheet: LabTable, mapped: Mapping[str, SignalSource] | None) -> list[tuple[str, SignalSource]]:
    """Return signals whose column has their name; beside a map, only those whose cells are numbers."""
    named = [(name, SignalSource(column=name)) for name in sheet.names if name in UNITS and name not in (mapped or {})
             and not (mapped and name in sheet.faults)]
    for name, source in named:
        stated = sheet.unit(source.column)
        if stated and TO_SI[stated] != (UNITS[name], 1.0):
            raise InputError(f"{sheet.path}: {name} is in {UNITS[name]} by its name and in {stated} by the row of "
                             f"units; say which with --map: [{name}], column = \"{name}\" and unit.")
    if DEGREE_ALIAS in sheet and "gait_percent" in sheet and not {"knee_angle_rad"} & {*sheet.names, *(mapped or {})}:
        named.append(("knee_angle_rad", SignalSource(column=DEGREE_ALIAS, unit="deg")))
    return named


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


FORCE = _words("force forces tension load loadcell cell kraft zugkraft seilkraft newton f fx fz effort fuerza carga "
               "traccion li lali zhangli suoli shengli")
TARGET = _words("target desired reference ref set setpoint command commanded cmd soll demand goal consigne consigna "
                "objetivo deseada mubiao")
ROPE = _words("rope cable wire tendon bowden motor servo drum winch actuator position pos displacement disp stroke "
                 "weg seil seilweg length travel enc encoder moteur corde deplacement course posicion desplazamiento "
                 "recorrido weizhi weiyi shengsuo gangsi lasheng dianji xingcheng")
SPEED = _words("velocity vel speed geschwindigkeit vitesse velocidad sudu")
KNEE = _words("knee knie joint angle winkel flexion gelenk theta genou angulo rodilla jiaodu xiguanjie guanjie "
              "xijiao xigai xibu zhuanjiao")
NEAR = _words("start input in proximal prox motorside upstream near front 1 a antrieb eingang anfang source vorne vorn "
              "vorder ein avant entree amont delantera delantero entrada shuru "
              "jinduan qian qianduan qianli ruduan rukou shiduan "
              "in")
FAR = _words("end output out distal dist loadside downstream far rear back 2 b abtrieb ausgang tip hinten hinter ende "
             "arriere sortie aval trasera trasero salida shuchu yuanduan hou houduan houli aus "
             "moduan chuduan chukou zhongduan")
GUESS = _words("estimate estimated est model predicted")
TIME = _words("time t timestamp zeit clock elapsed seconds sec temps tiempo shijian shike")
PERCENT = _words("gait phase percent pct gang")
COUNT = _words("cycle cycles stride rep repetition zyklus step ciclo zhouqi")
ACCELERATION = _words("acc accel acceleration beschleunigung imu")
OTHERS = _words("torque drehmoment couple nm strom ampere voltage volt temperature temperatur power leistung pwm")
"""Quantities that no signal of a bench has: without a unit in brackets such a column is no rope's position."""
AXIS = re.compile(r"(?:.+\.)?(?:servo_(?:position|target)_rad|servo_velocity_rad_s|servo_torque_nm|motor_voltage_v)")
"""Columns of a turning axis (docs/rigs.md), which a trial does not record."""
AXIS_UNITS = {"_rad": "rad", "_rad_s": "rad/s", "_nm": "N·m", "_v": "V"}
"""Units of the columns of a turning axis, by the end of their names."""
TORQUES = _words("nm n·m n*m mnm ncm")
"""Units of torque, in lower case."""
OF_AXIS = "of a turning axis, which a trial does not record; bowden diagnose and fit read the table itself"
OF_TORQUE = ("a torque, which a trial does not record; bowden diagnose and fit read the table of a turning axis, if "
             "its columns are time_s, servo_position_rad and servo_torque_nm, in s, rad and N·m")

LEAST = {"N": 0.5}
"""Smallest range of a signal that is not questioned where no unit is stated, by unit: kN of a rope bench are below."""
MOST = {"N": 1000.0, "m": 2.0, "rad": 2 * math.pi}
"""Largest value of a signal that is not questioned, by unit: beyond a rope bench, a wrong unit is likelier."""


class Words(NamedTuple):
    """Words of a signal's column: one of every group of `needs`, better also of `likes`, none of `never`."""

    needs: tuple[frozenset[str], ...]
    likes: frozenset[str]
    never: frozenset[str]


NOTHING: frozenset[str] = frozenset()
WORDS = {
    "time_s": Words((TIME,), NOTHING, NOTHING),
    "gait_percent": Words((PERCENT,), PERCENT, FORCE),
    "servo_target_m": Words((ROPE, TARGET), ROPE, FORCE | KNEE | SPEED),
    "servo_position_m": Words((ROPE,), ROPE, FORCE | KNEE | TARGET | SPEED),
    "servo_velocity_m_s": Words((SPEED,), ROPE, FORCE | KNEE | TARGET),
    "servo_force_n": Words((FORCE, frozenset(("motor", "servo", "drive", "actuator"))), NOTHING, NEAR | FAR | TARGET),
    "knee_target_rad": Words((KNEE, TARGET), KNEE, FORCE),
    "knee_angle_rad": Words((KNEE,), KNEE, FORCE | TARGET | SPEED),
    "tension_start_n": Words((FORCE, NEAR), FORCE, TARGET | GUESS),
    "tension_end_n": Words((FORCE, FAR), FORCE, TARGET | GUESS),
    "desired_force_n": Words((FORCE, TARGET), FORCE, NOTHING),
    "estimated_end_force_n": Words((FORCE, GUESS), FORCE, NOTHING),
    "cycle": Words((COUNT,), NOTHING, FORCE | TIME),
}
_KNOWN = frozenset().union(FORCE, TARGET, ROPE, KNEE, NEAR, FAR, GUESS, _words("left right links rechts"))
_SYMBOL = re.compile(r"\bF(in|out|start|end|prox|dist|ein|aus)(?![a-z])", re.IGNORECASE)
"""A force's symbol with its index written behind it, as in Fin_lbf."""
_UNIT = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$|\s*/\s*([^\s/\d]+)\s*$|\s+in\s+(\S+)\s*$|_([A-Za-zµ°%]+)$")


class Guess(NamedTuple):
    """A column for a signal, the confidence, its grounds, and a question to check ("": nothing special)."""

    signal: str
    column: str
    unit: str
    scale: float
    why: str
    score: float
    question: str = ""


class Unassigned(NamedTuple):
    """A column that is given to no signal, and the reason."""

    column: str
    why: str


def split_unit(name: str) -> tuple[str, str]:
    """Return a header without its unit, and the unit as it is written; empty if it states none."""
    found = _UNIT.search(name)
    if found is None:
        return name, ""
    bracketed = found[1]
    text = next(filter(None, found.groups()), "").strip()
    if unit_of(text) and not (text.lower() == "in" and not bracketed):  # F_in is an input, not inches
        return name[:found.start()], text
    stated = bracketed and text not in ("-", "1", "#") and " " not in text and not _tokens(text) & _KNOWN
    return (name[:found.start()], text) if stated else (name, "")


def guesses(sheet: LabTable) -> list[Guess]:
    """Return at most one column for each signal, the surest first taken."""
    found = [guess for name in sheet.names[:2000] if name not in sheet.faults
             for signal in MOTION_AND_FORCE if (guess := _guess(sheet, name, signal.name, signal.unit)) is not None]
    taken: dict[str, Guess] = {}
    columns: set[str] = set()
    for guess in sorted(found, key=lambda one: -one.score):
        if guess.signal not in taken and guess.column not in columns:
            taken[guess.signal] = guess
            columns.add(guess.column)
    return [taken[signal.name] for signal in MOTION_AND_FORCE if signal.name in taken]


def unassigned(sheet: LabTable, found: Sequence[Guess]) -> list[Unassigned]:
    """Return the columns that no signal has, each with the reason."""
    by_signal = {guess.signal: guess.column for guess in found}
    taken = set(by_signal.values())
    rows = []
    for name in [name for name in sheet.names if name not in taken][:200]:
        stated = _stated(sheet, name)[1]
        fits = [] if name in sheet.faults else [
            signal.name for signal in MOTION_AND_FORCE if _guess(sheet, name, signal.name, signal.unit) is not None]
        if name in sheet.faults:
            why = "row {} has no number: {!r}".format(*sheet.faults[name]) + (
                ", nor a time as 2026-05-13 09:00:00.000" if ":" in sheet.faults[name][1] else "")
        elif AXIS.fullmatch(name):
            why = OF_AXIS
        elif stated.lower() in TORQUES:
            why = OF_TORQUE
        elif stated and not unit_of(stated):
            why = f"its unit {stated!r} is not known: give a unit that is, and scale"
        elif fits:
            why = f"{by_signal[fits[0]]!r} looks more like {fits[0]}"
        elif not np.isfinite(sheet.column(name)).any():
            why = "it has no number, as formulas that were never calculated"
        elif _repeated(sheet, name) is not None:
            why = "other columns have this name; give each a name of its own"
        elif _tokens(_stated(sheet, name)[0]) & TIME and not _rises(sheet.column(name)):
            why = "its times do not rise"
        else:
            why = "its name and unit fit no signal"
        rows.append(Unassigned(name, why))
    return rows + [Unassigned(name, why) for name, why in sheet.left_out.items()]


def written_unit(sheet: LabTable, name: str) -> str:
    """Return the unit of a column for a reader: its signal's, else as the file states it; "" where it states none."""
    of_axis = next(AXIS_UNITS[end] for end in AXIS_UNITS if name.endswith(end)) if AXIS.fullmatch(name) else ""
    return UNITS.get(name) or of_axis or sheet.unit(name) or split_unit(name)[1]


def _repeated(sheet: LabTable, name: str) -> str | None:
    """Return the name that a column shares with others, to which its number was added on reading; else None."""
    shared = re.sub(r" \(\d+\)$", "", name)
    return shared if shared in sheet and (shared != name or f"{name} (2)" in sheet) else None


def _rises(values: Floats) -> bool:
    """Return whether values can be times: some rise, and at most 1 % fall."""
    steps = np.diff(values[np.isfinite(values)])
    return bool((steps > 0).any() and (steps < 0).sum() <= 0.01 * len(steps))


def _stated(sheet: LabTable, name: str) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit by the row of units, else by the name, as written."""
    bare, unit = split_unit(_repeated(sheet, name) or name)
    unit_text = sheet.written_unit(name)
    return bare, unit_text if unit_text not in ("", "-", "1") else unit


def _guess(sheet: LabTable, name: str, signal: str, si: str) -> Guess | None:
    if reserved(name) and name != signal and name != "knee_angle_deg":
        return None
    bare, stated = _stated(sheet, name)
    unit = unit_of(stated)
    if stated and not unit and si not in ("1", "%"):
        return None
    if unit and TO_SI[unit][0] != si and not (unit == "ns" and si == "s"):
        return None
    words = _tokens(bare)
    if not unit and words & OTHERS and name != signal:
        return None
    if unit in ("g", "mg") and words & ACCELERATION:
        return None
    words |= {"force"} if unit and TO_SI[unit][0] == "N" else set()
    wanted = WORDS[signal]
    if _met(words, wanted.never) and name != signal:
        return None
    met = sum(bool(_met(words, group)) for group in wanted.needs)
    if met < len(wanted.needs) and name != signal and not (name in sheet.begins_ns and signal == "time_s"):
        return None
    values = sheet.column(name)
    known = values[np.isfinite(values)]
    if not len(known) or (signal == "time_s" and not _rises(values)):
        return None
    score = 10.0 * (name == signal) + 2 * met + 0.5 * _met(words, wanted.likes) + bool(unit) - 0.1 * len(words)
    chosen, scale, why = _unit(signal, si, unit, known)
    question = "has no unit: is it in inches?" if si == "m" and not unit and name.lower().endswith("_in") else ""
    question = PUSHES if _pushes(signal, known) else question
    return Guess(signal, name, chosen, scale, why, score, question or _question(si, chosen, bool(unit), known))


def _question(si: str, unit: str, stated: bool, known: Floats) -> str:
    """Return the question about a column whose largest value is beyond `LEAST` or `MOST`; "" between them."""
    largest = float(np.abs(known).max()) * TO_SI[unit][1]
    if not stated and 0.0 < largest < LEAST.get(si, 0.0):
        return f"reaches only {largest:.4g} {si}, less than a rope bench has: no unit is stated, so is it k{si}?"
    if largest <= MOST.get(si, math.inf):
        return ""
    return (f"reaches {largest:.4g} {si}, more than a rope bench has: "
            f"{'is the unit right?' if stated else 'no unit is stated, so which is it?'}")


PUSHES = "is below 0, and a rope only pulls: does scale = -1 turn it?"


def _pushes(signal: str, values: Floats) -> bool:
    """Return whether a tension of a rope is below 0 in nearly every row."""
    known = values[np.isfinite(values)]
    return signal in ("tension_start_n", "tension_end_n") and len(known) > 0 and float(np.mean(known < 0.0)) > 0.95


def _met(words: set[str], group: frozenset[str]) -> int:
    """Return how many words are of the group; German runs words together, so longer ones may be part of one."""
    return sum(word in group or any(len(one) > 3 and one in word for one in group) for word in words)


def _tokens(name: str) -> set[str]:
    parted = re.sub(r"([a-z])([A-Z])|([A-Za-z])([0-9])", r"\1\3 \2\4", _SYMBOL.sub(r"f \1", name))
    plain = unicodedata.normalize("NFKD", parted.lower()).encode("ascii", "ignore").decode()  # é as e, ä as a
    return {word for word in re.split(r"[^a-z0-9]+", plain) if word}


def _unit(signal: str, si: str, stated: str, known: Floats) -> tuple[str, float, str]:
    """Return unit, factor and the reason; the range decides if no unit is stated."""
    largest, step = float(np.abs(known).max()), float(np.median(np.diff(known))) if len(known) > 1 else 0.0
    unit, why = stated, "unit by the file" if stated else "unit by its range: check"
    if not stated:
        unit = si
        if si == "s":
            unit = next((name for above, name in ((1e17, "ns"), (1e14, "us"), (1e11, "ms")) if largest > above),
                        "ms" if 0.5 < step < 1e3 and largest < 1e9 else "s")
        elif si == "rad" and largest > 7:
            unit = "deg"
        elif si in ("m", "m/s") and largest > 2:
            unit = f"m{si}"
    scale = 1.0
    if signal.startswith("knee") and np.median(known) > 0:
        scale, why = -1.0, f"{why}; positive in the file, flexion is negative here"
    return unit, scale, why


def text(sheet: LabTable, map_name: str) -> str:
    """Write the map of a table, commented; raises `InputError` where no column looks like time."""
    found = guesses(sheet)
    if not found:
        raise InputError(f"{sheet.path}: no column's name, unit or range looks like a signal ("
                         f"{', '.join(sheet.names[:20])}); write a map by hand, docs/trials.md shows one.")
    lines = [f"# Map of {sheet.path.name}: {len(sheet)} rows, {len(sheet.names)} columns.",
             "# Guessed from names, units and ranges: check every table, above all signs and which",
             "# sensor is START and which END, then say",
             f"#   bowden import {sheet.path} --map {map_name} -o trial.mcap", ""]
    lines += _how(sheet)
    for guess in found:
        lines += _table(sheet, guess)
    missing = [signal for signal in MOTION_AND_FORCE if signal.name not in {guess.signal for guess in found}]
    lines += ["# No column looked like these; what is not there is missing knowledge, never zeros:"] if missing else []
    lines += [f"# [{signal.name}]  # {signal.unit}: {signal.text}" for signal in missing]
    lines += ["", "# Columns not assigned; to use one, write its signal's table as above, with column, unit and scale:",
              *_rest(sheet, unassigned(sheet, found))]
    return "\n".join(lines) + "\n"


def _how(sheet: LabTable) -> list[str]:
    """Return the detected dialect as a commented table [csv], of a workbook its sheet; nothing of other files."""
    if not sheet.dialect:
        return []
    if "sheet" in sheet.dialect:
        return ["[csv]", f"sheet = {json.dumps(sheet.dialect['sheet'], ensure_ascii=False)}", ""]
    remarks = f" ({'; '.join(sheet.remarks)})" if sheet.remarks else ""
    return [f"# The file is read with these values{remarks}; to read it otherwise, uncomment and change:", "# [csv]",
            *(f"# {name} = {json.dumps(value, ensure_ascii=False)}" for name, value in sheet.dialect.items()), ""]


def _table(sheet: LabTable, guess: Guess) -> list[str]:
    meaning = next(signal for signal in MOTION_AND_FORCE if signal.name == guess.signal)
    values = sheet.column(guess.column)
    source = SignalSource(guess.column, guess.unit, guess.scale)
    converted = values * source.factor(guess.signal, str(sheet.path))
    lines = [f"[{guess.signal}]  # {meaning.text}", f"column = {json.dumps(guess.column, ensure_ascii=False)}"
             f"  # {_range(values)} in the file, {_range(converted)} {meaning.unit} then"]
    lines.append(f"unit = {json.dumps(guess.unit, ensure_ascii=False)}  # {guess.why}")
    lines += [f"# CHECK: {guess.question}"] if guess.question else []
    return [*lines, f"scale = {guess.scale:g}", "offset = 0.0", ""]


def _range(values: Floats) -> str:
    known = values[np.isfinite(values)]
    return f"{known.min():.6g} … {known.max():.6g}" if len(known) else "nothing known"


def _rest(sheet: LabTable, columns: Iterable[Unassigned]) -> list[str]:
    rows = [f"#   {json.dumps(name, ensure_ascii=False)}: "
            + (why if name in sheet.faults or name not in sheet else
               f"{_range(sheet.column(name))}; {why}") for name, why in columns]
    return rows or ["#   none"]
