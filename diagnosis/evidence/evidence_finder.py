"""Steps of a diagnosis by evidence, from trials to findings: reference fit, search, decision, held-out errors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from diagnosis.compared_signals import Figures
from diagnosis.evidence import decision
from diagnosis.evidence.decision import DOUBTED, NAMED_NATS, Decision
from diagnosis.evidence.detection_limits import detection_limits
from diagnosis.evidence.held_out import HeldOut, blocks_of, held_out, rest
from diagnosis.evidence.hypothesis_search import TrialModes
from diagnosis.evidence.identical_motion import search_trial
from diagnosis.evidence.session_change import under
from diagnosis.findings import Findings
from estimation.data.table import Table
from estimation.forward_model import ForwardModel, predicted
from estimation.joint_fit import fit_reference
from estimation.likelihood_data import Recording
from estimation.own_effects_model import with_own_effects
from estimation.path_model import PATH_MODEL
from estimation.population_reference import reference_of_population
from estimation.posterior import SURROGATE, PosteriorMode, SessionData, begun, mode, named_change
from estimation.reference_fit import ReferenceFit
from parameters import InputError
from physics.effects.catalogue import CATALOGUE
from physics.effects.hypotheses import FRICTION, Read, Variant
from physics.effects.separating_experiments import EXPERIMENTS

NO_REFERENCE: Final = (
    "{}: is not of a rope over a knee, and a rig of another kind has no population to compare it with: name trials of "
    "this rig in the reference condition with --healthy, or identify it with bowden fit.")


class EvidenceFinder:
    """Diagnosis of one bench by evidence; the reference trials are fitted once for each set of outputs."""

    def __init__(self, reference: Sequence[Table], session_sd: Mapping[str, float] | None = None,
                 model: ForwardModel = PATH_MODEL, calibration: Mapping[str, Any] | None = None,
                 own_effects: Sequence[str] = ()) -> None:
        """Store the reference trials.  Without one, bench population and `calibration` are the reference condition.

        `session_sd`: 1σ between sessions by constant, in coordinates (None: the published one).  `own_effects`: names
        of a user's effects that compete beside those of the catalogue.
        """
        self.model = with_own_effects(model, own_effects)
        self._tables, self._calibration = reference, calibration
        self._session_sd = session_sd
        self._fits: dict[tuple[str, ...], ReferenceFit] = {}

    def lacking(self, trials: Sequence[Table]) -> str:
        """Return a sentence on the columns without which the force path cannot be simulated; "" if none is missing."""
        for given in [*trials, *self._tables]:
            missing = self.model.lacking(given)
            if missing:
                each = "it" if len(missing) == 1 else "them"
                return (f"{given.source}: has no column {', '.join(missing)}; the simulation of this rig needs {each}. "
                        f"Record {each}, in trials and reference trials alike.")
        return ""

    def unlike(self, trials: Sequence[Table]) -> str:
        """Return a sentence if the reference trials do not fit the model, so that they are of another rig; else ""."""
        if not self._tables and "gait_percent" in trials[0]:
            return ""
        try:
            fit = self.reference(trials)
        except (ZeroDivisionError, np.linalg.LinAlgError):  # no rope has such constants
            return NO_REFERENCE.format(trials[0].source) if not self._tables else (
                f"{self._tables[0].source}: the reference trials do not fit: no constants of the model predict them.")
        if not self._tables:
            return self._foreign(fit, trials[0])
        return fit.unlike(self.model.record(self._tables[0]), self._tables[0].source)

    def _foreign(self, fit: ReferenceFit, given: Table) -> str:
        """Return a sentence if a trial does not fit the model of the bench at the origin of `fit`; else ""."""
        trial, first = self.recording(given, fit.outputs), fit.outputs.index(self.model.judged[0])
        left = trial.part(trial.data - predicted(self.model, fit.origin, trial), first)
        if np.std(left) <= self.model.unlike_share * np.std(given[self.model.judged[0]]):
            return ""
        return NO_REFERENCE.format(given.source)

    def diagnose(self, trials: Sequence[Table], holdout: Sequence[Table] = (), warnings: Sequence[str] = ()
                 ) -> Findings:
        """Return which effects of the catalogue, if any, changed the bench from the reference trials to `trials`.

        `trials`: of one session.  If the reference trials are gaits and `trials` has gaits and experiments, the
        experiments only reduce the ambiguity set of the gaits.  `holdout`: trials to which nothing is fitted.
        `warnings`: sentences on the files, which precede the findings' own.  Raises `InputError` if the force path
        cannot be simulated.
        """
        refused = self.lacking([*trials, *holdout])
        if refused:
            raise InputError(refused)
        outputs = self._outputs([*trials, *holdout])
        reference = self.reference([*trials, *holdout])
        trials, others = self._by_motion(trials)
        read = [self.recording(t, outputs) for t in trials]
        observed = reference.observe(*read)
        unlike = self.unlike_motion(trials)
        found, pair = search_trial(reference, [self.recording(t, outputs) for t in self._tables], observed, not unlike)
        observed = found.observed
        decided = self._decided(found)
        bench = self.model.constants.named(found.reference.bench_coordinates())
        said = list(warnings)
        while beyond := _beyond(found, decided, bench):
            name, sentence = beyond
            said.append(sentence)
            found.refused.add(name)
            decided = self._decided(found)
        if pair is not None:
            said.append(f"{Path(self._tables[pair.reference].source).name} has the motion of the trial: only their "
                        "difference was compared, since what the model misses repeats.")
        if others and len(decided.chosen) == 1 < len(decided.among):
            split = _split(found, decided, reference, read, [self.recording(t, outputs) for t in others])
            if split is None:
                said.append(f"{', '.join(t.source for t in others)}: no constants near those of the gaits predict it, "
                            "so it removes no effect; record it in the reference condition, too.")
            decided = split or decided
        figures = _held_out(found, decided, reference, trials, read)
        if unlike and pair is None:
            said.append(unlike)
            decided = replace(decided, lacking=(), verdict="none")
        elif refused := _refused(found, decided):
            said.append(refused)
            decided = self._known(decision.unnamed(found))
            figures = replace(figures, named=None)
        if pair is not None and decided.chosen and len(self._tables) == 1:
            said.append(f"{Path(self._tables[0].source).name} alone does not show how far sessions differ: a second "
                        "trial in the reference condition shows whether they differ so without a change.")
        said += [*figures.at_rest(), *_unseen(found, decided)]
        said += self._untold(outputs)
        at = _mode_of(found, decided)
        kept = None
        if holdout:
            unseen = reference.observe(*(self.recording(t, outputs) for t in holdout))
            kept = HeldOut(unseen, reference.missed(unseen), rest(unseen, found.null),
                           rest(unseen, at) if decided.chosen else None, blocks_of(holdout, unseen.trials))
        relations = figures.figures(reference, kept)
        said += _worse(relations)
        gain = figures.gain()
        error = {"reference": reference.rmse_n, "before": figures.rms_n("reference"),
                 "session": figures.rms_n("session"), "after": figures.rms_n("session" if gain is None else "named")}
        evidence = {"log_bayes_factors": decided.gains, "named_nats": decision.threshold(self.model),
                    "misfit": decided.misfit, "error_n": error,
                    "shifts": _shifts(at, reference, found)}
        variants = decision.chosen_variants(found, decided.chosen)
        causes = [self._cause(name, at, bench, gain.percent if gain is not None else 0.0)
                  | {"at_peak_n": _at_peak(found, at, variant), "probability": _probability(found, decided, name)}
                  for name, variant in zip(decided.chosen, variants, strict=True)]
        if len(causes) > 1 and _unchanged(causes[1]):
            causes, decided = causes[:1], decision.of_best(decided)
        experiment = _experiment(decided.among) if decided.verdict == "ambiguous" else None
        return Findings(
            decided.verdict, causes, list(decided.among),
            experiment, relations, said, _limits(found, bench), reference=self.kind,
            simulation={"before_rms_n": error["before"], "session_rms_n": error["session"],
                        "after_rms_n": None if gain is None else error["after"],
                        "session_sigma": max(abs(shift) for _, shift in named_change(found.null, found.prior).values()),
                        "healthy_rms_n": reference.rmse_n if self._tables else None,
                        "gain_percent": None if gain is None else gain.percent,
                        "gain_interval": None if gain is None else [gain.low, gain.high],
                        "signals": figures.judged, "on": "cycles that no fit has seen"},
            part=decided.part, evidence=evidence, unexplained=_unexplained(decided, relations),
            variants=tuple(decision.chosen_variants(found, decided.chosen)),
            alternatives=[self._cause(name, found.single[name], bench, 0.0)
                          for name in decided.among or [n for n, nats in decided.gains.items() if nats > 0.0]
                          if name not in decided.chosen and name in found.single],
            traces=figures.traces(trials), held_traces=kept.traces(holdout) if kept is not None else {})

    def observed(self, trials: Sequence[Table]
                 ) -> tuple[ReferenceFit, SessionData, Sequence[Table], Sequence[Recording]]:
        """Return the reference condition, the data of trials of one session under it, the trials, and its own trials.

        If all reference trials are gaits and some of the trials are, the experiments are left out.
        """
        trials = self._by_motion(trials)[0]
        reference, outputs = self.reference(trials), self._outputs(trials)
        read, known = ([self.recording(t, outputs) for t in some] for some in (trials, self._tables))
        return reference, reference.observe(*read), trials, known

    @property
    def kind(self) -> str:
        """Return the kind of the reference condition: healthy (reference trials), calibration or nominal."""
        return "healthy" if self._tables else "nominal" if self._calibration is None else "calibration"

    def _by_motion(self, trials: Sequence[Table]) -> tuple[Sequence[Table], Sequence[Table]]:
        """Return the gaits among the trials, and apart from them the experiments, if all reference trials are gaits.

        Otherwise all trials are in the first part.
        """
        if not self._of_gaits():
            return trials, ()
        walked = [t for t in trials if "gait_percent" in t]
        return (walked, [t for t in trials if "gait_percent" not in t]) if walked else (trials, ())

    def _of_gaits(self) -> bool:
        """Return whether there are reference trials and all of them are gaits."""
        return bool(self._tables) and all("gait_percent" in t for t in self._tables)

    def unlike_motion(self, trials: Sequence[Table]) -> str:
        """Return a sentence if all reference trials are gaits and no trial is one; else "".

        Gaits do not show the model's error in another motion, so that a name could be that error's (decision 67).
        """
        if not self._of_gaits() or any("gait_percent" in t for t in trials):
            return ""
        return (f"{Path(trials[0].source).name} has no gait_percent, and all reference trials have: what the "
                "model misses in this motion is unknown. Give a gait of the same session beside it, or this experiment "
                "in the reference condition (--healthy).")

    def reference(self, trials: Sequence[Table]) -> ReferenceFit:
        """Return the reference condition, with the outputs that all reference trials and `trials` have.

        The fit of the reference trials is cached.  Without reference trials it is the bench population's.
        """
        outputs = self._outputs(trials)
        key = outputs if self._tables else (*outputs, *(t.digest for t in trials))
        if key not in self._fits:
            read = [self.recording(t, outputs) for t in self._tables or trials]
            self._fits[key] = fit_reference(self.model, self.model.sessions(read), self._session_sd) if self._tables \
                else reference_of_population(self.model, read, self._calibration)
        return self._fits[key]

    def _decided(self, found: TrialModes) -> Decision:
        """Return the verdict; never `unexplained` without reference trials, since the bench's model error is unknown.
        """
        return self._known(decision.decide(found))

    def _known(self, decided: Decision) -> Decision:
        """Return a decision without a lack of fit if no reference trial shows the model's error, else as it is."""
        if self._tables:
            return decided
        return replace(decided, lacking=(), verdict="none" if decided.verdict == "unexplained" else decided.verdict)

    def _outputs(self, trials: Sequence[Table]) -> tuple[str, ...]:
        """Return the outputs that the trials and the reference trials all have."""
        return tuple(n for n in self.model.signals if all(n in t for t in [*trials, *self._tables]))

    def recording(self, given: Table, outputs: Sequence[str]) -> Recording:
        """Return a trial as a recording that has no other outputs than `outputs`."""
        kept = {n: v for n, v in given.columns.items() if n not in self.model.signals or n in outputs}
        made: Recording = self.model.record(replace(given, columns=kept))
        return made

    def _untold(self, outputs: Sequence[str]) -> list[str]:
        """Return a sentence per missing output on the effects that this column would make observable.

        Without reference trials, one more sentence is about what they would add.
        """
        effects = self.model.hypotheses
        said = [] if self._tables else [
            "No reference trial: compared with the population of like benches"
            + ("" if self._calibration is None else " and this bench's calibration")
            + ". Trials of this bench in the reference condition (--healthy) would show smaller changes, and changes "
            "that no effect explains."]
        friction = [name for name, h in effects.items() if h.part == FRICTION]
        return said + [f"With {column} recorded these could be told, or better: "
                       + ", ".join([name for name, h in effects.items() if column in h.needs]
                                   + (friction if column == "tension_end_n" else [])) + "."
                       for column in self.model.signals if column not in outputs]

    def _cause(self, name: str, at: PosteriorMode, bench: Mapping[str, float], gain: float) -> dict[str, Any]:
        """Return an effect as published: site, parameters with 95 % intervals, values before, and gain in percent."""
        told, before = {}, {}
        for parameter, read in self.model.hypotheses[name].reads.items():
            value = read(at.table.named(at.q), bench)
            was = read(bench, bench)
            half = _half(at, read, bench)
            low, high, unit = self.model.limits(name, parameter)
            told[parameter] = {"value": min(max(value, low), high), "low": min(max(value - half, low), high),
                               "high": max(min(value + half, high), low), "unit": unit}
            before[parameter] = was
        return {"effect": name, "site": CATALOGUE[name].site, "parameters": told, "was": before, "gain_percent": gain}


