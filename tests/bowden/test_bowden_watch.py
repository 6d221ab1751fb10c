"""A trial is diagnosed while it runs: by its own process, its stop at one row, its end as `bowden diagnose` has it."""

from __future__ import annotations

import cProfile
import json
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bowden.cli.app import run
from bowden.watch.file_watch import DIAGNOSED_S, DRIFT_S, GaitWindows, LatestCycles
from diagnosis.evidence.decision import threshold
from diagnosis.finder import Finder
from estimation.data import table
from estimation.data.table import Table
from estimation.joint_fit import fit_reference
from estimation.likelihood_data import PathRecording
from estimation.path_model import PATH_MODEL
from estimation.running_evidence import DiagnosisSchedule, Naming, RunningEvidence
from tests.hidden.watch_calibration import Question, compared
from trial import read
from trial.growing import GrowingTrial
from trial.mcap_file import container, records

GAIT = ("--cycles", "4", "--period", "1.2", "--serial", "3")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reference trial of a simulated bench, and that bench with a longer pre-sliding distance as a plant model."""
    folder = tmp_path_factory.mktemp("watch")
    (folder / "bench.toml").write_text("[effects.presliding]\npresliding = 6e-4\n", encoding="utf-8")
    assert run(["trial", *GAIT, "-o", str(folder / "good.mcap"), "--json"]) == 0
    return folder


def watched(bowden: Callable[..., Any], place: Path, name: str, *words: object) -> tuple[int, dict[str, Any]]:
    """Run the changed bench under a watch; return the exit status and the JSON object."""
    status, out, err = bowden("trial", *GAIT, "--day", 1, "--plant-model", place / "bench.toml", "-o", place / name,
                              "--watch", "--healthy", place / "good.mcap", *words, "--json")
    assert out, err
    found: dict[str, Any] = json.loads(out)
    return status, found


def test_a_refused_whole_has_its_reason(place: Path, bowden: Callable[..., Any]) -> None:
    status, out, _ = bowden("watch", place / "good.mcap", "--healthy", place / "good.mcap")
    assert (status, out.splitlines()[-2]) == (0, "Verdict: refused")
    assert out.splitlines()[-1].endswith("; a healthy trial must be another one.")


@pytest.mark.slow
def test_a_torn_recording_is_said_not_to_grow(place: Path, bowden: Callable[..., Any]) -> None:
    torn = place / "torn.mcap"
    torn.write_bytes((place / "good.mcap").read_bytes()[:200_000])
    status, _, err = bowden("watch", torn, "--healthy", place / "good.mcap", "--for", 9)
    assert status == 1  # the whole is not diagnosed
    assert err.count("torn.mcap: does not grow") == 1
    assert f"bowden recover {torn} -o FILE" in err


@pytest.mark.exhaustive
def test_the_diagnosis_after_the_last_cycle_is_that_of_the_file(place: Path, bowden: Callable[..., Any]) -> None:
    status, found = watched(bowden, place, "whole.mcap")
    assert status == 0
    cycles = found["watch"]["cycles"]
    assert [one["cycle"] for one in cycles] == [0, 1, 2, 3]
    assert "presliding" in cycles[-1]["suspected"]
    # the effect acts from the first cycle on; the evidence of that one alone may be below the threshold
    assert cycles[-1]["since"] <= 1
    assert 0.2 < cycles[-1]["end_error_n"] < 3.0
    _, out, _ = bowden("diagnose", place / "whole.mcap", "--healthy", place / "good.mcap",
                       "--json")
    offline = json.loads(out)
    assert "presliding" in offline["class"]
    told = found["watch"]["diagnosis"]
    assert (told["verdict"], told["class"], told["causes"]) == (offline["verdict"], offline["class"],
                                                                offline["causes"])
    _, out, _ = bowden("watch", place / "whole.mcap", "--healthy", place / "good.mcap", "--json")
    again = json.loads(out)
    # by the file as while it was written; how much of it a cycle finds depends on the two processes' pace
    assert [one["cycle"] for one in again["cycles"]] == [0, 1, 2, 3]
    assert again["cycles"][-1]["best"] == cycles[-1]["best"]
    assert again["diagnosis"] == told


@pytest.mark.exhaustive
def test_a_named_effect_stops_the_trial_at_the_same_row_in_every_run(place: Path, bowden: Callable[..., Any]) -> None:
    digests = []
    for name in ("first.mcap", "second.mcap"):
        status, found = watched(bowden, place, name, "--stop-on", "presliding", "--cycles", 6)
        assert status != 0
        assert found["outcome"] == "stopped"
        assert "presliding" in found["watch"]["stopped_by"]
        recorded = read.open(place / name)
        assert any("requested by the watch" in event.text for event in recorded.events)
        # a diagnosis needs three cycles, and cycle 2 is whole in the file when cycle 4 begins
        assert (recorded.columns["cycle"] == 4.0).sum() < 200
        digests.append(recorded.digest())
    assert digests[0] == digests[1]


@pytest.mark.exhaustive
def test_a_reference_bench_raises_no_suspicion_and_its_trial_is_what_it_is_without_a_watch(
        place: Path, bowden: Callable[..., Any]) -> None:
    assert bowden("trial", *GAIT, "--day", 2, "-o", place / "alone.mcap", "--json").status == 0
    status, out, err = bowden("trial", *GAIT, "--day", 2, "-o", place / "beside.mcap", "--watch", "--healthy",
                              place / "good.mcap", "--stop-on", "any", "--json")
    assert status == 0, err
    told = json.loads(out)["watch"]
    assert all(one["suspected"] == [] for one in told["cycles"])
    assert told["diagnosis"]["verdict"] == "none"
    assert read.open(place / "beside.mcap").digest() == read.open(place / "alone.mcap").digest()


@pytest.mark.exhaustive
def test_a_bench_that_only_the_linear_model_suspects_is_not_suspected() -> None:
    one = compared(Question("lugre", "", 13001))
    assert one.largest >= threshold(PATH_MODEL)
    assert not one.ever
    assert one.agrees


def test_the_diagnoses_of_an_hour_are_few_even_if_the_change_seems_to_begin_anew_in_each_cycle() -> None:
    anew, steady = DiagnosisSchedule(), DiagnosisSchedule()
    times: list[list[int]] = [[], []]
    for count in range(3, 1800):
        for schedule, since, due in zip((anew, steady), (count - 3, 0), times, strict=True):
            if schedule.due(count, since):
                schedule.done(count)
                due.append(count)
    assert times[1][:5] == [3, 4, 6, 8, 11]
    assert len(times[1]) < 25
    assert len(times[0]) < 90
    late = DiagnosisSchedule()
    late.done(90)
    assert next(count for count in range(91, 100) if late.due(count, 91)) == 91


def tiled(path: Path, times: int, every: int = 5) -> Table:
    """Return the numbered cycles of a trial `times` times in succession, with each fifth of their rows."""
    once = {name: values[::every] for name, values in table.read(path).columns.items()}
    row_s = float(np.median(np.diff(once["time_s"])))
    step = {"time_s": np.ptp(once["time_s"]) + row_s, "cycle": np.ptp(once["cycle"]) + 1.0}
    return table.table("tiled", {name: np.concatenate([values + k * step.get(name, 0.0) for k in range(times)])
                                 for name, values in once.items()})


@pytest.mark.exhaustive
def test_a_cycle_of_a_long_trial_needs_no_more_calls_rows_and_memory_than_one_after_two_minutes(place: Path) -> None:
    trial, good = tiled(place / "good.mcap", 36), table.read(place / "good.mcap")
    names = tuple(trial.columns)
    latest, cut = LatestCycles(trial.source, names, Finder()), GaitWindows(names, 2.0)
    diagnosed: list[int] = []

    def stated(count: int) -> dict[str, float]:
        """Return an effect, so that every cycle is suspected, without a diagnosis."""
        diagnosed.append(len(latest.recorded(count)))
        return {"stiffness": 20.0}

    running = RunningEvidence(fit_reference(PATH_MODEL, [PathRecording(good)]), DRIFT_S, Naming(-np.inf, stated))
    calls, held = [], []
    tracemalloc.start()
    for window in cut.add(np.stack([trial[name] for name in names], axis=1)):
        counted = cProfile.Profile()
        with counted:
            latest.add(window.rows)
            running.add(*window[:3])
        calls.append(sum(row.callcount for row in counted.getstats()))
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert len(calls) == 143
    assert max(calls[-20:]) <= 1.05 * max(calls[100:120])
    assert max(held[-20:]) - max(held[100:120]) < 0.5e6  # bytes; the evidence of one cycle takes 0.2 MB
    row_s = 0.005
    assert max(diagnosed) * row_s == pytest.approx(DIAGNOSED_S, rel=0.01)
    # a third more cycles between two diagnoses: four cycles diagnosed for each of the trial
    assert sum(diagnosed) < 4 * len(trial)


GROW = """
import sys
from pathlib import Path
source, target = Path(sys.argv[1]).read_bytes(), Path(sys.argv[2])
with target.open("wb", buffering=0) as file:
    for first in range(0, len(source), 70_001):
        file.write(source[first:first + 70_001])
        print(first, flush=True)
        sys.stdin.readline()
