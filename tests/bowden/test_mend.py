"""`bowden mend`: journal, resumption, and a bench that is repaired overnight."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import bowden
from bowden.bench import configuration
from bowden.mending.journal import Journal
from bowden.mending.mended_bench import MendedBench, paired_interval
from bowden.models.diagnosing import DiagnosisResult
from bowden.trials import recorded
from diagnosis.findings import Findings
from diagnosis.laws.law_result import Laws
from parameters import InputError
from physics import bench_model
from physics.terms import Term
from trial import read

SETTINGS = {"reference": ["good.mcap"], "hours": 1.0}


def test_a_resumed_journal_returns_what_was_done_and_does_the_rest(tmp_path: Path) -> None:
    first = Journal(tmp_path / "journal.jsonl", SETTINGS, resume=False)
    first.step("gait", lambda: {"file": "gait.mcap"})
    again = Journal(tmp_path / "journal.jsonl", SETTINGS, resume=True)
    assert again.step("gait", lambda: pytest.fail("done twice")) == {"file": "gait.mcap"}
    assert again.step("diagnosis", lambda: {"verdict": "none"}) == {"verdict": "none"}
    assert [line["step"] for line in again.lines] == ["settings", "gait", "diagnosis"]


@pytest.mark.parametrize("cut", [1, 5, 20])
def test_a_line_that_a_killed_process_cut_short_is_done_again(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "journal.jsonl"
    Journal(path, SETTINGS, resume=False).step("gait", lambda: {"file": "gait.mcap"})
    path.write_bytes(path.read_bytes()[:-cut])
    again = Journal(path, SETTINGS, resume=True)
    assert again.step("gait", lambda: {"file": "new.mcap"}) == {"file": "new.mcap"}
    assert [json.loads(line)["step"] for line in path.read_text("utf-8").splitlines()] == ["settings", "gait"]


def test_a_journal_of_another_run_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    Journal(path, SETTINGS, resume=False).step("gait", dict)
    with pytest.raises(InputError, match="a run was recorded here"):
        Journal(path, SETTINGS, resume=False)
    with pytest.raises(InputError, match=r"was begun with hours [\d.]+, not 2\.0; resume with the same options"):
        Journal(path, {**SETTINGS, "hours": 2.0}, resume=True)
    with pytest.raises(InputError, match="expected home"):
        Journal(path, SETTINGS, resume=True).step("home", dict)


def test_the_interval_of_paired_gains_is_students() -> None:
    low, high = paired_interval([2.0, 2.1, 2.2, 2.1], [1.0, 1.2, 1.1, 1.1])
    assert (round(low, 3), round(high, 3)) == (0.87, 1.13)


def test_a_single_pair_has_no_interval() -> None:
    found = MendedBench("time is up", Path("night"), before=[2.0], after=[1.0])
    assert (found.gain, found.interval, found.scatter) == (1.0, None, "one pair of trials, so no interval")


def test_a_size_is_scaled_from_where_the_bench_was() -> None:
    cause = {"effect": "cable_friction", "was": {"mu1": 0.1}, "parameters": {
        "mu1": {"value": 0.2, "low": 0.18, "high": 0.22, "unit": ""}}}
    term = Term("zero", "step", {"at_s": 1.0}, (2e-3,), ((1e-3, 3e-3),), "m", "geometry", "zero")
    found = Findings("found", [cause], laws=Laws([term], [20.0], {}, [], 1))
    scaled = DiagnosisResult(found, [], [], None).scaled(1.5)
    row = scaled.causes[0]["parameters"]["mu1"]
    assert [row[key] for key in ("value", "low", "high")] == pytest.approx([0.25, 0.22, 0.28])
    assert scaled.terms[0].coefficients == pytest.approx((3e-3,))


def test_a_reference_that_is_no_recorded_trial_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"good\.csv: a reference trial of mend"):
        bowden.mend([tmp_path / "good.csv"], tmp_path / "night")


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    good = tmp_path / "good.mcap"
    bowden.run(bowden.Experiment(cycles=1, settle=0, period_s=0.6), output=good)
    with pytest.raises(InputError, match=r"good\.mcap/night: cannot be made"):
        bowden.mend([good], good / "night")


@pytest.mark.parametrize(("shape", "sentence"), [
    ("bench_start_only", "has no END load cell"), ("bench_two_legs", "repairs a bench of one"),
    ("bench_no_knee_drive", r"good\.mcap: was recorded on a bench with other devices than"),
])
def test_a_bench_that_no_run_can_repair_is_refused(tmp_path: Path, shape: str, sentence: str) -> None:
    good, bench = tmp_path / "good.mcap", tmp_path / "bench.toml"
    bowden.run(bowden.Experiment(cycles=1, settle=0, period_s=0.6), output=good)
    bench.write_text(configuration.as_template(shape=shape), encoding="utf-8")
    with pytest.raises(InputError, match=sentence):
        bowden.mend([good], tmp_path / "night", configuration=bench)
    assert not (tmp_path / "night").exists()


@pytest.mark.exhaustive
def test_the_declared_bench_is_the_one_that_runs(
        tmp_path: Path, bowden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bench.toml").write_text(configuration.as_template(shape="bench_no_knee_drive"), encoding="utf-8")
    walk = ("--config", "bench.toml", "--cycles", 4)
    assert bowden("trial", *walk, "--period", 1.2, "-o", "good.mcap").status == 0
    done = bowden("mend", *walk, "--reference", "good.mcap", "--hours", 0, "--seed", 5, "-o", "night", "--json")
    assert done.status == 0, done.stderr
    good, gait = (recorded.sections(read.open(Path(name)))["network"].bench.shape
                  for name in ("good.mcap", "night/gait.mcap"))
    assert gait == good


@pytest.mark.exhaustive
def test_a_bench_is_repaired_and_a_killed_run_goes_on(tmp_path: Path) -> None:
    good = tmp_path / "good.mcap"
    bowden.run(bowden.Experiment(cycles=6, period_s=1.3), bus=bowden.simulated(serial=3), output=good)
    worn = bowden.simulated(serial=3, plant_model={"effects": {"start_gain": {"start_gain": 1.06}}})
    night = tmp_path / "night"
    found = bowden.mend([good], night, bus=worn, cycles=6)
    assert found.kept, found
    assert "start_gain" in found.names
    assert (night / "mend.html").exists()
    lines = (night / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (night / "journal.jsonl").write_bytes(b"".join(lines[:-1]) + lines[-1][:10])
    again = bowden.mend([good], night, bus=worn, cycles=6, resume=True)
    assert (again.kept, again.before, again.after) == (True, found.before, found.after)


@pytest.mark.exhaustive
def test_an_effect_that_is_likely_and_not_named_is_decided_by_the_loop(tmp_path: Path) -> None:
    good = tmp_path / "good.mcap"
    bowden.run(bowden.Experiment(cycles=6, period_s=1.3), bus=bowden.simulated(serial=3), output=good)
    worn = bowden.simulated(serial=3, plant_model={"effects": {"cable_friction": {"mu1": 0.105}}})
    found = bowden.mend([good], tmp_path / "night", bus=worn, cycles=6)
    assert (found.verdict, list(found.names)) == ("none", [])
    assert found.kept, found
    assert "likely and not named" in found.ending
    assert "Named" not in (tmp_path / "night" / "mend.html").read_text("utf-8")
    extension = bench_model.read(tmp_path / "night" / "extended.toml")
    assert set(extension.effects) <= {"cable_friction", "cable_bend"}
