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


def guessed(bowden: Command, header: str, *columns: np.ndarray) -> tuple[set[str], str]:
    """Write a table, let its map be guessed, and return the signals that have a column, and what was printed."""
    np.savetxt("lab.csv", np.column_stack(columns), delimiter=",", comments="", header=header, fmt="%.6g")
    status, out, err = bowden("import", "lab.csv", "--guess", "-o", "map.toml", "--overwrite")
    assert (status, err) == (0, "")
    return set(tomllib.loads(Path("map.toml").read_text())), " ".join(out.split())


def test_why_a_column_is_left_out_is_true(here: Path, bowden: Command) -> None:
    signals, out = guessed(bowden, "time,Kraft,Kraft,Kraft", TIME, 9 + TIME, 8 + TIME, 7 + TIME)
    assert signals == {"time_s"}
    assert out.count("other columns have this name; give each a name of its own") == 3
    signals, out = guessed(bowden, "time_s,start force,end force", -TIME, 9 + TIME, TIME * np.nan)
    assert signals == {"tension_start_n"}
    assert "'time_s': its times do not rise" in out
    assert "'end force': it has no number" in out
    assert "No column looks like time, which a trial needs" in out
    status, _, err = bowden("import", "lab.csv", "--map", "map.toml", "-o", "lab.mcap")
    assert status == 2
    assert "row 3: time_s" in err


def test_a_map_without_time_is_refused_with_what_to_add(here: Path, bowden: Command) -> None:
    assert guessed(bowden, "start force,end force", 9 + TIME, 8 + TIME)[0] == {"tension_start_n", "tension_end_n"}
    status, _, err = bowden("import", "lab.csv", "--map", "map.toml", "-o", "lab.mcap")
    assert (status, "the map names no column for time_s; add [time_s]" in err) == (2, True)


def test_columns_of_other_names_come_with_the_way_to_use_them(here: Path, bowden: Command) -> None:
    np.savetxt("lab.csv", np.column_stack([TIME, 9 + TIME]), delimiter=",", comments="", header="time_s,start force")
    status, out, _ = bowden("import", "lab.csv", "-o", "lab.mcap")
    assert status == 0
    assert "left out: start force" in out
    assert "bowden import lab.csv --guess -o map.toml" in out


@pytest.mark.parametrize(("first", "second", "apart_s"), [
    ("05/13/2026 11:59:59.500 AM", "05/13/2026 12:00:01.000 PM", 1.5), ("9:00:00 pm", "9:00:00.250 PM", 0.25),
    ("12:30:00 AM", "1:00:00 AM", 1800.0),
])
def test_times_with_am_and_pm_are_read(here: Path, bowden: Command, first: str, second: str, apart_s: float) -> None:
    (here / "lab.csv").write_text(f"time,start force\n{first},9\n{second},8\n", encoding="utf-8")
    assert bowden("import", "lab.csv", "--guess", "-o", "map.toml")[0] == 0
    assert bowden("import", "lab.csv", "--map", "map.toml", "-o", "lab.mcap")[0] == 0
    assert np.diff(trial.open(here / "lab.mcap").columns["time_s"]).tolist() == [apart_s]


def test_a_date_whose_order_is_uncertain_is_left_out_with_one_that_is_read(here: Path, bowden: Command) -> None:
    (here / "lab.csv").write_text("time,start force\n05/06/2026 09:00:00,9\n05/06/2026 09:00:01,8\n", encoding="utf-8")
    status, out, _ = bowden("import", "lab.csv", "--guess", "-o", "map.toml")
    assert (status, "nor a time as 2026-05-13 09:00:00.000" in " ".join(out.split())) == (0, True)


def test_sheets_are_no_columns_to_add(here: Path, bowden: Command) -> None:
    workbook(here / "lab.xlsx")
    assert "To use one of them" not in bowden("import", "lab.xlsx", "--guess", "-o", "map.toml")[1]


