"""An identification: a bench is measured on its bus, or recorded trials of it are fitted again, into a bench model."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from bowden import model_files
from bowden.bench import buses, configuration
from bowden.bench.buses import BusSettings, opened
from bowden.deferred import on_first_use
from bowden.model_files import BenchModel, Model
from bowden.progress import SILENT, Progress
from bowden.trials import force_paths, provenance, recorded, session
from bowden.trials.recorded_trial import Trial
from parameters import InputError
from physics.bench_model import of_calibration
from physics.calibration import nominal, read, write
from trial import read as trial
from trial.read import paths_metadata
from trial.record import Recorder, RecordingError
from trial.signals import of_bench

with on_first_use():
    from estimation import bench_fit
    from estimation.transfer.calibration_fit import Segment
    from master.identification import identify as procedures
    from master.network.link import Link
    from physics import inverse
    from physics.calibration import Calibration


class StoppedError(Exception):
    """The bench stopped before there was a result; the text is the reason, in one sentence."""


class IdentificationResult(NamedTuple):
    """Result of an identification: reason of a stop (None: completed), calibration, and the fitted experiments.

    With a reason and a calibration a gait trial stopped: the discrepancy is of the gait trials before it, if any.
    `path` is the force path that was identified, "" on a bench of a single one.
    """

    reason: str | None
    calibration: Calibration | None
    segments: Sequence[Segment]
    path: str = ""


def perform(
    what: str, sections: Mapping[str, Any], guess: Path | Calibration | None, chosen: BusSettings, recording: Path, *,
    date: str, gait: bool = True, overwrite: bool = False, progress: Progress = SILENT,
) -> list[IdentificationResult]:
    """Run the experiments of `what` on a bus, recorded in `recording`; return the calibration of each force path.

    On a bench of several paths a file `guess` names one file of each path (`force_paths.file_of`). "all" ends with gait
    trials if `gait`; if one stops, the calibration has the discrepancy of those before it.
    """
    network = sections["network"]
    if what == "gait" and not (gait and procedures.with_gait(what, network)):
        raise InputError("identify gait: needs END, a knee drive and no --no-gait; give identify all instead.")
    paths = [path.name for path in network.bench.force_paths] if force_paths.several(network.bench) else [""]
    guesses = {path: _calibration(force_paths.file_of(guess, path) if path and isinstance(guess, Path) else guess)
               or nominal() for path in paths}
    wanted = procedures.Identification(
        what=what, guess=guesses[paths[0]], guesses=guesses, network=network, limits=sections["limits"],
        homing=sections["homing"])
    session.compile_laws(simulated=chosen.simulated, progress=progress)
    with opened(chosen, network) as bus:
        recorder = Recorder(
            recording, metadata={"experiment": f"identify {what}", "bench": chosen.bench,
                                 "rate_hz": str(network.rate_hz), "bitrate": str(network.bitrate),
                                 "commit": provenance.commit(), **paths_metadata(network.bench),
                                 **{f"{path}.bench": force_paths.bench_of(chosen.bench, path)
                                    for path in paths if path}},
            attachments={**provenance.attachments(wanted.guess, sections),
                         **{f"{path}.calibration.toml": write(guesses[path]).encode() for path in paths if path}},
            threaded=not chosen.simulated, overwrite=overwrite, signals=of_bench(network.bench))
        link = Link(bus.bus, bus.clock)
        with session.discarding(recorder), progress.running(f"identify {what}") as update:
            progress.remark(procedures.pulls(wanted, gait=gait and procedures.with_gait(what, network)))
            outcome, segments = procedures.run(link, bus.tap, recorder, wanted, lambda _part, share: update(share))
        found = [IdentificationResult(outcome.reason, None, own, path)
                 for path, own in zip(paths, segments.values(), strict=True)]
        if outcome.reason is None:
            with progress.waiting("fitting"):
                found = [each._replace(calibration=procedures.calibrate(
                    what, each.segments, guesses[each.path],
                    bench=force_paths.bench_of(chosen.bench, each.path) if each.path else chosen.bench,
                    date=date, trial=recording.name)) for each in found]
            if gait and procedures.with_gait(what, network):
                named = [each.path or network.bench.force_paths[0].name for each in found]
                with progress.running("gait trials") as update:
                    reason, gaits = procedures.walk(link, bus.tap, recorder, wanted, {
                        name: each.calibration or nominal() for name, each in zip(named, found, strict=True)},
                        lambda _part, share: update(share))
                    found = [_walked(reason, gaits[name], each) for name, each in zip(named, found, strict=True)]
        try:
            recorder.close(dataclasses.asdict(dataclasses.replace(outcome, reason=found[0].reason)))
        except RecordingError as error:
            found = [each._replace(reason=each.reason or f"recording failed: {error}", calibration=None)
                     for each in found]
    if outcome.reason is not None and session.never_ran(recording):
        recording.unlink(missing_ok=True)
    return found


def _walked(reason: str | None, gaits: Sequence[Segment], found: IdentificationResult) -> IdentificationResult:
    """Return an identification with the discrepancy fitted to its gait trials; `reason`: why these stopped."""
    segments = [*found.segments, *gaits]
    known = None if found.calibration is None else procedures.with_discrepancy(found.calibration, segments)
    return found._replace(reason=reason, calibration=known, segments=segments)


def again(
    what: str, trials: Sequence[Path], guess: Path | Calibration | None, *, date: str, progress: Progress = SILENT
) -> IdentificationResult:
    """Fit recorded experiments of one bench again; without a `guess` the fit starts from the first trial's calibration.

    Raises `InputError` for trials of two benches, or where an experiment that `what` needs is in none of them.
    """
    given = [trial.open(path) for path in trials]
    benches = {each.metadata.get("bench", "") for each in given} - {""}
    if len(benches) > 1:
        raise InputError(f"--from: the trials are of different benches, {' and '.join(sorted(benches))}; "
                         "identify one bench at a time.")
    segments = [segment for each in given for segment in procedures.recorded(each)]
    start = _calibration(guess) or recorded.calibration(given[0])
    inverse.prepare()
    with progress.waiting("fitting"):
        found = procedures.calibrate(what, segments, start, bench=next(iter(benches), ""), date=date,
                                   trial=", ".join(path.name for path in trials))
        return IdentificationResult(None, procedures.with_discrepancy(found, segments), segments)


def _calibration(given: Path | Calibration | None) -> Calibration | None:
    return read(given) if isinstance(given, Path) else given


def identify(
    what: str = "all", *, bus: BusSettings | None = None, trials: Sequence[Trial | str | Path] = (),
    model: Model | None = None, config: str | Path | None = None, output: str | Path | None = None,
    gait: bool = True, overwrite: bool = False, date: str | None = None, progress: Progress = SILENT,
) -> BenchModel:
    """Measure a bench by the paper's procedures and return its model; or, with `trials`, fit recorded ones again.

    `what`: stiffness, swing, friction, sensors, gait or all. `bus`: `bowden.simulated(…)`, also the default, or
    `bowden.bus(…)`. `model`: starting point (None: the packaged nominal one); `config`: a bench.toml. `gait`: whether
    "all" ends with gait trials, which measure the discrepancy START → END. `output`: the file that keeps the recording
    (None: it is not kept). `date`: ISO date for the evidence (today). Raises `InputError` for bad input,
    `StoppedError` if the bench stopped.
    """
    date = datetime.date.today().isoformat() if date is None else date
    guess = None if model is None else model_files.given(model).calibration
    if trials:
        if bus is not None:
            raise InputError("identify: trials are fitted without a bus; leave bus out, or the trials.")
        paths = [each.path if isinstance(each, Trial) else Path(each) for each in trials]
        return _model(again(what, paths, guess, date=date, progress=progress))
    with TemporaryDirectory(prefix="bowden-") as folder:
        found, *others = perform(
            what, configuration.read(None if config is None else Path(config)), guess, bus or buses.simulated(),
            Path(output or f"{folder}/identification.mcap"), date=date, gait=gait, overwrite=overwrite,
            progress=progress)
    if others:
        raise InputError("identify: the bench has several force paths, and a model has one; say bowden identify.")
    return _model(found)


def _model(found: IdentificationResult) -> BenchModel:
    if found.calibration is None:
        raise StoppedError(found.reason or "the identification found nothing")
    return of_calibration(found.calibration)


def fit(
    trials: Sequence[Trial | str | Path], *, lowpass_hz: float | None = None, progress: Progress = SILENT,
) -> BenchModel:
    """Fit the simulation's constants to reference trials of one bench, as `bowden fit` does.

    `trials`: any motion, own or imported, with rope position and START, END where recorded; `lowpass_hz`: cut-off of a
    zero-phase low-pass on every signal, Hz. Errors on held-out trials are in `BenchModel.fitted`; the constants of a
    rig of another kind are in `BenchModel.rig`. Raises `InputError`.
    """
    with progress.waiting("fitting"):
        paths = [each.path if isinstance(each, Trial) else Path(each) for each in trials]
        return dataclasses.replace(bench_fit.fit(paths, lowpass_hz).model, label="fit")
