"""Steps of a diagnosis from trials to verdict: integrity, reference condition, search, test on held-out cycles.

This module only connects the steps; each decision is made in the module of its step.  The same files always give the
same verdict.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from diagnosis import simulation_fit
from diagnosis.bench_fit import oriented, turned
from diagnosis.data import integrity, scales, table
from diagnosis.data.table import Table
from diagnosis.evidence.evidence_finder import EvidenceFinder, can_be_of_bench
from diagnosis.evidence.held_out import BLOCK_S
from diagnosis.evidence.likelihood_data import MOTION
from diagnosis.findings import Findings
from diagnosis.judgement import simulator_verdict as judgement
from diagnosis.judgement import wire_faults
from diagnosis.judgement.judge import Judge, of_experiment
from diagnosis.judgement.verdict import Figures
from diagnosis.judgement.wire_faults import WireFindings
from diagnosis.problem import candidates, problem, rig
from diagnosis.problem.healthy_trials import HealthyTrials
from parameters import InputError, read_toml
from physics import bench_model
from physics.bench_model import BenchModel
from physics.calibration import ScalarEvidence
from physics.relations.relation import RELATIONS

UNFIT: Final = 0.2
"""Largest RMSE of the reference trials, relative to the spread of the predicted signal; above it they are refused."""
Given = str | Path | Table
"""A trial: its file (MCAP or CSV), or its columns in memory."""


class Finder:
    """Diagnosis of one bench: `fit` reads its reference trials once, `diagnose` then diagnoses any number of trials.

    `calibration`: file or tables of the bench's calibration (None: the calibration attached to the trials, if any).
    `lowpass`: cut-off, Hz, of the zero-phase low-pass that every signal first passes.  `session_sd`: 1σ of each
    constant between sessions, from a logbook (None: the published one).

    With reference trials of the bench the effects compete by evidence (`diagnosis.evidence`).  Without reference
    trials, and on other rigs, effects compete by the error of the prediction equations.
    """

    def __init__(self, calibration: str | Path | Mapping[str, Any] | None = None, lowpass: float | None = None,
                 session_sd: Mapping[str, float] | None = None) -> None:
        self.calibration, self.lowpass, self.session_sd = _calibration(calibration), lowpass, session_sd
        self._evidence: EvidenceFinder | None = None
        self._locked = self._reversed = False
        self._read: list[Table] = []
        self._findings: list[integrity.Finding] = []
        self._plain: list[Table] = []
        self._healthy = HealthyTrials()

    def fit(self, healthy: Sequence[Given]) -> Finder:
        """Read, check and fit `healthy`, trials of the bench in the reference condition; returns itself.

        The fit covers the prediction equations that the columns of these trials allow.  A diagnosed trial with other
        columns causes one further fit per set of columns.  Raises `InputError` for unusable files.
        """
        self.examine(healthy)
        with threadpool_limits(1, user_api="blas"):
            if self._healthy and not any(f.refuses for f in self._findings):
                core, tables = self._by_evidence((), ()), self._healthy.tables
                if core is None:
                    problem.build_problem(tables, self._healthy, self._known(tables))
                elif not core.lacking(()):
                    core.reference(())
        return self

    def examine(self, healthy: Sequence[Given]) -> Finder:
        """Read and check the reference trials `healthy` and postpone their fit to the first diagnosis; returns itself.
        """
        self._read = [_read(t) for t in healthy]
        self._findings = [f for t in self._read for f in (*integrity.examine(t), *scales.contradictions(t))]
        self._plain = [] if any(f.refuses for f in self._findings) else [self._usable(t) for t in self._read]
        self._healthy = HealthyTrials([_filtered(t, self.lowpass) for t in self._plain])
        self._locked, self._reversed = all("knee_angle_rad" not in t for t in self._healthy), False
        simulable, sign = oriented([self._simulable(t) for t in self._healthy])
        self._reversed = sign < 0
        self._evidence = EvidenceFinder(simulable, self.session_sd) if simulable else None
        return self

    def diagnose(self, trials: Sequence[Given], holdout: Sequence[Given] = ()) -> Findings:
        """Return which effects explain the error of the simulation on `trials`; nothing is fitted on `holdout`.

        Contradictory data give the verdict `refused`.  Raises `InputError` for unusable files.
        """
        # with matrices of some hundred columns, waiting threads cost more time than they save
        with threadpool_limits(1, user_api="blas"):
            return replace(self._diagnosed(trials, holdout), lowpass_hz=self.lowpass)

    def _known(self, trials: Sequence[Table]) -> Mapping[str, Any] | None:
        return self.calibration if self.calibration is not None else trials[0].calibration

    def _diagnosed(self, trials: Sequence[Given], holdout: Sequence[Given]) -> Findings:
        if not trials:
            raise InputError("diagnose: no trial given; name at least one.")
        held = [[_read(t) for t in group] for group in (trials, holdout)]
        findings = [f for group in held for t in group for f in (*integrity.examine(t), *scales.contradictions(t))]
        findings += self._findings
        if not any(f.refuses for f in findings):
            findings += integrity.between(held[0], held[1], self._read)
            findings += scales.against_range([*held[0], *held[1]], self._read)
            findings += scales.against_bench([*held[0], *held[1]], self._read, self._known(held[0]))
        warnings = [f.text for f in findings if not f.refuses] + [n for g in (*held, self._read) for t in g
                                                                  for n in t.notes]
        refusals = [f.text for f in findings if f.refuses]
        if refusals:
            return Findings("refused", warnings=refusals + warnings)
        plain = [[self._usable(t) for t in group] for group in held]
        groups = [[_filtered(t, self.lowpass) for t in group] for group in plain]
        carried = wire_faults.examine(plain[0], self._plain)
        by_evidence = self._by_evidence(groups[0], groups[1])
        if by_evidence is None:
            return self._judged(groups[0], groups[1], carried, warnings)
        if carried.told:
            return replace(_of_wire(carried, warnings), part="wire", evidence={})
        groups = [[self._simulable(t) for t in group] for group in groups]
        short = _short(groups[0])
        if short:
            return Findings("refused", warnings=[short, *warnings])
        refused = by_evidence.lacking([*groups[0], *groups[1]]) or by_evidence.unlike(groups[0])
        if refused:
            return Findings("refused", warnings=[refused, *warnings])
        found = by_evidence.diagnose(groups[0], groups[1], warnings)
        undecided = _undecided(groups[0], found.verdict, found.rivals, [])
        again = undecided is not None and found.experiment in {t.experiment for t in groups[0]}
        return replace(found, bench=simulation_fit.bench_model_of(by_evidence.reference(groups[0])),
                       undecided=undecided, experiment=None if again else found.experiment)

    def _usable(self, given: Table) -> Table:
        """Return a table without the signals that hold no information; a bench's knee may be locked."""
        walked = any("gait_percent" in t for t in (given, *self._read))
        return integrity.usable(given, MOTION if walked else ())

    def _simulable(self, given: Table) -> Table:
        """Return a trial with a locked knee if no reference trial has the knee's angle, its rope counted as theirs."""
        locked = table.with_locked_knee(given) if self._locked else given
        return turned(locked) if self._reversed else locked

    def _by_evidence(self, trials: Sequence[Table], holdout: Sequence[Table]) -> EvidenceFinder | None:
        """Return the diagnosis by evidence if it applies to these trials, else None.

        It applies to gaits, and to other trials of the bench of the reference trials.
        """
        core, every = self._evidence, [*trials, *holdout]
        if core is None or any("gait_percent" in t for t in [*every, *self._healthy]):
            return core
        if not can_be_of_bench([*every, *self._healthy]) or core.lacking(every) or core.unlike(every):
            return None
        return core

    def _judged(self, trials: Sequence[Table], holdout: Sequence[Table], carried: WireFindings, warnings: list[str]
                ) -> Findings:
        healthy, known = self._healthy, self._known(trials)
        settled = problem.build_problem(trials, healthy, known)
        if settled.any_rig and healthy and settled.checked:
            settled = rig.against_healthy(trials, healthy.tables, lambda s: Judge(s, ()).found.best.fit)
        source = ", ".join(t.source for t in trials)
        if not settled.checked:
            lacks = "; ".join(f"{n} lacks {', '.join(c)}" for n, c in settled.missing.items() if c)
            return Findings("refused", warnings=[f"{source}: no relation can be checked ({lacks}).", *warnings])
        cycles = len(np.unique(np.concatenate([b.cycle for b in settled.blocks])))
        if cycles < integrity.LEAST_CYCLES:
            return Findings("refused", warnings=[
                f"{source}: {cycles} cycles; expected at least {integrity.LEAST_CYCLES}, so that some stay unseen.",
                *warnings])
        unfit = _unfit(settled)
        if unfit:
            named = ", ".join(h.source for h in healthy)
            return Findings("refused", warnings=[*(f"{named}: {t}" for t in unfit), *warnings])
        if carried.told and not settled.any_rig and not settled.elsewhere:
            return _of_wire(carried, warnings + _said(settled, bool(healthy)))
        judge, said = _judge(settled, trials, holdout, healthy, known)
        figures = judge.figures() | ({} if settled.any_rig else carried.figures)
        causes = judge.causes()
        if (wrong := _clock(trials, healthy.tables, causes, settled.reference.values)) is not None:
            return Findings("refused", warnings=[wrong, *warnings])
        session = judge.session()
        if all(t.turning for t in trials):
            figures, causes, session = _turned(figures, causes, session)
        undecided, proposed = _undecided(trials, judge.word(), judge.rivals(), said), judge.experiment()
        if undecided is not None and proposed in {t.experiment for t in trials}:
            proposed = None
        return Findings(judge.word(), causes, judge.rivals(), proposed, figures,
                        warnings + _said(settled, bool(healthy)) + said + judge.blind_rivals() + judge.on_bounds()
                        + _worse(figures),
                        judge.limits(),
                        reference=settled.reference.kind, found=judge.found, split=judge.within is not None,
                        simulation=judgement.judged(judge, trials, holdout, healthy), rate_hz=settled.rate_hz,
                        bench=_bench(settled, known), session=session, undecided=undecided)


