"""extended.toml: what was found is what simulator and controller load."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis.extension import extended, text
from diagnosis.findings import Findings
from eds.declaration import PathNodes
from estimation.data.table import Table, table
from parameters import InputError
from physics.bench_model import BenchModel, read
from physics.calibration import ScalarEvidence
from physics.conversions import SIMULATED, converted
from physics.effects.catalogue import CATALOGUE, apply, complete
from virtual_bus.machine import plant_model

NODES = PathNodes(1, 2, 3, 4)
"""Node ids of the packaged bench."""

TRIAL: Table = table("runs/gait.mcap", {"time_s": np.arange(0.0, 13.0, 0.5), "tension_end_n": np.ones(26)})


def cause(name: str, **values: float) -> dict[str, Any]:
    units = {p.name: p.unit for p in CATALOGUE[name].parameters}
    told = {key: {"value": value, "low": 0.9 * value, "high": 1.1 * value, "unit": units[key]}
            for key, value in values.items()}
    return {"effect": name, "site": CATALOGUE[name].site, "parameters": told, "gain_percent": 31.234}


def test_what_is_written_is_read_and_reaches_the_plant(tmp_path: Path) -> None:
    found = Findings("ambiguous", [cause("presliding", presliding=4e-4), cause("end_gain", end_gain=1.05)],
                     ["presliding", "end_gain", "stiffness"], "amplitude_sweep", lowpass_hz=20.0,
                     reference="nominal")
    path = tmp_path / "extended.toml"
    path.write_text(text(found, [TRIAL]), encoding="utf-8")
    extension = read(path)
    assert extension.effects == {"presliding": {"presliding": 4e-4}, "end_gain": {"end_gain": 1.05}}
    assert extension.found["on"] == ["gait.mcap"]
    assert extension.found["class"] == ["presliding", "end_gain", "stiffness"]
    assert extension.found["gain_percent"] == {"presliding": 31.23, "end_gain": 31.23}
    assert extension.found["lowpass_hz"] == 20.0
    assert plant_model.read(str(path), NODES).effects == apply(extension.effects)


def test_the_bench_stands_in_the_same_file_as_what_was_found(tmp_path: Path) -> None:
    known = BenchModel({"mu1": 0.11, "rope_zero": 0.03}, {"mu1": ScalarEvidence(0.10, 0.12)})
    found = Findings("found", [cause("presliding", presliding=4e-4)], ["presliding"], reference="healthy",
                     bench=known)
    path = tmp_path / "extended.toml"
    path.write_text(text(found, [TRIAL]), encoding="utf-8")
    model = read(path)
    assert model.values == known.values
    assert model.evidence["mu1"] == ScalarEvidence(0.10, 0.12)
    assert model.effects == {"presliding": {"presliding": 4e-4}}
    simulated = plant_model.read(str(path), NODES).effects["plant"]
    assert simulated["mu1"] == 0.11
    assert simulated["presliding_m"] == 4e-4


def test_an_effect_per_trial_says_how_long_the_trial_was(tmp_path: Path) -> None:
    path = tmp_path / "extended.toml"
    drift = Findings("found", [cause("friction_drift", friction_drift=0.4)], ["friction_drift"],
                     reference="nominal")
    path.write_text(text(drift, [TRIAL]), encoding="utf-8")
    assert plant_model.read(str(path), NODES).effects["plant"]["friction_drift_s"] == 12.5


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_every_effect_of_the_catalogue_can_be_written_and_read(name: str, tmp_path: Path) -> None:
    values = {p.name: 0.75 * p.likely[0] + 0.25 * p.likely[1] for p in CATALOGUE[name].parameters}
    path = tmp_path / "extended.toml"
    found = Findings("found", [cause(name, **values)], [name], reference="nominal")
    path.write_text(text(found, [TRIAL]), encoding="utf-8")
    told = read(path).effects[name]
    assert {key: told[key] for key in values} == values
    assert complete(name, told)


def test_another_model_of_the_bench_is_extended_by_the_change() -> None:
    """The two divide the friction differently: not the coefficient is common to them, but how far an exponent moves."""
    bench = BenchModel({"mu1": 0.1, "mu2": 0.3, "fabric_wrap": 0.2, "load_slope": 0.1})
    calibration = BenchModel({"cable_exponent": 0.27, "mu2": 0.012, "phi0": 6.0, "fabric_wrap": 1.0,
                              "load_slope": -0.1, "stiffness_b": 1e-4, "stiffness_a": 0.0})

    def on_calibration(name: str, was: float, **value: float) -> BenchModel:
        changed = {**cause(name, **value), "was": dict.fromkeys(value, was)}
        return extended(calibration, Findings("found", [changed], [name], bench=bench, reference="healthy"), [TRIAL])

    known = converted(SIMULATED, calibration.values)["mu1"]
    cable = on_calibration("cable_friction", 0.1, mu1=0.15).effects
    assert cable["cable_friction"]["mu1"] == pytest.approx(known + 0.05)
    wrapped = on_calibration("fabric_wrap", 0.2, fabric_wrap=0.6)
    assert wrapped.values["mu2"] * wrapped.values["phi0"] == pytest.approx(0.072)
    assert wrapped.values["mu2"] * wrapped.effects["fabric_wrap"]["fabric_wrap"] == pytest.approx(0.012 + 0.3 * 0.4)
    slope = on_calibration("load_dependent_friction", 0.1, load_slope=0.4).effects
    assert slope["load_dependent_friction"]["load_slope"] == pytest.approx(-0.1 + 0.3)
    assert on_calibration("presliding", 3e-4, presliding=6e-4).effects == {"presliding": {"presliding": 6e-4}}


def test_nothing_found_is_an_empty_model(tmp_path: Path) -> None:
    path = tmp_path / "extended.toml"
    path.write_text(text(Findings("none"), [TRIAL]), encoding="utf-8")
    assert read(path).effects == {}


def test_a_refused_trial_extends_nothing() -> None:
    with pytest.raises(InputError, match=r"gait\.mcap: refused"):
        text(Findings("refused", warnings=["a clock runs fast"]), [TRIAL])


@pytest.mark.parametrize(("written", "says"), [
    ("[plant]\nmu1 = 0.1\n", "unknown table plant"), ("found = 3\n", "found is not a table"),
    ("[effects.gremlin]\n", "gremlin is not in the catalogue"),
])
def test_another_file_is_refused(written: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "other.toml"
    path.write_text(written, encoding="utf-8")
    with pytest.raises(InputError, match=f"{path.name}.*{says}"):
        read(path)
