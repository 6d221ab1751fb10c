"""Limits above the packaged ones need a reason, which stands in the trial; a trial names no code that is imported."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trial.read import open as opened

RAISED = "[limits]\nstart_n = 300\n"
CODE = """from pathlib import Path
from bowden.controllers import ControllerOutput, Trace
from master.control.packaged import PaperController

Path("imported").write_text("")


class Own(PaperController):
    pass
"""


@pytest.fixture
def raised(tmp_path: Path) -> Path:
    file = tmp_path / "bench.toml"
    file.write_text(RAISED)
    return file


@pytest.mark.parametrize("command", [
    ("trial", "-o", "trial.mcap"), ("jog", "knee", "--by", "-1"), ("home",), ("identify", "all", "-o", "c.toml")])
def test_a_raised_limit_without_a_reason_is_refused(
    bowden: Callable[..., Any], raised: Path, command: tuple[str, ...]
) -> None:
    status, out, err = bowden(*command, "--config", str(raised))
    assert status == 2
    assert out == ""
    assert "limits.start_n = 300 N (packaged 120)" in err
    assert "--raise-limits REASON" in err


def test_check_says_a_raised_limit(bowden: Callable[..., Any], raised: Path) -> None:
    status, out, _ = bowden("check", "config", str(raised))
    assert status == 1
    assert "limits.start_n = 300 N (packaged 120)" in out
    status, out, _ = bowden("check", "config", str(raised), "--json")
    assert json.loads(out)["limits_above_packaged"] == ["limits.start_n = 300 N (packaged 120)"]


def test_the_reason_stands_in_the_trial(bowden: Callable[..., Any], raised: Path, tmp_path: Path) -> None:
    file = tmp_path / "trial.mcap"
    status, _, err = bowden("trial", "--config", str(raised), "--raise-limits", "proof load of the rope", "--cycles",
                            "1", "--settle", "0", "--period", "1.1", "-o", str(file))
    assert status == 0, err
    assert 'raised = "proof load of the rope"' in opened(file).attachments["bench.toml"].decode()


def test_a_lower_limit_needs_no_reason(bowden: Callable[..., Any], tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text("[limits]\nstart_n = 80\nknee_low_rad = -1.2\n")
    assert bowden("check", "config", str(file))[0] == 0


def test_a_trial_decides_no_import(bowden: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_controller.py").write_text(CODE)
    status, _, err = bowden("trial", "--controller", "own_controller:Own", "--cycles", "1", "--settle", "0", "--period",
                            "1.1", "-o", "own.mcap")
    assert status == 0, err
    mark = tmp_path / "imported"
    mark.unlink()
    sys.modules.pop("own_controller")
    status, _, err = bowden("replay", "own.mcap", "--onto", "controller")
    assert status == 2
    assert "--allow-controller own_controller:Own" in err
    assert not mark.exists()
    assert bowden("replay", "own.mcap", "--onto", "controller", "--allow-controller", "own_controller:Own")[0] == 0
    assert mark.exists()


@pytest.mark.parametrize(("options", "most_n"), [
    # the rope is stopped at 12 N, or at 1.125 times 20 N, and goes on for a cycle or two
    (("--peak", "10"), 1.5 + 1.1 * 12.0),
    (("--peak", "20"), 1.5 + 1.1 * 22.5),
])
def test_homing_pulls_no_harder_than_the_trial(
    bowden: Callable[..., Any], tmp_path: Path, options: tuple[str, ...], most_n: float
) -> None:
    file = tmp_path / "trial.mcap"
    status, out, err = bowden("trial", *options, "--cycles", "1", "--settle", "0", "-o", str(file))
    assert status == 0, out + err
    told = re.search(r"Pulls START to at most (\d+) N while homing", err)
    assert told is not None
    columns = opened(file).columns
    before = int((columns["desired_force_n"] > 0.0).argmax())
    pulled = float(columns["tension_start_n"][:before].max())
    assert 10.0 < pulled < most_n
    assert pulled <= float(told[1]) + 0.5  # told in whole newtons


def test_homing_n_lets_homing_pull_harder(bowden: Callable[..., Any], tmp_path: Path) -> None:
    file = tmp_path / "trial.mcap"
    walk = ("--peak", "10", "--cycles", "1", "--settle", "0")
    status, out, err = bowden("trial", *walk, "--homing-n", "30", "-o", str(file))
    assert status == 0, out + err
    assert float(opened(file).columns["tension_start_n"].max()) > 30.0


@pytest.mark.parametrize(("command", "pattern"), [
    (("home",), r"Pulls START to at most 15 N\."),
    (("home", "--homing-n", "20"), r"Pulls START to at most 24 N\."),
    (("jog", "servo", "--by", "-1"), r"Stops where START reads 20 N more than at the beginning, and at 60 N\."),
])
def test_what_moves_says_first_how_hard_it_pulls(
    bowden: Callable[..., Any], command: tuple[str, ...], pattern: str
) -> None:
    channel = " ".join(command)
    status, out, err = bowden(*command, "--interface", "bowden", "--channel", channel, "--json")
    assert (status, err) == (0, "")
    status, _, err = bowden(*command, "--interface", "bowden", "--channel", channel)
    assert status == 0
    assert re.search(pattern, err)
    if command[0] == "home":
        most = re.search(r"at most (\d+) N", err)
        assert most is not None
        assert float(json.loads(out)["tension_start_n"]) < float(most[1])


@pytest.mark.parametrize(("what", "sentence"), [
    pytest.param("sensors", "Pulls START to at most 51 N while homing.", marks=pytest.mark.exhaustive),
    ("stiffness", "Pulls START to at most 51 N while homing, then to at most 68 N."),
    pytest.param("friction", "Pulls START to at most 51 N while homing, then to at most 94 N.",
                 marks=pytest.mark.exhaustive),
])
def test_an_identification_says_first_how_hard_it_pulls(
    bowden: Callable[..., Any], tmp_path: Path, what: str, sentence: str
) -> None:
    status, out, err = bowden("identify", what, "-o", str(tmp_path / "own.toml"))
    assert status == 0, out
    assert sentence in err
    pulled = float(opened(tmp_path / "own.mcap").columns["tension_start_n"].max())
    told = max(float(found) for found in re.findall(r"([0-9]+) N", sentence))
    assert 0.8 * told < pulled < told