CLOCK: Final = 0.2
"""Tolerance, relative, within which the change of an inertia equals the square of the ratio of the sampling periods.

Also the least deviation of that ratio from 1 that counts as a wrong clock."""


def _clock(trials: Sequence[Table], healthy: Sequence[Table], causes: Sequence[Mapping[str, Any]],
           reference: Mapping[str, float]) -> str | None:
    """Return a sentence if a wrong clock in `time_s` explains the changed inertia; None otherwise.

    If the clock runs k times too fast, accelerations appear k² times too small, and the inertia k² times too large.
    """
    told = next((c["parameters"]["drive_inertia"]["value"] for c in causes if c["effect"] == "drive_inertia"), 0.0)
    if not healthy or told <= 0.0 or reference["drive_inertia"] <= 0.0:
        return None
    paces = [float(np.median(np.concatenate([np.diff(t["time_s"]) for t in group]))) for group in (trials, healthy)]
    factor, change = paces[0] / paces[1], told / reference["drive_inertia"]
    if abs(factor - 1.0) < CLOCK or abs(change / factor**2 - 1.0) > CLOCK:
        return None
    return (f"{', '.join(t.source for t in trials)}: time_s advances {factor:.3g} times as far a row as in the healthy "
            f"trials, and the inertia would be {change:.3g} times as large, which is what a clock off by {factor:.3g} "
            f"does: divide time_s by {factor:.3g}, or record at their rate.")


