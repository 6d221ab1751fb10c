"""One force path of a recorded trial of several, as a trial of a single path.

Columns `<path>.<name>`, attachments `<path>.<file>` and metadata `<path>.<key>` lose their prefix; entries without a
prefix hold for every path. So any reader of trials can read one path, without code for benches of several.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

from parameters import InputError
from trial.read import Trial, TrialFile
from trial.signals import of_path

T = TypeVar("T")
File = TypeVar("File", bound=TrialFile)
PATHS = "paths"
"""Key of the metadata that lists a trial's force paths; a trial of a single path has none."""
ALONE = "joint_alone"
"""Key of a path's metadata: true where no other path has its joint, so that its frames are those of a single path."""


def names(trial: TrialFile) -> tuple[str, ...]:
    """Return the force paths of a trial of several, in declared order; none for a trial of a single path."""
    return tuple(trial.metadata.get(PATHS, "").split())


def one_path(trial: File, path: str | None) -> File:
    """Return one force path of a trial of several as a trial; raises `InputError` for a path that it has not, or None.
    """
    known = names(trial)
    if path is None:
        raise InputError(f"{trial.path}: records the force paths {', '.join(known)}; name one with --path.")
    refuse_unknown(str(trial.path), path, known)
    metadata = {key: text for key, text in _own(trial.metadata, path, known).items() if key != PATHS}
    result = None if trial.result is None else dict(trial.result)
    homed: Any = (result or {}).pop("homed", {})
    if result is not None:
        result |= homed.get(path, {})
    others = set(known) - {path}
    stored = {name: old for old in trial.units if (name := of_path(old, path)) is not None}
    in_memory: dict[str, Any] = {"columns": {name: trial.columns[old] for name, old in stored.items()}} if isinstance(
        trial, Trial) else {}
    return dataclasses.replace(
        trial, **in_memory, stored_names=stored, units={name: trial.units[old] for name, old in stored.items()},
        derived=frozenset(filter(None, (of_path(old, path) for old in trial.derived))),
        events=tuple(event for event in trial.events if event.source not in others),
        metadata={**metadata, "path": path}, attachments=_own(trial.attachments, path, known), result=result,
        has_frames=metadata.get(ALONE) == "true")


def refuse_unknown(source: str, path: str, known: tuple[str, ...]) -> None:
    """Raise `InputError` if a file of the paths `known` does not have a path."""
    if path not in known:
        raise InputError(f"{source}: has no path {path}; " + (
            f"expected one of {', '.join(known)}." if known else "it records a single one: leave --path out."))


def _own(given: Mapping[str, T], path: str, known: tuple[str, ...]) -> dict[str, T]:
    """Return what holds for every path, and what holds for this one in its place."""
    prefixes = tuple(f"{name}." for name in known)
    common = {key: value for key, value in given.items() if not key.startswith(prefixes)}
    return common | {key.removeprefix(f"{path}."): value for key, value in given.items() if key.startswith(f"{path}.")}
