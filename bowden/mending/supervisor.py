"""Steps of an unattended repair, from reference trials to an extension that has gained in the loop.

    gait → diagnosis → repeat → diagnosis → (experiment → diagnosis)… → choice → trials A B A B … → kept or undone

A: the bench's calibration alone, B: with the extension.  One trial with each of the likeliest effects chooses the
extension that is proven, and its size.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from bowden.bench import buses
from bowden.bench.buses import BusSettings
from bowden.mending.journal import Journal
from bowden.mending.mended_bench import MendedBench, paired_interval, write_page
from bowden.mending.night_trials import EndedNightError, NightTrials, percent
from bowden.models.diagnosing import Diagnosis, DiagnosisResult
from bowden.models.experiment_plan import of_trials
from bowden.progress import SILENT, Progress
from bowden.trials import repeated_motion
from bowden.trials.experiment import Experiment
from bowden.trials.session import PreparedTrial
from parameters import InputError
from parameters.files import write_whole
from physics.bench_model import BenchModel
from physics.effects.catalogue import CATALOGUE, unchanged
from physics.effects.compensation import UNDONE
from trial.report.words import words

PAIRS: Final = 4
"""Pairs of trials without and with the extension: the fewest whose interval of a gain excludes 0 at 2 σ of scatter."""
EXPERIMENTS: Final = 2
"""Largest number of experiments that are run to decide between effects."""
CHOICES: Final = 3
"""Largest number of effects of an ambiguous answer, or not named, that are tried in the loop, one trial each."""
LIKELY_NATS: Final = 3.0
"""Log Bayes factor from which an effect that the diagnosis does not name is tried in the loop: odds of 20."""
MOST_SIZE: Final = 2.0
"""Largest factor, up or down, by which trials in the loop change the size that the diagnosis estimated.

Effects of the session's scatter take a part of an effect's response, so that its size is often off by a third; a size
off by more would be another effect's."""
JOURNAL, EXTENDED, PAGE = "journal.jsonl", "extended.toml", "mend.html"
REPEAT: Final = repeated_motion.NAME


def mend(reference: Sequence[str | Path], folder: str | Path, *, bus: BusSettings | None = None, hours: float = 1.0,
         cycles: int = 10, configuration: str | Path | None = None, bitrate: int | None = None, resume: bool = False,
         progress: Progress = SILENT) -> MendedBench:
    """Repair the model of a bench without anybody, within `hours` of bench time; returns the outcome.

    `reference`: trials of the bench in the reference condition, recorded by `bowden trial`; their peak force is the
    greatest that is asked for.  `folder`: where trials and journal go.  `configuration`: a bench.toml (None: the
    packaged bench).  `bitrate`: of the bus, bit/s, in place of the configuration's.  `resume`: go on with the journal
    in `folder`.  Every trial has all limits and the safe stop.  Raises `InputError` for unusable input.
    """
    paths, folder = [Path(path) for path in reference], Path(folder)
    asked = Experiment(configuration=configuration, cycles=cycles, bitrate=bitrate)
    bench = NightTrials(paths, folder, bus or buses.simulated(), hours, asked, progress)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); give a writable place.") from None
    journal = Journal(folder / JOURNAL, {
        "reference": [str(path.resolve()) for path in paths], "hours": hours, "cycles": cycles,
        **({} if configuration is None else {"configuration": str(configuration)})}, resume=resume)
    return _Run(paths, bench, journal).run()