"""


def test_rows_of_a_growing_file_are_those_of_the_whole(place: Path, tmp_path: Path) -> None:
    whole, grown = read.open(place / "good.mcap"), GrowingTrial(tmp_path / "grown.mcap")
    found, counted = [], cProfile.Profile()
    with subprocess.Popen([sys.executable, "-c", GROW, str(place / "good.mcap"), str(grown.path)], text=True,
                          stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        assert writer.stdin is not None
        assert writer.stdout is not None
        while not grown.closed:
            assert writer.stdout.readline()
            with counted:
                found.append(grown.rows())
            writer.stdin.write("\n")
            writer.stdin.flush()
        writer.communicate("\n" * 1000)
    rows = np.concatenate([one for one in found if one.size])
    assert sum(one.size > 0 for one in found) > 3
    assert grown.columns == tuple(whole.columns)
    np.testing.assert_array_equal(rows.T, np.array(list(whole.columns.values())))
    # each chunk is unpacked once, however often the file is looked at
    unpacked = sum(row.callcount for row in counted.getstats() if getattr(row.code, "co_name", "") == "unpack")
    with records.mapped(grown.path) as view:
        assert unpacked == sum(opcode == container.CHUNK for opcode, *_ in records.records(
            view, len(container.MAGIC), len(view) - len(container.MAGIC)))


def test_cycles_of_a_bus_without_numbers_are_cut_by_the_period() -> None:
    time = np.arange(0.0, 7.0, 0.01)
    rows = np.stack([time, time, time, time], axis=1)
    windows = GaitWindows(("time_s", "servo_position_m", "knee_angle_rad", "tension_start_n"), 2.0)
    found = [window for part in np.array_split(rows, 9) for window in windows.add(part)]
    assert [(window.cycle, window.begins_s) for window in found] == [(0, 0.0), (1, 2.0), (2, 4.0)]
    assert found[2].columns["time_s"][0] == pytest.approx(1.5)
    assert found[2].columns["time_s"][-1] == pytest.approx(5.99)


@pytest.mark.parametrize(("words", "said"), [
    (("trial", "-o", "x.mcap", "--watch"), "name at least one with --healthy"),
    (("trial", "-o", "x.mcap", "--stop-on", "any"), "--stop-on belongs to --watch"),
    (("trial", "-o", "x.mcap", "--watch", "--healthy", "none.csv", "--stop-on", "moon"), "--stop-on moon"),
    (("trial", "-o", "x.mcap", "--watch", "--healthy", "none.mcap"), "none.mcap: no such file"),
    (("watch", "x.mcap"), "name at least one with --healthy"),
    (("watch", "x.csv", "--healthy", "x.mcap"), "say bowden diagnose x.csv, or make a trial of it with bowden import"),
    (("watch", "--healthy", "x.mcap"), "give either a file or --interface"),
    (("watch", "y.mcap", "--healthy", "rig.csv"), "rig.csv: has no column servo_position_m, knee_angle_rad; record it"),
    (("watch", "--interface", "virtual", "--healthy", "x.mcap"), "name the file with -o FILE"),
], ids=lambda given: " ".join(given) if isinstance(given, tuple) else "")
def test_a_watch_that_cannot_watch_is_refused_in_one_sentence(here: Path, bowden: Callable[..., Any],
                                                              words: tuple[str, ...], said: str) -> None:
    (here / "rig.csv").write_text("time_s,tension_start_n\n" + "".join(f"{k / 100},{k % 7}\n" for k in range(200)))
    status, out, err = bowden(*words)
    assert (status, out) == (2, "")
    assert said in err
    assert not (here / "x.mcap").exists()
