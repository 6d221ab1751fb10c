"""An identification from checked options to a calibration: measured now, or fitted again to what was recorded."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bowden import provenance, recorded, session
from bowden.buses import Chosen, opened
from bowden.progress import SILENT, Progress
from parameters import InputError

if TYPE_CHECKING:
    from master.identification.calibration_fit import Segment
    from physics.calibration import Calibration


class Identified(NamedTuple):
    """Why it stopped (None: it did not), the calibration, and the experiments that it was fitted to."""

    reason: str | None
    calibration: Calibration | None
    segments: Sequence[Segment]


def perform(
    what: str, sections: Mapping[str, Any], guess: Path | None, chosen: Chosen, recording: Path, *, date: str,
    overwrite: bool = False, progress: Progress = SILENT,
) -> Identified:
    """Run the experiments of `what` on a bus, recorded in `recording`."""
    from master.identification import identify
    from master.network.link import Link
    from physics.calibration import nominal, read
    from trial.record import Recorder, RecordingError

    network = sections["network"]
    wanted = identify.Identification(
        what=what, guess=nominal() if guess is None else read(guess), network=network, limits=sections["limits"],
        homing=sections["homing"])
    session.compile_laws(simulated=chosen.simulated, progress=progress)
    with opened(chosen, bitrate=network.bitrate, rate_hz=network.rate_hz, truth=None) as bus:
        recorder = Recorder(
            recording, metadata={"experiment": f"identify {what}", "bench": chosen.bench,
                                 "rate_hz": str(network.rate_hz), "bitrate": str(network.bitrate),
                                 "commit": provenance.commit()},
            attachments=provenance.attachments(wanted.guess, sections), threaded=not chosen.simulated,
            overwrite=overwrite)
        with session.discarding(recorder), progress.running(f"identify {what}") as update:
            outcome, segments = identify.run(Link(bus.bus, bus.clock), bus.tap, recorder, wanted,
                                             lambda _part, share: update(share))
        try:
            recorder.close(dataclasses.asdict(outcome))
        except RecordingError as error:
            return Identified(outcome.reason or f"recording failed: {error}", None, segments)
    if outcome.reason is not None:
        return Identified(outcome.reason, None, segments)
    with progress.waiting("fitting"):
        return Identified(None, identify.calibrate(
            what, segments, wanted.guess, bench=chosen.bench, date=date, trial=recording.name), segments)


def again(
    what: str, trials: Sequence[Path], guess: Path | None, *, date: str, progress: Progress = SILENT
) -> Identified:
    """Fit to the experiments that `trials` recorded, on one bench; without a `guess` it starts where the first did.

    Raises `InputError` for trials of two benches, or where an experiment that `what` needs is in none of them.
    """
    from master.identification import identify
    from physics import inverse
    from physics.calibration import read
    from trial import read as trial

    given = [trial.open(path) for path in trials]
    benches = {each.metadata.get("bench", "") for each in given} - {""}
    if len(benches) > 1:
        raise InputError(f"--from: the trials are of different benches, {' and '.join(sorted(benches))}; "
                         "identify one bench at a time.")
    segments = [segment for each in given for segment in identify.recorded(each)]
    start = recorded.calibration(given[0]) if guess is None else read(guess)
    inverse.prepare()
    with progress.waiting("fitting"):
        return Identified(None, identify.calibrate(
            what, segments, start, bench=next(iter(benches), ""), date=date,
            trial=", ".join(path.name for path in trials)), segments)
