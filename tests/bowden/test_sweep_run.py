"""A sweep end to end: the figures of `bowden trial`, resumed, interrupted, identified once, on a Dask cluster."""

from __future__ import annotations

import csv
import importlib
import json
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from bowden.bench import configuration
from bowden.models.diagnose_each import ReferenceCondition, diagnose_each
from bowden.sweep import rows as sweep_rows
from bowden.sweep import run, summary
from bowden.sweep.row_trial import FIGURES
from bowden.sweep.sweep_table import SweepTable
from bowden.workers import ENDED, Workers, local, workers_of
from parameters import InputError
from physics.calibration import nominal, write

SHORT = ("--grid", "cycles=2", "--grid", "period=0.6", "--grid", "controller=none")


def lines(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def planned(*axes: str) -> list[sweep_rows.Row]:
    short = ("cycles=2", "period=0.6", "controller=none")
    return sweep_rows.rows(configuration.read(None), {}, [sweep_rows.axis(text) for text in (*short, *axes)])


def test_a_row_holds_what_the_trial_says_and_a_second_sweep_continues(bowden: Callable[..., Any], here: Path) -> None:
    told = bowden("sweep", *SHORT, "--grid", "serial=2", "--workers", 1, "-o", "t.csv", "--json")
    assert told.status == 0, told.stderr
    said = json.loads(told.stdout)
    assert said.pop("figures")["true_relative_rmse_percent"]["trials"] == 1
    assert said.pop("cells") == []  # one controller, one peak: no cells to tell apart
    assert said == {"table": "t.csv", "trials": 1, "resumed": 0, "not_completed": 0}
    alone = bowden("trial", "--cycles", 2, "--period", 0.6, "--controller", "none", "--serial", 2, "-o", "t.mcap",
                   "--json")
    expected = json.loads(alone.stdout)
    assert tuple(expected) == FIGURES
    (row,) = lines(here / "t.csv")
    for name in set(FIGURES) - {"trial", "wall_s"}:
        value = expected[name]
        assert row[name] == ("" if value is None else repr(value) if isinstance(value, float) else str(value)), name
    (here / "kept").mkdir()
    again = bowden("sweep", *SHORT, "--grid", "serial=1-2", "--workers", 1, "-o", "t.csv", "--json", "--keep", "kept")
    assert json.loads(again.stdout)["resumed"] == 1
    first, second = lines(here / "t.csv")
    assert second == row
    assert Path(first["trial"]).parent == here / "kept"
    assert Path(first["trial"]).is_file()


def test_an_interruption_loses_no_trial_that_was_under_way(tmp_path: Path) -> None:
    rows = planned("serial=1-6")

    with (ThreadPoolExecutor(1) as executor, SweepTable(tmp_path / "t.csv", list(rows[0])) as table,
          pytest.raises(KeyboardInterrupt)):
        run.sweep(rows, table, Workers(executor, 1), tmp_path / "c", update=_interrupting())
    done = [row["bench.serial"] for row in lines(tmp_path / "t.csv")]
    assert done[0] == "1"
    assert len(done) in (1, 2)
    assert all(row["outcome"] == "completed" for row in lines(tmp_path / "t.csv"))


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="Windows blocks no signals")
def test_a_worker_is_out_of_reach_of_ctrl_c_from_its_first_instruction() -> None:
    with local(1) as workers:
        blocked = workers.executor.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result()
    assert {signal.SIGINT, signal.SIGHUP, signal.SIGQUIT} <= blocked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


