"""Modulated constants of a bench's model, for changes that no effect of the catalogue describes.

    value(t) = value·(1 + a·m(t))     of a constant with a relative coefficient
    value(t) = value + a·m(t)         of any other constant

A term is a carrier (a constant of the forward model), a modulation m with its parameters, and a coefficient a.  Since
the carrier is a constant of the bench, a term has a unit and a part of the bench.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from parameters import InputError
from physics import expressions
from physics.laws import Array

SPEED_M_S: Final = 5e-3
"""Speed, m/s, at which the direction of motion counts as tanh(1) = 0.76; a rope's friction has turned over by then."""
TENSION_N: Final = 30.0
"""Tension, N, in whose units modulations by load are stated: the middle of a 40 to 60 N gait."""


class Course(NamedTuple):
    """Signals that modulations depend on, each of shape (samples,), SI.

    `time_s`: from the start of the trial.  `tension_n`: tension of the model, not of the sensor, at START; at END for
    constants of END.  `phase`: share of the gait cycle, 0 … 1, NaN outside it, or None if the trial is no gait.
    `knee_rad`: None if no joint is recorded.
    """

    time_s: Array
    position_m: Array
    speed_m_s: Array
    tension_n: Array
    knee_rad: Array | None
    phase: Array | None


class Modulation(NamedTuple):
    """A function of the course with nonlinear parameters, by name with unit; `words`: its formula with {parameters}.

    `components`: number of functions with a coefficient each; a sine has two, its quadratures.  `confirm`: motion in
    which the modulation shows most.
    """

    parameters: Mapping[str, str]
    function: Callable[[Course, Mapping[str, float]], Sequence[Array]]
    words: str
    depends: str
    confirm: str
    components: int = 1


def _memory(course: Course, tau_s: float) -> Array:
    """Return the tension behind a first-order low-pass with the time constant `tau_s`, N."""
    steps = np.diff(course.time_s, prepend=course.time_s[0])
    keep = np.exp(-steps / tau_s)
    out, last = np.empty_like(course.tension_n), float(course.tension_n[0])
    for i, (tension, share) in enumerate(zip(course.tension_n.tolist(), keep.tolist(), strict=True)):
        last = out[i] = share * last + (1.0 - share) * tension
    return out


def _knee(course: Course) -> Array:
    assert course.knee_rad is not None
    return course.knee_rad


def _phase(course: Course) -> Array:
    assert course.phase is not None
    return course.phase


def _bump(distance: Array, width: float) -> Array:
    return np.asarray(np.exp(-0.5 * (distance / width) ** 2))


def _around(course: Course, p: Mapping[str, float]) -> Array:
    """Return the distance of the gait's phase from that of a pulse, in cycles, −0.5 … 0.5; outside the gait 0.5."""
    return np.nan_to_num((_phase(course) - p["phase"] + 0.5) % 1.0 - 0.5, nan=0.5)


def _turns(angle: Array) -> tuple[Array, Array]:
    return np.asarray(np.sin(angle)), np.asarray(np.cos(angle))


_M = Modulation
MODULATIONS: Final[Mapping[str, Modulation]] = MappingProxyType({
    "constant": _M({}, lambda c, p: [np.ones_like(c.time_s)], "", "nothing", "repeat the trial"),
    "time": _M({}, lambda c, p: [c.time_s / c.time_s[-1] - 0.5], " · (t/T − 0.5)", "time_s",
               "a longer trial of the same motion"),
    "step": _M({"at_s": "s"}, lambda c, p: [np.asarray(c.time_s >= p["at_s"], np.float64)], " from t = {at_s} on",
               "time_s", "repeat the trial: the change should still be there"),
    "decay": _M({"tau_s": "s"}, lambda c, p: [np.exp(-c.time_s / p["tau_s"])], " · exp(−t/{tau_s})", "time_s",
                "rest, then repeat the trial: the change should come back"),
    "tension": _M({}, lambda c, p: [c.tension_n / TENSION_N - 1.0], " · (T/30 N − 1)", "tension_n",
                  "ramps to two peaks"),
    "tension_squared": _M({}, lambda c, p: [(c.tension_n / TENSION_N) ** 2 - 1.0], " · ((T/30 N)² − 1)", "tension_n",
                          "ramps to two peaks"),
    "saturation": _M({"from_n": "N"}, lambda c, p: [np.maximum(c.tension_n - p["from_n"], 0.0) / TENSION_N],
                     " · max(T − {from_n}, 0)/30 N", "tension_n", "ramps to a peak beyond the one recorded"),
    "load_memory": _M({"tau_s": "s"}, lambda c, p: [_memory(c, p["tau_s"]) / TENSION_N],
                      " · T/30 N behind a lag of {tau_s}", "tension_n", "hold the rope at a high load, then unload"),
    "knee": _M({}, lambda c, p: [_knee(c) + 0.5], " · (θ + 0.5 rad)", "knee_rad", "ramps at three locked knee angles"),
    "knee_squared": _M({}, lambda c, p: [_knee(c) ** 2 - 0.25], " · (θ² − 0.25 rad²)", "knee_rad",
                       "ramps at three locked knee angles"),
    "knee_bump": _M({"at_rad": "rad", "width_rad": "rad"}, lambda c, p: [
        _bump(_knee(c) - p["at_rad"], p["width_rad"])], " about the knee angle {at_rad} (± {width_rad})", "knee_rad",
        "swing the knee slowly through the angle under constant load"),
    "direction": _M({}, lambda c, p: [np.tanh(c.speed_m_s / SPEED_M_S)], " · sign of the rope's speed", "speed_m_s",
                    "pull and release at constant speed"),
    "position_sine": _M({"radius_m": "m"}, lambda c, p: _turns(c.position_m / p["radius_m"]),
                        " · sin(x/{radius_m} + phase)", "position_m", "several turns of the drum under constant load",
                        2),
    "position_bump": _M({"at_m": "m", "width_m": "m"}, lambda c, p: [_bump(c.position_m - p["at_m"], p["width_m"])],
                        " about the rope position {at_m} (± {width_m})", "position_m",
                        "pull the rope slowly through the place under constant load"),
    "phase_bump": _M({"phase": "", "width": ""}, lambda c, p: [_bump(_around(c, p), p["width"])],
                     " about the gait phase {phase} (± {width})", "phase",
                     "the same gait at another cadence: a pulse of the gait moves with it"),
    "time_sine": _M({"hz": "Hz"}, lambda c, p: _turns(2.0 * np.pi * p["hz"] * c.time_s), " · sin(2π·{hz}·t + phase)",
                    "time_s", "stand still under constant load: a vibration goes on", 2),
})
"""Modulations of terms, by name: the functions of the trial's course that may multiply a constant."""


