"""A bench without END runs from its packaged declaration: trial, report, replay, diagnosis, stop."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import bowden as api
from bowden.bench import configuration
from bowden.trials.recorded import sections
from eds.declaration import packaged, text_of
from trial.read import open as opened

Command = Callable[..., tuple[int, str, str]]
OF_END = ("relative_rmse_percent", "relative_rmse_window_percent", "max_idle_tension_n", "peak_jump_n")


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the configuration, a trial of four gait cycles, and its figures as JSON."""
    folder = tmp_path_factory.mktemp("start_only")
    (folder / "bench.toml").write_text(configuration.as_template(shape="bench_start_only"))
    told = api.run(
        api.Experiment(peak_n=20, period_s=1, cycles=4, rate_hz=500, configuration=folder / "bench.toml"),
        output=folder / "trial.mcap")
    (folder / "figures.json").write_text(json.dumps(told.figures))
    return folder


def test_figures_that_need_end_are_absent_and_the_true_ones_are_there(ran: Path) -> None:
    figures = json.loads((ran / "figures.json").read_text())
    assert (figures["outcome"], figures["missed_cycles"], figures["stale_inputs"]) == ("completed", 0, 0)
    assert [figures[name] for name in OF_END] == [None] * 4
    assert figures["true_relative_rmse_percent"] < 6.0


def test_nothing_of_end_is_on_the_bus_or_in_the_cycle(ran: Path) -> None:
    trial = opened(ran / "trial.mcap")
    ids = set(np.unique(trial.frames["can_id"]).tolist())
    assert {0x181, 0x182, 0x183, 0x201} <= ids
    assert not ids & {0x084, 0x184, 0x584, 0x604, 0x704}
    for name in ("tension_end_n", "end_pdo_age_ns", "end_pdo_arrival_ns"):
        assert np.isnan(trial.columns[name]).all()
    assert not trial.columns["missed_inputs"].any()


def test_the_trial_carries_its_declaration(ran: Path) -> None:
    assert sections(opened(ran / "trial.mcap"))["network"].bench == packaged("bench_start_only")


def test_the_controller_s_steps_are_made_again(ran: Path, bowden: Command) -> None:
    status, out, _ = bowden("replay", ran / "trial.mcap", "--onto", "controller", "--json")
    assert (status, json.loads(out)["same"]) == (0, True)


def test_the_report_says_why_figures_are_absent(ran: Path, bowden: Command) -> None:
    assert bowden("report", ran / "trial.mcap", "-o", ran / "report.html")[0] == 0
    assert "No figures of force: END (measured) not known." in (ran / "report.html").read_text()


@pytest.mark.exhaustive
def test_the_diagnosis_says_what_end_would_tell(ran: Path, bowden: Command) -> None:
    status, out, _ = bowden("diagnose", ran / "trial.mcap", "--json")
    assert status == 0
    assert "With tension_end_n recorded these could be told" in out


def test_a_start_that_is_cut_off_lets_the_rope_go(here: Path, bowden: Command) -> None:
    (here / "bench.toml").write_text(text_of("bench_start_only"))
    bus = api.simulated(faults=[{"kind": "cut", "node": 3, "start_s": 3.0}])
    told = api.run(api.Experiment(peak_n=20, period_s=1, cycles=2, rate_hz=500, configuration=here / "bench.toml"),
                   bus=bus)
    assert told.outcome == "stopped"
    assert "start" in str(told.figures["stop_reason"])


def test_end_cannot_be_tared(here: Path, bowden: Command) -> None:
    (here / "bench.toml").write_text(text_of("bench_start_only"))
    status, out, err = bowden("tare", "end", "--config", "bench.toml", "--interface", "bowden")
    assert status in (1, 2)
    assert "the declared bench has no load cell end" in out + err


def test_init_writes_the_shape_and_refuses_an_unknown_one(here: Path, bowden: Command) -> None:
    assert bowden("init", "--shape", "bench_start_only", "-o", "one.toml")[0] == 0
    assert configuration.read(here / "one.toml")["network"].bench == packaged("bench_start_only")
    status, out, err = bowden("init", "--shape", "bench_three_legs", "-o", "two.toml")
    assert (status, out, (here / "two.toml").exists()) == (2, "", False)
    assert "expected one of bench, bench_start_only" in err


@pytest.mark.exhaustive
def test_a_bench_without_end_is_identified_and_controlled(here: Path, bowden: Command) -> None:
    (here / "bench.toml").write_text(text_of("bench_start_only"))
    assert bowden("identify", "all", "--config", "bench.toml", "-o", "own.toml")[0] == 0
    status, out, _ = bowden("trial", "--config", "bench.toml", "--calibration", "own.toml", "--controller", "extended",
                            "--peak", 40, "--cycles", 6, "-o", "trial.mcap", "--json")
    assert status == 0
    assert json.loads(out)["true_relative_rmse_percent"] < 0.6
