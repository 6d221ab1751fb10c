"""Steps of a diagnosis from trials to verdict: integrity, reference condition, search, test on held-out cycles.

This module only connects the steps; each decision is made in the module of its step.  The same files always give the
same verdict.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from diagnosis import wire_faults
from diagnosis.evidence.evidence_finder import NO_REFERENCE, EvidenceFinder
from diagnosis.evidence.held_out import cycles_of
from diagnosis.findings import Findings
from diagnosis.laws.law_findings import discover
from diagnosis.laws.law_result import Laws
from diagnosis.wire_faults import WireFindings
from estimation import simulation_fit
from estimation.bench_fit import oriented, turned
from estimation.data import integrity, scales, table, windows
from estimation.data.table import Table
from estimation.likelihood_data import MOTION
from estimation.path_model import can_be_of_bench, is_of_bench
from estimation.rig_model import rig_model_of
from parameters import InputError, read_toml
from physics import bench_model
from physics.bench_model import BenchModel

Given = str | Path | Table
"""A trial: its file (MCAP or CSV), or its columns in memory."""


class Finder:
    """Diagnosis of one bench or rig: `fit` reads its reference trials once, `diagnose` then diagnoses any trials.

    `calibration`: file or tables of the bench's calibration (None: the calibration attached to the trials, if any).
    `lowpass`: cut-off, Hz, of the zero-phase low-pass that every signal first passes.  `session_sd`: 1σ of each
    constant between sessions, from a logbook (None: the published one).  `own_effects`: names of effects of files that
    compete beside those of the catalogue (`physics.effects.own_effects`).

    Effects compete by evidence (`diagnosis.evidence`).  Without reference trials a bench is compared with the bench
    population and its calibration; a rig of another kind is refused.
    """

    def __init__(self, calibration: str | Path | Mapping[str, Any] | None = None, lowpass: float | None = None,
                 session_sd: Mapping[str, float] | None = None, own_effects: Sequence[str] = ()) -> None:
        self.calibration, self.lowpass, self.session_sd = _calibration(calibration), lowpass, session_sd
        self.own_effects = own_effects
        self._reversed = False
        self._read: list[Table] = []
        self._findings: list[integrity.Finding] = []
        self._plain: list[Table] = []
        self._healthy: list[Table] = []
        self._bench: EvidenceFinder | None = None
        self._rigs: dict[frozenset[str], EvidenceFinder] = {}

    def fit(self, healthy: Sequence[Given]) -> Finder:
        """Read, check and fit `healthy`, trials of the bench in the reference condition; returns itself.

        The fit covers the outputs that these trials have.  A diagnosed trial with other columns causes one further fit
        per set of columns.  Raises `InputError` for unusable files.
        """
        self.examine(healthy)
        with threadpool_limits(1, user_api="blas"):
            if self._healthy:
                core = self._core(())
                if not core.lacking(()):
                    core.reference(())
        return self

    def examine(self, healthy: Sequence[Given]) -> Finder:
        """Read and check the reference trials `healthy` and postpone their fit to the first diagnosis; returns itself.
        """
        self._read = [_read(t) for t in healthy]
        self._findings = [f for t in self._read for f in (*integrity.examine(t), *scales.contradictions(t))]
        self._plain = [] if any(f.refuses for f in self._findings) else [self._usable(t) for t in self._read]
        self._healthy = [_filtered(t, self.lowpass) for t in self._plain]
        self._rigs, self._bench, self._reversed = {}, None, False
        if self._healthy:
            simulable, sign = oriented([self._locked(t) for t in self._healthy])
            self._reversed = sign < 0
            self._bench = EvidenceFinder(simulable, self.session_sd, own_effects=self.own_effects)
        return self

    def diagnose(self, trials: Sequence[Given], holdout: Sequence[Given] = (), *, terms: bool = False) -> Findings:
        """Return which effects explain the error of the simulation on `trials`; nothing is fitted on `holdout`.

        `terms`: where effects do not explain the trials, or not all of it, seek terms that do, too (`Findings.laws`).
        Contradictory data give the verdict `refused`.  Raises `InputError` for unusable files.
        """
        # with matrices of some hundred columns, waiting threads cost more time than they save
        with threadpool_limits(1, user_api="blas"):
            return replace(self._diagnosed(trials, holdout, terms), lowpass_hz=self.lowpass)

    def discover(self, trials: Sequence[Given]) -> tuple[Laws, BenchModel | None]:
        """Return the terms that extend the model of the reference condition in `trials`, and that model.

        `trials`: of one session.  A rig of another kind has no model (None).

        Raises `InputError` for unusable files, and without reference trials: a law departs from them.
        """
        if not trials or not self._read:
            raise InputError("discover: name at least one trial, and one in the reference condition with --healthy.")
        with threadpool_limits(1, user_api="blas"):
            return self._discovered(trials)

    def _discovered(self, trials: Sequence[Given]) -> tuple[Laws, BenchModel | None]:
        held = [[_read(t) for t in trials], list[Table]()]
        refusals = self._examined(held)[1]
        if refusals:
            raise InputError(refusals[0])
        tables = [_filtered(self._usable(t), self.lowpass) for t in held[0]]
        core = self._core(tables)
        if core is self._bench:
            tables = [self._simulable(t) for t in tables]
        refused = _short(tables) or core.lacking(tables) or core.unlike(tables) or core.unlike_motion(tables)
        if refused:
            raise InputError(refused)
        return discover(*core.observed(tables)), self._model(core, tables)

    def _known(self, trials: Sequence[Table]) -> Mapping[str, Any] | None:
        return self.calibration if self.calibration is not None else trials[0].calibration

    def _diagnosed(self, trials: Sequence[Given], holdout: Sequence[Given], terms: bool) -> Findings:
        if not trials:
            raise InputError("diagnose: no trial given; name at least one.")
        held = [[_read(t) for t in group] for group in (trials, holdout)]
        warnings, refusals = self._examined(held)
        if refusals:
            return Findings("refused", warnings=refusals + warnings)
        plain = [[self._usable(t) for t in group] for group in held]
        groups = [[_filtered(t, self.lowpass) for t in group] for group in plain]
        carried = wire_faults.examine(plain[0], self._plain)
        if not self._healthy:
            refused = self._compared_with_population(groups)
            if refused:
                return Findings("refused", warnings=[refused, *warnings])
        core = self._core([*groups[0], *groups[1]])
        if carried.faults and core is self._bench:
            return replace(_of_wire(carried, warnings), part="wire", evidence={})
        if core is self._bench:
            groups = [[self._simulable(t) for t in group] for group in groups]
        refused = _short(groups[0]) or core.lacking([*groups[0], *groups[1]]) or core.unlike(groups[0])
        if refused:
            return Findings("refused", warnings=[refused, *warnings])
        found = core.diagnose(groups[0], groups[1], warnings)
        wrong = _clock(groups[0], self._healthy, found)
        if wrong:
            return Findings("refused", warnings=[wrong, *warnings])
        undecided = _undecided(groups[0], found)
        again = undecided is not None and found.experiment in {t.experiment for t in groups[0]}
        unstable = core.reference([*groups[0], *groups[1]]).warning()
        found = replace(found, warnings=[*([unstable] if unstable else []), *found.warnings])
        if terms and self._healthy and (found.unexplained or found.verdict == "unexplained"):
            found = replace(found, laws=discover(*core.observed(groups[0]), found.variants))
        return replace(found, bench=self._model(core, groups[0]), undecided=undecided,
                       experiment=None if again else found.experiment)

    def _examined(self, held: Sequence[Sequence[Table]]) -> tuple[list[str], list[str]]:
        """Return the warnings and the refusals of the integrity checks of trials and held-out trials."""
        findings = [f for group in held for t in group for f in (*integrity.examine(t), *scales.contradictions(t))]
        findings += self._findings
        if not any(f.refuses for f in findings):
            findings += integrity.between(held[0], held[1], self._read)
            findings += scales.against_range([*held[0], *held[1]], self._read)
            findings += scales.against_bench([*held[0], *held[1]], self._read, self._known(held[0]))
        notes = list(dict.fromkeys(n for group in (*held, self._read) for t in group for n in t.notes))
        return [f.text for f in findings if not f.refuses] + notes, [f.text for f in findings if f.refuses]

    def _compared_with_population(self, groups: Sequence[Sequence[Table]]) -> str:
        """Prepare a diagnosis without reference trials; return a sentence if the trials are of no bench, else ""."""
        every = [self._locked(t) for t in (*groups[0], *groups[1])]
        if not can_be_of_bench(every):
            return NO_REFERENCE.format(every[0].source)
        self._reversed = oriented(every[:1])[1] < 0
        self._bench = EvidenceFinder([], self.session_sd, calibration=self._known(groups[0]),
                                    own_effects=self.own_effects)
        return ""

    def _usable(self, given: Table) -> Table:
        """Return a table without the signals that hold no information; a bench's knee may be locked."""
        walked = any("gait_percent" in t for t in (given, *self._read))
        return integrity.usable(given, MOTION if walked else ())

    def _locked(self, given: Table) -> Table:
        """Return a trial with a locked knee if no reference trial has the knee's angle; without these, if no gait."""
        moves = "gait_percent" in given if not self._healthy else any("knee_angle_rad" in t for t in self._healthy)
        return given if moves else table.with_locked_knee(given)

    def _simulable(self, given: Table) -> Table:
        """Return a trial prepared for the bench's model: locked knee detected, rope's sign as in the reference."""
        return turned(self._locked(given)) if self._reversed else self._locked(given)

    def _core(self, trials: Sequence[Table]) -> EvidenceFinder:
        """Return the diagnosis of these trials: of the bench if the reference trials are of it, as `fit` decides.

        Else of a rig with the columns that all of them have.
        """
        bench, every = self._bench, [*trials, *self._healthy]
        assert bench is not None
        if not self._healthy or any("gait_percent" in t for t in trials) or is_of_bench(
                self._read, lambda: bench.lacking(()) or bench.unlike(())):
            return bench
        columns = frozenset.intersection(*(frozenset(t.columns) for t in every))
        if columns not in self._rigs:
            self._rigs[columns] = EvidenceFinder(self._healthy, self.session_sd, rig_model_of(self._healthy, trials))
        return self._rigs[columns]

    def _model(self, core: EvidenceFinder, trials: Sequence[Table]) -> BenchModel | None:
        """Return the bench as identified from its reference trials, else from its calibration; None for a rig."""
        if core is not self._bench:
            return None
        if self._healthy:
            return simulation_fit.bench_model_of(core.reference(trials))
        known = self._known(trials)
        return None if known is None else bench_model.from_tables(known, "calibration")