def test_a_cell_that_is_no_number_does_not_stand_in_the_way_of_the_map_that_leaves_it_out(here: Path, bowden: Command
                                                                                          ) -> None:
    (here / "lab.csv").write_text("time_s,tension_end_n,tension_start_n\n0,5,OL\n0.01,5.1,6\n", encoding="utf-8")
    assert "row 2 of tension_start_n is no number: 'OL'" in bowden("info", "lab.csv")[1]
    assert bowden("import", "lab.csv", "-o", "lab.mcap")[0] == 2
    assert bowden("import", "lab.csv", "--guess", "-o", "map.toml")[0] == 0
    status, out, _ = bowden("import", "lab.csv", "--map", "map.toml", "-o", "lab.mcap")
    assert (status, "left out: tension_start_n (row 2 has no number: 'OL')" in out) == (0, True)
    assert set(trial.open("lab.mcap").columns) >= {"tension_end_n"}


def test_an_import_asks_about_a_range_that_no_rope_bench_has(here: Path, bowden: Command) -> None:
    np.savetxt("lab.csv", np.column_stack([1e3 * TIME, 20 + TIME, 5 + TIME]), delimiter=",", comments="",
               header="time_s,servo_position_m,tension_start_n")
    status, out, _ = bowden("import", "lab.csv", "-o", "lab.mcap")
    assert status == 0
    assert "Check time_s: it advances 10 s a row" in out
    assert "Check servo_position_m: it reaches 23.99 m, more than a rope bench has: is the unit right?" in out
    assert "tension_start_n:" not in out


def test_german_ends_of_a_rope_are_known(here: Path, bowden: Command) -> None:
    assert guessed(bowden, "Zeit,Kraft Anfang (N),Kraft Ende (N)", TIME, 9 + TIME, 8 + TIME)[0] == {
        "time_s", "tension_start_n", "tension_end_n"}


@pytest.mark.parametrize("name", ["a.blf", "a.log", "a.asc", "a.trc", "a.csv", "a.xlsx", "a.mat", "a.parquet",
                                  "a.mcap"])
@pytest.mark.parametrize("words", [("info",), ("import", "-o", "b.mcap")])
def test_an_empty_file_is_said_to_be_empty(here: Path, bowden: Command, name: str, words: tuple[str, ...]) -> None:
    (here / name).touch()
    status, out, err = bowden(words[0], name, *words[1:])
    assert (status, out) == (2, "")
    assert err.startswith(f"bowden: {name}: cannot be read (the file is empty); give ")


def test_times_that_fall_are_remarked(here: Path, bowden: Command) -> None:
    np.savetxt("lab.csv", np.column_stack([TIME[::-1], 9 + TIME]), delimiter=",", comments="",
               header="time_s,tension_start_n")
    assert f"{ROWS - 1} times of time_s do not rise" in bowden("info", "lab.csv")[1]


