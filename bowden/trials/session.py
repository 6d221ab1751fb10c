"""A trial from checked options to a closed file and its figures.

The rule of this file: everything that can be refused is refused before a file is made or a frame is sent.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from bowden import output_files
from bowden.bench import configuration
from bowden.bench.buses import BusSettings, opened
from bowden.bench.configuration import override
from bowden.deferred import on_first_use
from bowden.progress import SILENT, Progress
from bowden.trials import force_paths
from parameters import InputError, read_toml
from trial import read
from trial.record import Recorder, RecordingError
from trial.signals import Signal, of_bench

with on_first_use():
    import nodes
    from bowden.bench import monitor_program
    from bowden.pages import figures as report
    from bowden.trials import provenance, recorded, setup_checks
    from eds.bench import bus_load
    from eds.bench.bench_network import wire
    from logbook.database import refuse_no_logbook
    from master.control import controller
    from master.cycle.log import CycleSink
    from master.cycle.safety import Condition
    from master.motion.experiment_run import ExperimentSetup, PreparedExperiment, Result
    from master.motion.paths_run import PlannedPaths
    from master.motion.scripted_experiments import Scripted, checked, laps
    from master.network.link import Link
    from master.settings import Gait, Walk
    from parameters.plugins import load
    from physics import bench_model, inverse, stride_walk
    from physics import reference as law
    from physics.bench_model import BenchModel, nominal
    from physics.calibration import refuse_beyond_validity
    from physics.plant import bench_plant
    from physics.reference import Reference
    from physics.stride_walk import Stride
    from trial import curves
    from trial.curves import Curve, read_curve, read_desired, read_strides
    from virtual_bus.compiled import cycle_code


TABLE_RAD = 0.05
"""Step of knee angle, rad, at which a function of a desired force is tabulated; between two, it is a straight line."""


class Watch(Protocol):
    """Observer of a trial while the trial is recorded."""

    def beside(self, recording: CycleSink) -> CycleSink:
        """Return a recorder that records in `recording` and shows its records."""

    def ended(self, sentence: str) -> None:
        """Report the outcome of the trial."""


@dataclass(frozen=True)
class PreparedTrial:
    """A checked experiment, the bus it will run on, and the sections and other files it came from.

    `script` names the experiment of the catalogue that is run in place of the gait; "" for the gait.
    `own_signals` are the controller's own columns, behind those of every trial.  `paths` has the experiment of each
    force path, on a bench of several.
    """

    experiment: ExperimentSetup
    sections: Mapping[str, Any]
    chosen: BusSettings
    files: Mapping[str, bytes] = field(default_factory=dict)
    script: str = ""
    own_signals: tuple[Signal, ...] = ()
    paths: Mapping[str, ExperimentSetup] = field(default_factory=dict)

    @property
    def laps(self) -> int:
        """Number of gait cycles, or laps of the script."""
        cycles = self.experiment.walk.parts or self.experiment.gait.cycles
        return laps(self.script, cycles) if self.script else cycles

    def planned(self) -> PreparedExperiment | Scripted | PlannedPaths:
        """Return the experiment with its tables and a tested controller; raises `InputError` for unusable ones."""
        if self.paths:
            return PlannedPaths(self.paths, self.experiment, self.script)
        return Scripted(self.experiment, self.script) if self.script else PreparedExperiment(self.experiment)


def entered(sections: dict[str, Any], logbook: Path | None, config: Path | None) -> Path | None:
    """Return the logbook that trials are entered in: `logbook`, or the one that `[record]` names beside `config`.

    It is taken out of the sections: no path of a machine stands in a trial.  Raises `InputError` where none is there.
    """
    told = sections["record"].logbook
    sections["record"] = dataclasses.replace(sections["record"], logbook="")
    found = logbook
    if found is None and told:
        found = Path(told) if config is None else config.parent / told
    if found is not None:
        refuse_no_logbook(found)
    return found


def strides(knee: Path | None, walk: Walk) -> tuple[Stride, ...]:
    """Return the strides of a knee file that a walk plays in random order; none where one repeats."""
    if knee is None or not walk.strides:
        return ()
    return tuple(Stride(one.percent, one.values, one.stride_s) for one in read_strides(knee))


def reference(
    gait: Gait, knee: Path | None, desired: Path | None, *, period_given: bool, peak_given: bool,
    walk: Walk | None = None, rate_hz: int = 1000,
) -> tuple[Reference, Gait, list[str]]:
    """Build the reference from the paper's formulas or from files; `gait` comes back with their period and peak.

    The knee of a `walk` of several strides is their mean.
    """
    notes: list[str] = []
    angle = law.paper_angle()
    several = () if walk is None else strides(knee, walk)
    if several:
        notes.append(f"{knee}: {len(several)} strides, played in random order; their mean is what is expected.")
        angle = law.recorded_angle(*stride_walk.mean(several))
        periods = [one.period_s for one in several if math.isfinite(one.period_s)]
        if periods and not period_given:
            gait = override(gait, {"period_s": (str(knee), round(sum(periods) / len(periods) * rate_hz) / rate_hz)})
    elif knee is not None:
        curve = read_curve(knee, "knee_angle_rad")
        notes.append(curve.note())
        angle = law.recorded_angle(curve.percent, curve.values)
        if not period_given and math.isfinite(curve.stride_s):
            gait = override(gait, {"period_s": (str(knee), curve.stride_s)})
    if desired is not None:
        if peak_given:
            raise InputError("--peak belongs to the paper's force; leave it out with --desired, which has its own.")
        wanted = read_desired(desired)
        notes.append(wanted.note())
        made = law.Reference(gait.period_s, angle, law.recorded_force(wanted.percent, wanted.values) if isinstance(
            wanted, Curve) else law.recorded_surface(*wanted))
        return made, override(gait, {"peak_n": (str(desired), made.peak_n)}), notes
    return law.Reference(gait.period_s, angle, law.paper_force(gait.peak_n)), gait, notes


def desired_file(desired: Path | None) -> Path | None:
    """Return the file of a desired force: of a function "module:name", its table by phase and knee angle.

    The table is the function at every percent of the gait and every `TABLE_RAD` of knee angle; it is attached to the
    trial, so that nothing of the function runs in a control cycle or in a replay.  Raises `InputError`.
    """
    if desired is None or ":" not in desired.name or desired.exists():
        return desired
    function = load("desired force", str(desired), "bowden.desired_forces", {})
    rows = ["gait_percent,knee_angle_rad,desired_force_n"]
    for percent in range(100):
        for i in range(-35, 5):
            at = f"desired force {str(desired)!r}: at {percent} % of the gait and {TABLE_RAD * i:g} rad it"
            try:
                force = float(function(float(percent), TABLE_RAD * i))
            except Exception as error:
                raise InputError(f"{at} raised {type(error).__name__}: {error}; mend it.") from None
            if not curves.FORCE.low <= force <= curves.FORCE.high:
                raise InputError(f"{at} is {force:g} N, expected {curves.FORCE.low:g} to "
                                 f"{curves.FORCE.high:g}; mend it.")
            rows.append(f"{percent},{TABLE_RAD * i:g},{force!r}")
    return recorded.copied("desired.csv", "\n".join(rows).encode() + b"\n")


def prepare(
    sections: Mapping[str, Any], reference: Reference, calibration: Path | BenchModel | None, chosen: BusSettings,
    *, dry_run: bool, controller_model: Path | BenchModel | None = None, files: Mapping[str, bytes] | None = None,
    script: str | None = None, knee: Path | None = None,
) -> PreparedTrial:
    """Join sections to an experiment that can be run; raises `InputError` if it cannot.

    `calibration` is the bench model that the controller works from, `controller_model` one whose effects it
    compensates, too: files, or their content. `knee` is the file of the strides that a walk plays. A bench with a limb
    is refused without a file of recent set-up checks.
    """
    bus_load.refuse(wire(sections["network"]))
    configuration.refuse_raised(sections["limits"], "this bench")
    configuration.refuse_unheld(sections, "this bench")
    file = calibration if isinstance(calibration, Path) else None
    setup_checks.refuse_unchecked(sections, file)
    files = {**(files or {}), **setup_checks.attached(file)}
    gait = sections["gait"]
    kind = controller.find(gait.controller, where="--controller")
    if script is not None:
        checked(script, where="--experiment")
        if dry_run:
            raise InputError(f"--dry-run moves nothing, so --experiment {script} would tell nothing; leave one out.")
    cycles = sections["walk"].strides or gait.cycles
    if gait.settle >= cycles:
        raise InputError(f"--settle {gait.settle} leaves none of {cycles} cycles; give more cycles or --settle 0.")
    walk = sections["walk"]
    walking = walk.differs
    if walking and (script is not None or force_paths.several(sections["network"].bench)):
        raise InputError("--strides and --phase felt belong to the gait of one force path; leave them out.")
    if force_paths.several(sections["network"].bench):
        return _several_paths(sections, reference, calibration, controller_model, chosen, dry_run, script, files)
    bench = _bench(chosen)
    model, told = _read(calibration, bench), _read(controller_model, bench)
    measured = next((known for known in (model, told) if known is not None and known.values), nominal()).calibration
    refuse_beyond_validity(measured, reference.peak_n)
    experiment = ExperimentSetup(reference=reference, calibration=measured, dry_run=dry_run,
                                 strides=strides(knee, walk), **beyond(model, told), **sections)
    attached = controller_model or (model if any(beyond(model).values()) else None)
    return PreparedTrial(experiment, sections, chosen, {**files, **provenance.controller_model(attached)},
                         script or "", controller.signals(kind, walking))


def prepare_gait(
    sections: Mapping[str, Any], calibration: Path | BenchModel | None, chosen: BusSettings, *, peak_given: bool,
    period_given: bool, settle_given: bool = True, knee: Path | None = None, desired: Path | None = None,
    dry_run: bool = False, controller_model: Path | BenchModel | None = None, script: str | None = None,
    progress: Progress = SILENT,
) -> PreparedTrial:
    """Join sections and the files of knee and desired force to a gait trial, with remarks on these files.

    `peak_given`, `period_given`: the user chose them, so that a file does not.  Unless `settle_given`, the last cycle
    is in the figures.  Raises `InputError` as `prepare` does.
    """
    expected, gait, notes = reference(
        sections["gait"], knee, desired, period_given=period_given, peak_given=peak_given, walk=sections["walk"],
        rate_hz=sections["network"].rate_hz)
    cycles = sections["walk"].strides or gait.cycles
    if not settle_given and gait.settle >= cycles:
        notes.append(f"settle = {gait.settle} leaves none of {cycles} cycles; the figures leave out {cycles - 1}.")
        gait = dataclasses.replace(gait, settle=cycles - 1)
    prepared = prepare(
        {**sections, "gait": gait}, expected, calibration, chosen, dry_run=dry_run, controller_model=controller_model,
        files=provenance.curves(knee=knee, desired=desired), script=script, knee=knee)
    for note in notes:
        progress.remark(note)
    return prepared


def _several_paths(
    sections: Mapping[str, Any], reference: Reference, calibration: Path | BenchModel | None,
    controller_model: Path | BenchModel | None, chosen: BusSettings, dry_run: bool, script: str | None,
    files: Mapping[str, bytes],
) -> PreparedTrial:
    """Prepare a trial of a bench of several force paths, with a calibration file for each path.

    On a path for which the controller model has no file, no effect is compensated.
    """
    whole = ExperimentSetup(reference=reference, dry_run=dry_run, **sections)
    setups: dict[str, ExperimentSetup] = {}
    without = set() if controller_model is None else force_paths.without_file(controller_model, sections["network"])
    for path in sections["network"].bench.force_paths:
        bench = force_paths.bench_of(_bench(chosen), path.name)
        given = [force_paths.file_of(each, path.name) if isinstance(each, Path) else each
                 for each in (calibration, controller_model)]
        model, told = (_read(each, bench) for each in (given[0], None if path.name in without else given[1]))
        measured = next((known for known in (model, told) if known is not None and known.values), nominal()).calibration
        setups[path.name] = force_paths.setup_of(
            whole, path, calibration=measured, **beyond(model, told))
        refuse_beyond_validity(measured, setups[path.name].reference.peak_n)
    kind = controller.find(sections["gait"].controller, where="--controller")
    return PreparedTrial(whole, sections, chosen, files, script or "",
                         controller.signals(kind), setups)


def _read(given: Path | BenchModel | None, bench: str = "") -> BenchModel | None:
    return bench_model.read(given, bench=bench) if isinstance(given, Path) else given


def _bench(chosen: BusSettings) -> str:
    """Return the bench that a calibration must belong to: that of a simulated model if it was measured on a bench."""
    simulated = chosen.arguments.get("plant_model")
    if simulated is None:
        return chosen.bench
    tables = read_toml(Path(simulated)) if isinstance(simulated, str) else simulated
    return bench_model.from_tables(tables, str(simulated)).bench or chosen.bench


def beyond(*models: Path | BenchModel | None) -> dict[str, Any]:
    """Return the effects (`known`) and the `terms` of bench models, as keyword arguments of an experiment.
    """
    read = [model for model in map(_read, models) if model is not None]
    return {"known": {name: values for model in read for name, values in model.effects.items()},
            "terms": tuple(term for model in read for term in model.terms)}


def perform(
    prepared: PreparedTrial, output: Path, picture: Path | None = None, *, overwrite: bool = False,
    progress: Progress = SILENT, announce: str = "", watch: Sequence[Watch] = (),
) -> dict[str, Any]:
    """Run the experiment into `output`; returns the figures of `trial --json` in its order of keys.

    `announce` is remarked when the bus is open, before anything is sent; each `watch` receives the records during the
    run: the live page, a diagnosis.
    """
    simulated = prepared.chosen.simulated
    truth = output.with_name(f"{output.stem}.truth.mcap") if simulated else None
    output_files.refuse([output, truth, picture], overwrite=overwrite)
    compile_laws(simulated=simulated, progress=progress)
    with output_files.restored_unless_written(output, truth) as older:
        return _performed(prepared, output, truth, picture, older=older, overwrite=overwrite, progress=progress,
                          announce=announce, watch=watch)


def _performed(
    prepared: PreparedTrial, output: Path, truth: Path | None, picture: Path | None, *, older: bool,
    overwrite: bool, progress: Progress, announce: str, watch: Sequence[Watch],
) -> dict[str, Any]:
    """Run the experiment as `perform` describes; a run without a control cycle has no file.

    `older`: a trial of the output's name was moved aside; it stays if this one stops before the end of homing.
    """
    network, simulated = prepared.experiment.network, prepared.chosen.simulated
    planned = prepared.planned()
    with ExitStack() as after, opened(prepared.chosen, network, truth=truth) as bus:
        if truth is not None:
            after.callback(truth.unlink, missing_ok=True)  # a trial that does not begin leaves no file
        monitor_program.refuse_other(bus.tap, bus.clock, network.monitor)
        # a logbook orders the sessions of a simulated bench by their days, others by the dates of recording
        day = {"day": str(prepared.chosen.arguments["day"])} if simulated else {}
        of_paths = force_paths.metadata(prepared.paths, network) if prepared.paths else {}
        recorder = Recorder(output, metadata={"bus": prepared.chosen.in_words, **day,
                                              **provenance.metadata(prepared.experiment, prepared.script), **of_paths},
                            attachments={**provenance.attachments(prepared.experiment.calibration, prepared.sections),
                                         **force_paths.attachments(prepared.paths, prepared.sections),
                                         **prepared.files},
                            threaded=not simulated, overwrite=overwrite,
                            signals=(signals := of_bench(network.bench, prepared.own_signals)))
        after.callback(recorder.discard)
        began = time.perf_counter()
        if announce:
            progress.remark(f"{announce} {planned.pulls}")
        with progress.running("trial") as update, bus.host() as refused:
            sink: CycleSink = ProgressRecorder(recorder, update, prepared.laps, signals)
            for one in watch:
                sink = one.beside(sink)
            for sentence in refused:
                sink.event(bus.clock(), "host", "master", sentence)
            after.pop_all()
            try:
                result = planned.run(Link(bus.bus, bus.clock), bus.tap, sink)
            except KeyboardInterrupt:  # a second Ctrl-C
                recorder.close({"outcome": "stopped", "stop_reason": "interrupted"})
                after.callback(_removed_unless_run, output, truth)
                raise
            except Exception as error:  # of a plant's plug-in, or a fault of this program
                recorder.close({"outcome": "stopped", "stop_reason": str(error)})
                after.callback(set_aside, output, truth)
                raise
        wall_s = time.perf_counter() - began
        result = closed(recorder, result)
        for one in watch:
            one.ended(result.stop_reason or result.outcome)
    if result.stop_reason is not None and _removed_unless_run(output, truth):
        return report.refused(prepared.experiment, result, wall_s, serial=prepared.chosen.serial, simulated=simulated)
    kept = recorder.failure is None
    unbegun = older and result.stop_reason and not (result.was_homed or prepared.experiment.dry_run)
    if kept and (unbegun or (not watch and (result.stop_reason or "").startswith(Condition.CONTROLLER.value))):
        output, truth = set_aside(output, truth)
    figures = report.figures(prepared.experiment, result, output, truth, wall_s, serial=prepared.chosen.serial,
                             simulated=simulated, kept=kept, progress=progress, paths=prepared.paths)
    if picture is not None and kept:
        report.picture(output, picture, prepared.experiment, prepared.paths)
    return figures


def set_aside(output: Path, truth: Path | None) -> tuple[Path, Path | None]:
    """Rename the recording of a trial whose plug-in failed or homing did not end, so that its name stays free.

    Returns the new paths, "….failed.mcap"; the recording of an earlier failure is replaced.
    """
    failed = output.with_name(f"{output.stem}.failed.mcap")
    aside = None if truth is None else output.with_name(f"{output.stem}.failed.truth.mcap")
    for path, new in ((output, failed), (truth, aside)):
        if path is not None and new is not None and path.exists():
            path.replace(new)
    return failed, aside


def never_ran(output: Path) -> bool:
    """Return whether a run ended before its first control cycle: its file would only make the next one fail."""
    try:
        return not read.open_file(output).extent.rows
    except InputError:
        return False  # a disk that is full: what is there is kept


def _removed_unless_run(output: Path, truth: Path | None) -> bool:
    """Remove the files of a run that ended before its first control cycle; return whether it did."""
    empty = never_ran(output)
    for path in (output, truth):
        if empty and path is not None:
            path.unlink(missing_ok=True)
    return empty


def closed(recorder: Recorder, result: Result) -> Result:
    """Close the recording; if that fails, as on a full disk, return a stopped result with the reason."""
    try:
        recorder.close(dataclasses.asdict(result))
    except RecordingError as error:
        if result.stop_reason is None:
            return dataclasses.replace(result, outcome="stopped", stop_reason=f"recording failed: {error}")
    return result


@contextmanager
def discarding(recorder: Recorder) -> Iterator[None]:
    """Remove the file of a run that is refused before it starts."""
    try:
        yield
    except InputError:
        recorder.discard()
        raise


def compile_laws(*, simulated: bool, progress: Progress = SILENT) -> None:
    """Compile all numba functions that are not cached on this machine; remark the seconds it took."""
    began, compiled = time.perf_counter(), False
    with progress.waiting("preparing; a first run on a machine compiles the laws"):
        inverse.prepare()
        if simulated:
            nodes.prepare()
            compiled = bench_plant.prepare() | cycle_code.prepare()
    if compiled:
        progress.remark(f"compiled the laws for this machine in {time.perf_counter() - began:.1f} s; "
                        "later runs find them compiled.")


class ProgressRecorder:
    """A recorder that reports the progress of the gait, once in `EVERY` rows."""

    EVERY = 200

    def __init__(
        self, recorder: Recorder, update: Callable[[float], None], cycles: int, signals: Sequence[Signal]
    ) -> None:
        ends = [signal.name.rpartition(".")[2] for signal in signals]
        self._cycle, self._percent = ends.index("cycle"), ends.index("gait_percent")
        self.frame, self.frames, self.event = recorder.frame, recorder.frames, recorder.event
        self._record, self._update, self._cycles, self._count = recorder.cycle, update, cycles, 0
        self._width = recorder.width

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        """Record one control cycle."""
        if len(values) < self._width:  # a row of which the controller says nothing
            values = (*values, *(math.nan,) * (self._width - len(values)))
        self._record(time_ns, values)
        self._count += 1
        if not self._count % self.EVERY and values[self._cycle] >= 0:
            percent = values[self._percent]
            self._update((values[self._cycle] + (percent / 100 if math.isfinite(percent) else 0)) / self._cycles)