def _clock(trials: Sequence[Table], healthy: Sequence[Table], found: Findings, tolerance: float = 0.2) -> str:
    """Return a sentence if a wrong clock in `time_s` explains a changed inertia of a rig; else "".

    If the clock runs k times too fast, accelerations appear k² times too small, and the inertia k² times too large,
    within `tolerance`, relative; a ratio k closer to 1 than that is no wrong clock.  The inertia is that of the
    reported force, which the drive's gain divides.
    """
    shifts = (found.evidence or {}).get("shifts", {})
    told, gain = shifts.get("inertia"), shifts.get("demand_gain", {"from": 1.0, "to": 1.0})
    if told is None or told["from"] <= 0.0:
        return ""
    paces = [float(np.median(np.concatenate([np.diff(t["time_s"]) for t in group]))) for group in (trials, healthy)]
    factor, change = paces[0] / paces[1], told["to"] / told["from"] * gain["from"] / gain["to"]
    if abs(factor - 1.0) < tolerance or abs(change / factor**2 - 1.0) > tolerance:
        return ""
    return (f"{', '.join(t.source for t in trials)}: time_s advances {factor:.3g} times as far a row as in the "
            f"reference trials, and the inertia would be {change:.3g} times as large, which is what a clock off by "
            f"{factor:.3g} does: divide time_s by {factor:.3g}, or record at their rate.")