def _unchanged(cause: Mapping[str, Any]) -> bool:
    """Return whether an effect's parameters are what they were: its direction only bends that of another effect."""
    return all(p["low"] <= cause["was"][name] <= p["high"] for name, p in cause["parameters"].items())


def _probability(found: TrialModes, decided: Decision, name: str) -> float:
    """Return the probability of a chosen effect; of a second one beside the first."""
    least = decision.threshold(found.observed.model)
    if name == decided.chosen[0]:
        return decision.probabilities(decided.gains, least)[name]
    return decision.probabilities(found.further(decided.chosen[0]), DOUBTED * least)[name]


def _at_peak(found: TrialModes, at: PosteriorMode, variant: Variant) -> dict[str, float]:
    """Return the change of END and START by an effect, N, where the first trial's START is highest; {} for a rig."""
    observed, model, without = found.observed, found.observed.model, at.q.copy()
    if model.pools_sessions:
        return {}
    reference = found.prior.origin.copy()
    reference[list(at.table.free)] += found.prior.mean[:len(at.table.free)]
    rows = [at.table.index[name] for direction in variant.directions for name in direction.along]
    without[rows] = reference[rows]
    changed = observed.predicted(at.q) - observed.predicted(without)
    trial, first = next(observed.each(changed))
    peak = int(np.argmax(trial.binned(trial.measured(model.judged[0]))))
    return {name: float(error[peak]) for name, error in model.errors(trial, first).items() if name in model.judged}


