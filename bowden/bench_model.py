"""What a bench is known to be: a calibration, and the effects that a diagnosis found beyond it.

The rule of this file: it alone knows which files and classes a bench model is made of; the rest of the library hands
it on.  SI throughout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parameters import InputError, read_toml

if TYPE_CHECKING:
    from physics.calibration import Calibration

Effects = Mapping[str, Mapping[str, float]]
"""Effect → parameter → value, SI; names of `docs/effects.md`."""


@dataclass(frozen=True)
class BenchModel:
    """The model of one bench: measured scalars with their evidence, and effects with their values.

    `calibration` is what `bowden.identify` measured (`physics.calibration.Calibration`); `effects` is empty for a
    bench that nothing is wrong with.
    """

    calibration: Calibration
    effects: Effects = field(default_factory=dict)
    evidence: str = field(default="", repr=False)
    """The text of extended.toml that the effects were read from or found with; "" where there is none."""

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the calibration as TOML, as `bowden identify -o` does; raises `InputError` for an existing file."""
        from physics.calibration import write

        return _written(Path(path), write(self.calibration), overwrite=overwrite)

    def save_effects(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the effects as extended.toml, as `bowden diagnose -o` does."""
        return _written(Path(path), self.effects_text(), overwrite=overwrite)

    def effects_text(self) -> str:
        """Return the effects as the text of an extended.toml."""
        tables = "\n".join(
            "\n".join((f"[effects.{name}]", *(f"{key} = {value!r}" for key, value in values.items()), ""))
            for name, values in self.effects.items())
        return self.evidence or tables

    def plant_tables(self) -> dict[str, Any]:
        """Return what the simulated bench takes as its plant model: the effects."""
        return {"effects": {name: dict(values) for name, values in self.effects.items()}}

    def calibration_tables(self) -> dict[str, Any]:
        """Return the calibration as the tables of its TOML file, as the diagnosis takes it."""
        import tomllib

        from physics.calibration import write

        return tomllib.loads(write(self.calibration))


Model = BenchModel | str | Path
"""A bench model, or the calibration.toml that holds one."""


def nominal() -> BenchModel:
    """Return the packaged model: the paper's numbers, belonging to no bench."""
    from physics import calibration

    return BenchModel(calibration.nominal())


def read(calibration: str | Path, effects: str | Path | None = None, *, bench: str = "") -> BenchModel:
    """Read a model from calibration.toml, and extended.toml where `effects` names one; raises `InputError`.

    `bench`: the bench that the calibration must belong to; "" for any.
    """
    from physics import calibration as scalars
    from physics.effects.effects_table import stated

    measured = scalars.read(Path(calibration), bench=bench)
    if effects is None:
        return BenchModel(measured)
    return BenchModel(measured, stated(read_toml(Path(effects)), str(effects)),
                      Path(effects).read_text(encoding="utf-8"))


def extended(calibration: Calibration, text: str) -> BenchModel:
    """Return the model of a calibration and the text of an extended.toml."""
    import tomllib

    from physics.effects.effects_table import stated

    return BenchModel(calibration, stated(tomllib.loads(text), "extended.toml"), text)


def given(model: Model | None) -> BenchModel:
    """Return a model however it was given; the nominal one for None."""
    if model is None:
        return nominal()
    return model if isinstance(model, BenchModel) else read(model)


def _written(path: Path, text: str, *, overwrite: bool) -> Path:
    from bowden import output_files

    output_files.refuse([path], overwrite=overwrite)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give a writable place.") from None
    return path