class _Run:
    def __init__(self, reference: Sequence[Path], bench: NightTrials, journal: Journal) -> None:
        self.reference, self.bench, self.journal, self.folder = reference, bench, journal, bench.folder

    def run(self) -> MendedBench:
        """Run all steps, and write page and extension, however the run ends."""
        result = MendedBench("", self.folder)
        try:
            result = self._repaired()
        except EndedNightError as ended:
            result = replace(result, ending=str(ended))
        except KeyboardInterrupt:
            result = replace(result, ending="interrupted; go on with --resume")
        result = replace(result, steps=tuple(self.journal.lines))
        write_page(result, self.folder / PAGE)
        return result

    def _repaired(self) -> MendedBench:
        trials = [self._trial("gait", self.bench.gait)]
        finder = Diagnosis(self.bench.plain).fit(self.reference)
        found = self._diagnosed("diagnosis", finder, trials)
        tried: set[str] = set()
        if found.verdict in ("ambiguous", "unexplained"):
            found = self._repeated(finder, found)
        while found.verdict == "ambiguous" and len(tried) < EXPERIMENTS:
            name = self._proposed(trials, len(tried) + 1)
            if name is None or name in tried:
                break
            tried.add(name)
            trials.append(self._trial(name, replace(self.bench.gait, name=name, cycles=None)))
            again = self._diagnosed(f"diagnosis with {name}", finder, trials)
            if again.verdict == "refused":  # the experiment is unusable here; the gait's answer stands
                break
            found = again
        return self._mended(found)

    def _repeated(self, finder: Diagnosis, found: DiagnosisResult) -> DiagnosisResult:
        """Return the diagnosis of the reference trial's own motion, if it separates more than that of the gait.

        The diagnosis compares the two trials directly, so that the repeated one is diagnosed alone.
        """
        try:
            prepared = repeated_motion.prepared(self.bench.walked, self.bench.gait.sections(), self.bench.bus)
        except InputError as error:
            reason = f"not repeated: {error}"
            self.journal.step(REPEAT, lambda: {"experiment": reason})
            return found
        again = self._diagnosed(f"diagnosis of {REPEAT}", finder, [self._trial(REPEAT, prepared)])
        separates = again.causes and (not found.causes or len(again.rivals) < len(found.rivals))
        return again if separates else found

    def _proposed(self, trials: Sequence[Path], count: int) -> str | None:
        """Return the experiment that is most likely to decide, None if none is."""
        def plan() -> dict[str, str | None]:
            proposed = of_trials(list(trials), list(self.reference)).proposed_beside
            return {"experiment": None if proposed is None else proposed.name}

        name: str | None = self.journal.step(f"plan {count}", plan)["experiment"]
        return name

    def _mended(self, found: DiagnosisResult) -> MendedBench:
        """Return the outcome: nothing to extend, nothing that the loop can prove, or an extension and its proof."""
        if found.verdict == "refused":
            raise EndedNightError(f"the trials were refused: {found.warnings[0]}")
        outcome = MendedBench("", self.folder, found.verdict, [cause["effect"] for cause in found.causes],
                              [term.equation for term in found.terms])
        if not outcome.names and not outcome.equations:
            return self._unnamed(found, outcome)
        sensed = [name for name in found.rivals if CATALOGUE[name].site == "END sensor"]
        if found.verdict == "ambiguous" and sensed:
            return replace(outcome, ending="not tried: END itself may read wrongly "
                                           f"({', '.join(map(words, sensed))}), so that it proves nothing")
        choices = [each for each in (found, *found.alternatives) if _compensable(each.model)]
        if not choices:
            return replace(outcome, ending="not tried: a controller cannot compensate it by START, rope and knee")
        return self._tried(choices, outcome)

    def _unnamed(self, found: DiagnosisResult, outcome: MendedBench) -> MendedBench:
        """Return the outcome where no cause is named: effects that are likely are tried, and the loop decides.

        Nothing is tried if END's sensor may be the cause.
        """
        nats = found.found.evidence["log_bayes_factors"] if found.found.evidence else {}
        likely = [each for each in found.alternatives if nats[each.causes[0]["effect"]] >= LIKELY_NATS]
        choices = [each for each in likely if _compensable(each.model)]
        if not choices or any(CATALOGUE[each.causes[0]["effect"]].site == "END sensor" for each in likely):
            return replace(outcome, ending="nothing to mend: no cause is named and no law was found")
        tried = self._tried(choices, outcome)
        of = "".join(f": {words(name)}, likely and not named" for name in tried.names)
        return replace(tried, names=[], ending=tried.ending + of)

    def _tried(self, choices: Sequence[DiagnosisResult], outcome: MendedBench) -> MendedBench:
        """Return the outcome of the extension that is best in the loop, with its names and equations, and its proof."""
        try:
            chosen = self._chosen(choices[:CHOICES])
            outcome = replace(outcome, names=[cause["effect"] for cause in chosen.causes],
                              equations=[term.equation for term in chosen.terms])
            return self._proven(chosen, outcome)
        except EndedNightError as ended:
            return replace(outcome, ending=str(ended))

    def _with(self, step: str, found: DiagnosisResult) -> dict[str, Any] | None:
        """Run a trial whose controller compensates the extension of `found`; return None if the trial was stopped."""
        result = self.bench.recorded(
            self.journal, step, replace(self.bench.gait, controller="extended", model=found.model))
        return result if result["outcome"] == "completed" else None

    def _without(self, step: str) -> dict[str, Any]:
        return self.bench.completed(self.journal, step, replace(self.bench.gait, controller="extended"))

    def _chosen(self, choices: Sequence[DiagnosisResult]) -> DiagnosisResult:
        """Return the diagnosis with whose extension END's error in the loop is least, at its best size there.

        One trial with each extension: the error is taken to be linear in the size.  The proof is of other trials.
        """
        before = self.bench.apart(self._without("choice of nothing"))
        rated = list[tuple[float, int, float]]()
        for k, each in enumerate(choices):
            name = words(each.causes[0]["effect"]) if each.causes else "law"
            result = self._with(f"choice of {name}", each)
            if result is not None:
                moved = self.bench.apart(result) - before
                best = -float(before @ moved) / max(float(moved @ moved), 1e-12)
                size = float(np.clip(best, 1.0 / MOST_SIZE, MOST_SIZE))
                rated.append((float(np.linalg.norm(before + size * moved)), k, size))
        if not rated:
            raise EndedNightError("undone: the trials with an extension were stopped")
        _, k, size = min(rated)
        return choices[k].scaled(size)

    def _proven(self, found: DiagnosisResult, outcome: MendedBench) -> MendedBench:
        """Run pairs of trials without and with the extension of `found`; an extension without gain is deleted."""
        extended, before, after, kept = self.folder / EXTENDED, list[float](), list[float](), False
        write_whole(extended, found.model.text(), overwrite=True)
        try:
            for pair in range(1, PAIRS + 1):
                before.append(percent(self._without(f"{pair}-A")))
                mended = self._with(f"{pair}-B", found)
                if mended is None:
                    raise EndedNightError("undone: a trial with the extension was stopped")
                after.append(percent(mended))
            kept = paired_interval(before, after)[0] > 0.0
            ending = ("mended: the extension gains in the loop" if kept else
                      "undone: the extension does not gain in the loop")
        except EndedNightError as ended:
            ending = str(ended)
        finally:
            if not kept:
                extended.unlink()
        return replace(outcome, ending=ending, before=before[:len(after)], after=after, kept=kept)

    def _diagnosed(self, step: str, finder: Diagnosis, trials: Sequence[Path]) -> DiagnosisResult:
        """Diagnose the trials together, and enter the verdict in the journal; a resumed run diagnoses again."""
        found = finder.diagnose(trials, terms=True)
        self.journal.step(step, lambda: {"verdict": found.verdict, "class": list(found.rivals),
                                         "causes": [cause["effect"] for cause in found.causes],
                                         "equations": [term.equation for term in found.terms],
                                         "warnings": list(found.warnings)})
        return found

    def _trial(self, step: str, experiment: Experiment | PreparedTrial) -> Path:
        """Return the file of a trial that was completed."""
        return self.folder / str(self.bench.completed(self.journal, step, experiment)["file"])


def _compensable(model: BenchModel) -> bool:
    """Return whether a controller, which has START, rope and knee, can compensate an effect or a term of the model."""
    return any(CATALOGUE[name].inverse is not unchanged for name in model.effects) or any(
        term.carrier in UNDONE and term.modulation != "time_sine" for term in model.terms)