def _refused(found: TrialModes, decided: Decision) -> str:
    """Return a sentence if the best effect is not named after all; else "".

    With a lack of fit of the best model, the evidence must reach `DOUBTED` times the threshold, and no misfit may
    exceed `DOUBTED` times that of a lack of fit.  No gain on held-out cycles is required: far outside their scatter,
    constants of the session predict an effect as well as the effect itself.
    """
    if not decided.chosen:
        return ""
    name = decided.chosen[0]
    left = max((decided.misfit[key] for key in decided.lacking if key != "session"), default=0.0)
    if decided.lacking and (left > DOUBTED * decision.MISFIT
                            or decided.gains[name] < DOUBTED * decision.threshold(found.observed.model)):
        return (f"{name} explains the trial best ({decided.gains[name]:.0f} nats), but not what it departs by (misfit "
                f"{left:.2g}): it is not named.")
    return ""


def _unexplained(decided: Decision, relations: Mapping[str, Figures]) -> dict[str, dict[str, Any]]:
    """Return the outputs in which the best model has a lack of fit, with its size, RMS error and reference RMSE.

    A lack of fit by constants alone (`session`) stands under the output with the largest error over its reference RMSE.
    """
    def row(name: str) -> dict[str, Any]:
        f = relations[name]
        return {"misfit": decided.misfit[name], "rms": f.rmse_after if f.rmse_after is not None else f.rmse_session,
                "floor": f.floor}
    names = [name for name in decided.lacking if name in relations]
    if decided.lacking and not names:
        names = [max(relations, key=lambda n: (relations[n].rmse_before or 0.0) / (relations[n].floor or 1.0))]
    return {name: row(name) for name in names}