def _worse(figures: Mapping[str, Figures]) -> list[str]:
    """Return a sentence on each prediction equation whose error on held-out trials rises with the effects found."""
    return [f"{name}: with what was found the trials held out are predicted worse, {f.holdout_before:.3g} → "
            f"{f.holdout_after:.3g} {f.unit} RMS; it holds for these trials alone: do not extend the simulation by it."
            for name, f in figures.items() if f.holdout_before is not None and f.holdout_after is not None
            and f.holdout_after > f.holdout_before]


def _undecided(trials: Sequence[Table], word: str, rivals: Sequence[str], said: Sequence[str]) -> str | None:
    """Return a sentence on an experiment, recorded with a gait, that did not make the ambiguity set single.

    None if the verdict is not ambiguous, or if the trials are only gaits or only experiments.
    """
    run = [t for t in trials if "gait_percent" not in t]
    if word != "ambiguous" or len(run) in (0, len(trials)):
        return None
    names = ", ".join(sorted({t.experiment for t in run if t.experiment})) or "the experiment"
    why = said[0].rstrip(".") if said else "each of them meets it as well as healthy trials are met"
    return f"{names} did not decide between {', '.join(rivals)}: {why}."


def _turned(figures: Mapping[str, Figures], causes: Sequence[Mapping[str, Any]], session: Mapping[str, Any] | None
            ) -> tuple[dict[str, Figures], list[dict[str, Any]], dict[str, Any] | None]:
    """Return figures, causes and session of a turning axis in units of rotation, such as N·m for N."""
    units = table.TURNED_UNITS
    return ({n: replace(f, unit=units.get(f.unit, f.unit)) if n in ("drive_force", "servo") else f
             for n, f in figures.items()},
            [{**c, "parameters": {n: {**p, "unit": units.get(p["unit"], p["unit"])}
                                  for n, p in c["parameters"].items()}} for c in causes],
            None if session is None else {**session, "shifts": [
                {**one, "unit": units.get(one["unit"], one["unit"])} for one in session["shifts"]]})


