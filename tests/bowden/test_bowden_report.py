"""`bowden report` as a user types it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import trial


def record(path: Path) -> None:
    recorder = trial.Recorder(path, metadata={"bitrate": "1000000"}, attachments={}, threaded=False)
    for row in range(100):
        recorder.frame(row * 1_000_000, 0x181, bytes(8))
        recorder.cycle(row * 1_000_000, [row / 1000, *[0.5] * (len(trial.SIGNALS) - 1)])
    recorder.close({"outcome": "completed"})


def test_report_writes_one_page_and_says_how_large(bowden: Callable[..., Any], here: Path) -> None:
    record(here / "trial.mcap")
    told = bowden("report", "trial.mcap", "-o", "report.html", "--json")
    assert (told.status, told.stderr) == (0, "")
    assert json.loads(told.stdout) == {"report": "report.html", "bytes": (here / "report.html").stat().st_size}
    assert sorted(path.name for path in here.iterdir()) == ["report.html", "trial.mcap"]


def test_report_keeps_what_is_there(bowden: Callable[..., Any], here: Path) -> None:
    record(here / "trial.mcap")
    (here / "report.html").write_text("mine")
    told = bowden("report", "trial.mcap", "-o", "report.html")
    assert told.status == 2
    assert told.stderr == "bowden: report.html: the file exists; give another name or --overwrite.\n"
    assert (here / "report.html").read_text() == "mine"
    assert bowden("report", "trial.mcap", "-o", "report.html", "--overwrite").status == 0


def test_report_refuses_what_is_no_trial(bowden: Callable[..., Any], here: Path) -> None:
    (here / "trial.mcap").write_bytes(b"no trial")
    told = bowden("report", "trial.mcap", "-o", "report.html", "--json")
    assert (told.status, told.stdout) == (2, "")
    assert not (here / "report.html").exists()


def test_the_report_of_a_log_speaks_of_control_cycles_and_of_inputs(bowden: Callable[..., Any], here: Path) -> None:
    Path("bus.log").write_text("".join(
        f"({k / 1000:.6f}) can0 080#\n({k / 1000 + 1e-4:.6f}) can0 181#37129D520000F6FF\n" for k in range(200)))
    assert bowden("import", "bus.log", "-o", "bus.mcap")[0] == 0
    assert bowden("report", "bus.mcap", "-o", "bus.html")[0] == 0
    page = Path("bus.html").read_text()
    assert "; control cycles 200" in page
    assert "gait cycles 200" not in page
    assert ">servo inputs, arrival<" in page
    assert "time_s (s)" not in page


def test_the_report_of_one_gait_cycle_speaks_of_one(bowden: Callable[..., Any], here: Path) -> None:
    assert bowden("trial", "--cycles", 1, "--settle", 0, "--period", 1.0, "-o", "one.mcap")[0] == 0
    assert bowden("report", "one.mcap", "-o", "one.html")[0] == 0
    page = Path("one.html").read_text()
    assert "Gait cycle 0 counts, peak 40 N" in page
    assert "One gait cycle." in page