def _unseen(found: TrialModes, decided: Decision, least: float = 0.1) -> list[str]:
    """Return a sentence if nothing is named and the motion exceeds the reference trials' by the share `least` or more.
    """
    beyond = found.observed.beyond
    if decided.chosen or beyond < least:
        return []
    what = "Speed or acceleration" if found.observed.model.pools_sessions else "Knee motion or tension"
    return [f"{what} exceeds the range of the reference trials by {100.0 * beyond:.0f} %: only large changes can be "
            "told. Record a reference trial (--healthy) with the motion and peak of the trial."]


def _experiment(names: Sequence[str]) -> str:
    """Return the catalogue's experiment of the best effect of a set whose experiment the bench runs by itself.

    If every effect of the set needs an experiment by hand, it is that of the best one.
    """
    wanted = [CATALOGUE[name].experiment for name in names]
    return next((name for name in wanted if not EXPERIMENTS[name].by_hand), wanted[0])


def _worse(relations: Mapping[str, Figures]) -> list[str]:
    """Return a sentence on each output whose error on held-out trials rises with the effects found."""
    return [f"{name}: with what was found the trials held out are predicted worse, {f.holdout_session:.3g} → "
            f"{f.holdout_after:.3g} {f.unit} RMS; it holds for these trials alone: do not extend the simulation by it."
            for name, f in relations.items() if f.holdout_session is not None and f.holdout_after is not None
            and f.holdout_after > f.holdout_session]


