"""Parameters of a sweep: rows, each the complete description of one trial.

A row names every parameter as "table.key", with a value of its declared type, and has been checked by the
declaration; two equal rows are the same trial.  The knee of a row may depart from the reference in angle and tempo;
the desired force and its time remain the reference's.
"""

import dataclasses
import difflib
import itertools
import math
import typing
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bowden.bench import configuration
from bowden.trials import session
from eds import declaration
from eds.bench import bus_load
from eds.bench.bench_network import Network, wire
from master.control import controller
from parameters import InputError, checked, declarations, parameter
from physics.reference import CYCLE_POINTS, Reference
from virtual_bus.build import GROUPS, steady
from virtual_bus.bus_options import Options


@dataclass(frozen=True)
class Departure:
    """Departure of the knee from its reference; the defaults are no departure."""

    angle_rad: float = parameter(
        0.0, "rad", "amplitude of a sine, once a gait cycle, on top of the reference", low=-0.3, high=0.3,
        source="assumed: people do not walk a table")
    tempo: float = parameter(
        1.0, "", "gait cycles of the knee to one of the reference", low=0.5, high=2.0,
        source="assumed: people do not walk to a clock")


def motion(reference: Reference, departure: Departure) -> Reference | None:
    """Return the knee's motion in place of `reference`; None without a departure."""
    if departure == Departure():
        return None
    phase = np.linspace(0.0, 1.0, CYCLE_POINTS + 1)
    turn = 2.0 * np.pi * phase
    angle = np.array([reference.knee_angle(at) for at in phase]) + departure.angle_rad * np.sin(turn)
    velocity = np.array([reference.knee_velocity(at) for at in phase])
    slope = (velocity * reference.period_s + 2.0 * np.pi * departure.angle_rad * np.cos(turn)) / 100.0
    return Reference(reference.period_s / departure.tempo, (angle, slope), (np.zeros_like(phase),) * 3)


Value = float | int | str
Row = dict[str, Value]

NOMINAL, IDENTIFIED = "nominal", "identified"
SHORT = {"peak": "gait.peak_n", "period": "gait.period_s", "cycles": "gait.cycles", "settle": "gait.settle",
         "controller": "gait.controller", "rate": "network.rate_hz", "serial": "bench.serial", "day": "bench.day",
         "seed": "bench.seed", "calibration": "files.calibration"}
"""Options of `bowden trial`, by the parameters that they set."""
LARGEST_SWEEP = 1_000_000
DECLARED = "network.bench"
"""Key of a row that holds the tables of its bench as JSON text, "" for the packaged bench; it cannot be varied."""


def _option(name: str) -> Any:
    found = Options.__dataclass_fields__[name]
    return dataclasses.field(default=found.default, metadata=found.metadata)


@dataclass(frozen=True)
class SweptBench:
    """The simulated bench, as the virtual bus takes it; `steady` has its names joined by "+"."""

    serial: int = _option("serial")
    day: int = _option("day")
    seed: int = _option("seed")
    plant: str = _option("plant")
    steady: str = parameter("", "", "what the day leaves as it was, names joined by +",
                            source="virtual_bus/machine/scatter.py")


@dataclass(frozen=True)
class Files:
    """Files of a trial; "" for none.  They are read where the trial runs."""

    calibration: str = parameter(NOMINAL, "", "nominal, identified, or a calibration.toml", source="bowden trial")
    knee: str = parameter("", "", "knee motion, CSV", source="bowden trial")
    desired: str = parameter("", "", "desired force, CSV", source="bowden trial")


ALWAYS: dict[str, type[Any]] = {
    "bench": SweptBench, **{name: configuration.declaration(name) for name in configuration.SECTIONS},
    "departure": Departure, "files": Files,
}
"""Tables that are in every row, whole; those of the plant are there as far as they are varied."""


class Draw(NamedTuple):
    """One parameter drawn at random, evenly, or evenly in its logarithm."""

    name: str
    low: float
    high: float
    logarithmic: bool

    def at(self, share: float) -> Value:
        """Return the value at a share of the range, 0…1."""
        if kind_of(self.name) is int:
            return int(self.low + share * (self.high - self.low + 1))
        if self.logarithmic:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)


@cache
def kinds() -> Mapping[str, type[Any]]:
    """Type of every parameter that can be varied, by its full name."""
    tables = {**ALWAYS, **GROUPS}
    return {f"{table}.{key}": typing.get_type_hints(cls)[key]
            for table, cls in tables.items() for key, _, _ in declarations(cls)}


