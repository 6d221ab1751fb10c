"""Steps of an unattended repair, from reference trials to an extension that has gained in the loop.

    gait → diagnosis → repeat → diagnosis → (experiment → diagnosis)… → trials A B A B … → kept or undone

A: the bench's calibration alone, B: with the extension.  Only END as its sensor reads it decides, by its departure
from the reference trial: what the sensor reads wrongly there, it reads wrongly here, too.

The journal has one JSON line for each completed step, on the disk before the next step begins.  A run that was killed
is resumed by running the same steps again: a step with a line returns its result.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from bowden.bench import buses, configuration
from bowden.bench.buses import BusSettings
from bowden.model_files import BenchModel
from bowden.models.diagnosing import Diagnosis, DiagnosisResult
from bowden.models.experiment_plan import of_trials
from bowden.progress import SILENT, Progress
from bowden.trials import repeated_motion, session
from bowden.trials.experiment import GAIT, Experiment
from bowden.trials.recorded_trial import Trial
from bowden.trials.session import PreparedTrial
from parameters import InputError
from parameters.files import write_whole
from trial.report.page import Page, Series, Tile, number


class Journal:
    """Completed steps of a run in `path`, in their order; `settings` are the run's, on the first line."""

    def __init__(self, path: Path, settings: dict[str, Any], *, resume: bool) -> None:
        """Begin a journal, or with `resume` read the one at `path`.

        Raises `InputError` if a journal is there and `resume` is not asked for, and if its settings differ.
        """
        self.path, self.lines = path, list[dict[str, Any]]()
        if path.exists():
            if not resume:
                raise InputError(f"{path}: a run was recorded here; give another folder, or --resume.")
            self.lines = _read(path)
        if not self.lines:
            self._append({"step": "settings", "result": settings})
        elif self.lines[0]["result"] != settings:
            raise InputError(f"{path}: was begun with {self.lines[0]['result']}; resume with the same options.")
        self._next = 1

    def step(self, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """Return the result of the next step: from its line if it was completed, else made and written.

        Raises `InputError` if the journal's line is of another step: the program or a file has changed.
        """
        if self._next < len(self.lines):
            line = self.lines[self._next]
            if line["step"] != name:
                raise InputError(f"{self.path}: line {self._next + 1} is {line['step']}, expected {name}; begin anew "
                                 "in another folder.")
        else:
            line = {"step": name, "result": make()}
            self._append(line)
        self._next += 1
        result: dict[str, Any] = line["result"]
        return result

    def _append(self, line: dict[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line, ensure_ascii=False, allow_nan=False) + "\n")
            file.flush()
            os.fsync(file.fileno())
        self.lines.append(line)


def _read(path: Path) -> list[dict[str, Any]]:
    """Return the complete lines of a journal; a last line that a killed process cut short is removed from the file."""
    text = path.read_bytes()
    whole = text[:text.rfind(b"\n") + 1]
    if whole != text:
        with path.open("r+b") as file:
            file.truncate(len(whole))
    try:
        return [json.loads(line) for line in whole.decode("utf-8").splitlines()]
    except ValueError:
        raise InputError(f"{path}: is no journal of bowden mend; give another folder.") from None


Floats = NDArray[np.float64]

PAIRS: Final = 4
"""Pairs of trials without and with the extension: the fewest whose interval of a gain excludes 0 at 2 σ of scatter."""
STOPS: Final = 2
"""Number of stopped trials at which the run ends: one may be chance, two are the bench."""
EXPERIMENTS: Final = 2
"""Largest number of experiments that are run to decide between effects."""
JOURNAL, EXTENDED, PAGE = "journal.jsonl", "extended.toml", "mend.html"
REPEAT: Final = repeated_motion.NAME
BINS: Final = 100
"""Parts of the gait over which END is averaged from cycle to cycle: 1 % each, the step of the paper's tables."""
INTERRUPTED: Final = "interrupted"
"""Beginning of the stop reason of a trial that the operator stopped."""


@dataclass(frozen=True)
class MendedBench:
    """Outcome of a run: `ending` in words; `kept` if the extension gained; the extension's `equations` and names.

    `before`, `after`: END's error, % of the peak, in the trials A and B: RMS of its mean cycle from that of the
    reference trial, or from the desired force where that ran by another controller.  `gain`: mean of their
    differences, in points of percent, with its 95 % `interval`.  `folder` has the trials, the journal, the extension
    and the page.
    """

    ending: str
    folder: Path
    verdict: str = ""
    names: Sequence[str] = ()
    equations: Sequence[str] = ()
    before: Sequence[float] = ()
    after: Sequence[float] = ()
    kept: bool = False
    steps: Sequence[dict[str, Any]] = field(default_factory=tuple)

    @property
    def gain(self) -> float | None:
        """Mean fall of END's error, points of percent; None without trials."""
        return float(np.mean(np.subtract(self.before, self.after))) if self.before else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval of the mean fall, by Student's t over the pairs; None with fewer than two."""
        return paired_interval(self.before, self.after) if len(self.before) > 1 else None

    def as_json(self) -> dict[str, Any]:
        """Return the object that `bowden mend --json` prints."""
        return {"ending": self.ending, "verdict": self.verdict, "names": list(self.names),
                "equations": list(self.equations), "before_percent": list(self.before),
                "after_percent": list(self.after), "gain_points": self.gain,
                "interval": None if self.interval is None else list(self.interval), "kept": self.kept,
                "folder": str(self.folder)}


def paired_interval(before: Sequence[float], after: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % interval of the mean of `before` less `after`, by Student's t over the pairs."""
    fall = np.subtract(before, after)
    half = float(student.ppf(0.975, fall.size - 1) * fall.std(ddof=1) / math.sqrt(fall.size))
    return float(fall.mean()) - half, float(fall.mean()) + half


def end_error(trial: Trial, settle: int = 1) -> Floats:
    """Return END less the desired force, N, by part of the gait, mean of the cycles from `settle` on; NaN: unknown."""
    error = trial.columns["tension_end_n"] - trial.columns["desired_force_n"]
    kept = np.isfinite(error) & (trial.columns["cycle"] >= settle)
    part = np.minimum(BINS * trial.columns["gait_percent"][kept] / 100.0, BINS - 1).astype(int)
    count = np.bincount(part, minlength=BINS)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(part, error[kept], BINS) / count)


class _EndedError(Exception):
    """The run ends here; the text says why."""


def mend(reference: Sequence[str | Path], folder: str | Path, *, bus: BusSettings | None = None, hours: float = 1.0,
         cycles: int = 10, resume: bool = False, progress: Progress = SILENT) -> MendedBench:
    """Repair the model of a bench without anybody, within `hours` of bench time; returns the outcome.

    `reference`: trials of the bench in the reference condition, recorded by `bowden trial`; their peak force is the
    greatest that is asked for.  `folder`: where trials and journal go.  `resume`: go on with the journal there.  Every
    trial has all limits and the safe stop.  Raises `InputError` for unusable input.
    """
    return _Run([Path(path) for path in reference], Path(folder), bus or buses.simulated(), hours, cycles, resume,
                progress).run()


class _Run:
    def __init__(self, reference: Sequence[Path], folder: Path, bus: BusSettings, hours: float, cycles: int,
                 resume: bool, progress: Progress) -> None:
        self.reference, self.folder, self.bus, self.progress = reference, folder, bus, progress
        trials = [_reference_trial(path) for path in reference]
        self.plain = _calibration(trials[0])
        gaits = [trial for trial in trials if trial.metadata.get("experiment", GAIT) == GAIT]
        if not gaits:
            raise InputError("mend: no reference trial is a gait; record one with bowden trial.")
        walked = max(gaits, key=lambda trial: float(trial.metadata["peak_n"]))
        self.walked = Path(walked.path)
        self.gait = Experiment(peak_n=float(walked.metadata["peak_n"]), period_s=float(walked.metadata["period_s"]),
                               cycles=cycles, controller=walked.metadata["controller"], model=self.plain)
        # another controller leaves a larger error than an extension mends: END is then compared with the desired force
        alike = walked.metadata["controller"] == "extended" and self.plain is not None
        self.restored = end_error(walked) if alike else np.zeros(BINS)
        self.budget_s, self.used_s, self.stops = 3600.0 * hours, 0.0, 0
        folder.mkdir(parents=True, exist_ok=True)
        self.journal = Journal(folder / JOURNAL, {
            "reference": [str(path.resolve()) for path in reference], "hours": hours, "cycles": cycles}, resume=resume)

    def run(self) -> MendedBench:
        """Run all steps, and write page and extension, however the run ends."""
        result = MendedBench("", self.folder)
        try:
            result = self._repaired()
        except _EndedError as ended:
            result = replace(result, ending=str(ended))
        except KeyboardInterrupt:
            result = replace(result, ending="interrupted; go on with --resume")
        result = replace(result, steps=tuple(self.journal.lines))
        write_page(result, self.folder / PAGE)
        return result

    def _repaired(self) -> MendedBench:
        trials = [self._trial("gait", self.gait)]
        finder = Diagnosis(self.plain).fit(self.reference)
        found = self._diagnosed("diagnosis", finder, trials)
        tried: set[str] = set()
        if found.verdict in ("ambiguous", "unexplained"):
            found = self._repeated(finder, found)
        while found.verdict in ("ambiguous", "unexplained") and len(tried) < EXPERIMENTS:
            name = self._proposed(found, trials, tried)
            if name is None:
                break
            tried.add(name)
            trials.append(self._trial(name, replace(self.gait, name=name, cycles=None)))
            again = self._diagnosed(f"diagnosis with {name}", finder, trials)
            if again.verdict == "refused":  # the experiment is unusable here; the gait's answer stands
                break
            found = again
        return self._proven(found)

    def _repeated(self, finder: Diagnosis, found: DiagnosisResult) -> DiagnosisResult:
        """Return the diagnosis of the reference trial's own motion, if it separates more than that of the gait.

        The diagnosis compares the two trials directly, so that the repeated one is diagnosed alone.
        """
        try:
            prepared = repeated_motion.prepared(self.walked, configuration.read(None), self.bus)
        except InputError as error:
            reason = str(error)
            self.journal.step(REPEAT, lambda: {"experiment": f"not repeated: {reason}"})
            return found
        again = self._diagnosed(f"diagnosis of {REPEAT}", finder, [self._trial(REPEAT, prepared)])
        separates = again.causes and (not found.causes or len(again.rivals) < len(found.rivals))
        return again if separates else found

    def _proposed(self, found: DiagnosisResult, trials: Sequence[Path], tried: set[str]) -> str | None:
        """Return the experiment that is most likely to decide, None if none is."""
        if found.verdict != "ambiguous":
            return None

        def plan() -> dict[str, Any]:
            proposed = of_trials(list(trials), list(self.reference)).proposed_beside
            return {"experiment": None if proposed is None else proposed.name}

        name = self.journal.step(f"plan {len(tried) + 1}", plan)["experiment"]
        return None if name in tried else name

    def _proven(self, found: DiagnosisResult) -> MendedBench:
        """Extend the model by effects and terms, and return the outcome of trials without and with the extension."""
        names, equations = [cause["effect"] for cause in found.causes], [term.equation for term in found.terms]
        outcome = MendedBench("", self.folder, found.verdict, names, equations)
        if found.verdict == "refused":
            raise _EndedError(f"the trials were refused: {found.warnings[0]}")
        if not names and not equations:
            return replace(outcome, ending="nothing to mend: no cause is named and no law was found")
        extended = found.model
        write_whole(self.folder / EXTENDED, extended.text(), overwrite=True)
        before, after = list[float](), list[float]()
        controlled = replace(self.gait, controller="extended")
        try:
            for pair in range(1, PAIRS + 1):
                before.append(_percent(self._completed(f"{pair}-A", controlled)))
                mended = self._recorded(f"{pair}-B", replace(controlled, model=extended))
                if mended["outcome"] != "completed":  # what the extension brought to a stop is not tried again
                    raise _EndedError(f"undone: a trial with the extension was stopped: {mended['stop_reason']}")
                after.append(_percent(mended))
            kept = paired_interval(before, after)[0] > 0.0
            ending = "mended: the extension gains in the loop" if kept else (
                "undone: the extension does not gain in the loop")
        except _EndedError as ended:
            kept, ending = False, str(ended)
        if not kept:
            (self.folder / EXTENDED).unlink()
        return replace(outcome, ending=ending, before=before[:len(after)], after=after, kept=kept)

    def _diagnosed(self, step: str, finder: Diagnosis, trials: Sequence[Path]) -> DiagnosisResult:
        """Diagnose the trials together; the journal keeps the answer for the page, the files give it again."""
        found = finder.diagnose(trials, terms=True)
        self.journal.step(step, lambda: {"verdict": found.verdict, "class": list(found.rivals),
                                         "causes": [cause["effect"] for cause in found.causes],
                                         "equations": [term.equation for term in found.terms],
                                         "warnings": list(found.warnings)})
        return found

    def _trial(self, step: str, experiment: Experiment | PreparedTrial) -> Path:
        """Return the file of a trial that was completed (`_completed`)."""
        return self.folder / str(self._completed(step, experiment)["file"])

    def _completed(self, step: str, experiment: Experiment | PreparedTrial) -> dict[str, Any]:
        """Return the journal's result of a trial; a stopped one is recorded once more."""
        result = self._recorded(step, experiment)
        return result if result["outcome"] == "completed" else self._recorded(f"{step} again", experiment)

    def _recorded(self, step: str, experiment: Experiment | PreparedTrial) -> dict[str, Any]:
        """Return the journal's result of a trial, recorded now if there is none.

        Ends the run by time and at the second stopped trial.
        """
        path = self.folder / f"{step}.mcap"

        def record() -> dict[str, Any]:
            bus = self._bus()
            prepared = experiment.prepared(bus, self.progress) if isinstance(experiment, Experiment) else replace(
                experiment, chosen=bus)
            figures = session.perform(prepared, path, overwrite=True, progress=self.progress)
            trial = Trial(figures["trial"] or path, figures)
            if (trial.figures.get("stop_reason") or "").startswith(INTERRUPTED):
                raise KeyboardInterrupt  # not in the journal: the trial is recorded again when the run goes on
            seconds = 1e-9 * float(trial.time_ns[-1] - trial.time_ns[0]) if len(trial) else 0.0
            return {"file": path.name, "seconds": seconds, "outcome": trial.outcome or "",
                    "stop_reason": trial.figures.get("stop_reason"), "percent": self._error_percent(trial)}

        if self.used_s > self.budget_s:
            raise _EndedError(f"time is up: {self.used_s:.0f} s of the bench were used")
        result = self.journal.step(step, record)
        self.used_s += result["seconds"]
        if result["outcome"] != "completed":
            self.stops += 1
            if self.stops >= STOPS:
                raise _EndedError(f"{self.stops} trials were stopped, the last one: {result['stop_reason']}")
        return result

    def _bus(self) -> BusSettings:
        """Return the bus; the noise of a simulated bench is new in each trial, as on a real one."""
        if "seed" not in self.bus.arguments:
            return self.bus
        seed = int(self.bus.arguments["seed"]) + len(self.journal.lines)
        return replace(self.bus, arguments={**self.bus.arguments, "seed": seed})

    def _error_percent(self, trial: Trial) -> float | None:
        """Return the RMS of END's mean cycle from that of the reference trial, % of the peak; None where not measured.
        """
        if "tension_end_n" not in trial.columns or not len(trial):
            return None
        apart = end_error(trial) - self.restored
        known = np.isfinite(apart)
        return float(100.0 * np.sqrt(np.mean(apart[known] ** 2)) / self.gait.peak_n) if known.any() else None


def _percent(result: dict[str, Any]) -> float:
    """Return END's error, % of the peak, of a trial's result."""
    if result["percent"] is None:
        raise _EndedError(f"{result['file']}: END was not measured")
    return float(result["percent"])


def _reference_trial(path: Path) -> Trial:
    if path.suffix.lower() != ".mcap":
        raise InputError(f"{path}: a reference trial of mend is one of bowden trial, .mcap; give one.")
    trial = Trial(path)
    missing = [name for name in ("peak_n", "period_s", "controller") if name not in trial.metadata]
    if missing:
        raise InputError(f"{path}: has no {', '.join(missing)}; give a trial that bowden trial recorded.")
    return trial


def _calibration(trial: Trial) -> BenchModel | None:
    """Return the calibration that a reference trial ran on; None for the packaged nominal one."""
    import tomllib

    from estimation.data.table import NOMINAL
    from physics import bench_model

    text = trial.attachments.get("calibration.toml")
    if text is None or trial.metadata.get("calibration") == NOMINAL:
        return None
    return bench_model.from_tables(tomllib.loads(bytes(text).decode("utf-8")), f"{trial.path}: calibration.toml")


def write_page(result: MendedBench, path: Path) -> None:
    """Write the story of a run as one HTML page without network."""
    badge = ("mended", "good") if result.kept else ("not mended", "plain")
    page = Page("A bench repaired overnight", f"{result.ending}.", badge=badge)
    page.section("Outcome")
    page.text(_sentence(result))
    if result.gain is not None:
        low, high = result.interval or (None, None)
        page.tiles([
            Tile(number(float(np.mean(result.before)), 3), "%", "END without the extension", "error, of the peak"),
            Tile(number(float(np.mean(result.after)), 3), "%", "END with it", "error, of the peak"),
            Tile(number(result.gain, 3), "points", "gain", f"95 %: {number(low, 3)} … {number(high, 3)}")])
        pairs = np.arange(1.0, len(result.before) + 1.0)
        page.plot("END's error by pair of trials", pairs, [
            Series("without", result.before, "#d97706", points=True),
            Series("with", result.after, "#2563eb", points=True)], "pair", "%")
    page.section("Steps")
    page.table(["step", "what happened"], [(line["step"], _words(line["result"])) for line in result.steps[1:]])
    page.section("Files")
    page.text(f"Trials, journal.jsonl and, where it was kept, extended.toml are in {result.folder}.")
    page.write(path, overwrite=True)


def _sentence(result: MendedBench) -> str:
    """Return what was named and what became of it, in one sentence."""
    cause = ", ".join(name.replace("_", " ") for name in result.names) or "; ".join(result.equations)
    if not cause:
        return f"{result.ending[:1].upper()}{result.ending[1:]}."
    return f"Named: {cause}. {result.ending[:1].upper()}{result.ending[1:]}."


def _words(result: dict[str, Any]) -> str:
    """Return a step's result in words: a trial, a diagnosis or a plan."""
    if "file" in result:
        percent = "END not measured" if result["percent"] is None else f"END off by {number(result['percent'], 3)} %"
        stopped = f" ({result['stop_reason']})" if result["stop_reason"] else ""
        return f"{result['file']}: {result['outcome']}{stopped}, {result['seconds']:.0f} s, {percent}"
    if "verdict" in result:
        among = ", ".join(name.replace("_", " ") for name in result["class"])
        return "; ".join([str(result["verdict"]) + (f": {among}" if among else ""), *result["equations"]])
    return str(result["experiment"] or "no experiment is likely to decide")
