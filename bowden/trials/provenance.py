"""Provenance of a trial: operator, devices, configuration, calibration and software.

No wall time, no output path and no truth of a simulated bench is included, so that one configuration and seed give
one file.
"""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import asdict
from hashlib import sha256
from importlib import metadata as installed
from pathlib import Path
from typing import Any

from bowden.bench import configuration
from bowden.bench.configuration import PERSON, as_text
from bowden.deferred import on_first_use

with on_first_use():
    from eds.bench import bench_network
    from eds.dictionary import packaged
    from master.motion.experiment_run import ExperimentSetup
    from physics.bench_model import BenchModel
    from physics.calibration import Calibration, write
    from safety_monitor import read

CONTROLLER_MODEL = "controller_model.toml"
PACKAGES = ("bowden-bench", "canopen", "mcap", "numba", "numpy", "python-can", "scipy", "zstandard")


def metadata(experiment: ExperimentSetup, script: str = "") -> dict[str, str]:
    """Return the identity of the trial, as text; `script` names the experiment run in place of the gait."""
    gait = experiment.gait
    compensated = [*experiment.known, *(f"{term.carrier} × {term.modulation}" for term in experiment.terms)]
    return {
        "experiment": script or "gait",
        "controller": gait.controller,
        **({"tuning": gait.tuning} if gait.tuning else {}),
        **({"controller_model": ", ".join(compensated)} if compensated else {}),
        "calibration": Path(experiment.calibration.label).name,
        "peak_n": repr(gait.peak_n),
        "period_s": repr(gait.period_s),
        "course": course(experiment),
        "cycles": str(experiment.walk.parts or gait.cycles),
        "settle": str(gait.settle),
        "rate_hz": str(experiment.network.rate_hz),
        "bitrate": str(experiment.network.bitrate),
        "dry_run": str(experiment.dry_run).lower(),
        **monitored(experiment.network.monitor),
        **{name: text for name, text in asdict(experiment.record).items() if text},
        "commit": commit(),
    }


def monitored(file: str) -> dict[str, str]:
    """Return the digest of the safety monitor's file and whose bounds it has; nothing without a monitor."""
    if not file:
        return {}
    bounds = read(Path(file))
    return {"monitor_person": bounds.person, "monitor_sha256": bounds.sha256}


def course(experiment: ExperimentSetup) -> str:
    """Return a digest of desired knee motion and force, to a millionth: a replay compares it with its own."""
    followed = experiment.reference if experiment.motion is None else experiment.motion
    wanted = [experiment.reference.at(i / 100) for i in range(100)]
    numbers = [round(value * 1e6) for i, at in enumerate(wanted)
               for value in (at.knee_angle_rad, at.force_n, followed.knee_angle(i / 100))]
    told: tuple[Any, ...] = (numbers, round(followed.period_s * 1e9))
    if experiment.reference.surface is not None:
        told += tuple((1e6 * column).round().tolist() for column in experiment.reference.surface)
    if experiment.strides:
        told += ([[round(angle * 1e6) for angle in stride.angle_rad] for stride in experiment.strides], experiment.walk)
    return sha256(repr(told).encode()).hexdigest()[:16]


def attachments(calibration: Calibration, sections: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the files that make the trial readable alone: configuration, calibration, packages, EDS files."""
    devices = {f"{name}.eds": packaged(name).read_bytes() for name in sorted(set(bench_network.FILES.values()))}
    devices |= {Path(mapping.file).name: Path(mapping.file).read_bytes()
                for mapping in sections["network"].bench.other_devices.values() if mapping.file}
    devices |= {Path(device.type.file).name: Path(device.type.file).read_bytes()
                for device in sections["network"].bench.observers}
    if sections["network"].monitor:
        devices[PERSON] = Path(sections["network"].monitor).read_bytes()
    return {
        "bench.toml": as_text(sections).encode(),
        "calibration.toml": write(calibration).encode(),
        configuration.SAFETY_TABLE: configuration.held_as_csv(configuration.held_limits(sections)),
        "packages.txt": "".join(f"{name}=={_version(name)}\n" for name in PACKAGES).encode(),
        **devices,
    }


def curves(**files: Path | None) -> dict[str, bytes]:
    """Return the files that a reference was made from, by their parts' names: knee.csv, desired.csv."""
    return {f"{part}.csv": path.read_bytes() for part, path in files.items() if path is not None}


def controller_model(given: Path | BenchModel | None) -> dict[str, bytes]:
    """Return the effects given to the controller, under their part's name."""
    if given is None:
        return {}
    return {CONTROLLER_MODEL: given.read_bytes() if isinstance(given, Path) else given.text().encode()}


def _version(name: str) -> str:
    try:
        return installed.version(name)
    except installed.PackageNotFoundError:
        return "not installed"


def commit() -> str:
    """Return the commit of the source tree in use, "+" behind it if the tree differs; "" outside a repository."""
    here = Path(__file__).resolve().parents[2]
    if not (here / ".git").exists():  # installed: a repository around it is not this project's
        return ""
    try:
        told = subprocess.run(
            ["git", "-C", str(here), "describe", "--always", "--abbrev=40", "--dirty=+", "--exclude=*"],
            capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return told.stdout.strip() if told.returncode == 0 else ""
