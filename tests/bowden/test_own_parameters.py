"""Parameters that a controller declares: `trial --set`, `sweep --grid controller.…`, ranked with their values."""

from __future__ import annotations

import csv
import io
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import trial
from bowden.bench import configuration
from bowden.sweep import rows as sweep_rows
from bowden.sweep import run, summary
from bowden.sweep.sweep_table import SweepTable
from bowden.workers import ENDED, Workers, local
from parameters import InputError

OWN = '''
import os
from dataclasses import dataclass
from bowden.controllers import Column, Controller, ControllerOutput, Trace, parameter

@dataclass(frozen=True)
class Gains:
    kp: float = parameter(100.0, "1", "share of the stretch fed forward, %", low=0.0, high=200.0, source="tuned")
    fault: int = parameter(0, "", "what fails", low=0, high=4, source="a test")

class Own(Controller[None]):
    parameters = Gains
    columns = (Column("kp", "1", "the gain in use"),)
    def __init__(self, model, gait, conditions):
        self.gait, self.own = gait, conditions.own
        if self.own.fault == 2:
            os._exit(7)
        if self.own.fault > 2:
            raise SystemExit if self.own.fault == 3 else KeyboardInterrupt
    def initial(self):
        return None
    def step(self, seen, state):
        if self.own.fault == 1 and seen.sample > 50:
            raise KeyError("no such gain")
        i = seen.sample % self.gait.samples
        target = self.gait.stretch[i] * self.own.kp / 100 + self.gait.swing[i] - self.gait.slack[i]
        return ControllerOutput(target, self.gait.knee[i]), None, Trace(self.gait.desired[i], own=(self.own.kp,))
'''
SHORT = ("cycles=1", "settle=0", "period=0.6", "rate=500")


@pytest.fixture
def own(here: Path) -> Path:
    """A controller in `own.py` of the working directory."""
    (here / "own.py").write_text(OWN)
    return here


def planned(*axes: str) -> list[sweep_rows.Row]:
    return sweep_rows.rows(configuration.read(None), {}, [sweep_rows.axis(text) for text in (*SHORT, *axes)])