EXPRESSION: Final = "expression"
"""Modulation of a term whose function is a user's expression over the signals of `Course` and its parameters."""


def modulation_of(name: str, expression: str = "", parameters: Iterable[str] = ()) -> Modulation:
    """Return a modulation of the library, or that of an `expression` with the names of its parameters."""
    if name != EXPRESSION:
        return MODULATIONS[name]
    function = expressions.compiled(expression)
    return Modulation(dict.fromkeys(parameters, ""), lambda c, p: [np.broadcast_to(function({
        **{key: 0.0 if value is None else value for key, value in c._asdict().items()}, **p}), c.time_s.shape)],
        f" · ({expression})".replace("{", "{{").replace("}", "}}"), "time_s", "repeat the trial")


class Carrier(NamedTuple):
    """A constant that terms may modulate: unit of the coefficient ("": relative), 1σ of its size, part, and words."""

    unit: str
    sd: float
    part: str
    words: str

    @property
    def relative(self) -> bool:
        """Return whether the coefficient multiplies the constant."""
        return self.unit == ""


@dataclass(frozen=True)
class Term:
    """A term with its numbers: `coefficients`, one for each component of the modulation, with 95 % intervals.

    `unit`: of the coefficients ("": relative to the constant).  `part`: part of the bench.  `expression`: function of
    a modulation that is not in the library.
    """

    carrier: str
    modulation: str
    parameters: Mapping[str, float]
    coefficients: tuple[float, ...]
    intervals: tuple[tuple[float, float], ...]
    unit: str
    part: str
    words: str
    expression: str = ""

    @property
    def shape(self) -> Modulation:
        """The modulation, of the library or by the term's own expression."""
        return modulation_of(self.modulation, self.expression, self.parameters)

    @property
    def size(self) -> float:
        """Return the amplitude of the modulation: the coefficient, or of two quadratures their hypotenuse."""
        return self.coefficients[0] if len(self.coefficients) == 1 else math.hypot(*self.coefficients)

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval of `size`; of two quadratures, by the mean of their half widths."""
        if len(self.coefficients) == 1:
            return self.intervals[0]
        half = 0.25 * sum(high - low for low, high in self.intervals)
        return max(self.size - half, 0.0), self.size + half

    @property
    def phase_rad(self) -> float | None:
        """Return the phase of a sine, rad; None of other modulations."""
        return None if len(self.coefficients) == 1 else math.atan2(self.coefficients[1], self.coefficients[0])

    def scaled(self, share: float) -> Term:
        """Return the term with its coefficients and their intervals multiplied by `share`."""
        return replace(self, coefficients=tuple(share * a for a in self.coefficients),
                       intervals=tuple((share * low, share * high) for low, high in self.intervals))

    def course(self, course: Course) -> Array:
        """Return a·m(t), shape (samples,), in the unit of the coefficient."""
        parts = self.shape.function(course, self.parameters)
        return np.asarray(sum(a * part for a, part in zip(self.coefficients, parts, strict=True)))

    def changed(self, value: float, course: Course) -> Array:
        """Return the constant over the course, SI, from its unmodulated `value`."""
        added = self.course(course)
        return value * (1.0 + added) if self.unit == "" else value + added

    @property
    def equation(self) -> str:
        """Return the term in words with its numbers: "friction of the cable × (1 + 0.31 · sin(x/20 mm + 0.4))"."""
        shape = self.shape.words.format(**{
            name: quantity(value, self.shape.parameters[name]) for name, value in self.parameters.items()})
        if self.phase_rad is not None:
            shape = shape.replace("phase)", f"{self.phase_rad:.2g})".replace("-", "−")).replace("+ −", "− ")
        low, high = self.interval
        said = f"{quantity(self.size, self.unit)}{shape}"
        bounds = f"{quantity(low, self.unit)} … {quantity(high, self.unit)}"
        body = f"{self.words} × (1 + {said})" if self.unit == "" else f"{self.words} + {said}"
        return f"{body.replace('+ −', '− ')}, size {bounds}"

    def as_json(self) -> dict[str, Any]:
        """Return the term as JSON values."""
        return {"carrier": self.carrier, "modulation": self.modulation, "parameters": dict(self.parameters),
                "coefficient": self.size, "coefficients": list(self.coefficients), "interval": list(self.interval),
                "intervals": [list(pair) for pair in self.intervals], "unit": self.unit, "part": self.part,
                "words": self.words, "equation": self.equation}


PREFIXES: Final = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"))


def quantity(value: float, unit: str) -> str:
    """Return a value with three significant digits and its unit with a prefix, such as "1.22 mm"."""
    if unit == "" or value == 0.0:
        return f"{value:.3g} {unit}".strip().replace("-", "−")
    scale, prefix = next((pair for pair in PREFIXES if abs(value) >= 0.1 * pair[0]), PREFIXES[-1])
    if unit not in ("m", "s", "rad"):
        scale, prefix = 1.0, ""
    return f"{value / scale:.3g} {prefix}{unit}".replace("-", "−")


ARRAY: Final = "terms"
"""Name of the array of tables in extended.toml, and of the list in `--json`."""


def rows(terms: Sequence[Term]) -> list[str]:
    """Return the lines of `[[terms]]` of a bench model."""
    lines: list[str] = []
    for term in terms:
        values = ", ".join(f"{name} = {value!r}" for name, value in term.parameters.items())
        lines += ["", f"[[{ARRAY}]]  # {term.equation}", f'carrier = "{term.carrier}"',
                  f'modulation = "{term.modulation}"', f"parameters = {{ {values} }}" if values else "parameters = {}",
                  f"coefficients = {list(term.coefficients)!r}",
                  f"intervals = {[list(pair) for pair in term.intervals]!r}", f'unit = "{term.unit}"',
                  f'part = "{term.part}"', f'words = "{term.words}"']
        lines += [f"{EXPRESSION} = {json.dumps(term.expression)}"] if term.expression else []
    return lines


def stated(tables: Mapping[str, Any], where: str) -> tuple[Term, ...]:
    """Return the terms in a file's tables.  Raises `InputError` for an unknown modulation or a wrong value."""
    given = tables.get(ARRAY, [])
    if not isinstance(given, list):
        raise InputError(f"{where}: {ARRAY} is not an array of tables; write each term as [[{ARRAY}]].")
    return tuple(_term(row, f"{where} [[{ARRAY}]] {number}") for number, row in enumerate(given, 1))