def _split(found: TrialModes, decided: Decision, reference: ReferenceFit, read: Sequence[Recording],
           others: Sequence[Recording]) -> Decision | None:
    """Return the decision with the ambiguity set reduced by the experiments `others`, the best effect first.

    No reference trial has the motion of an experiment, so the model error there is estimated from the residual of the
    best effect of the set.  An effect is removed if the evidence of another one is `NAMED_NATS` higher or more.  If
    even the best effect needs constants far outside the session scatter (`DOUBTED`), None: the set stays as it is.
    So it does if another effect is best with that model error.
    """
    observed = reference.observe(*read, *others)
    modes = _refitted(found, {name: found.single[name] for name in decided.among}, observed)
    best = max(modes.values(), key=lambda at: at.log_evidence)
    squares = best.residual**2 * observed.weight
    weight = observed.weight.copy()
    known = sum(trial.data.size for trial in read)
    scaled = [rows / max(1.0, float(np.mean(squares_of))) for (_, rows), (_, squares_of) in zip(
        observed.each(weight), observed.each(squares), strict=True)]
    weight[known:] = np.concatenate(scaled)[known:]
    observed = replace(observed, weight=weight)
    first = max(modes, key=lambda name: modes[name].log_evidence)
    modes = _refitted(found, modes, observed)
    best = max(modes.values(), key=lambda at: at.log_evidence)
    # σ² is what the first effect leaves; if another one is best with it, the model error there is not known
    if best.cost > DOUBTED * observed.count or modes[first] is not best:
        return None
    kept = tuple(sorted((name for name, at in modes.items() if at.log_evidence > best.log_evidence - NAMED_NATS),
                        key=lambda name: -modes[name].log_evidence))
    return replace(decided, verdict="found" if len(kept) == 1 else "ambiguous", chosen=kept[:1], among=kept,
                   part=found.observed.model.hypotheses[kept[0]].part)


def _refitted(
    found: TrialModes, starts: Mapping[str, PosteriorMode], observed: SessionData,
) -> dict[str, PosteriorMode]:
    """Return the mode of each effect, fitted from its start and from the best effect's mode."""
    def fitted(name: str, base: PosteriorMode) -> PosteriorMode:
        return mode(observed, found.prior, [found.variants[name]], begun(base, found.variants[name]))

    modes = {name: fitted(name, at) for name, at in starts.items()}
    best = max(modes.values(), key=lambda at: at.log_evidence)
    return {name: at if at is best else max(at, fitted(name, best), key=lambda m: m.log_evidence)
            for name, at in modes.items()}


