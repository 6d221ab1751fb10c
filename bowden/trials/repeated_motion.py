"""The motion of a recorded trial, to be repeated: its gait, settings and calibration, and the targets that it sent.

The diagnosis compares a trial with a reference trial of the same motion directly, since the model's error under one
motion repeats under it.
"""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bowden.bench.buses import BusSettings
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    from bowden.trials import provenance, recorded, session
    from bowden.trials.session import PreparedTrial
    from master.control.controller import RecordedTargets
    from master.motion.experiment_run import ExperimentSetup
    from trial import read
    from trial.read import Trial

ATTACHMENT = "targets.csv"
NAME = "repeat"
"""The experiment of the catalogue that repeats a motion."""
COLUMNS = ("servo_target_m", "knee_target_rad")
SETTINGS = ("gait", "impedance", "homing")
"""Sections that a repeated motion takes from the recorded trial; network, limits and record are those of today."""


def refuse_beside(given: Path | None, experiment: str | None, others: Mapping[str, Any]) -> None:
    """Raise `InputError` for options that contradict a repeated motion, and for the experiment without its trial.

    `others`: options that the recorded trial decides, by their spelling; None for those not given.
    """
    if given is None:
        if experiment == NAME:
            raise InputError(f"--experiment {NAME} repeats the motion of a trial; name it with --motion-of.")
        return
    beside = [name for name, value in others.items() if value is not None]
    if experiment not in (None, NAME):
        beside.append("--experiment")
    if beside:
        raise InputError(f"--motion-of repeats a trial as it was; leave {', '.join(beside)} out.")


def prepared(given: Path, sections: Mapping[str, Any], chosen: BusSettings) -> PreparedTrial:
    """Return the experiment that repeats the motion of the trial `given` under today's `sections`.

    Raises `InputError` for a trial whose motion cannot be repeated.
    """
    whole, bench = read.open(given), sections["network"].bench
    names = read.path_names(whole) or ("",)
    if names != bench.path_prefixes:
        raise InputError(f"{given}: records {_paths(names)}, this bench has {_paths(bench.path_prefixes)}; give its "
                         "bench.toml with --config.")
    trials = {name: read.one_path(whole, name) if name else whole for name in names}
    setups = {name: _setup(trial, sections["network"].rate_hz) for name, trial in trials.items()}
    sent, setup = {name: sent_targets(trial) for name, trial in trials.items()}, next(iter(setups.values()))
    kept = (provenance.CONTROLLER_MODEL, *(f"{part}.csv" for part in recorded.CURVES))
    files = {name: whole.attachments[name] for name in kept if name in whole.attachments}
    files |= {f"{name}.{ATTACHMENT}" if name else ATTACHMENT: text(targets) for name, targets in sent.items()}
    made = session.prepare({**sections, **{name: getattr(setup, name) for name in SETTINGS}}, setup.reference, None,
                           chosen, dry_run=False, files=files)

    def repeated(experiment: ExperimentSetup, name: str) -> ExperimentSetup:
        own = setups[name]
        return dataclasses.replace(
            experiment, calibration=own.calibration, known=own.known, terms=own.terms, targets=sent[name])

    paths = {name: repeated(experiment, name) for name, experiment in made.paths.items()}
    return dataclasses.replace(
        made, experiment=made.experiment if paths else repeated(made.experiment, ""), paths=paths)


def _paths(names: tuple[str, ...]) -> str:
    return f"the force paths {', '.join(names)}" if len(names) > 1 else "a single force path"


def _setup(trial: Trial, rate_hz: int) -> ExperimentSetup:
    """Return the experiment of a trial; raises `InputError` where its motion cannot be repeated at the rate."""
    if trial.metadata.get("dry_run") == "true" or (trial.result or {}).get("outcome") != "completed":
        raise InputError(f"{trial.path}: --motion-of needs a trial that moved the bench to its end.")
    setup = recorded.experiment(trial)
    if setup.walk.differs:
        raise InputError(f"{trial.path}: its force follows strides that differ; --motion-of repeats a gait on the "
                         "clock.")
    if setup.network.rate_hz != rate_hz:
        raise InputError(f"{trial.path}: its targets are for {setup.network.rate_hz} Hz, the network runs {rate_hz}; "
                         f"say --rate {setup.network.rate_hz}.")
    return setup


def sent_targets(trial: Trial) -> RecordedTargets:
    """Return the targets of a trial's gait, run-in and run-out, by control cycle; raises `InputError` without them."""
    walked = np.isfinite(trial.columns["gait_percent"])
    rope, knee = (trial.columns[name][walked] for name in COLUMNS)
    if not np.isfinite(rope).all() or not np.isfinite(knee).all():
        raise InputError(f"{trial.path}: has control cycles without targets; its motion cannot be repeated.")
    return RecordedTargets(tuple(rope.tolist()), tuple(knee.tolist()))


def text(targets: RecordedTargets) -> bytes:
    """Return targets as the attachment of a trial that repeats them."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(COLUMNS)
    rows.writerows(zip(map(repr, targets.rope_m), map(repr, targets.knee_rad), strict=True))
    return out.getvalue().encode()


def targets_of(attachments: Mapping[str, bytes]) -> RecordedTargets | None:
    """Return the targets that a trial repeated; None where its controller's own were sent."""
    if ATTACHMENT not in attachments:
        return None
    rope, knee = np.loadtxt(io.BytesIO(attachments[ATTACHMENT]), delimiter=",", skiprows=1, unpack=True, ndmin=2)
    return RecordedTargets(tuple(rope.tolist()), tuple(knee.tolist()))