def _term(row: Any, where: str) -> Term:
    expected = ("carrier", "modulation", "parameters", "coefficients", "intervals", "unit", "part", "words")
    own = isinstance(row, Mapping) and row.get("modulation") == EXPRESSION
    if not isinstance(row, Mapping) or set(row) != {*expected, *([EXPRESSION] if own else [])}:
        raise InputError(f"{where}: expected the keys {', '.join(expected)}; copy the term as bowden discover "
                         "wrote it.")
    expression = str(row[EXPRESSION]) if own else ""
    if own:
        expressions.names_of(expression, {*Course._fields, *row["parameters"]}, where)
    elif row["modulation"] not in MODULATIONS:
        raise InputError(f"{where}: modulation = {row['modulation']!r}; expected one of {', '.join(MODULATIONS)}.")
    shape = modulation_of(row["modulation"], expression, row["parameters"])
    if set(row["parameters"]) != set(shape.parameters):
        raise InputError(f"{where}: parameters {', '.join(row['parameters']) or 'none'}; expected "
                         f"{', '.join(shape.parameters) or 'none'} of {row['modulation']}.")
    numbers = [*row["parameters"].values(), *row["coefficients"], *(v for pair in row["intervals"] for v in pair)]
    wrong = [v for v in numbers if isinstance(v, bool) or not isinstance(v, int | float) or not math.isfinite(v)]
    if wrong or len(row["coefficients"]) != shape.components or len(row["intervals"]) != shape.components:
        raise InputError(f"{where}: expected finite numbers and {shape.components} coefficients with an interval each; "
                         "copy the term as bowden discover wrote it.")
    return Term(str(row["carrier"]), str(row["modulation"]), {n: float(v) for n, v in row["parameters"].items()},
                tuple(float(v) for v in row["coefficients"]),
                tuple((float(low), float(high)) for low, high in row["intervals"]), str(row["unit"]), str(row["part"]),
                str(row["words"]), expression)
