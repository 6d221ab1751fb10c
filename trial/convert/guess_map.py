"""A map for somebody else's table, guessed from names, units and ranges, to be checked by who knows the bench.

The rule of this file: a guess is written with what it rests on; a column is given to one signal at most, and what
fits no signal, or no column, is listed.  Words are those of English and German labs.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from parameters import InputError
from trial.convert.csv_file import reserved
from trial.convert.csv_table import SignalSource
from trial.convert.lab_table import TO_SI, Floats, LabTable, unit_of
from trial.signals import MOTION_AND_FORCE


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


FORCE = _words("force forces tension load loadcell cell kraft zugkraft seilkraft newton f fx fz")
TARGET = _words("target desired reference ref set setpoint command commanded cmd soll demand goal")
ROPE = _words("rope cable wire tendon bowden motor servo drum winch actuator position pos displacement disp stroke "
                 "weg seil seilweg length travel")
SPEED = _words("velocity vel speed geschwindigkeit")
KNEE = _words("knee knie joint angle winkel flexion gelenk theta")
NEAR = _words("start input in proximal prox motorside upstream near front 1 a antrieb eingang source")
FAR = _words("end output out distal dist loadside downstream far rear 2 b abtrieb ausgang tip")
GUESS = _words("estimate estimated est model predicted")
TIME = _words("time t timestamp zeit clock elapsed seconds sec")
PERCENT = _words("gait phase percent pct gang")
COUNT = _words("cycle cycles stride rep repetition zyklus step")


class Words(NamedTuple):
    """What a signal's column is called: every group of `needs` has a word of it, `likes` tell more, none of `never`."""

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
_UNIT = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$|\s*/\s*([^\s/\d]+)\s*$|\s+in\s+(\S+)\s*$|_([A-Za-zµ°%]+)$")


class Guess(NamedTuple):
    """A column for a signal, how sure it is, and what it rests on."""

    signal: str
    column: str
    unit: str
    scale: float
    why: str
    score: float


def split_unit(name: str) -> tuple[str, str]:
    """Return a header without its unit, and the unit; empty where it states none."""
    found = _UNIT.search(name)
    unit = unit_of(next(filter(None, found.groups()), "")) if found else ""
    return (name[:found.start()], unit) if found and unit else (name, "")


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


def _guess(sheet: LabTable, name: str, signal: str, si: str) -> Guess | None:
    if reserved(name) and name != signal and name != "knee_angle_deg":
        return None
    bare, unit = split_unit(name)
    unit = sheet.unit(name) or unit
    if unit and TO_SI[unit][0] != si and not (unit == "ns" and si == "s"):
        return None
    words = _tokens(bare) | ({"force"} if unit and TO_SI[unit][0] == "N" else set())
    wanted = WORDS[signal]
    if _met(words, wanted.never) and name != signal:
        return None
    met = sum(bool(_met(words, group)) for group in wanted.needs)
    if met < len(wanted.needs) and name != signal and not (name in sheet.begins_ns and signal == "time_s"):
        return None
    values = sheet.column(name)
    known = values[np.isfinite(values)]
    if not len(known) or (signal == "time_s" and (np.diff(known) < 0).mean() > 0.01):
        return None
    score = 10.0 * (name == signal) + 2 * met + 0.5 * _met(words, wanted.likes) + bool(unit) - 0.1 * len(words)
    chosen, scale, why = _unit(signal, si, unit, known)
    return Guess(signal, name, chosen, scale, why, score)


def _met(words: set[str], group: frozenset[str]) -> int:
    """Return how many words are of the group; German runs words together, so longer ones may be part of one."""
    return sum(word in group or any(len(one) > 3 and one in word for one in group) for word in words)


def _tokens(name: str) -> set[str]:
    parted = re.sub(r"([a-z])([A-Z0-9])", r"\1 \2", name)
    return {word for word in re.split(r"[^a-z0-9äöü]+", parted.lower()) if word}


def _unit(signal: str, si: str, stated: str, known: Floats) -> tuple[str, float, str]:
    """Return unit, factor and the reason; where no unit is stated the range tells."""
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
    taken = {guess.column for guess in found}
    lines += ["", "# Columns not used:", *_rest(sheet, [name for name in sheet.names if name not in taken])]
    return "\n".join(lines) + "\n"


def _how(sheet: LabTable) -> list[str]:
    if not sheet.said:
        return []
    return [f"# Read with: {'; '.join(sheet.said)}. To read it otherwise:", "# [csv]",
            "# encoding = \"utf-8\"", "# delimiter = \";\"", "# decimal = \",\"", "# comment = \"#\"",
            f"# header_row = {sheet.header_row}", "# units_row = 0", ""]


def _table(sheet: LabTable, guess: Guess) -> list[str]:
    meaning = next(signal for signal in MOTION_AND_FORCE if signal.name == guess.signal)
    values = sheet.column(guess.column)
    source = SignalSource(guess.column, guess.unit, guess.scale)
    converted = values * source.factor(guess.signal, str(sheet.path))
    lines = [f"[{guess.signal}]  # {meaning.text}", f"column = {json.dumps(guess.column, ensure_ascii=False)}"
             f"  # {_range(values)} in the file, {_range(converted)} {meaning.unit} then"]
    lines.append(f"unit = {json.dumps(guess.unit, ensure_ascii=False)}  # {guess.why}")
    return [*lines, f"scale = {guess.scale:g}", "offset = 0.0", ""]


def _range(values: Floats) -> str:
    known = values[np.isfinite(values)]
    return f"{known.min():.6g} … {known.max():.6g}" if len(known) else "nothing known"


def _rest(sheet: LabTable, names: Iterable[str]) -> list[str]:
    rows = []
    for name in list(names)[:200]:
        rows.append(f"#   {json.dumps(name, ensure_ascii=False)}: "
                    + ("no numbers" if name in sheet.faults else _range(sheet.column(name))))
    return rows or ["#   none"]