OWN = "controller."
"""Beginning of the names of parameters that a controller declares itself."""


def kind_of(name: str) -> type[Any]:
    """Return the type of a parameter; one of a controller's own is a number."""
    return float if name.startswith(OWN) else kinds()[name]


def full_name(name: str) -> str:
    """Return "table.key" of a parameter; raises `InputError` for one that nobody declares.

    Names of a controller's own parameters are checked with the controller of each row.
    """
    found = SHORT.get(name, name)
    if found not in kinds() and not found.startswith(OWN):
        close = difflib.get_close_matches(name, [*SHORT, *kinds()], n=1)
        hint = f"did you mean {close[0]}?" if close else "see bowden init for the names of bench.toml."
        raise InputError(f"{name}: no parameter has that name; {hint}")
    return found


def value(name: str, text: str) -> Value:
    """Return the value of the parameter `name` from its text; raises `InputError`."""
    kind = kind_of(name)
    try:
        return typing.cast(Value, kind(text.strip()))
    except ValueError:
        expected = {int: "a whole number", float: "a number"}[kind]
        raise InputError(f"{name}: {text!r} is not {expected}; mend that value.") from None


def axis(text: str) -> tuple[str, list[Value]]:
    """Return name and values of "NAME=V,V…"; whole numbers also as ranges, 1-20."""
    name, values = _split(text, "--grid", "NAME=VALUE,VALUE")
    found: list[Value] = []
    for part in values.split(","):
        low, dash, high = part.partition("-")
        if kind_of(name) is int and dash and low:
            found += range(int(value(name, low)), int(value(name, high)) + 1)
        else:
            found.append(value(name, part))
    if len(set(found)) < len(found) or not found:
        raise InputError(f"--grid {text}: expected at least one value and none of them twice; mend the list.")
    return name, found


def draw(text: str) -> Draw:
    """Return the draw described by "NAME=LOW:HIGH" or "NAME=LOW:HIGH:log"."""
    name, limits = _split(text, "--draw", "NAME=LOW:HIGH")
    low, _, rest = limits.partition(":")
    high, _, log = rest.partition(":")
    if kind_of(name) is str or not high or log not in ("", "log"):
        raise InputError(f"--draw {text}: expected a number's NAME=LOW:HIGH, or NAME=LOW:HIGH:log; mend it.")
    drawn = Draw(name, float(value(name, low)), float(value(name, high)), log == "log")
    if not drawn.low < drawn.high or (drawn.logarithmic and drawn.low <= 0):
        raise InputError(f"--draw {text}: low must be below high, and above 0 where it is logarithmic; swap them.")
    return drawn


def _split(text: str, option: str, form: str) -> tuple[str, str]:
    name, equals, rest = text.partition("=")
    if not equals or not rest:
        raise InputError(f"{option} {text}: expected {form}; write it so.")
    return full_name(name.strip()), rest


def rows(
    sections: Mapping[str, Any], fixed: Mapping[str, Value], axes: Sequence[tuple[str, Sequence[Value]]],
    draws: Sequence[Draw] = (), count: int = 1, seed: int = 0,
) -> list[Row]:
    """Return the rows: every point of the grid with each of the `count` random draws, the same for every point."""
    names = [name for name, _ in axes] + [drawn.name for drawn in draws]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name}: is varied twice; keep one.")
    base: Row = {}
    for table, cls in ALWAYS.items():
        given = sections.get(table) or cls()
        base |= {f"{table}.{key}": getattr(given, key) for key, _, _ in declarations(cls)}
    base[DECLARED] = declaration.as_json((sections.get("network") or Network()).bench)
    trials = math.prod(len(values) for _, values in axes) * (count if draws else 1)
    if trials > LARGEST_SWEEP:
        raise InputError(f"{trials} trials, expected at most {LARGEST_SWEEP}; vary less.")
    grid = [dict(zip((name for name, _ in axes), point, strict=True))
            for point in itertools.product(*(values for _, values in axes))]
    shares = np.random.Generator(np.random.Philox(seed)).random((count if draws else 1, len(draws))).tolist()
    drawn = [{each.name: each.at(share) for each, share in zip(draws, line, strict=True)} for line in shares]
    varied = frozenset(names).union(fixed)
    whole = [_tuned({**base, **fixed, **point, **more}) for point in grid for more in drawn]
    for name in names:
        if name.startswith(OWN) and all(row[name] == "" for row in whole):
            raise InputError(f"{name}: no controller of this sweep declares that parameter; see docs/controllers.md.")
    distinct = {tuple(row.items()): row for row in whole}
    return [checked_row(row, varied) for row in distinct.values()]


