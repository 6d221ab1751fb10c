"""`bowden fit`: identification of the constants of one bench or rig, and the file model.toml that holds them.

The file is a bench model (`physics.bench_model`).  `[parameters.NAME]`, `[discrepancy]`: calibration of the bench, as
`bowden identify` writes it.  `[simulation.NAME]`: parameters of the many-segment simulation, fitted to the same trials.
`[fitted]`: trials and errors of the fit.  A value that the data do not determine has no interval and is its prior's.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from estimation import rig_fit, simulation, simulation_fit
from estimation.data import integrity, scales, table
from estimation.data.table import Table
from estimation.fitted_quantities import quantities
from estimation.path_model import PATH_MODEL, can_be_of_bench, is_of_bench
from estimation.reference_fit import ReferenceFit
from estimation.rig_fit import Constant
from estimation.simulation_fit import identified
from estimation.transfer import trial_calibration
from parameters import InputError
from physics.bench_model import BenchModel, of_calibration
from physics.calibration import Calibration, ScalarEvidence
from physics.parameters import ESTIMATED

Values = Mapping[str, float]

HEAD: Final = ("# The constants of one bench, fitted to its healthy trials: value with 95 % interval, SI.\n"
               "# Without an interval: these trials do not determine it, and it is the one of like benches.\n")
HEAD_OF_RIG: Final = "# The constants of a rig, fitted to its reference trials: value with 95 % interval, SI.\n"
ROPE: Final = ("servo_position_m", "servo_target_m", "servo_velocity_m_s")
"""Columns of the rope's motion; their sign is reversed if the rope position falls where the rope is pulled."""
FIXED: Final = ("theta1", "phi0", "home_preload", "drum_radius")
"""Constants that only scale others: no trial determines them."""


@dataclass(frozen=True)
class FittedBench:
    """Bench or rig as fitted.

    `model`: what model.toml holds.  `constants`: of the simulation, or of a rig, by name.  `figures`: RMS error of the
    simulated START and END, N, on held-out rows.  `relations`: of a rig, errors by output, in its unit.  `rig`: terms
    of a rig of another kind; None for a bench, which is a rope over a knee.
    """

    model: BenchModel
    constants: Mapping[str, Constant]
    figures: Mapping[str, Any] = field(default_factory=dict)
    relations: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    rig: tuple[str, ...] | None = None

    @property
    def values(self) -> dict[str, float]:
        """All parameters of the simulation; nominal if the model has no value."""
        return self.model.simulation_values()

    @property
    def pulls(self) -> int:
        """1 if a growing rope position pulls, −1 if it lets out."""
        return int(self.model.fitted["pulls"])

    @property
    def undetermined(self) -> list[str]:
        """Names of the constants that the data do not determine."""
        return [n for n, c in self.constants.items() if not c.determined]

    def as_json(self) -> dict[str, Any]:
        """Return the model as a dictionary of JSON values."""
        return {"trials": list(self.model.fitted["trials"]),
                "constants": {n: dataclasses.asdict(c) for n, c in self.constants.items()},
                "not_determined": self.undetermined, "simulation": dict(self.figures),
                "rig": None if self.rig is None else list(self.rig),
                "relations": {n: dict(r) for n, r in self.relations.items()}, "warnings": list(self.warnings)}

    def text(self) -> str:
        """Return the model as the text of model.toml."""
        return (HEAD if self.rig is None else HEAD_OF_RIG) + self.model.text()


def fit(trials: Sequence[str | Path | Table], lowpass: float | None = None) -> FittedBench:
    """Fit the constants of a bench to trials of any motion in the reference condition.

    `lowpass`: cut-off, Hz, of the zero-phase low-pass that every signal first passes (None: no filter).  Trials of
    another rig than a rope over a knee are fitted by `rig_fit`.
    Raises `InputError` for contradictory trials, and for columns that allow no prediction.
    """
    if not trials:
        raise InputError("fit: no trial given; name at least one healthy trial.")
    with threadpool_limits(1, user_api="blas"):
        return _fitted([t if isinstance(t, Table) else table.read(t) for t in trials], lowpass)


def _fitted(given: Sequence[Table], lowpass: float | None) -> FittedBench:
    findings = [f for t in given for f in (*integrity.examine(t), *scales.contradictions(t))]
    for finding in findings:
        if finding.refuses:
            raise InputError(finding.text)
    usable = [integrity.usable(t) for t in given]
    usable = [t if lowpass is None else table.low_passed(t, lowpass) for t in usable]
    tables, pulls = oriented([table.with_locked_knee(t) for t in usable])
    whole: list[ReferenceFit | None] = []

    def unlike() -> str:
        if lacking := _lacking(tables):
            return lacking
        fit, why = identified(tables)
        whole.append(fit)
        return why

    if not is_of_bench(given, unlike):
        return _rig(usable, given, findings)
    if not whole and (why := unlike()):
        raise InputError(f"a gait, but no rope that a tension stretches over a knee: {why}")
    first, rest = _parts(tables)
    early, _ = identified(first)
    unseen = {} if early is None else _unseen(rest, simulation_fit.fitted(first, early))
    bench = whole[0]
    assert bench is not None
    values = simulation_fit.fitted(tables, bench)
    constants = _constants(values, bench)
    known = of_calibration(_calibration(tables, bench))
    figures = {end: {"unseen_rms_n": row["rms_n"], "peak_n": row["peak_n"]} for end, row in unseen.items()
               if row["rms_n"] is not None}
    model = dataclasses.replace(
        known, fitted={"trials": [Path(t.source).name for t in given], "pulls": pulls, **figures},
        simulation={n: c.value for n, c in constants.items()},
        simulation_evidence={n: ScalarEvidence(c.low, c.high) for n, c in constants.items() if c.determined})
    return FittedBench(model, constants, unseen, warnings=tuple(filter(None, (
        *(f.text for f in findings), bench.warning()))))


