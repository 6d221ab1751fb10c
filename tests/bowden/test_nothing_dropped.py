"""Tables of other labs: each column and sheet is taken, or listed with the reason why not."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import trial

ROWS = 400
TIME = np.arange(ROWS) / 100
Command = Callable[..., tuple[int, str, str]]


def test_matlab_fields_of_another_length_are_listed(here: Path, bowden: Command) -> None:
    from scipy.io import savemat

    savemat(here / "lab.mat", {"rig": {"t": TIME, "force_start": 10 + TIME, "force_end": 5 + TIME,
                                       "rope_mm": TIME[::10], "gain": 2.0, "who": "N. N."}})
    status, out, _ = bowden("import", "lab.mat", "--guess", "-o", "map.toml")
    assert status == 0
    assert "'rig.rope_mm': 40 values, the table has 400 rows" in out
    assert "'rig.gain': 1 value, the table has 400 rows" in out
    assert "'rig.who': no numbers" in out
    assert "rig.rope_mm" in (here / "map.toml").read_text()
    status, out, _ = bowden("import", "lab.mat", "--map", "map.toml", "-o", "lab.mcap")
    assert (status, "left out: rig.rope_mm (40 values" in out) == (0, True)
    assert "rig.rope_mm is left out" in bowden("info", "lab.mat")[1]


def test_a_force_too_small_for_a_rope_is_questioned(here: Path, bowden: Command) -> None:
    np.savetxt(here / "lab.csv", np.column_stack([TIME, 0.003 + 0.107 * TIME / 4]), delimiter=",", comments="",
               header="time,start force")
    status, out, _ = bowden("import", "lab.csv", "--guess", "-o", "map.toml")
    assert (status, "no unit is stated, so is it kN?" in " ".join(out.split())) == (0, True)
    assert "# CHECK: reaches only 0.1097 N" in (here / "map.toml").read_text()


def workbook(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "Notes"
    book.active.append(["Recorded by N. N."])
    for name, column in (("Run 1", "start force"), ("Run 2", "end force")):
        sheet = book.create_sheet(name)
        for row in (("time (s)", f"{column} (N)"), *zip(TIME.tolist(), (10 + TIME).tolist(), strict=True)):
            sheet.append(row)
    book.save(path)


def test_a_workbook_whose_first_sheet_holds_notes_is_read(here: Path, bowden: Command) -> None:
    workbook(here / "lab.xlsx")
    status, out, err = bowden("import", "lab.xlsx", "--guess", "-o", "map.toml")
    assert (status, err) == (0, "")
    assert "Excel, sheet 'Run 1'" in out
    assert "sheet 'Run 2'\": another table; --sheet takes it" in out
    assert "sheet 'Notes'\": no" in out
    assert bowden("import", "lab.xlsx", "--guess", "--sheet", "Run 2", "-o", "two.toml")[0] == 0
    assert set(tomllib.loads((here / "two.toml").read_text())) == {"csv", "time_s", "tension_end_n"}
    assert bowden("import", "lab.xlsx", "--map", "two.toml", "-o", "two.mcap")[0] == 0
    assert trial.open("two.mcap").columns["tension_end_n"] == pytest.approx(10 + TIME)
    status, _, err = bowden("import", "lab.xlsx", "--guess", "--sheet", "Run 3", "-o", "three.toml")
    assert (status, "expected one of 'Notes', 'Run 1', 'Run 2'" in err) == (2, True)


@pytest.mark.parametrize(("header", "signals"), [
    ("t,Fin_lbf,Fout_lbf", {"Fin_lbf": "tension_start_n", "Fout_lbf": "tension_end_n"}),
    ("shijian,qianduanlali,houduanlali,shengsuoweiyi,xijiao", {
        "qianduanlali": "tension_start_n", "houduanlali": "tension_end_n", "shengsuoweiyi": "servo_position_m",
        "xijiao": "knee_angle_rad"}),
    ("shijian,shuru_lali,moduan_lali", {"shuru_lali": "tension_start_n", "moduan_lali": "tension_end_n"}),
])
def test_names_of_forces_are_known(here: Path, bowden: Command, header: str, signals: dict[str, str]) -> None:
    width = header.count(",")
    np.savetxt(here / "lab.csv", np.column_stack([TIME, *[1 + TIME * (k + 1) / 8 for k in range(width)]]),
               delimiter=",", comments="", header=header)
    assert bowden("import", "lab.csv", "--guess", "-o", "map.toml")[0] == 0
    guessed = tomllib.loads((here / "map.toml").read_text())
    assert {row["column"]: name for name, row in guessed.items() if name != "time_s"} == signals


def test_marks_between_thousands_are_read_and_a_date_that_stands_is_no_clock(here: Path, bowden: Command) -> None:
    def german(value: float) -> str:
        return f"{value:,.3f}".translate(str.maketrans(",.", ".,"))

    rows = [f"02.03.2026 10:00:00\t{german(1e3 * t)}\t{german(9e5 + 1e3 * t)}\tgut" for t in TIME]
    (here / "lab.txt").write_text("\n".join(["Datum\tZeit (ms)\tKraft vorn (mN)\tUrteil", *rows]))
    status, out, _ = bowden("import", "lab.txt", "--guess", "-o", "map.toml")
    assert (status, "marks between thousands" in " ".join(out.split())) == (0, True), out
    assert "'Urteil': row 2 has no number: 'gut'" in out
    guessed = tomllib.loads((here / "map.toml").read_text())
    assert [guessed[name]["column"] for name in ("time_s", "tension_start_n")] == ["Zeit (ms)", "Kraft vorn (mN)"]
    assert bowden("import", "lab.txt", "--map", "map.toml", "-o", "lab.mcap")[0] == 0
    assert trial.open(here / "lab.mcap").columns["tension_start_n"][-1] == pytest.approx(900.0 + TIME[-1])