def _tuned(row: Row) -> Row:
    """Return a row with the controller's own parameters in `gait.tuning`; those that it does not declare are "".

    Rows of one controller that differ in another controller's parameters become equal.
    """
    given = {name: value for name, value in row.items() if name.startswith(OWN)}
    if not given:
        return row
    kind = controller.find(str(row["gait.controller"]), where="gait")
    declared = {name for name, _, _ in declarations(kind.parameters)} if kind.parameters else set()
    own = {name: value for name, value in given.items() if name.removeprefix(OWN) in declared}
    text = ", ".join(filter(None, (str(row["gait.tuning"]),
                                   *(f"{name.removeprefix(OWN)}={value:g}" for name, value in own.items()))))
    return {**row, **{name: own.get(name, "") for name in given}, "gait.tuning": text}


def table(row: Row, name: str) -> Any:
    """Return one table of a row as its checked dataclass."""
    cls = ALWAYS[name]
    given: dict[str, Any] = {key: row[f"{name}.{key}"] for key, _, _ in declarations(cls)}
    if name == "network":
        given["bench"] = declaration.from_json(str(row[DECLARED]), where=DECLARED)
    return checked(cls(**given), where=name)


def placed(row: Row) -> Row:
    """Return a row whose files and plug-ins in files have whole paths, so that a worker in another folder finds them.

    A plug-in "module:Class" in the current folder becomes the path of that module's file.
    """
    found = dict(row)
    for name in ("gait.controller", "bench.plant"):
        module, colon, attribute = str(row[name]).rpartition(":")
        file = Path(module if module.endswith(".py") else f"{module.replace('.', '/')}.py")
        if colon and file.is_file():
            found[name] = f"{file.resolve()}:{attribute}"
    for name in ("files.knee", "files.desired", "files.calibration"):
        if row[name] not in ("", NOMINAL, IDENTIFIED):
            found[name] = str(Path(str(row[name])).resolve())
    return found


def plant_model(row: Row) -> dict[str, dict[str, Value]]:
    """Return the plant's parameters that a row sets, by table."""
    model: dict[str, dict[str, Value]] = {}
    for name, given in row.items():
        group, _, key = name.partition(".")
        if group in GROUPS:
            model.setdefault(group, {})[key] = given
    return model


def checked_row(row: Row, varied: Container[str]) -> Row:
    """Return `row`, numbers in their declared type; raises `InputError`.

    A period or peak that is not in `varied` comes from the knee or desired-force file, where there is one.
    """
    row = {name: float(given) if kinds().get(name) is float else given for name, given in row.items()}
    files, bench = table(row, "files"), table(row, "bench")
    for file in (files.knee, files.desired, files.calibration):
        if file not in ("", NOMINAL, IDENTIFIED) and not Path(file).is_file():
            raise InputError(f"{file}: no such file; give the path of an existing one.")
    if files.knee or files.desired:
        _, gait, _ = session.reference(
            table(row, "gait"), *(Path(file) if file else None for file in (files.knee, files.desired)),
            period_given="gait.period_s" in varied, peak_given="gait.peak_n" in varied, walk=table(row, "walk"),
            rate_hz=table(row, "network").rate_hz)
        row |= {"gait.period_s": gait.period_s, "gait.peak_n": gait.peak_n}
    gait = table(row, "gait")
    kind = controller.find(gait.controller, where="gait")
    controller.own_parameters(kind, gait.tuning, where=f"controller {gait.controller}")
    if gait.settle >= gait.cycles:
        raise InputError(f"settle = {gait.settle} leaves none of {gait.cycles} cycles; give more cycles.")
    steady(bench.steady.replace("+", ","))
    for name in ("impedance", "limits", "homing", "departure"):
        table(row, name)
    _affordable(table(row, "network"))
    for group, given in plant_model(row).items():
        checked(GROUPS[group](**given), where=group)
    return row


_affordable = cache(lambda network: bus_load.refuse(wire(network)))