def _lacking(tables: Sequence[Table]) -> str:
    """Return a sentence on the first trial without a column that the bench's model needs, else ""."""
    return next((f"{t.source}: no rope position, or no START." for t in tables if PATH_MODEL.lacking(t)), "")


def _calibration(trials: Sequence[Table], bench: ReferenceFit) -> Calibration:
    found = quantities(bench, trial_calibration.scalars_of)
    return trial_calibration.calibrated(
        trials, {n: q.value for n, q in found.items()}, {n: q.sd for n, q in found.items() if q.determined},
        bench.model.constants.named(bench.bench_coordinates())["end_offset"])


def oriented(tables: Sequence[Table]) -> tuple[list[Table], int]:
    """Return the trials with a rope position that grows as the rope is pulled, and the sign of the recorded position.

    The sign is 1 if the trials were recorded so, and −1 if their rope columns had to be negated.  The sign of
    most trials follows from a regression; where it contradicts, from simulations of the first trial with either sign.
    """
    if not can_be_of_bench(tables) or any(PATH_MODEL.lacking(t) for t in tables) or all(
            PATH_MODEL.pulls(t) for t in tables):
        return list(tables), 1
    if PATH_MODEL.scan_error(tables[0]) <= PATH_MODEL.scan_error(turned(tables[0])):
        return list(tables), 1
    return [turned(t) for t in tables], -1


def turned(given: Table) -> Table:
    """Return a trial with the rope's position, target and velocity negated."""
    return dataclasses.replace(given, columns={n: -v if n in ROPE else v for n, v in given.columns.items()})


def _rig(usable: Sequence[Table], given: Sequence[Table], findings: Sequence[integrity.Finding]) -> FittedBench:
    first, rest = _parts(usable)
    found = rig_fit.fit(first, rest, usable)
    blind = (f"{name}: the last part of each trial is predicted no better than by a constant; record longer trials, "
             "or more kinds of motion." for name, row in found.signals.items() if row["unseen"] > row["spread"])
    errors = {name: {"unseen_rms": row["unseen"], "unit": row["unit"]} for name, row in found.signals.items()
              if row["unseen"] is not None}
    model = BenchModel(
        fitted={"trials": [Path(t.source).name for t in given], "pulls": 1, "terms": list(found.effects), **errors},
        rig={n: {"value": c.value, "unit": c.unit, "interval": [c.low, c.high]} for n, c in found.constants.items()})
    return FittedBench(model, found.constants, {}, found.signals, (*(f.text for f in findings), *blind), found.effects)


def _part(given: Table, low: float, high: float) -> Table:
    """Return the rows of a trial from share `low` to share `high` of its length, 0 … 1."""
    size = len(given)
    rows = slice(round(low * size), round(high * size))
    return dataclasses.replace(given, columns={n: v[rows] for n, v in given.columns.items()})


def _parts(tables: Sequence[Table], share: float = 0.6) -> tuple[list[Table], list[Table]]:
    """Return the first `share` of each trial, for the fit, and the last part, held out to test that fit."""
    return [_part(t, 0.0, share) for t in tables], [_part(t, share, 1.0) for t in tables]


def _unseen(rest: Sequence[Table], values: Values) -> dict[str, Any]:
    """Return RMS of measured less simulated and peak, N, by tension, on rows held out from the fit of `values`."""
    figures = {}
    for name in simulation.SIGNALS:
        parts, peak = [], 0.0
        for given in rest:
            if name in given:
                keep = simulation.counted(given) & np.isfinite(given[name])
                parts.append((given[name] - getattr(simulation.simulate(given, values), name))[keep])
                peak = max(peak, float(np.nanmax(given[name])))
        if parts:
            figures[name] = {"rms_n": math.sqrt(float(np.mean(np.concatenate(parts) ** 2))), "peak_n": peak}
    return figures


def _constants(values: Values, bench: ReferenceFit) -> dict[str, Constant]:
    """Return each constant with its 95 % interval, within the bounds of its row of the parameter table.

    The difference between the two models' estimates counts as 1σ of model error.
    """
    constants = {}
    for name, found in simulation_fit.parameters_of(bench).items():
        stated = ESTIMATED[name]
        half = 1.96 * math.hypot(found.sd, values[name] - found.value)
        value, low, high = (min(max(values[name] + side * half, stated.low), stated.high) for side in (0.0, -1.0, 1.0))
        constants[name] = Constant(value, low, high, stated.unit, found.determined)
    return constants | {n: Constant(values[n], values[n], values[n], ESTIMATED[n].unit, False)
                        for n in FIXED}


def as_fitted(given: Table, model: BenchModel) -> Table:
    """Return a trial whose rope position has the sign of the model's trials."""
    return turned(given) if model.fitted.get("pulls", 1) < 0 else given