def _undecided(trials: Sequence[Table], found: Findings) -> str | None:
    """Return a sentence on an experiment, recorded with a gait, that did not make the ambiguity set single.

    None if the verdict is not ambiguous, or if the trials are only gaits or only experiments.
    """
    run = [t for t in trials if "gait_percent" not in t]
    if found.verdict != "ambiguous" or len(run) in (0, len(trials)):
        return None
    names = ", ".join(sorted({t.experiment for t in run if t.experiment})) or "the experiment"
    return (f"{names} did not decide between {', '.join(found.rivals)}: it does not separate them beyond the model's "
            "error.")


def diagnose(
    trials: Sequence[Given], calibration: str | Path | Mapping[str, Any] | None = None, healthy: Sequence[Given] = (),
    holdout: Sequence[Given] = (), lowpass: float | None = None,
) -> Findings:
    """Diagnose `trials` once, against the reference trials `healthy`; the arguments are those of `Finder`."""
    return Finder(calibration, lowpass).examine(healthy).diagnose(trials, holdout)


def _short(trials: Sequence[Table], least: int = 3) -> str:
    """Return a sentence if the trials have fewer than the `least` cycles for a cross-validation, else ""."""
    cycles = sum(np.unique(cycles_of(t)).size for t in trials)
    if cycles >= least:
        return ""
    seconds = sum(float(np.ptp(t["time_s"])) for t in trials if "cycle" not in t)
    length, unit = (f"{seconds:.2g} s", " s") if seconds else (f"{cycles} cycle{'' if cycles == 1 else 's'}", "")
    return (f"{', '.join(t.source for t in trials)}: {length}; expected at least {least}{unit}, so that some stay "
            "unseen.")


def _of_wire(carried: WireFindings, warnings: list[str]) -> Findings:
    """Return the findings of a faulty bus or converter.

    The bench itself is then not diagnosed, since its values arrive late, incomplete or coarse.
    """
    names = [t.effect.name for t in carried.faults]
    return Findings("found" if len(names) == 1 else "ambiguous", carried.causes(), names,
                    carried.faults[0].effect.experiment if len(names) > 1 else None, carried.figures,
                    [*warnings, "wire and converter come first: the bench itself was not searched."])


def _read(given: str | Path | Table) -> Table:
    return windows.bounded(given) if isinstance(given, Table) else windows.read(given)


def _filtered(given: Table, lowpass: float | None) -> Table:
    return given if lowpass is None else table.low_passed(given, lowpass)


def _calibration(given: str | Path | Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    if not isinstance(given, str | Path):
        return given
    tables = read_toml(Path(given))
    bench_model.from_tables(tables, str(given))
    return tables