def test_a_recording_of_nothing_sends_nobody_to_an_import(here: Path, bowden: Command) -> None:
    from mcap.writer import Writer

    with (here / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    assert "no topics: nothing was recorded" in bowden("info", "a.mcap")[1]
    for command in ("report", "diagnose"):
        status, _, err = bowden(command, "a.mcap", *(("-o", "a.html") if command == "report" else ()))
        assert (status, err) == (2, "bowden: a.mcap: has no topics, so nothing was recorded; record again.\n")


def test_a_table_in_a_trial_s_place_comes_with_the_import(here: Path, bowden: Command) -> None:
    np.savetxt("lab.csv", TIME, header="time_s", comments="")
    assert bowden("report", "lab.csv", "-o", "a.html")[2] == (
        "bowden: lab.csv: not an MCAP file; give a recorded trial, or make one: bowden import lab.csv -o trial.mcap.\n")


def test_a_turning_axis_is_not_taken_for_a_rope(here: Path, bowden: Command) -> None:
    np.savetxt(here / "axis.csv", np.column_stack([TIME, np.sin(TIME), np.cos(TIME), 30 + TIME]), delimiter=",",
               comments="", header="time_s,servo_position_rad,servo_torque_nm,motor temperature")
    status, out, _ = bowden("import", "axis.csv", "--guess", "-o", "map.toml")
    assert (status, set(tomllib.loads((here / "map.toml").read_text()))) == (0, {"time_s"})
    assert out.count("turning axis") == 2
    assert "'motor temperature': its name and unit fit no signal" in " ".join(out.split())
    status, out, _ = bowden("import", "axis.csv", "-o", "axis.mcap")
    assert (status, "bowden diagnose and fit read the table itself" in out) == (0, True)


def test_a_column_without_any_value_is_named(here: Path, bowden: Command) -> None:
    (here / "lab.csv").write_text("time_s,tension_start_n,tension_end_n\n" + "".join(
        f"{k / 100},,{10 + k % 7}\n" for k in range(ROWS)))
    status, out, _ = bowden("import", "lab.csv", "-o", "lab.mcap")
    assert (status, "Check tension_start_n: it has no value in any row" in out) == (0, True), out
    assert "Check tension_end_n" not in out


def test_structures_of_another_rate_come_by_their_own_times(here: Path, bowden: Command) -> None:
    from scipy.io import savemat

    fast = np.arange(4 * ROWS) / 400
    savemat(here / "lab.mat", {"force": {"t_s": TIME, "start_N": 10 + TIME, "end_N": 5 + TIME},
                               "motor": {"t_s": TIME[::10], "rope_mm": 20 + TIME[::10]},
                               "knee": {"t_s": fast, "angle_deg": -fast}, "photo": np.ones((7, 7))})
    status, out, _ = bowden("import", "lab.mat", "--guess", "-o", "map.toml")
    assert status == 0
    assert "'photo(:,1)': 7 values, the table has 1600 rows" in out
    assert "3 columns of another rate by their own times" in " ".join(out.split())
    status, out, _ = bowden("import", "lab.mat", "--map", "map.toml", "-o", "lab.mcap")
    assert status == 0
    columns = trial.open(here / "lab.mcap").columns
    known = np.isfinite(columns["servo_position_m"])
    assert known.sum() == ROWS // 10
    assert columns["servo_position_m"][known] == pytest.approx(0.02 + 1e-3 * TIME[::10])
    assert np.isfinite(columns["tension_start_n"]).sum() == ROWS
    assert columns["knee_angle_rad"] == pytest.approx(-np.radians(fast))


def test_vectors_of_signals_outweigh_a_picture(here: Path, bowden: Command) -> None:
    from scipy.io import savemat

    savemat(here / "lab.mat", {"t": TIME, "force_start": 10 + TIME, "photo": np.ones((7, 7))})
    assert bowden("import", "lab.mat", "--guess", "-o", "map.toml")[0] == 0
    assert set(tomllib.loads((here / "map.toml").read_text())) == {"time_s", "tension_start_n"}


def test_rows_of_a_workbook_have_the_numbers_that_the_workbook_shows(here: Path, bowden: Command) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Spring A"])
    book.active["A4"], book.active["B4"], book.active["C4"] = "time (s)", "start\nforce (N)", "remark"
    for row in zip(TIME.tolist(), (10 + TIME).tolist(), [None, "wobbles", *[None] * ROWS], strict=False):
        book.active.append(row)
    book.save(here / "lab.xlsx")
    status, out, _ = bowden("import", "lab.xlsx", "--guess", "-o", "map.toml")
    assert (status, "the header in row 4" in " ".join(out.split())) == (0, True), out
    assert "'remark': row 6 has no number: 'wobbles'" in out
    assert tomllib.loads((here / "map.toml").read_text())["tension_start_n"]["column"] == "start force (N)"


@pytest.mark.parametrize(("delimiter", "quote", "mark"), [
    ("\t", "", ","), (",", '"', ","), (",", '"', "."), (";", "", ".")])
def test_whole_numbers_with_marks_between_thousands_and_quoted_decimal_commas_are_read(
        here: Path, bowden: Command, delimiter: str, quote: str, mark: str) -> None:
    def row(time_ms: str, force: str) -> str:
        return delimiter.join(f"{quote}{cell}{quote}" for cell in (time_ms, force))

    dotted = [(f"{round(1e3 * t):,}", f"{10 + t:.2f}") for t in TIME]
    swapped = str.maketrans(",.", ".,") if mark == "," else {}
    (here / "lab.csv").write_text("\n".join([row("time (ms)", "start force (N)"), *(
        row(*(cell.translate(swapped) for cell in cells)) for cells in dotted)]))
    status, _, err = bowden("import", "lab.csv", "--guess", "-o", "map.toml")
    assert (status, err) == (0, "")
    assert bowden("import", "lab.csv", "--map", "map.toml", "-o", "lab.mcap")[0] == 0
    read = trial.open(here / "lab.mcap")
    assert read.time_ns / 1e9 == pytest.approx(TIME)
    assert read.columns["tension_start_n"] == pytest.approx(10 + TIME)


def test_a_position_in_in_is_asked_about(here: Path, bowden: Command) -> None:
    signals, out = guessed(bowden, "time_s,start_lbf,servo_position_in", TIME, 9 + TIME, 1 + TIME / 40)
    assert signals == {"time_s", "tension_start_n", "servo_position_m"}
    assert "Check servo_position_m: 'servo_position_in' has no unit: is it in inches?" in out


def test_times_that_rows_share_and_counted_rows_come_with_what_to_do(here: Path, bowden: Command) -> None:
    rows = [f"{t // 0.02 * 0.02:.2f},{10 + t:.2f}" for t in TIME]
    (here / "lab.csv").write_text("\n".join(["time_s,tension_start_n", *rows]))
    _, _, err = bowden("import", "lab.csv", "-o", "lab.mcap")
    assert "row 3: time_s = 0 stands in the row before too; write times with more digits" in err
    signals, out = guessed(bowden, "index,tension_start_n", 100 * TIME, 9 + TIME)
    assert signals == {"tension_start_n"}
    assert "a column that counts rows will do, with the seconds of a row as its scale" in out


def test_channels_of_another_rate_in_a_tdms_file_come_by_their_own_times(here: Path, bowden: Command) -> None:
    nptdms = pytest.importorskip("nptdms")

    def channel(name: str, values: np.ndarray, step_s: float) -> object:
        return nptdms.ChannelObject("rig", name, values, {"wf_increment": step_s, "wf_start_offset": 0.0})

    with nptdms.TdmsWriter(here / "lab.tdms") as file:
        file.write_segment([channel("microphone", np.zeros(8 * ROWS), 0.00125),
                            channel("tension_start_n", 10 + TIME, 0.01), channel("tension_end_n", 5 + TIME, 0.01),
                            channel("servo_position_m", 0.1 + TIME[::10], 0.1)])
    status, out, _ = bowden("import", "lab.tdms", "-o", "lab.mcap")
    assert (status, "2 columns of another rate by their own times" in " ".join(out.split())) == (0, True)
    read = trial.open(here / "lab.mcap")
    assert read.columns["tension_end_n"] == pytest.approx(5 + TIME)
    known = np.isfinite(read.columns["servo_position_m"])
    assert read.columns["servo_position_m"][known] == pytest.approx(0.1 + TIME[::10])


def test_a_table_of_a_turning_axis_in_other_words_is_sent_to_the_columns_that_are_read(
        here: Path, bowden: Command) -> None:
    for name, phase in (("new.csv", 0.0), ("old.csv", 0.5)):
        turn = np.column_stack([TIME, np.sin(5 * TIME + phase), np.cos(5 * TIME + phase), TIME])
        np.savetxt(here / name, turn, delimiter=";", comments="", header="Zeit [s];Winkel [rad];Moment [Nm];x")
    status, out, _ = bowden("import", "new.csv", "--guess", "-o", "map.toml")
    assert (status, "'Moment [Nm]': a torque" in out) == (0, True)
    assert "are time_s, servo_position_rad and servo_torque_nm, in s, rad and N·m" in " ".join(out.split())
    for name in ("new.csv", "old.csv"):
        _, _, rows = (here / name).read_text().partition("\n")
        (here / name).write_text("time_s;servo_position_rad;servo_torque_nm;x\n" + rows)
    assert "N·m" in bowden("info", "new.csv")[1]
    (here / "volts.csv").write_text((here / "new.csv").read_text().replace("servo_torque_nm", "motor_voltage_v"))
    assert "motor_voltage_v    │    V │" in bowden("info", "volts.csv")[1]
    (here / "degrees.csv").write_text((here / "new.csv").read_text().replace("x\n", "x\ns;deg;Nm;\n", 1))
    assert "servo_position_rad is in deg by the row of units; write it in rad" in bowden(
        "diagnose", "degrees.csv", "--healthy", "old.csv")[2]
    _, out, _ = bowden("diagnose", "new.csv", "--healthy", "old.csv")
    assert out.count("columns not used: x") == 1


def test_of_many_columns_that_are_not_used_the_first_are_named_and_the_others_counted(
        here: Path, bowden: Command) -> None:
    for name, phase in (("new.csv", 0.0), ("old.csv", 0.5)):
        turn = np.column_stack([TIME, np.sin(5 * TIME + phase), np.cos(5 * TIME + phase), *[TIME] * 11])
        np.savetxt(here / name, turn, delimiter=",", comments="", header=",".join(
            ["time_s", "servo_position_rad", "servo_torque_nm", *(f"x{k:02}" for k in range(11))]))
    _, out, _ = bowden("diagnose", "new.csv", "--healthy", "old.csv")
    assert "columns not used: x00, x01, x02, x03, x04, x05, x06, x07 and 3 more" in " ".join(out.split())


def read_back(bowden: Command, text: str) -> tuple[dict[str, np.ndarray], str]:
    """Import a table by its guessed map; return its columns and what was printed."""
    Path("lab.csv").write_text(text, encoding="utf-8")
    status, guess, err = bowden("import", "lab.csv", "--guess", "-o", "map.toml", "--overwrite")
    assert (status, err) == (0, "")
    status, out, err = bowden("import", "lab.csv", "--map", "map.toml", "-o", "lab.mcap", "--overwrite")
    assert (status, err) == (0, "")
    return trial.open("lab.mcap").columns, " ".join(f"{guess} {out}".split())


def test_cells_with_their_units_are_read(here: Path, bowden: Command) -> None:
    rows = [f"{1e3 * t:.0f} ms;{(10 + t) / 1e3:.5f} kN;{50 * t % 100:.1f}%" for t in TIME]
    columns, out = read_back(bowden, "\n".join(["time;start force;gait_percent", *rows]))
    assert columns["tension_start_n"] == pytest.approx(10 + TIME)
    assert columns["gait_percent"] == pytest.approx(50 * TIME % 100)
    assert "units in the cells" in out


def test_a_name_over_two_lines_and_a_true_minus_are_read(here: Path, bowden: Command) -> None:
    rows = [f"{t:.2f};{10 + t:.2f};{0.5 * np.sin(t):.4f}".replace("-", "−") for t in TIME]
    columns, _ = read_back(bowden, "\n".join(['"time\n(s)";"start force\n(N)";"rope\nposition (m)"', *rows]))
    assert columns["tension_start_n"] == pytest.approx(10 + TIME)
    assert columns["servo_position_m"] == pytest.approx(0.5 * np.sin(TIME), abs=1e-4)


def test_a_rope_that_pushes_is_asked_about(here: Path, bowden: Command) -> None:
    rows = [f"{t:.2f},{-10 - t:.2f},{5 + t:.2f}" for t in TIME]
    _, out = read_back(bowden, "\n".join(["time,start force,end force", *rows]))
    assert out.count("is below 0, and a rope only pulls: does scale = -1 turn it?") == 2
    assert "tension_end_n: 'end force' is below" not in out
