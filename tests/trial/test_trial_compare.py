"""Two trials side by side, against differences that were put there."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import trial
from trial.compare import compare
from trial.record import TrialContent, write


def made(path: Path, rate_hz: int = 100, error_n: float = 0.0, start_ns: int = 0, config: str = "") -> trial.Trial:
    """Write four gait cycles of two seconds, END off by `error_n`."""
    time_s = np.arange(8 * rate_hz) / rate_hz
    columns = {
        "time_s": time_s, "gait_percent": time_s % 2 * 50, "cycle": np.floor(time_s / 2),
        "tension_end_n": 40 * np.sin(time_s) + error_n, "servo_statusword": np.full(len(time_s), 0x1237 + error_n),
    }
    content = TrialContent(start_ns + np.rint(time_s * 1e9).astype(np.int64), columns)
    write(path, content, metadata={"peak_n": "40", "seed": str(error_n)},
          result={"relative_rmse_percent": 2.0 + error_n, "outcome": "completed"},
          attachments={"bench.toml": config.encode(), "notes.txt": b"a\nb\n"})
    return trial.open(path)


def test_a_trial_is_the_same_as_itself(tmp_path: Path) -> None:
    one, two = made(tmp_path / "a.mcap"), made(tmp_path / "b.mcap")
    found = compare(one, two)
    assert found.same
    assert found.matched == "row by row"
    assert (found.metadata, found.attachments, found.only_a, found.only_b) == ([], {}, [], [])
    assert {row.largest for row in found.signals} == {0.0}


def test_what_differs_is_named_with_both_values(tmp_path: Path) -> None:
    one = made(tmp_path / "a.mcap", config="[gait]\npeak_n = 40\ncycles = 4\n")
    two = made(tmp_path / "b.mcap", error_n=0.5, start_ns=10**9, config="[gait]\npeak_n = 50\ncycles = 4\n")
    found = compare(one, two)
    assert not found.same
    assert found.metadata == [("seed", "0.0", "0.5")]
    assert found.attachments == {"bench.toml": [("gait.peak_n", 40, 50)]}
    assert found.result == [("relative_rmse_percent", 2.0, 2.5), ("outcome", "completed", "completed")]
    end = next(row for row in found.signals if row.name == "tension_end_n")
    assert (end.rows, end.unit) == (800, "N")
    assert (end.rms, end.mean, end.largest) == pytest.approx((0.5, -0.5, 0.5))
    assert json.loads(json.dumps(found.as_json(), allow_nan=False))["signals"]["tension_end_n"]["rows"] == 800


def test_a_file_that_only_one_carries_is_one_row(tmp_path: Path) -> None:
    one, two = made(tmp_path / "a.mcap"), made(tmp_path / "b.mcap")
    del two.attachments["notes.txt"]  # type: ignore[attr-defined]
    assert compare(one, two).attachments == {"notes.txt": [("file", "4 bytes", None)]}
    assert compare(two, one).attachments == {"notes.txt": [("file", None, "4 bytes")]}


def test_other_rates_are_compared_at_the_same_gait_phase(tmp_path: Path) -> None:
    found = compare(made(tmp_path / "a.mcap"), made(tmp_path / "b.mcap", rate_hz=250, error_n=0.5))
    assert found.matched == "by gait phase"
    end = next(row for row in found.signals if row.name == "tension_end_n")
    # a straight line between samples of 40·sin(t), 4 ms apart, is off by at most 40·0.004²/8
    assert (end.rms, end.largest) == pytest.approx((0.5, 0.5), abs=40 * 0.004**2 / 8)
    assert "servo_statusword" not in {row.name for row in found.signals}


def test_without_a_gait_rows_are_matched_by_time_and_unknown_values_left_out(tmp_path: Path) -> None:
    for name, rate in (("a.mcap", 100), ("b.mcap", 50)):
        time_s = np.arange(2 * rate) / rate
        end = np.where(time_s < 1, time_s, math.nan)
        content = TrialContent(np.rint(time_s * 1e9).astype(np.int64), {"time_s": time_s, "tension_end_n": end})
        write(tmp_path / name, content, metadata={}, result={})
    found = compare(trial.open(tmp_path / "a.mcap"), trial.open(tmp_path / "b.mcap"))
    assert found.matched == "by time"
    end_row = next(row for row in found.signals if row.name == "tension_end_n")
    assert end_row.largest == pytest.approx(0, abs=1e-12)
    assert end_row.rows == 99  # 0 … 0.98 s: beyond the last known value of B nothing is compared


def test_what_only_one_has_is_listed(tmp_path: Path) -> None:
    time_s = np.arange(10) / 10
    times = np.rint(time_s * 1e9).astype(np.int64)
    write(tmp_path / "a.mcap", TrialContent(times, {"time_s": time_s, "cycle": time_s}), metadata={"x": "1"}, result={})
    write(tmp_path / "b.mcap", TrialContent(times, {"time_s": time_s, "held": time_s}), metadata={}, result={"y": 1})
    found = compare(trial.open(tmp_path / "a.mcap"), trial.open(tmp_path / "b.mcap"))
    assert (found.only_a, found.only_b) == (["cycle"], ["held"])
    assert found.metadata == [("x", "1", None)]
    assert found.result == [("y", None, 1)]