def test_a_trial_sets_them_within_their_bounds(own: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    words = ("trial", "--controller", "own.py:Own", "--cycles", 1, "--settle", 0, "--period", 0.6, "-o", "a.mcap")
    assert bowden(*words, "--set", "kp=95")[0] == 0
    recorded = trial.open("a.mcap")
    assert recorded.metadata["tuning"] == "kp=95"
    assert set(recorded.columns["kp"][recorded.columns["cycle"] == 0]) == {95.0}
    status, _, err = bowden("replay", "a.mcap", "--onto", "controller", "--allow-controller", "own.py:Own")
    assert (status, err) == (0, "")
    for given, said in (("kp=400", "outside 0 … 200"), ("ki=1", "ki"), ("kp", "is no NAME=VALUE"),
                        ("kp=4,kp=5", "kp=4,kp=5 gives a parameter two values; keep one")):
        status, out, err = bowden(*words, "--set", given, "--overwrite")
        assert (status, out, said in err, err.count("\n")) == (2, "", True, 1), err
    status, _, err = bowden("trial", "--set", "kp=4", "-o", "b.mcap")
    assert (status, "declares no parameters" in err) == (2, True)


def test_parameters_that_are_no_dataclass_are_refused(own: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    (own / "own.py").write_text(OWN.replace("@dataclass(frozen=True)\n", ""), encoding="utf-8")
    status, out, err = bowden("trial", "--controller", "own.py:Own", "--cycles", 1, "--settle", 0, "-o", "a.mcap")
    assert (status, out, "are no dataclass; write @dataclass(frozen=True)" in err, err.count("\n")) == (2, "", True, 1)


def test_a_controller_that_fails_leaves_its_name_free(own: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    words = ("trial", "--controller", "own.py:Own", "--cycles", 1, "--settle", 0, "--period", 0.6, "-o", "a.mcap")
    status, out, _ = bowden(*words, "--set", "fault=1")
    assert (status, "Trial: a.failed.mcap" in out) == (1, True)
    assert sorted(path.name for path in own.glob("*.mcap")) == ["a.failed.mcap", "a.failed.truth.mcap"]
    assert bowden(*words)[0] == 0


@pytest.mark.slow
def test_a_sweep_varies_them_and_a_trial_that_raises_ends_its_row(own: Path) -> None:
    rows = planned("controller=own.py:Own,none", "controller.kp=95,100", "controller.fault=0,1")
    assert [row["gait.tuning"] for row in rows] == [
        "kp=95, fault=0", "kp=95, fault=1", "kp=100, fault=0", "kp=100, fault=1", ""]
    with ThreadPoolExecutor(1) as executor, SweepTable(own / "t.csv", list(rows[0])) as table:
        run.sweep(rows, table, Workers(executor, 1), own / "c")
    made = list(csv.DictReader(io.StringIO((own / "t.csv").read_text())))
    assert [row["outcome"] for row in made] == ["completed", "stopped", "completed", "stopped", "completed"]
    assert "KeyError" in made[1]["stop_reason"]
    ranked = summary.ranked(summary.ranked_rows(own / "t.csv"))
    assert {one.controller for one in ranked} == {(row["gait.tuning"] and f"own.py:Own {row['gait.tuning']}") or "none"
                                                  for row in made}
    with pytest.raises(InputError, match=r"controller\.ki: no controller of this sweep declares"):
        planned("controller=own.py:Own", "controller.ki=1")


def test_a_worker_in_another_folder_finds_a_plug_in(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "own", raising=False)  # another test's plug-in of that name, and its folder
    monkeypatch.setattr(sys, "path", [path for path in sys.path if not (Path(path) / "own.py").exists()])
    row = planned("controller=own:Own", "controller.kp=95")[0]
    placed = sweep_rows.placed(row)
    assert placed["gait.controller"] == f"{own.resolve() / 'own.py'}:Own"


@pytest.mark.exhaustive
def test_a_trial_that_ends_its_process_ends_its_row_alone(own: Path) -> None:
    rows = [*planned("controller=own.py:Own", "controller.fault=2,3,4"), *planned("controller=none", "serial=1,2")]
    rows = [{**row, "controller.fault": row.get("controller.fault", "")} for row in rows]
    (own / "in").mkdir()
    os.environ.pop("PYTHONPATH", None)
    with local(2) as workers, SweepTable(own / "t.csv", list(rows[0])) as table:
        run.sweep(rows, table, workers, own / "c")
    made = list(csv.DictReader(io.StringIO((own / "t.csv").read_text())))
    assert [row["outcome"] for row in made] == ["failed", "refused", "failed", "completed", "completed"]
    assert [row["stop_reason"] for row in made[::2]] == [ENDED, ENDED, ""]
    assert "raised SystemExit" in made[1]["stop_reason"]


@pytest.mark.exhaustive
@pytest.mark.walltime
def test_a_dask_worker_of_another_folder_runs_a_plug_in_and_each_failure_ends_its_row_alone(
    own: Path, bowden: Callable[..., tuple[int, str, str]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    dask = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    axes = [word for text in (*SHORT, "controller=own.py:Own", "controller.fault=0,2,1") for word in ("--grid", text)]
    os.chdir(tmp_path_factory.mktemp("elsewhere"))  # of the cluster: it knows the plug-in by its path alone
    # a lost worker's row is tried twice by the sweep, each time once by Dask, which else tries four times
    with (pytest.importorskip("dask").config.set({"distributed.scheduler.allowed-failures": 0}),
          dask.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster):
        os.chdir(own)
        status, _, err = bowden("sweep", *axes, "--scheduler", cluster.scheduler_address, "-o", "t.csv", "--json")
    made = list(csv.DictReader(io.StringIO((own / "t.csv").read_text())))
    assert [row["outcome"] for row in made] == ["completed", "failed", "stopped"], (status, err)
    assert made[1]["stop_reason"] == ENDED  # its worker was lost
    assert "KeyError" in made[2]["stop_reason"]
    assert "Traceback" not in err
