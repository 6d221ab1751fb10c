"""An identification from checked options to a calibration."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bowden import about, session, terminal
from bowden.bus import Chosen, opened

if TYPE_CHECKING:
    from master.calibration import Calibration


def perform(
    what: str, sections: Mapping[str, Any], guess: Path | None, chosen: Chosen, recorded: Path, *, date: str,
    overwrite: bool, quiet: bool,
) -> tuple[str | None, Calibration | None]:
    """Run the experiments of `what`, recorded in `recorded`; returns the reason of a stop, or the calibration."""
    from master import identify
    from master.calibration import nominal, read
    from master.link import Link
    from trial.record import Recorder, RecordingError

    network = sections["network"]
    wanted = identify.Identification(
        what=what, guess=nominal() if guess is None else read(guess), network=network, limits=sections["limits"],
        homing=sections["homing"])
    session.compile_laws(simulated=chosen.simulated, quiet=quiet)
    with opened(chosen, bitrate=network.bitrate, rate_hz=network.rate_hz, truth=None) as bus:
        recorder = Recorder(
            recorded, metadata={"experiment": f"identify {what}", "rate_hz": str(network.rate_hz),
                                "bitrate": str(network.bitrate), "commit": about.commit()},
            attachments=about.attachments(wanted.guess, sections), threaded=not chosen.simulated, overwrite=overwrite)
        with session.discarding(recorder), terminal.progress(f"identify {what}", shown=not quiet) as update:
            outcome, segments = identify.run(Link(bus.bus, bus.clock), bus.tap, recorder, wanted,
                                             lambda _part, share: update(share))
        try:
            recorder.close(dataclasses.asdict(outcome))
        except RecordingError as error:
            return outcome.reason or f"recording failed: {error}", None
    if outcome.reason is not None:
        return outcome.reason, None
    with terminal.waiting("fitting", shown=not quiet):
        return None, identify.calibrate(
            what, segments, wanted.guess, bench=chosen.bench, date=date, trial=recorded.name)