STARTED = """
import multiprocessing, signal
from bowden.child_processes import unsignalled
context = multiprocessing.get_context("spawn")
near, far = context.Pipe()
process = context.Process(target=far.recv)
with unsignalled():
    process.start()
blocked = [line for line in open(f"/proc/{process.pid}/status") if line.startswith("SigBlk")][0]
print(int(blocked.split()[1], 16) >> signal.SIGINT - 1 & 1)
near.send(None)
process.join()
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc/PID/status")
def test_the_first_process_of_a_command_is_out_of_reach_of_ctrl_c(here: Path) -> None:
    started = subprocess.run([sys.executable, "-c", STARTED], capture_output=True, text=True, check=False)
    assert (started.stdout, started.stderr) == ("1\n", "")


@pytest.mark.parametrize("tempo", [0.9, pytest.param(1.1, marks=pytest.mark.slow)])
def test_a_knee_out_of_step_at_the_end_is_led_back_to_the_reference(tempo: float, tmp_path: Path) -> None:
    # half a cycle out of step after five
    rows = sweep_rows.rows(configuration.read(None), {}, [sweep_rows.axis(text) for text in (
        f"departure.tempo={tempo}", "cycles=5", "controller=extended")])
    with ThreadPoolExecutor(1) as executor, SweepTable(tmp_path / "t.csv", list(rows[0])) as table:
        run.sweep(rows, table, Workers(executor, 1), tmp_path / "c")
    (row,) = lines(tmp_path / "t.csv")
    assert row["outcome"] == "completed", row["stop_reason"]


def _interrupting() -> Callable[[float], None]:
    calls: list[float] = []

    def update(share: float) -> None:
        calls.append(share)
        if len(calls) == 1:
            raise KeyboardInterrupt

    return update


def test_a_trial_that_is_refused_is_a_row_that_says_why(tmp_path: Path) -> None:
    soft = tmp_path / "soft.toml"
    soft.write_text(write(nominal()).replace("value = -1.7e-06", "value = -3e-06"))
    rows = planned(f"calibration={soft}", "peak=60")
    with ThreadPoolExecutor(1) as executor, SweepTable(tmp_path / "t.csv", list(rows[0])) as table:
        run.sweep(rows, table, Workers(executor, 1), tmp_path / "c")
    (row,) = lines(tmp_path / "t.csv")
    assert row["outcome"] == "refused"
    assert "turning point" in row["stop_reason"]


@pytest.mark.exhaustive
def test_a_bench_is_identified_once_and_its_calibration_kept(bowden: Callable[..., Any], here: Path) -> None:
    wanted = ("sweep", *SHORT, "--grid", "day=1", "--grid", "serial=3", "--identify", "--workers", 1, "-o", "t.csv",
              "--json")
    assert bowden(*wanted, "--grid", "peak=40,50").status == 0
    (calibration,) = (here / "t.calibrations").iterdir()
    stamp = calibration.stat().st_mtime_ns
    assert {row["calibration"] for row in lines(here / "t.csv")} == {f"t.calibrations/{calibration.name}"}
    assert bowden(*wanted, "--grid", "peak=40,50,60").status == 0
    assert calibration.stat().st_mtime_ns == stamp
    assert len(lines(here / "t.csv")) == 3


@pytest.mark.parametrize(("more", "said"), [
    (("--grid", "paek=40"), "did you mean peak"),
    (("--identify", "--calibration", "c.toml"), "leave one of them out"),
    (("--keep", "absent"), "--keep absent: is no directory"),
    (("--draws", "0"), "whole numbers from 1"),
])
def test_bad_input_ends_in_a_sentence_and_no_table(
    bowden: Callable[..., Any], here: Path, more: tuple[str, ...], said: str
) -> None:
    told = bowden("sweep", *more, "-o", "t.csv")
    assert told.status == 2
    assert told.stdout == ""
    assert said in told.stderr
    assert list(here.iterdir()) == []


@pytest.mark.exhaustive
@pytest.mark.walltime
def test_a_dask_cluster_of_two_workers_gives_the_same_table(bowden: Callable[..., Any], here: Path) -> None:
    dask = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    with dask.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        told = bowden("sweep", *SHORT, "--grid", "serial=1-3", "--scheduler", cluster.scheduler_address, "-o",
                      "far.csv", "--json")
    assert told.status == 0, told.stderr
    near = bowden("sweep", *SHORT, "--grid", "serial=1-3", "--workers", 1, "-o", "near.csv", "--json")
    assert near.status == 0
    far_lines, near_lines = (
        [{name: cell for name, cell in row.items() if name != "wall_s"} for row in lines(here / name)]
        for name in ("far.csv", "near.csv"))
    assert far_lines == near_lines
    assert len(far_lines) == 3


@pytest.mark.exhaustive
@pytest.mark.walltime
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates")
def test_a_dask_cluster_with_certificates_takes_no_one_without(here: Path) -> None:
    dask = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=bench",
                    "-keyout", "key.pem", "-out", "cert.pem"], cwd=here, check=True, capture_output=True)
    shutil.copy(here / "cert.pem", here / "ca.pem")
    configured = {f"distributed.comm.tls.{who}.{what}": str(here / f"{what}.pem")
                  for who in ("client", "scheduler", "worker") for what in ("cert", "key")}
    configured |= {"distributed.comm.tls.ca-file": str(here / "ca.pem")}
    secured = dask.Security(require_encryption=True, tls_ca_file=str(here / "ca.pem"), **{
        f"tls_{who}_{what}": str(here / f"{what}.pem")
        for who in ("client", "scheduler", "worker") for what in ("cert", "key")})
    with dask.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, processes=False,
                           security=secured, protocol="tls://") as cluster:
        with importlib.import_module("dask").config.set(configured), workers_of(cluster.scheduler_address) as workers:
            assert workers.executor.submit(sum, (1, 2)).result() == 3
        with pytest.raises(InputError, match=r"set Dask's own distributed\.comm\.tls"), workers_of(
                cluster.scheduler_address):
            pass


class EndingWorker(ThreadPoolExecutor):
    """A worker whose every job ends it, as a plug-in that calls sys.exit does."""

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        return super().submit(sys.exit)


def test_a_diagnosis_that_ends_its_process_is_refused_alone(here: Path) -> None:
    trials = [here / "a.mcap", here / "b.mcap"]
    with EndingWorker(1) as executor:
        found = diagnose_each(trials, (), ReferenceCondition(None, (), None), Workers(executor, 1), lambda share: None)
    assert [one["verdict"] for one in found.values()] == ["refused", "refused"]
    assert f"a.mcap: {ENDED}; give fewer --workers" in found[str(here / "a.mcap")]["warnings"][0]


@pytest.mark.exhaustive
@pytest.mark.walltime
def test_a_lost_scheduler_ends_the_sweep_in_a_sentence_and_the_table_goes_on(
    bowden: Callable[..., Any], here: Path
) -> None:
    dask = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    wanted = ("sweep", *SHORT, "--grid", "serial=1-3", "-o", "t.csv")
    with dask.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as lost:
        closing = threading.Thread(target=lambda: (_until_a_row(here / "t.csv"), lost.close()))
        closing.start()
        told = bowden(*wanted, "--scheduler", lost.scheduler_address)
        closing.join()
    assert told.status == 2
    assert "was lost while it ran jobs" in told.stderr
    assert "the same command goes on from there" in told.stderr
    assert "Traceback" not in told.stderr
    done = len(lines(here / "t.csv"))
    assert 1 <= done < 3
    assert json.loads(bowden(*wanted, "--workers", 1, "--json").stdout)["resumed"] == done


def _until_a_row(path: Path) -> None:
    while not path.is_file() or len(lines(path)) < 1:
        threading.Event().wait(0.01)


def test_each_cell_of_the_grid_has_a_line_with_why_its_trials_stopped() -> None:
    found = [{"gait.controller": name, "bench.serial": str(serial), "outcome": outcome, "stop_reason": reason,
              "relative_rmse_percent": percent}
             for name, serial, outcome, reason, percent in (
                 ("paper", 1, "completed", "", "4.0"), ("paper", 2, "completed", "", "6.0"),
                 ("none", 1, "completed", "", "20.0"), ("none", 2, "stopped", "START above 100 N", ""))]
    cells = summary.cells(found, ["gait.controller", "bench.serial"])
    assert cells == [
        {"cell": {"gait.controller": "paper"}, "trials": 2, "completed": 2, "stopped": {},
         "median": {"relative_rmse_percent": 5.0}},
        {"cell": {"gait.controller": "none"}, "trials": 2, "completed": 1, "stopped": {"START above 100 N": 1},
         "median": {"relative_rmse_percent": 20.0}}]


def test_the_terminal_shows_the_cells() -> None:
    lines = list(summary.cell_lines([
        {"cell": {"gait.controller": name, "controller.share": ""}, "trials": 1, "completed": done, "stopped": stopped,
         "median": median}
        for name, done, stopped, median in (
            ("paper", 1, {}, {"relative_rmse_percent": 5.0}), ("none", 0, {"START above 100 N": 1}, {}))]))
    assert lines[1:] == ["  controller = paper: 1 of 1 completed, 5.00", "  controller = none: 0 of 1 completed, –",
                         "    1 not completed: START above 100 N"]