def _mode_of(found: TrialModes, decided: Decision) -> PosteriorMode:
    if not decided.chosen:
        return found.null
    if len(decided.chosen) == 1:
        return found.single[decided.chosen[0]]
    return found.pair[(decided.chosen[0], decided.chosen[1])]


def _half(at: PosteriorMode, read: Read, bench: Mapping[str, float]) -> float:
    """Return half the width of a parameter's 95 % interval, from its posterior and the model error (`SURROGATE`)."""
    change = read(at.table.named(at.q), bench) - read(bench, bench)
    return 1.96 * float(np.hypot(_sd(at, lambda v: read(v, bench)), SURROGATE * abs(change)))


def _beyond(found: TrialModes, decided: Decision, bench: Mapping[str, float]) -> tuple[str, str] | None:
    """Return the first chosen effect whose main parameter, its first one, is 1σ outside the bounds, and a sentence."""
    model, at = found.observed.model, _mode_of(found, decided)
    constants = model.constants.named(at.q)
    for name in decided.chosen:
        parameter, read = next(iter(model.hypotheses[name].reads.items()))
        low, high, unit = model.limits(name, parameter)
        value = read(constants, bench)
        sd = _half(at, read, bench) / 1.96
        if value + sd < low or value - sd > high:
            return name, (f"{name} would explain the trial with {parameter} = {value:.3g} {unit}".rstrip()
                          + f", which is outside {low:g} … {high:g}: it is not named.")
    return None


def _held_out(found: TrialModes, decided: Decision, reference: ReferenceFit, tables: Sequence[Table],
              read: Sequence[Recording]) -> HeldOut:
    return held_out(found.observed, found.prior, reference, decision.chosen_variants(found, decided.chosen),
                    (found.null, _mode_of(found, decided)), blocks_of(tables, read))


def _limits(found: TrialModes, bench: Mapping[str, float]) -> dict[str, Mapping[str, Any]]:
    """Return the detection limit of each effect in these trials as published."""
    # as in the log Bayes factors: the null of a trial with a large effect departs by that effect
    scale = found.overdispersion(found.null, *(found.single[name] for name in found.gains()))
    best, nats = next(iter(found.gains().items()), ("", 0.0))
    at, variants = (found.single[best], [found.variants[best]]) if nats > 0.0 else (found.null, [])
    scatters = [(weight + under(at, prior, variants).log_evidence, under(found.null, prior, ()))
                for weight, prior in found.session_priors]
    return {name: {"parameter": limit.parameter, "value": limit.value, "unit": limit.unit}
            for name, limit in detection_limits(found.observed, found.null, bench, scale, scatters).items()}


def _sd(at: PosteriorMode, read: Any) -> float:
    """Return 1σ of the function `read` of the constants at a mode, by the delta method."""
    gradient = np.zeros(at.x.size)
    base = read(at.table.named(at.q))
    for k, i in enumerate(at.active):
        q = at.q.copy()
        step = 1e-3 * (at.table.rows[i].session_sd or at.table.rows[i].step)
        q[i] += step
        gradient[k] = (read(at.table.named(q)) - base) / step
    return at.sd(gradient)


def _shifts(at: PosteriorMode, reference: ReferenceFit, found: TrialModes) -> dict[str, dict[str, Any]]:
    """Return the value of each active constant on the bench and in the trial, with the trial's 95 % interval.

    `sessions`: change relative to its 1σ between sessions, with the uncertainty of the bench; None for a constant that
    the reference condition does not have.
    """
    change = named_change(at, found.prior)
    bench, trial = at.table.values(reference.bench_coordinates()), at.table.values(at.q)
    shifts: dict[str, dict[str, Any]] = {}
    for i in at.active:
        row = at.table.rows[i]
        half = 1.96 * _sd(at, lambda v, name=row.name: v[name])
        shifts[row.name] = {"from": float(bench[i]), "to": float(trial[i]), "low": float(trial[i]) - half,
                            "high": float(trial[i]) + half, "unit": row.unit,
                            "sessions": change[row.name][1] if row.name in change else None}
    return shifts
