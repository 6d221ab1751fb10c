"""From trials to findings by evidence: integrity, wire, reference fit, search, decision, figures on held-out cycles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from diagnosis.data import integrity, scales, table
from diagnosis.data.table import Table
from diagnosis.evidence import decision
from diagnosis.evidence.decision import Decision
from diagnosis.evidence.hypothesis_search import Searched, search
from diagnosis.evidence.likelihood_data import Recording, lacking
from diagnosis.evidence.outputs import predicted
from diagnosis.evidence.posterior import Observed, PosteriorMode, begun, mode, named_change
from diagnosis.evidence.reference_fit import ReferenceFit, fit_reference, tension_errors
from diagnosis.finder import Findings
from diagnosis.judgement import wire_faults
from parameters import InputError
from physics.effects.catalogue import CATALOGUE
from physics.effects.hypotheses import HYPOTHESES
from physics.laws import Array
from physics.path_constants import FREE, TABLE, named, values

Given = str | Path | Table
FOLDS: Final = 2
"""Parts of the cycles: each is predicted by a fit to the other."""
BLOCK_S: Final = 2.0
"""Length of a block where a trial has no cycle numbers, s: about one gait cycle."""
SURROGATE: Final = 0.1
"""1σ of a parameter by the difference between the bench's friction and stretch equations and the model's, of its
change: with it intervals cover 90 to 98 % on the development family."""
NEEDS_REFERENCE: Final = ("--core evidence needs reference trials of this bench; name at least one with --healthy, or "
                          "leave --core out.")


class EvidenceFinder:
    """Diagnoses trials of one bench by evidence: `fit` fits the reference trials once, `diagnose` asks of one trial."""

    def __init__(self, lowpass: float | None = None) -> None:
        self.lowpass = lowpass
        self._plain: list[Table] = []
        self._findings: list[integrity.Finding] = []
        self._references: dict[tuple[str, ...], ReferenceFit] = {}

    def fit(self, healthy: Sequence[Given]) -> EvidenceFinder:
        """Read reference trials of this bench; returns itself.

        The fit is made when a trial is diagnosed, once for each set of outputs.  Raises `InputError` for files that
        cannot be used, and without a trial.
        """
        read = [_read(t) for t in healthy]
        if not read:
            raise InputError(NEEDS_REFERENCE)
        self._findings = [f for t in read for f in (*integrity.examine(t), *scales.contradictions(t))]
        self._plain = [] if any(f.refuses for f in self._findings) else [integrity.usable(t) for t in read]
        for given in self._plain:
            _refuse_lacking(given)
        return self

    def diagnose(self, trial: Given) -> Findings:
        """Decide which effect of the catalogue, if any, one trial shows against the reference trials.

        Raises `InputError` for files that cannot be used; data that contradict themselves are `refused`.
        """
        given = _read(trial)
        findings = [*integrity.examine(given), *scales.contradictions(given), *self._findings]
        warnings = [f.text for f in findings if not f.refuses]
        refusals = [f.text for f in findings if f.refuses]
        if refusals:
            return Findings("refused", warnings=refusals + warnings)
        plain = integrity.usable(given)
        _refuse_lacking(plain)
        carried = wire_faults.examine([plain], self._plain)
        if carried.told:
            names = [t.effect.name for t in carried.told]
            return Findings("found" if len(names) == 1 else "ambiguous", carried.causes(), names, warnings=[
                *warnings, "Wire and converter come first: the force path was not searched."], part="wire", evidence={})
        # matrices of some hundred columns: threads that wait for each other cost more than they calculate
        with threadpool_limits(1, user_api="blas"):
            return self._searched(plain, warnings)

    def _reference(self, outputs: tuple[str, ...]) -> ReferenceFit:
        """Return the fit of the reference trials to the outputs that the trial has, too."""
        if outputs not in self._references:
            kept = [Recording(_only(t, outputs)) for t in self._plain]
            lacks = next((t for t in kept if t.outputs != outputs), None)
            if lacks is not None:
                missing = ", ".join(n for n in outputs if n not in lacks.outputs)
                raise InputError(f"{lacks.source}: has no column {missing}, which the trial has; record reference "
                                 "trials with the same columns, or leave it out of the trial.")
            self._references[outputs] = fit_reference(kept)
        return self._references[outputs]

    def _searched(self, given: Table, warnings: list[str]) -> Findings:
        trial = Recording(given if self.lowpass is None else table.low_passed(given, self.lowpass))
        reference = self._reference(trial.outputs)
        observed = reference.observe(trial)
        found = search(observed, reference.prior)
        decided = decision.decide(found)
        at = _mode_of(found, decided)
        error = _errors(found, decided, reference, _blocks(given, trial))
        bench = named(_bench(reference))
        causes = [_cause(name, at, bench, reference, error) for name in decided.chosen]
        named_at = decided.chosen[0] if decided.chosen else None
        experiment = CATALOGUE[named_at].experiment if named_at and decided.verdict == "ambiguous" else None
        if decided.chosen and error["after"] >= error["before"]:
            warnings = [*warnings, "The gain on held-out cycles is below what reference trials scatter: the name rests "
                        "on the likelihood alone."]
        evidence = {"log_bayes_factors": decided.gains, "misfit": decided.misfit, "error_n": error,
                    "shifts": _shifts(at, reference, found)}
        return Findings(decided.verdict, causes, list(decided.among), experiment, warnings=warnings,
                        lowpass_hz=self.lowpass, reference="healthy", part=decided.part, evidence=evidence)


def _read(given: Given) -> Table:
    return given if isinstance(given, Table) else table.read(given)


def _only(given: Table, outputs: Sequence[str]) -> Table:
    """Return a trial without the output columns that are not among `outputs`."""
    from dataclasses import replace

    from diagnosis.evidence.likelihood_data import SIGNALS

    left = {n: v for n, v in given.columns.items() if n not in SIGNALS or n in outputs}
    return replace(given, columns=left)


def _refuse_lacking(given: Table) -> None:
    missing = lacking(given)
    if missing:
        raise InputError(f"{given.source}: has no column {', '.join(missing)}; --core evidence simulates the force "
                         "path from rope and knee motion. Record it, or leave --core out.")


def _mode_of(found: Searched, decided: Decision) -> PosteriorMode:
    if not decided.chosen:
        return found.null
    if len(decided.chosen) == 1:
        return found.single[decided.chosen[0]]
    return found.pair[(decided.chosen[0], decided.chosen[1])]


def _bench(reference: ReferenceFit) -> Array:
    """Return the coordinates of the bench: the posterior mean of the reference fit."""
    q = reference.origin.copy()
    q[list(FREE)] += reference.bench.mean[:len(FREE)]
    return np.asarray(q)


def _blocks(given: Table, trial: Recording) -> NDArray[np.intp]:
    """Return the number of the cycle of each bin, from 0; of 2 s where the trial numbers none."""
    time = trial.binned(trial.time_s)
    if "cycle" not in given:
        return np.asarray(np.floor(time / BLOCK_S).astype(np.intp))
    own = np.interp(time + given["time_s"][0], given["time_s"], np.nan_to_num(given["cycle"]))
    return np.asarray(np.floor(own).astype(np.intp))


def _errors(found: Searched, decided: Decision, reference: ReferenceFit, blocks: NDArray[np.intp]
            ) -> dict[str, float]:
    """Return the RMS errors of START and END, N: of the reference trials, before and after on held-out cycles.

    Before: the model as each reference trial identified it, nothing fitted to the trial.  After: with the chosen
    effects, each half of the cycles predicted by a fit to the other half.
    """
    trial, observed = found.observed.trial, found.observed
    prior = found.prior
    before = reference.missed(trial, observed.features)
    after = before
    if decided.chosen:
        left = np.zeros_like(trial.data)
        parity = np.tile(blocks % FOLDS, len(trial.outputs))
        chosen = [found.variants[decided.chosen[0]]]
        if len(decided.chosen) == 2:
            chosen.append(_variant_of(found, decided.chosen[1]))
        base = _mode_of(found, decided)
        for fold in range(FOLDS):
            seen = Observed(trial, observed.features, np.where(parity == fold, 1e-9, observed.weight))
            at = mode(seen, prior, chosen, begun(base, None, kept=chosen))
            left = np.where(parity == fold, trial.data - predicted(at.q, trial)
                            - observed.features @ at.x[at.constants:], left)
        after = float(np.sqrt(np.mean(tension_errors(trial, left) ** 2)))
    return {"reference": reference.rmse_n, "before": before, "after": after}


def _variant_of(found: Searched, name: str) -> Any:
    """Return the variant of a second effect: the one with which its pair was fitted."""
    return found.paired[name]


def _cause(name: str, at: PosteriorMode, bench: Mapping[str, float], reference: ReferenceFit, error: Mapping[str, float]
           ) -> dict[str, Any]:
    """Return an effect as the published dictionary: its parameters with 95 % intervals, and its gain."""
    effect = CATALOGUE[name]
    bounds = {p.name: p for p in effect.parameters}
    told = {}
    for parameter, read in HYPOTHESES[name].reads.items():
        value = read(named(at.q), bench)
        half = 1.96 * float(np.hypot(_sd(at, lambda v, read=read: read(v, bench)),
                                     SURROGATE * abs(value - read(bench, bench))))
        p = bounds[parameter]
        told[parameter] = {"value": min(max(value, p.low), p.high), "low": max(value - half, p.low),
                           "high": min(value + half, p.high), "unit": p.unit}
    gain = 100.0 * (1.0 - error["after"] / error["before"]) if error["before"] > 0.0 else 0.0
    return {"effect": name, "site": effect.site, "parameters": told, "gain_percent": max(gain, 0.0)}


def _sd(at: PosteriorMode, read: Any) -> float:
    """Return 1σ of a function of the constants at a mode, by its gradient."""
    gradient = np.zeros(at.x.size)
    base = read(named(at.q))
    for k, i in enumerate(at.active):
        q = at.q.copy()
        step = 1e-3 * (TABLE[i].session_sd or TABLE[i].step)
        q[i] += step
        gradient[k] = (read(named(q)) - base) / step
    return at.sd(gradient)


def _shifts(at: PosteriorMode, reference: ReferenceFit, found: Searched) -> dict[str, dict[str, Any]]:
    """Return each constant's value on the bench and in the trial, with the trial's 95 % interval.

    `sessions`: the change over its 1σ between sessions, uncertainty of the bench included; None of what is new.
    """
    change = named_change(at, found.prior)
    bench, trial = values(_bench(reference)), values(at.q)
    shifts: dict[str, dict[str, Any]] = {}
    for i in at.active:
        row = TABLE[i]
        half = 1.96 * _sd(at, lambda v, name=row.name: v[name])
        shifts[row.name] = {"from": float(bench[i]), "to": float(trial[i]), "low": float(trial[i]) - half,
                            "high": float(trial[i]) + half, "unit": row.unit,
                            "sessions": change[row.name][1] if row.name in change else None}
    return shifts
