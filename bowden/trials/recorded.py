"""The experiment of a recorded trial, from its attachments and metadata.

Everything comes out of the file, read by the same code as when the trial was run; nothing is taken from the machine.
"""

from __future__ import annotations

import atexit
import dataclasses
import functools
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bowden.bench import configuration
from bowden.deferred import on_first_use
from bowden.trials import force_paths
from parameters import InputError, read_toml
from physics.effects.separating_experiments import SCRIPTED

with on_first_use():
    from bowden.trials import provenance, repeated_motion, session
    from master.motion.experiment_run import ExperimentSetup
    from physics.calibration import Calibration, read
    from trial.read import Trial

FILES = ("bench.toml", "calibration.toml")
CURVES = ("knee", "desired")


def experiment(recorded: Trial, *, scripts: bool = False, allowed: str | None = None) -> ExperimentSetup:
    """Build the experiment of a trial; raises `InputError` where the file does not carry it, or it is no gait.

    `scripts` also takes those that ran in place of the gait (see `script`).  `allowed`: the controller "module:Class"
    that may be imported because the trial names it; a received file must not decide which code runs.
    """
    if recorded.metadata.get("experiment") != "gait" and not (scripts and script(recorded)):
        told = recorded.metadata.get("experiment", "nothing of the kind")
        raise InputError(f"{recorded.path}: records {told}, not a gait; give a trial of bowden trial.")
    with _unpacked(recorded, FILES) as folder:
        chosen = sections(recorded)
        named = chosen["gait"].controller
        if ":" in named and named != allowed:
            raise InputError(f"{recorded.path}: its controller is {named!r}, which replaying would import; read that "
                             f"code, then say --allow-controller {named}, or install it as an entry point.")
        knee, desired = (folder / f"{part}.csv" if f"{part}.csv" in recorded.attachments else None for part in CURVES)
        reference, chosen["gait"], _ = session.reference(
            chosen["gait"], knee, desired, period_given=True, peak_given=False, walk=chosen["walk"],
            rate_hz=chosen["network"].rate_hz)
        reference = force_paths.reference_of(
            reference, recorded.metadata.get("acts", ""), chosen["gait"].co_contraction)
        model = folder / provenance.CONTROLLER_MODEL
        made = ExperimentSetup(
            reference=reference, calibration=read(folder / "calibration.toml"),
            strides=session.strides(knee, chosen["walk"]),
            **session.beyond(model if model.exists() else None), dry_run=recorded.metadata.get("dry_run") == "true",
            targets=repeated_motion.targets_of(recorded.attachments), **chosen)
    if recorded.metadata.get("course", provenance.course(made)) != provenance.course(made):
        raise InputError(f"{recorded.path}: the motion or force it was run with is not in the file; "
                         "give a trial of bowden trial.")
    return made


def script(recorded: Trial) -> str:
    """Return the name of the experiment that a trial ran in place of the gait; "" if none is known."""
    named = recorded.metadata.get("experiment", "")
    return named if named in SCRIPTED else ""


def sections(recorded: Trial) -> dict[str, Any]:
    """Return the configuration that a trial carries, as its checked sections; the defaults if it carries none."""
    if "bench.toml" not in recorded.attachments:
        return configuration.read(None)
    with _unpacked(recorded, ("bench.toml",)) as folder:
        monitor = read_toml(folder / "bench.toml").get("monitor")
        named = monitor.get("file") if isinstance(monitor, dict) else None
        person = _own_file(recorded, named, "the safety monitor") if named and isinstance(named, str) else None
        found = configuration.read(folder / "bench.toml", person=person)
    bench = found["network"].bench
    inside = {device.node_id: dataclasses.replace(
        device.mapping, file=str(_own_file(recorded, device.mapping.file, device.name)))
        for device in bench.devices if device.mapping.file}
    return {**found, "network": dataclasses.replace(found["network"], bench=bench.mapped(inside))}


def _own_file(recorded: Trial, named: str, place: str) -> Path:
    """Return a copy of a file that bench.toml names, from the trial's attachments, never a file of this computer.

    A received file must not decide which files are read. Raises `InputError` where it is not attached.
    """
    name = Path(named).name
    if name not in recorded.attachments:
        raise InputError(f"{recorded.path}: its bench.toml names {named!r} for {place}, which is not attached; a "
                         "recording reads the files of its bench from its own attachments alone.")
    return copied(name, recorded.attachments[name])


def copied(name: str, content: bytes) -> Path:
    """Return a file of that name and content, which lasts as long as this process."""
    path = _copies() / sha256(content).hexdigest() / name
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    return path


@functools.cache
def _copies() -> Path:
    """Return the folder of the copies, which lasts as long as this process: they are read after their trial."""
    folder = tempfile.mkdtemp(prefix="bowden-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def calibration(recorded: Trial) -> Calibration:
    """Return the calibration that a trial was run with; raises `InputError` if it carries none."""
    with _unpacked(recorded, ("calibration.toml",)) as folder:
        return read(folder / "calibration.toml")


@contextmanager
def _unpacked(recorded: Trial, needed: tuple[str, ...]) -> Iterator[Path]:
    attached: Mapping[str, bytes] = recorded.attachments
    for name in needed:
        if name not in attached:
            raise InputError(f"{recorded.path}: {name} is not attached; give a trial of bowden trial.")
    with TemporaryDirectory(prefix="bowden-") as folder:
        for name in (*needed, provenance.CONTROLLER_MODEL, *(f"{part}.csv" for part in CURVES)):
            if name in attached:
                (Path(folder) / name).write_bytes(attached[name])
        yield Path(folder)
