"""Tables that lack columns: each command runs, or refuses in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
import pytest

import trial
from estimation.data import integrity
from estimation.data import table as data_table
from trial.report import sections
from trial.signals import MOTION_AND_FORCE

COMMANDS = ("diagnose lacking.csv", "diagnose lacking.csv --healthy whole.csv",
            "diagnose whole.csv --healthy lacking.csv", "fit lacking.csv -o model.toml", "simulate lacking.csv",
            "import lacking.csv -o lacking.mcap", "import lacking.csv --guess -o map.toml")
NAMES = [signal.name for signal in MOTION_AND_FORCE]


def table(path: Path, lacking: Collection[str] = (), phase: float = 0.0, step_s: float = 0.01) -> None:
    """Write a rope over a knee, in four cycles of 2 s, with every column but `lacking`."""
    time = np.arange(0.0, 8.0, step_s)
    turn = np.pi * time + phase
    end = 12.0 + 10.0 * np.sin(turn)
    columns = {name: np.zeros(time.size) for name in NAMES} | {
        "time_s": time, "gait_percent": 50.0 * (time % 2.0), "cycle": np.floor(time / 2.0),
        "servo_position_m": 0.02 + 3e-4 * end, "servo_target_m": 0.02 + 3e-4 * end,
        "servo_velocity_m_s": 3e-3 * np.pi * np.cos(turn), "knee_angle_rad": -0.3 + 0.1 * np.cos(turn),
        "tension_end_n": end, "tension_start_n": end * (1.3 + 0.2 * np.tanh(3.0 * np.cos(turn))),
        "servo_force_n": end * 1.5, "desired_force_n": end}
    names = [name for name in NAMES if name not in lacking]
    np.savetxt(path, np.column_stack([columns[name] for name in names]), delimiter=",", header=",".join(names),
               comments="", fmt="%.6g")


def refused(bowden: Callable[..., tuple[int, str, str]], lacking: Collection[str], command: str) -> bool:
    """Run a command on a table without columns `lacking`; return whether it refused the table, in one sentence."""
    table(Path("whole.csv"), phase=0.5, step_s=0.02)
    table(Path("lacking.csv"), lacking, step_s=0.02)
    status, _, err = bowden(*command.split())
    assert status in (0, 2), (lacking, command, err)
    assert "Error" not in err, (lacking, command, err)
    assert status == 0 or len(err.splitlines()) <= 1, err
    return bool(status)


@pytest.mark.parametrize("command", COMMANDS[:4])
def test_a_rope_without_its_position_is_refused_in_one_sentence(
    here: Path, bowden: Callable[..., tuple[int, str, str]], command: str
) -> None:
    assert refused(bowden, {"servo_position_m", "gait_percent", "cycle"}, command)


@pytest.mark.parametrize("command", ["plan lacking.csv --healthy whole.csv",
                                     pytest.param("discover lacking.csv --healthy whole.csv", marks=pytest.mark.slow)])
def test_a_trial_that_lacks_an_output_of_its_reference_trials_is_judged_by_the_others(
    here: Path, bowden: Callable[..., tuple[int, str, str]], command: str
) -> None:
    assert not refused(bowden, {"servo_force_n"}, command)


@pytest.mark.parametrize("moves", [0.0, 0.5])
@pytest.mark.parametrize("command", ["diagnose lacking.csv --healthy whole.csv", "fit whole.csv lacking.csv -o a.toml"])
def test_a_rig_whose_forces_have_other_names_is_asked_for_them(
    here: Path, bowden: Callable[..., tuple[int, str, str]], command: str, moves: float
) -> None:
    knee = {name for name in NAMES if name.startswith(("knee", "gait", "desired", "servo_f", "cycle", "estimated"))}
    table(Path("whole.csv"), knee)
    table(Path("lacking.csv"), knee, phase=moves)
    text = Path("lacking.csv").read_text()
    Path("lacking.csv").write_text(text.replace("tension_start_n", "F1_kN").replace("tension_end_n", "F2_kN"))
    status, _, err = bowden(*command.split())
    assert (status, err.count("\n")) == (2, 1), err
    assert "lacking.csv: has no column tension_start_n, tension_end_n" in err
    assert "columns not used: F1_kN, F2_kN" in err


def test_two_trials_of_two_rates_are_one_warning_that_names_both() -> None:
    pull = {"servo_position_m": np.sin, "tension_start_n": np.cos}
    first, second = (data_table.table(name, {"time_s": time, **{n: f(time) for n, f in pull.items()}})
                     for name, time in (("trial", np.arange(0.0, 8.0, 0.004)), ("good", np.arange(0.0, 8.0, 0.001))))
    found = [one.text for one in integrity.between([first], [], [second])
             if "sampled" in one.text]
    assert [text.partition(": another")[0] for text in found] == [
        "trial: sampled every 0.004 s, the others every 0.001 s"]


@pytest.mark.exhaustive
@pytest.mark.parametrize("number", range(20))
def test_a_table_without_any_of_its_columns_is_read_or_refused_in_one_sentence(
    here: Path, bowden: Callable[..., tuple[int, str, str]], number: int
) -> None:
    chance = np.random.default_rng(number)
    lacking = set(chance.choice(NAMES[1:], chance.integers(1, 8), replace=False))
    refused(bowden, lacking, COMMANDS[number % len(COMMANDS)])


def test_a_position_at_a_tenth_of_the_force_s_rate_is_diagnosed_and_drawn(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    table(Path("whole.csv"))
    header, *rows = Path("whole.csv").read_text().splitlines()
    slow = header.split(",").index("servo_position_m")
    cells = [row.split(",") for row in rows]
    position = np.array([float(row[slow]) for row in cells])
    for k, row in enumerate(cells):
        row[slow] = row[slow] if k % 10 == 0 and not 200 < k < 240 else ""
    Path("slow.csv").write_text("\n".join([header, *map(",".join, cells)]) + "\n")
    read = data_table.read("slow.csv")
    gone = np.isnan(read["servo_position_m"])
    assert np.flatnonzero(gone)[[0, -1]].tolist() == [201, 799]
    assert np.abs(read["servo_position_m"] - position)[~gone].max() < 2e-4
    assert "servo_position_m is recorded every 0.1 s" in read.notes[0]
    assert not any(finding.refuses for finding in integrity.examine(read))
    assert bowden("import", "slow.csv", "-o", "slow.mcap")[0] == 0
    drawn = sections.chosen(trial.open("slow.mcap"), ["servo_position_m"])["servo_position_m"]
    assert np.isfinite(drawn).mean() > 0.9  # but for the gap


@pytest.mark.parametrize(("column", "value", "command", "sentence"), [
    ("servo_position_m", np.nan, "fit lab.csv -o model.toml", "has no column servo_position_m that moves"),
    ("servo_position_m", np.nan, "simulate lab.csv", "no column servo_position_m with values"),
    ("tension_end_n", 1e30, "fit lab.csv -o model.toml", "has a wrong value or unit"),
    ("tension_end_n", 1e30, "discover whole.csv --healthy lab.csv", "has a wrong value or unit"),
    ("time_s", 1.0, "simulate lab.csv", "time_s must rise"),
])
def test_an_empty_or_impossible_column_is_one_sentence(
    here: Path, bowden: Callable[..., tuple[int, str, str]], column: str, value: float, command: str, sentence: str
) -> None:
    table(Path("whole.csv"), {"gait_percent", "cycle", "servo_force_n"}, phase=0.5)
    table(Path("lab.csv"), {"gait_percent", "cycle", "servo_force_n"})
    header, *rows = Path("lab.csv").read_text().splitlines()
    place = header.split(",").index(column)
    cells = [row.split(",") for row in rows]
    for row in cells if np.isnan(value) else cells[400:401]:
        row[place] = "" if np.isnan(value) else f"{value:g}"
    Path("lab.csv").write_text("\n".join([header, *map(",".join, cells)]) + "\n")
    status, _, err = bowden(*command.split())
    assert (status, err.count("\n")) == (2, 1)
    assert err.startswith("bowden: lab.csv")
    assert sentence in err