def _bench(settled: problem.ProblemSetting, known: Mapping[str, Any] | None) -> BenchModel | None:
    """Return the bench as identified from its reference trials, else from its calibration.

    None for another rig, and without either source.
    """
    if settled.any_rig or settled.elsewhere:
        return None
    if settled.learnt is None:
        return None if known is None else bench_model.from_tables(known, "calibration")
    values = {n: v for n, v in settled.learnt.reference.values.items() if n in settled.learnt.sigma}
    return BenchModel(values, {n: ScalarEvidence(v - 1.96 * settled.learnt.sigma[n], v + 1.96 * settled.learnt.sigma[n])
                               for n, v in values.items()})


def diagnose(
    trials: Sequence[Given], calibration: str | Path | Mapping[str, Any] | None = None, healthy: Sequence[Given] = (),
    holdout: Sequence[Given] = (), lowpass: float | None = None,
) -> Findings:
    """Diagnose `trials` once, against the reference trials `healthy`; the arguments are those of `Finder`."""
    return Finder(calibration, lowpass).examine(healthy).diagnose(trials, holdout)


def _short(trials: Sequence[Table]) -> str:
    """Return a sentence if the trials have too few cycles for a cross-validation, else ""."""
    cycles = int(sum(np.floor(float(t["time_s"][-1] - t["time_s"][0]) / BLOCK_S) if "cycle" not in t
                     else np.unique(t["cycle"][np.isfinite(t["cycle"])]).size for t in trials))
    if cycles >= integrity.LEAST_CYCLES:
        return ""
    return (f"{', '.join(t.source for t in trials)}: {cycles} cycles; expected at least {integrity.LEAST_CYCLES}, so "
            "that some stay unseen.")


def _judge(settled: problem.ProblemSetting, trials: Sequence[Table], holdout: Sequence[Table], healthy: HealthyTrials,
           known: Mapping[str, Any] | None) -> tuple[Judge, list[str]]:
    """Return the judgement of the trials, and sentences for the reader on experiments among them.

    The gaits determine the ambiguity set; experiments recorded with them can only reduce that set.  The reference
    trials are gaits, so the systematic model error in another motion is unknown.  A prediction equation that no effect
    of the set fits in the experiment is therefore left out there.
    """
    walked = [t for t in trials if "gait_percent" in t]
    if settled.floors is None or len(walked) in (0, len(trials)) or not all("gait_percent" in t for t in healthy):
        return Judge(settled, holdout), []
    first = Judge(problem.build_problem(walked, healthy, known), holdout)
    if len(first.rivals()) <= len(first.found.best.effects):
        return first, []
    split = Judge(settled, holdout, first)
    kept = split.holding()
    run, held = ({b.relation.name for b in there if of_experiment(b)} for there in (settled.blocks, kept))
    broken = sorted(run - held)
    said = [f"the experiment says nothing of {', '.join(broken)}: nothing of the class meets that there as healthy "
            "trials are met; record it healthy, too."] if broken else []
    if not split.told_by(kept):
        return first, said
    if broken:
        split = Judge(replace(settled, blocks=kept), holdout, first)
    return (split if split.found.best.effects else first), said


