"""Force paths of a bench of several: settings, attachments and figures of each."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bowden.bench.configuration import as_text
from bowden.deferred import on_first_use

with on_first_use():
    from bowden.trials import provenance
    from eds import declaration
    from eds.bench.bench_network import Network
    from eds.declaration import DeclaredBench, ForcePath
    from master.motion.experiment_run import ExperimentSetup
    from master.own_limits import counted, of_path
    from physics.bench_model import BenchModel
    from physics.calibration import write
    from physics.reference import Reference
    from trial import read
    from trial.read import TrialFile, one_path, path_names


def several(bench: DeclaredBench) -> bool:
    """Return whether a bench has more than one force path."""
    return len(bench.force_paths) > 1


def file_of(given: Path, path: str) -> Path:
    """Return the file of one path beside a file that a command names: own.toml and left make own.left.toml."""
    return given.with_name(f"{given.stem}.{path}{given.suffix}")


def without_file(given: Path | BenchModel, network: Network) -> set[str]:
    """Return the paths that have no file beside `given`; none of them if no path has one, or if it is no file."""
    names = {path.name for path in network.bench.force_paths}
    having = {name for name in names if isinstance(given, Path) and file_of(given, name).exists()}
    return names - having if having else set()


def bench_of(bench: str, path: str) -> str:
    """Return the bench name that a path's calibration carries; "" without a bench name."""
    return f"{bench} {path}" if bench else ""


def reference_of(reference: Reference, acts: str, co_contraction: float) -> Reference:
    """Return the reference of a path: that of an antagonist is mirrored, with its share of the force."""
    return reference.mirrored(declaration.MIRROR_RAD, co_contraction) if acts == declaration.EXTENDS else reference


def setup_of(whole: ExperimentSetup, path: ForcePath, **changed: Any) -> ExperimentSetup:
    """Return the experiment of one path."""
    network = dataclasses.replace(whole.network, bench=whole.network.bench.path(path.name))
    reference = reference_of(whole.reference, path.acts, whole.gait.co_contraction)
    limits = counted(whole.limits, whole.network.bench, path)
    return dataclasses.replace(whole, network=network, reference=reference, limits=limits, **changed)


def metadata(setups: Mapping[str, ExperimentSetup], network: Network) -> dict[str, str]:
    """Return what identifies each path in a trial, as text."""
    found = {read.PATHS: " ".join(setups)}
    for path in network.bench.force_paths:
        setup = setups[path.name]
        joints = [other.joint for other in network.bench.force_paths]
        own = {**provenance.metadata(setup), "peak_n": repr(setup.reference.peak_n), "acts": path.acts,
               read.ALONE: str(joints.count(path.joint) == 1).lower()}
        found |= {f"{path.name}.{key}": own[key] for key in ("calibration", "peak_n", "course", "acts", read.ALONE)}
    return found


def attachments(setups: Mapping[str, ExperimentSetup], sections: Mapping[str, Any]) -> dict[str, bytes]:
    """Return configuration and calibration of each path, as files of a trial of a single one."""
    found: dict[str, bytes] = {}
    bench = sections["network"].bench
    for name, setup in setups.items():
        limits = of_path(sections["limits"], bench, next(path for path in bench.force_paths if path.name == name))
        found[f"{name}.bench.toml"] = as_text({**sections, "network": setup.network, "limits": limits}).encode()
        found[f"{name}.calibration.toml"] = write(setup.calibration).encode()
    return found


def opened(file: Path, path: str | None, *, whole: bool = False) -> TrialFile:
    """Open a trial: of several force paths the one called `path`, or with `whole` all of them.

    Raises `InputError` for a trial of several paths where no path is named, and for a path that it has not.
    """
    found = read.open_file(file)
    return one_path(found, path) if path is not None or (path_names(found) and not whole) else found
