"""One experiment, described by its numbers, and run on a bus into a recorded trial.

It turns plain arguments into the checked sections that `session` runs; the output of the command line is in the
returned trial.
"""

import weakref
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bowden import model_files, output_files
from bowden.bench import buses, configuration
from bowden.bench.buses import BusSettings
from bowden.model_files import Model
from bowden.progress import SILENT, Progress
from bowden.trials import session
from bowden.trials.recorded_trial import Trial
from parameters import InputError

GAIT = "gait"
_OF_GAIT = ("peak_n", "period_s", "cycles", "settle", "soft_start", "controller", "idle_slack_m")
_OF_WALK = ("strides", "stumbles", "stops", "sits", "phase")
_OF_NETWORK = ("rate_hz", "bitrate")


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """An experiment to run; None uses the configuration, whose defaults are the paper's.

    `peak_n`: peak of the desired force, N. `period_s`: gait period, s. `cycles`: gait cycles; the first `settle` of
    them are left out of every figure; `soft_start` more come before, over which the peak rises. `controller`: a name
    of the entry-point group bowden.controllers, "module:Class", or the class itself. `rate_hz`: control cycles per
    second. `strides`: strides of `knee` to play in random order, in place of its first one again and again, drawn by
    the bus's seed; `stumbles`, `stops` and `sits` are drawn among them. `phase`: "felt", which is the default with
    `strides`, or "clock". `knee`, `desired`: CSV files of the knee motion and of the desired force, in place of the
    paper's. `name`: "gait", or an experiment of `bowden trial --experiment`. `model`: the controller's bench model or
    its file (None: the packaged nominal one). `dry_run`: everything on the bus, drives never enabled.
    `configuration`: a bench.toml.
    """

    peak_n: float | None = None
    period_s: float | None = None
    cycles: int | None = None
    settle: int | None = None
    soft_start: int | None = None
    controller: str | type[Any] | None = None
    idle_slack_m: float | None = None
    strides: int | None = None
    stumbles: int | None = None
    stops: int | None = None
    sits: int | None = None
    phase: str | None = None
    rate_hz: int | None = None
    bitrate: int | None = None
    knee: str | Path | None = None
    desired: str | Path | None = None
    name: str = GAIT
    model: Model | None = None
    dry_run: bool = False
    configuration: str | Path | None = None

    def prepared(self, bus: BusSettings, progress: Progress = SILENT) -> session.PreparedTrial:
        """Check the experiment for a bus; raises `InputError` for unusable input before a frame is sent."""
        sections = self.sections()
        knee, desired = (None if given is None else Path(given) for given in (self.knee, self.desired))
        desired = session.desired_file(desired)
        sections["walk"] = configuration.drawn(
            self._overridden(sections["walk"], _OF_WALK), bus.arguments.get("seed"))
        sections["gait"] = self._overridden(sections["gait"], _OF_GAIT)
        model = self.model if self.model is None else (
            Path(self.model) if isinstance(self.model, str | Path) else model_files.given(self.model))
        return session.prepare_gait(
            sections, model, bus, peak_given=self.peak_n is not None, period_given=self.period_s is not None,
            settle_given=self.settle is not None, knee=knee, desired=desired, dry_run=self.dry_run,
            script=None if self.name == GAIT else self.name, progress=progress)

    def sections(self) -> dict[str, Any]:
        """Return the checked sections of the configuration, with the network that the experiment states."""
        sections = configuration.read(None if self.configuration is None else Path(self.configuration))
        sections["network"] = self._overridden(sections["network"], _OF_NETWORK)
        return sections

    def _overridden(self, section: Any, names: tuple[str, ...]) -> Any:
        given = {name: getattr(self, name) for name in names}
        if "controller" in given:
            given["controller"] = _name(given["controller"])
        return configuration.override(section, {name: (f"Experiment({name}=…)", value)
                                                for name, value in given.items()})


def _name(controller: str | type[Any] | None) -> str | None:
    """Return how a trial records a controller: its name, or "module:Class"."""
    if controller is None or isinstance(controller, str):
        return controller
    return f"{controller.__module__}:{controller.__qualname__}"


def run(
    experiment: Experiment | None = None, *, bus: BusSettings | None = None, output: str | Path | None = None,
    overwrite: bool = False, progress: Progress = SILENT,
) -> Trial:
    """Run an experiment on a bus and return the recorded trial, whether it completed or stopped (`Trial.outcome`).

    `bus`: `bowden.simulated(…)`, which is also the default, or `bowden.bus(…)`.  `output`: the file to record; without
    one the recording is in a temporary folder that is removed with the trial.  Raises `InputError` for what can be
    refused before a frame is sent; what happens on the bus ends in the outcome.
    """
    prepared = (experiment or Experiment()).prepared(bus or buses.simulated(), progress)
    if output is not None:
        figures = session.perform(prepared, Path(output), overwrite=overwrite, progress=progress)
        return Trial(figures["trial"] or output, figures)
    with ExitStack() as folder:
        path = Path(folder.enter_context(TemporaryDirectory(prefix="bowden-")), "trial.mcap")
        figures = session.perform(prepared, path, progress=progress)
        trial = Trial(figures["trial"] or path, figures)
        weakref.finalize(trial.recorded, folder.pop_all().close)
    return trial


@dataclass(frozen=True)
class Verified:
    """One experiment twice: without (`before`) and with (`after`) compensation of a model's effects.

    `judged_by`: the figure compared, of the true END if the bench is simulated, else of its sensor; `gain_percent`:
    its reduction, None if a trial has no such figure.
    """

    before: Trial
    after: Trial
    judged_by: str
    gain_percent: float | None


def gained(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[str, float | None]:
    """Return the figure that two trials of one experiment are judged by, and by how much it fell, %."""
    judged = "true_relative_rmse_percent" if before["true_relative_rmse_percent"] is not None else (
        "relative_rmse_percent")
    first, second = before[judged], after[judged]
    return judged, 100.0 * (1.0 - second / first) if first and second is not None else None


def verify(
    model: Model, experiment: Experiment | None = None, *, bus: BusSettings | None = None,
    output: str | Path | None = None, overwrite: bool = False, progress: Progress = SILENT,
) -> Verified:
    """Run one experiment twice, with the model's constants alone and with its effects known to the controller too.

    `model`: what `DiagnosisResult.model` is, or the file that `bowden diagnose -o` wrote.  `experiment`: its own
    `model` must be None, its controller is "extended" where it names none.  `output`: the trials to write, with -before
    and -after before the suffix (None: they are not kept).  Raises `InputError`.
    """
    asked, chosen = experiment or Experiment(), bus or buses.simulated()
    if asked.model is not None:
        raise InputError("verify: the experiment states a model, and verify is given one; leave it out of the "
                         "experiment.")
    known = model_files.read(model, bench=chosen.bench) if isinstance(model, str | Path) else model_files.given(model)
    if not known.effects and not known.terms:
        raise InputError(f"verify: {known.label} states no effect and no term that a controller could be told of; give "
                         "what a diagnosis found.")
    asked = replace(asked, controller=asked.controller or "extended")
    paths = {name: None if output is None else Path(output).with_stem(f"{Path(output).stem}-{name}")
             for name in ("before", "after")}
    output_files.refuse(paths.values(), overwrite=overwrite)
    not_told = replace(known, effects={}, found={}, terms=()) if known.values else None
    before, after = (
        run(replace(asked, model=told), bus=chosen, output=paths[name], overwrite=overwrite, progress=progress)
        for name, told in (("before", not_told), ("after", known)))
    return Verified(before, after, *gained(before.figures, after.figures))
