"""A calibration: scalars with evidence, read back as written, refused where it does not belong."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from parameters import InputError, Remark
from physics import calibration
from physics.calibration import Calibration, ScalarEvidence
from physics.older_files import FIRST


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "calibration.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_at_most_thirty_two_scalars_and_no_sequence() -> None:
    names = calibration.scalars()
    assert len(names) <= 32  # decision 0036
    assert all(isinstance(getattr(calibration.nominal(), name), float) for name in names)


def test_reads_back_what_it_wrote(tmp_path: Path) -> None:
    evidence = {"stiffness_b": ScalarEvidence(2.9e-4, 3.1e-4, 0.98, "2025-11-20", "stiffness.mcap", 4e-6)}
    made = dataclasses.replace(calibration.nominal(), stiffness_b=3.05e-4, bench="7", evidence=evidence)
    path = written(tmp_path, calibration.write(made))
    back = calibration.read(path, bench="7")
    assert [getattr(back, name) for name in calibration.scalars()] == [
        getattr(made, name) for name in calibration.scalars()]
    assert back.evidence["stiffness_b"] == evidence["stiffness_b"]
    assert (back.bench, back.label) == ("7", str(path))


@pytest.mark.parametrize(("old", "new", "message"), [
    ("version = 2", "version = 3", "version = 3, expected 2"),
    ('bench = "7"', 'bench = "8"', "bench = '8', but the bench on the bus is '7'"),
    ("[parameters.rope_per_knee]", "[parameters.rope_per_ankle]", "unknown parameter rope_per_ankle"),
    ('unit = "m/rad"', 'unit = "mm/deg"', "rope_per_knee is in 'mm/deg', expected 'm/rad'"),
    ("value = 0.13", "value = 13.0", r"cable_exponent = 13\.0 is outside 0 … 1"),
    ("value = 0.13", 'value = "much"', "cable_exponent = 'much' is not a number"),
    ("value = 0.13", "value = 0.13\ninterval = [0.2, 0.1]", "low above high"),
    ("value = 0.13", "value = 0.13\ninterval = [0.2]", r"expected \[low, high\]"),
])
def test_refuses_with_the_reason(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = calibration.write(dataclasses.replace(calibration.nominal(), bench="7"))
    assert text.count(old) >= 1
    path = written(tmp_path, text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        calibration.read(path, bench="7")


def first_version(made: Calibration) -> str:
    """A file as version 1 had it: [scalars.NAME] with a calibration's own names."""
    text = calibration.write(made).replace("version = 2", "version = 1")
    older = {name: first for first, name in FIRST.items()}
    for name in calibration.scalars():
        text = text.replace(f"[parameters.{name}]", f"[scalars.{older.get(name, name)}]")
    return text.replace('unit = "1/rad"', 'unit = "rad/rad"')


def test_a_file_of_the_first_version_is_read(tmp_path: Path) -> None:
    made = dataclasses.replace(calibration.nominal(), rope_per_knee=0.041, stribeck_memory=0.03, bench="7")
    back = calibration.read(written(tmp_path, first_version(made)), bench="7")
    assert [getattr(back, name) for name in calibration.scalars()] == [
        getattr(made, name) for name in calibration.scalars()]


def test_what_a_bench_model_does_not_tell_is_assumed_and_said(tmp_path: Path) -> None:
    text = re.sub(r"\[parameters\.presliding\][^\[]*", "", calibration.write(calibration.nominal()))
    with pytest.warns(Remark, match="says nothing of presliding; taken as assumed"):
        assert calibration.read(written(tmp_path, text)).lacking == ("presliding",)


def test_a_peak_beyond_the_turning_point_is_refused() -> None:
    soft = Calibration(stiffness_a=-3e-6)
    calibration.refuse_beyond_validity(soft, 49.0)
    with pytest.raises(InputError, match=r"60 N is beyond the turning point.*50\.0 N"):
        calibration.refuse_beyond_validity(soft, 60.0)


def test_an_older_calibration_loads_with_neutral_values_and_says_so(tmp_path: Path) -> None:
    text = first_version(dataclasses.replace(calibration.nominal(), breakaway=0.2))
    for name in calibration.LATER:
        text = re.sub(rf"\[scalars\.{name}\].*?(?=\n\[|\Z)", "", text, flags=re.DOTALL)
    back = calibration.read(written(tmp_path, text))
    assert back.lacking == calibration.LATER
    assert back.fabric_breakaway == 0.2
    assert (back.stretch_short, back.load_slope, back.viscous, back.start_gain) == (0.0, 0.0, 0.0, 1.0)
    [sentence] = calibration.said_of(back, 50.0)
    assert "neutral values are taken" in sentence
    assert "stretch_short" in sentence


def test_a_force_beyond_what_was_identified_is_said() -> None:
    known = dataclasses.replace(calibration.nominal(), identified_to=60.0)
    assert calibration.said_of(known, 59.0) == []
    assert "identified up to 60 N" in calibration.said_of(known, 77.0)[0]