def _unfit(settled: problem.ProblemSetting) -> list[str]:
    """Return a sentence on each prediction equation that does not fit the reference trials within `UNFIT`."""
    if settled.learnt is None:
        return []
    told = []
    for name in ("friction", "elasticity", "kinematics"):
        left, spread = settled.learnt.misfit.get(name, 0.0), settled.learnt.spread.get(name, 0.0)
        if left > UNFIT * spread:
            told.append(f"the healthy trials do not fit: {name} leaves {left:.3g} of {spread:.3g} "
                        f"{RELATIONS[name].unit} ({100.0 * left / spread:.0f} %; expected below "
                        f"{100.0 * UNFIT:.0f} %); give healthy trials of this bench, recorded as these are, or none.")
    return told


def _of_wire(carried: WireFindings, warnings: list[str]) -> Findings:
    """Return the findings of a faulty bus or converter.

    The bench itself is then not diagnosed, since its values arrive late, incomplete or coarse.
    """
    names = [t.effect.name for t in carried.told]
    figures = {name: Figures(relation.unit, False) for name, relation in RELATIONS.items()} | carried.figures
    return Findings("found" if len(names) == 1 else "ambiguous", carried.causes(), names,
                    carried.told[0].effect.experiment if len(names) > 1 else None, figures,
                    [*warnings, "wire and converter come first: the bench's own relations were not searched."])


def _said(settled: problem.ProblemSetting, healthy: bool) -> list[str]:
    """Return sentences for the reader on the reference condition and on prediction equations that were not checked."""
    said = []
    if settled.any_rig:
        said.append("no calibration fits this rig: it is compared with an ideal transmission, rigid and without "
                    "friction; offsets, ratios and load-free friction are taken as found, and effects that need the "
                    "bench's geometry are not offered.")
    elif settled.elsewhere:
        said.append("no calibration fits this rig: it is compared with what its healthy trials are.")
    elif settled.reference.kind == "nominal":
        said.append("no calibration of this bench: compared with the nominal bench and the tolerances of like "
                    "benches; run bowden identify first, which measures what is this bench's own.")
    if settled.floors is None:
        said.append("no healthy trial of this bench: the answer `unexplained` is not available.")
    if settled.any_rig or settled.elsewhere:
        return said + _lacking(settled)
    untold = candidates.untold(settled.checked)
    if untold:
        lacking = sorted({c for lacks in settled.missing.values() for c in lacks})
        said.append(f"with {', '.join(lacking)} recorded these could be told, too: {', '.join(untold)}.")
    return said + [f"{n} not checked: no {', '.join(c)}." for n, c in settled.missing.items() if c]


def _lacking(settled: problem.ProblemSetting) -> list[str]:
    """Return sentences on the columns with which a rig of another kind would allow more prediction equations."""
    lacks = "; ".join(f"{n} ({', '.join(c)})" for n, c in settled.missing.items() if c)
    said = [f"not checked, for want of columns: {lacks}."] if lacks else []
    force = [b for b in settled.blocks if b.relation.name == "drive_force"]
    if force and not any(b.signals.has("tension_start_n") for b in force) and any(
            b.signals.has("knee_angle_rad") for b in force):
        said.append("servo_force_n carries the load, too, which no column says: record tension_start_n beside it.")
    return said


def _read(given: str | Path | Table) -> Table:
    return given if isinstance(given, Table) else table.read(given)


def _filtered(given: Table, lowpass: float | None) -> Table:
    return given if lowpass is None else table.low_passed(given, lowpass)


def _calibration(given: str | Path | Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    if not isinstance(given, str | Path):
        return given
    tables = read_toml(Path(given))
    bench_model.from_tables(tables, str(given))
    return tables
