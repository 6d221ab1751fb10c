"""Tables and logs of other labs, typed as they come: read as they were meant, or refused in one sentence."""

from __future__ import annotations

import gzip
import json
import math
import os
import re
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

import trial
from eds.bench.bench_network import Network, wire
from trial.convert import candump
from trial.convert.frames import rows_of

WIRE = wire(Network())
ROWS = 40
PLAIN = "time_s,tension_start_n,tension_end_n\n" + "".join(
    f"{k / 100},{20 + k / 8},{10 + k / 16}\n" for k in range(ROWS))


def german(text: str) -> str:
    """The same table with semicolons and decimal commas."""
    return text.replace(",", ";").replace(".", ",")


def with_units(text: str, units: str = "s,N,N") -> str:
    header, rest = text.split("\n", 1)
    return f"{header}\n{units}\n{rest}"


def repeated(text: str) -> str:
    """The same rows, the header again in the middle, as in two files put one behind the other."""
    lines = text.splitlines(keepends=True)
    return "".join([*lines[:20], lines[0], *lines[20:]])


def iso(text: str, stamp: Callable[[int], str]) -> str:
    lines = text.splitlines()
    return "\n".join([lines[0], *(f"{stamp(k)},{line.split(',', 1)[1]}" for k, line in enumerate(lines[1:]))]) + "\n"


WRITTEN: dict[str, tuple[bytes, str]] = {  # what a lab's program wrote, and what is said of it
    "plain": (PLAIN.encode(), ""),
    "semicolons and decimal commas": (german(PLAIN).encode(), "delimiter semicolon, decimal comma"),
    "tabs": (PLAIN.replace(",", "\t").encode(), "delimiter tab"),
    "tabs and decimal commas": (german(PLAIN).replace(";", "\t").encode(), "delimiter tab, decimal comma"),
    "blanks": (PLAIN.replace(",", "   ").encode(), "delimiter blanks"),
    "a byte order mark": (PLAIN.encode("utf-8-sig"), ""),
    "UTF-16": (PLAIN.encode("utf-16"), "UTF-16"),
    "UTF-16 without a mark": (PLAIN.encode("utf-16-le"), "UTF-16-LE"),
    "Latin-1": (("# Kraft in µN × 1e6\n" + PLAIN).encode("cp1252"), "CP1252, 1 comment line"),
    "carriage returns alone": (PLAIN.replace("\n", "\r").encode(), ""),
    "a row of units": (with_units(PLAIN).encode(), "units in row 2"),
    "a row of units in brackets": (with_units(PLAIN, "[s],[N],[N]").encode(), "units in row 2"),
    "comments": (("# rig 7\n% 40 N\n" + PLAIN + "# end\n").encode(), "3 comment lines"),
    "a title above": (f"Recorder 3.1\nOperator;N. N.\n\n{german(PLAIN)}".encode(),
                      "2 lines before the header in row 4"),
    "the header again": (repeated(PLAIN).encode(), "the header 1 more time"),
    "a delimiter at the end of rows": (PLAIN.replace("\n", ",\n").encode(), ""),
    "quoted": (PLAIN.replace("time_s", '"time_s"').replace("\n0.01,", '\n"0.01",').encode(), ""),
    "ISO 8601": (iso(PLAIN, lambda k: f"2024-05-01T12:00:00.{k:02}0Z").encode(),
                 "time_s is absolute, from 2024-05-01T12:00:00.000000 on"),
    "ISO 8601 with a zone": (iso(PLAIN, lambda k: f"2024-05-01 14:00:00.{k:02}+02:00").encode(),
                             "time_s is absolute, from 2024-05-01T12:00:00.000000 on"),
    "day, month, year": (iso(PLAIN, lambda k: f"01.05.2024 12:00:00.{k:02}").encode(), "from 2024-05-01T12:00:00"),
    "time of day, past midnight": (iso(PLAIN, lambda k: f"23:59:59.{80 + k:02}" if k < 20 else f"0:00:00.{k - 20:02}"
                                       ).encode(), "a time of day"),
}


@pytest.mark.parametrize("case", WRITTEN)
def test_a_table_is_read_as_it_was_written_and_it_is_said_how(
    here: Path, bowden: Callable[..., tuple[int, str, str]], case: str
) -> None:
    data, said = WRITTEN[case]
    (here / "lab.csv").write_bytes(data)
    status, out, err = bowden("import", "lab.csv", "-o", "trial.mcap")
    assert (status, err) == (0, "")
    assert said in out
    columns = trial.open(here / "trial.mcap").columns
    assert columns["time_s"] == pytest.approx(np.arange(ROWS) / 100, abs=1e-9)
    assert columns["tension_start_n"].tolist() == [20 + k / 8 for k in range(ROWS)]
    assert columns["tension_end_n"].tolist() == [10 + k / 16 for k in range(ROWS)]


def test_absolute_times_stay_absolute_on_the_trial_s_clock(here: Path, bowden: Callable[..., object]) -> None:
    (here / "lab.csv").write_text(iso(PLAIN, lambda k: f"2024-05-01T12:00:00.{k:02}0Z"))
    bowden("import", "lab.csv", "-o", "trial.mcap")
    assert trial.open(here / "trial.mcap").time_ns[0] == 1_714_564_800_000_000_000


LAB = "Zeit [ms];Kraft Eingang [N];Kraft Ausgang [N];Seilweg [mm];Kniewinkel [°];Bemerkung\n" + "".join(
    f"{10 * k};{20 + k / 8};{10 + k / 16};{k / 10};{30 + k / 2};walk\n".replace(".", ",") for k in range(ROWS))


def test_diagnose_offers_the_map_guess_writes_it_and_import_takes_it(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    (here / "lab.csv").write_text(LAB, encoding="utf-8")
    status, out, err = bowden("diagnose", "lab.csv")
    assert status == 2
    assert "bowden import lab.csv --guess -o map.toml" in err
    assert bowden("import", "lab.csv", "--guess", "-o", "map.toml")[0] == 0
    guessed = tomllib.loads((here / "map.toml").read_text(encoding="utf-8"))
    assert {signal: table["column"] for signal, table in guessed.items()} == {
        "time_s": "Zeit [ms]", "tension_start_n": "Kraft Eingang [N]", "tension_end_n": "Kraft Ausgang [N]",
        "servo_position_m": "Seilweg [mm]", "knee_angle_rad": "Kniewinkel [°]"}
    assert (guessed["time_s"]["unit"], guessed["servo_position_m"]["unit"]) == ("ms", "mm")
    assert guessed["knee_angle_rad"]["scale"] == -1  # flexion is negative here
    assert "Bemerkung" in (here / "map.toml").read_text(encoding="utf-8")
    status, out, err = bowden("import", "lab.csv", "--map", "map.toml", "-o", "trial.mcap")
    assert (status, err) == (0, "")
    assert "left out: Bemerkung" in out
    columns = trial.open(here / "trial.mcap").columns
    assert columns["time_s"] == pytest.approx(np.arange(ROWS) / 100)
    assert columns["servo_position_m"] == pytest.approx(np.arange(ROWS) / 1e4)
    assert columns["knee_angle_rad"] == pytest.approx(-np.radians(30 + np.arange(ROWS) / 2))


def _guessed(here: Path, bowden: Callable[..., tuple[int, str, str]], header: str, top: float = 5270.0,
             ) -> tuple[dict[str, Any], str]:
    """Write a table with `header` whose columns rise to `top`; return the guessed map and what is printed."""
    count = len(header.split(","))
    rows = "".join(",".join([f"{k / 10}", *[f"{top * k / 20}"] * (count - 1)]) + "\n" for k in range(21))
    (here / "lab.csv").write_text(f"{header}\n{rows}", encoding="utf-8")
    status, out, _ = bowden("import", "lab.csv", "--guess", "-o", "map.toml", "--overwrite")
    assert status == 0
    return tomllib.loads((here / "map.toml").read_text(encoding="utf-8")), out


@pytest.mark.parametrize(("spelt", "newton"), [
    ("[g]", 9.80665e-3), ("(gf)", 9.80665e-3), ("[gf]", 9.80665e-3), ("[mg]", 9.80665e-6), ("[lbf]", 4.4482216152605),
    ("[kp]", 9.80665), ("[dN]", 0.1), ("[kN]", 1e3)])
def test_a_stated_unit_of_force_is_never_dropped(
    here: Path, bowden: Callable[..., tuple[int, str, str]], spelt: str, newton: float
) -> None:
    name = f"F prox {spelt}"
    guessed, out = _guessed(here, bowden, f"t [s],{name}")
    assert guessed["tension_start_n"]["column"] == name
    assert name in out
    assert bowden("import", "lab.csv", "--map", "map.toml", "-o", "trial.mcap", "--overwrite")[0] == 0
    assert trial.open(here / "trial.mcap").columns["tension_start_n"][-1] == pytest.approx(5270 * newton)


def test_a_unit_behind_an_underscore_is_read_and_an_unknown_one_is_not_taken_for_newton(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    guessed, out = _guessed(here, bowden, "t_s,F_prox_g,F_dist [V]")
    assert (guessed["tension_start_n"]["unit"], "tension_end_n" in guessed) == ("g", False)
    assert "'F_dist [V]': its unit 'V' is not known" in out


def test_a_force_beyond_a_rope_bench_is_questioned(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    _, out = _guessed(here, bowden, "t [s],F prox")
    assert "Check tension_start_n: 'F prox' reaches 5270 N, more than a rope bench has: no unit is stated" in out
    assert "CHECK: reaches 5270 N" in (here / "map.toml").read_text(encoding="utf-8")
    assert "Check" not in _guessed(here, bowden, "t [s],F prox [g]")[1]


@pytest.mark.parametrize(("header", "signals"), [
    ("Zeit,Kraft vorne,Kraft hinten,enc_mm", "tension_start_n tension_end_n servo_position_m"),
    ("t,data.F1,data.F2", "tension_start_n tension_end_n"),
    ("temps [s],effort entrée [N],effort sortie [N],genou [deg]", "tension_start_n tension_end_n knee_angle_rad"),
    ("tiempo,fuerza entrada,fuerza salida,desplazamiento,rodilla",
     "tension_start_n tension_end_n servo_position_m knee_angle_rad"),
    ("shijian,lali_qian,lali_hou,weiyi,jiaodu", "tension_start_n tension_end_n servo_position_m knee_angle_rad")])
def test_common_words_of_five_languages_are_known(
    here: Path, bowden: Callable[..., tuple[int, str, str]], header: str, signals: str
) -> None:
    guessed, _ = _guessed(here, bowden, header, top=40.0)
    first, *others = header.split(",")
    assert {signal: table["column"] for signal, table in guessed.items()} == {
        "time_s": first, **dict(zip(signals.split(), others, strict=True))}


def test_what_is_not_assigned_is_on_the_terminal_with_what_to_say(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    _, out = _guessed(here, bowden, "t,F prox,F near,ai7", top=40.0)
    assert "Not assigned:" in out
    assert "looks more like tension_start_n" in out
    assert "'ai7': its name and unit fit no signal" in out
    assert "To use one of them, add to map.toml: [SIGNAL], column = " in out


def test_a_guessed_map_shows_the_detected_way_of_reading(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    (here / "lab.csv").write_bytes("Zeit;Kraft Eingang;Winkel\ns;N;°\n0,0;1,5;3\n0,1;2,5;4\n".encode("cp1252"))
    assert bowden("import", "lab.csv", "--guess", "-o", "map.toml")[0] == 0
    lines = (here / "map.toml").read_text(encoding="utf-8").splitlines()
    told = tomllib.loads("\n".join(line[2:] for line in lines if re.match(r"# \[csv\]|# [a-z_]+ = ", line)))
    assert told == {"csv": {"encoding": "cp1252", "delimiter": ";", "decimal": ",", "comment": "#", "header_row": 1,
                            "units_row": 2}}
    assert bowden("import", "lab.csv", "--map", "map.toml", "-o", "trial.mcap")[0] == 0


def test_a_map_overrides_what_would_be_detected(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    (here / "lab.csv").write_text("! rig 7\nms;N\nt;force\n0;1,5\n10;2,5\n", encoding="utf-16")
    (here / "map.toml").write_text(
        '[csv]\nencoding = "utf-16"\ndelimiter = ";"\ndecimal = ","\ncomment = "!"\nheader_row = 3\nunits_row = 2\n'
        '[time_s]\ncolumn = "t"\n[tension_end_n]\ncolumn = "force"\n')
    assert bowden("import", "lab.csv", "--map", "map.toml", "-o", "trial.mcap")[0] == 0
    columns = trial.open(here / "trial.mcap").columns
    assert (columns["time_s"].tolist(), columns["tension_end_n"].tolist()) == ([0.0, 0.01], [1.5, 2.5])


REFUSED = {  # what is in the file, and what is said
    "a unit against its name": (with_units(PLAIN, "ms,N,N"), "time_s is in s by its name and in ms"),
    "a month or a day": (iso(PLAIN, lambda k: f"03/04/2024 12:00:00.{k:02}"), "is not a number"),
    "a number of 6000 digits": (PLAIN + "1" * 6000 + ",1,1\n", "is not finite"),
    "a cell of 200,000 characters": (PLAIN + '"' + "x" * 200_000 + '",1,1\n', "field larger than field limit"),
    "nothing known": ("colour;taste\n1;2\n3;4\n", "has no column time_s"),
    "a picture": ("\x89PNG\r\n\x1a\n\0\0\0", "give a CSV file"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_meant_is_refused_in_one_sentence(
    here: Path, bowden: Callable[..., tuple[int, str, str]], case: str
) -> None:
    text, message = REFUSED[case]
    (here / "lab.csv").write_text(text)
    status, out, err = bowden("import", "lab.csv", "-o", "trial.mcap")
    assert (status, out) == (2, "")
    assert message in err
    assert err.startswith("bowden: lab.csv: ")
    assert err.count("\n") == 1
    assert len(err) < 400
    assert sorted(os.listdir()) == ["lab.csv"]


def test_fifty_thousand_columns_are_read_in_time_that_grows_with_their_number(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    def cost(columns: int) -> float:
        names = ",".join(["time_s", "tension_end_n", *(f"channel {k}" for k in range(columns))])
        rows = "".join(",".join([str(k), *["1.5"] * (columns + 1)]) + "\n" for k in range(3))
        (here / "wide.csv").write_text(f"{names}\n{rows}")
        begun = time.process_time()
        assert bowden("import", "wide.csv", "-o", "wide.mcap", "--overwrite", "--json")[0] == 0
        return time.process_time() - begun

    cost(100)
    assert cost(50_000) < 40 * cost(5_000)  # ten times where it is linear, a hundred where it is quadratic


@pytest.mark.parametrize("name", ["pipe.csv", "pipe.log", "pipe.mcap", "pipe.asc", "pipe.mat", "pipe.txt"])
def test_a_pipe_or_a_device_is_refused_before_it_is_read(
    here: Path, bowden: Callable[..., tuple[int, str, str]], name: str
) -> None:
    os.mkfifo(name)
    status, out, err = bowden("import", name, "-o", "trial.mcap")
    told = f"bowden: {name}: cannot be read, it is a named pipe; give the path of a file.\n"
    assert (status, out, err) == (2, "", told)
    os.unlink(name)
    os.symlink("/dev/zero", name)
    for command in (("import", name, "-o", "trial.mcap"), ("diagnose", name), ("trial", "--knee", name, "-o", "a.mcap"),
                    ("trial", "--config", name, "-o", "a.mcap"), ("info", name)):
        status, out, err = bowden(*command)
        assert (status, out, err.count("\n")) == (2, "", 1), command
        assert "it is a device" in err, command


@pytest.mark.parametrize("name", ["line.csv", "line.log", "line.asc"])
def test_a_line_of_a_gigabyte_is_refused_before_it_fills_the_memory(
    here: Path, bowden: Callable[..., tuple[int, str, str]], name: str
) -> None:
    with open(name, "wb") as file:
        file.write(b"time_s,")
        file.truncate(1 << 30)
    status, out, err = bowden("import", name, "-o", "trial.mcap")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert name in err


NESTED = "[" * 100_000 + "]" * 100_000


@pytest.mark.parametrize("text", [f"x = {NESTED}", "x = " + "9" * 6000, "x = 'open"])
def test_a_configuration_that_is_no_toml_is_refused(
    here: Path, bowden: Callable[..., tuple[int, str, str]], text: str
) -> None:
    (here / "bench.toml").write_text(text)
    for command in (("trial", "--config", "bench.toml", "-o", "a.mcap"), ("import", "a.csv", "--map", "bench.toml",
                                                                          "-o", "a.mcap")):
        status, out, err = bowden(*command)
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert "bench.toml: not valid TOML" in err


def made(path: Path, metadata: dict[str, str] | None = None, attachments: dict[str, bytes] | None = None) -> Path:
    recorder = trial.Recorder(path, metadata=metadata or {}, attachments=attachments or {}, threaded=False)
    for row in range(100):
        recorder.cycle(row * 1_000_000, [row / 1000, *[1.0] * (len(trial.SIGNALS) - 1)])
    recorder.close({})
    return path


@pytest.mark.parametrize("text", [b"stiffness = [", b"\xff\xfe", b"x = " + NESTED.encode(), b"x = " + b"9" * 6000])
def test_a_damaged_calibration_in_a_trial_is_named(
    here: Path, bowden: Callable[..., tuple[int, str, str]], text: bytes
) -> None:
    made(here / "a.mcap", attachments={"calibration.toml": text})
    status, out, err = bowden("diagnose", "a.mcap")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "a.mcap: the attached calibration.toml is damaged" in err


def test_an_output_is_never_written_through_a_link(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    (here / "precious").write_text("mine")
    made(here / "a.mcap")
    (here / "lab.csv").write_text(PLAIN)
    for command in (("import", "lab.csv"), ("export", "a.mcap"), ("report", "a.mcap")):
        ending = {"import": "mcap", "export": "csv", "report": "html"}[command[0]]
        link = here / f"out.{ending}"
        link.symlink_to(here / "precious")
        os.symlink(here / "precious", f".part-out.{ending}")  # where a temporary file of a known name would lie
        assert bowden(*command, "-o", link)[0] == 2
        assert bowden(*command, "-o", link, "--overwrite")[0] == 0
        assert not link.is_symlink()
    assert (here / "precious").read_text() == "mine"


def bench_log(cycles: int = 5) -> str:
    rows = []
    for row in range(cycles):
        at = 1_700_000_000_000_000_000 + row * 1_000_000
        rows += [(at, 0x80, 0, 0, 0, False, b"")]
        for cob_id, values in ((0x181, (0x1237, 0.01, 0.5)), (0x182, (0x237, 0.0)), (0x183, (20.5,)), (0x184, (1.0,))):
            data = WIRE.tpdo[cob_id].pack_si(*values)
            rows += [(at + 1000 * (cob_id - 0x100), cob_id, 0, len(data), 0, False, data)]
    return "".join(candump.lines(rows_of(rows)))


def screen(text: str, stamped: bool) -> str:
    """What candump shows of a log, with -ta or without."""
    lines = []
    for line in text.splitlines():
        stamp, channel, rest = line.split(" ")[:3]
        can_id, data = rest.split("#")
        shown = " ".join(data[at:at + 2] for at in range(0, len(data), 2))
        lines.append(f" {stamp if stamped else ''}  {channel}  {can_id}   [{len(data) // 2}]  {shown}")
    return "\n".join(lines) + "\n"


def logs(folder: Path) -> dict[str, Path]:
    plain = folder / "bench.log"
    plain.write_text(bench_log())
    found = {}
    for ending in ("csv", "db", "asc"):
        found[ending] = folder / f"bench.{ending}"
        with can.LogReader(plain) as reader, can.Logger(found[ending]) as writer:
            for message in reader:
                message.channel = 1
                writer.on_message_received(message)
    for ending, text in (("txt", bench_log()), ("screen.txt", screen(bench_log(), True))):
        found[ending] = folder / f"bench.{ending}"
        found[ending].write_text(text)
    found["asc.gz"] = folder / "bench.asc.gz"
    found["asc.gz"].write_bytes(gzip.compress(found["asc"].read_bytes()))
    return found


def test_logs_of_python_can_and_of_a_screen_give_the_columns_that_candump_gives(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    found = logs(here)
    assert bowden("import", "bench.log", "-o", "plain.mcap")[0] == 0
    plain = trial.open(here / "plain.mcap").columns
    for ending, path in found.items():
        assert bowden("import", path, "-o", "other.mcap", "--overwrite")[0] == 0, ending
        other = trial.open(here / "other.mcap").columns
        for name in ("servo_position_m", "tension_start_n", "tension_end_n", "knee_angle_rad"):
            assert np.array_equal(plain[name], other[name], equal_nan=True), (ending, name)


def test_a_screen_without_time_is_refused_with_the_remedy(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    (here / "bench.txt").write_text(screen(bench_log(), False))
    status, out, err = bowden("import", "bench.txt", "-o", "trial.mcap")
    assert (status, out) == (2, "")
    assert "without a time; record it with candump -L" in err


def test_fd_frames_and_long_dlcs_are_counted_and_said(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    (here / "fd.log").write_text("".join(f"(1.{k:06}) can0 123##1AABB\n" for k in range(12)))
    assert "holds 12 CAN FD frames and no classical one" in bowden("import", "fd.log", "-o", "a.mcap")[2]
    (here / "long.log").write_text(bench_log() + "(1700000001.000000) can0 123#1122334455667788_C\n")
    status, out, _ = bowden("import", "long.log", "-o", "a.mcap", "--json")
    assert (status, json.loads(out)["counts"]["dlc_above_8"]) == (0, 1)


def exported(here: Path, bowden: Callable[..., tuple[int, str, str]], *arguments: str) -> None:
    """What leaves as another format comes back the same."""
    made(here / "a.mcap")
    status, _, err = bowden("export", "a.mcap", *arguments)
    assert (status, err) == (0, "")
    status, _, err = bowden("import", arguments[-1], "-o", "back.mcap")
    assert (status, err) == (0, "")
    before, after = trial.open(here / "a.mcap").columns, trial.open(here / "back.mcap").columns
    assert set(after) == set(before)
    for name, column in before.items():
        assert np.array_equal(column, after[name], equal_nan=True), name


def test_parquet_goes_out_and_in(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    pytest.importorskip("pyarrow")
    exported(here, bowden, "-o", "a.parquet")


def test_matlab_goes_out_and_in(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    exported(here, bowden, "-o", "a.mat")


def test_matlab_7_3_goes_out_and_in(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    pytest.importorskip("h5py")
    exported(here, bowden, "--mat73", "-o", "a.mat")


def test_a_structure_of_matlab_is_guessed_and_imported(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    from scipy.io import savemat

    knee = 30 + np.arange(50) / 10
    savemat(here / "rig.mat", {"log": {"t": np.arange(50) / 100, "kneeAngle_deg": knee, "forceEnd": np.arange(50.0)},
                               "rate": 100.0, "subject": "S1"})
    assert bowden("import", "rig.mat", "--guess", "-o", "map.toml")[0] == 0
    assert bowden("import", "rig.mat", "--map", "map.toml", "-o", "rig.mcap")[0] == 0
    columns = trial.open(here / "rig.mcap").columns
    assert columns["knee_angle_rad"] == pytest.approx(-np.radians(knee))
    assert columns["tension_end_n"].tolist() == np.arange(50.0).tolist()


def test_mdf_signals_and_frames_are_imported(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    asammdf = pytest.importorskip("asammdf")
    along = np.arange(100) / 100
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(20 + along, along, name="tension_start_n", unit="N"),
                     asammdf.Signal(10 + along, along, name="tension_end_n", unit="N")])
        file.append([asammdf.Signal(np.arange(10.0), along[::10], name="temperature", unit="K")])
        file.save(here / "rig.mf4")
    status, out, err = bowden("import", "rig.mf4", "-o", "rig.mcap")
    assert (status, err) == (0, "")
    columns = trial.open(here / "rig.mcap").columns
    assert columns["tension_start_n"] == pytest.approx(20 + along)
    assert "left out: temperature" in out
    with can.Logger(here / "bus.mf4") as writer:
        for message in can.LogReader(logs(here)["asc"]):
            writer.on_message_received(message)
    assert bowden("import", "bus.mf4", "-o", "bus.mcap")[0] == 0
    assert trial.open(here / "bus.mcap").columns["tension_start_n"] == pytest.approx(np.full(5, 20.5))


def test_a_missing_library_is_named_with_its_extra(
    here: Path, bowden: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, name, extra in (("asammdf", "a.mf4", "mf4"), ("h5py", "b.mat", "mat73"), ("pyarrow", "c.parquet",
                                                                                       "parquet")):
        (here / name).write_bytes(b"MATLAB 7.3 MAT-file".ljust(600))
        for hidden in {module, *(one for one in sys.modules if one.startswith(f"{module}."))}:
            monkeypatch.setitem(sys.modules, hidden, None)
        status, _, err = bowden("import", name, "-o", "out.mcap")
        assert status == 2
        assert f"pip install bowden-bench[{extra}]" in err


def test_units_of_a_whole_angle_are_what_they_say() -> None:
    from trial.convert.lab_table import TO_SI, unit_of

    assert [unit_of(text) for text in ("[°]", "(deg)", "Degrees", "kN", "msec", "x")] == [
        "°", "deg", "deg", "kN", "ms", ""]
    assert TO_SI["°"] == ("rad", math.pi / 180)


@pytest.mark.parametrize("ending", [".xlsx", ".tdms", ".mf4"])
def test_cycles_go_out_and_in_through_excel_tdms_and_mdf(
    here: Path, bowden: Callable[..., tuple[int, str, str]], ending: str
) -> None:
    pytest.importorskip({".xlsx": "openpyxl", ".tdms": "nptdms", ".mf4": "asammdf"}[ending])
    (here / "lab.csv").write_text(PLAIN)
    assert bowden("import", "lab.csv", "-o", "a.mcap")[0] == 0
    assert bowden("export", "a.mcap", "-o", f"a{ending}")[::2] == (0, "")
    assert bowden("import", f"a{ending}", "-o", "b.mcap")[::2] == (0, "")
    one, other = trial.open(here / "a.mcap").columns, trial.open(here / "b.mcap").columns
    for name in ("time_s", "tension_start_n", "tension_end_n"):
        assert other[name] == pytest.approx(one[name], abs=1e-12)


def test_a_workbook_with_units_and_other_names_is_guessed(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (("Zeit", "Kraft vorne"), ("ms", "g"), *((10 * k, 100.5 * k) for k in range(ROWS))):
        book.active.append(row)
    book.save(here / "lab.xlsx")
    assert bowden("import", "lab.xlsx", "--guess", "-o", "map.toml")[0] == 0
    assert bowden("import", "lab.xlsx", "--map", "map.toml", "-o", "a.mcap")[0] == 0
    columns = trial.open(here / "a.mcap").columns
    assert columns["time_s"] == pytest.approx(np.arange(ROWS) / 100)
    assert columns["tension_start_n"] == pytest.approx(100.5 * 9.80665e-3 * np.arange(ROWS))


def test_the_library_reads_any_file_that_import_takes(here: Path) -> None:
    import bowden as library

    (here / "lab.csv").write_text(PLAIN)
    read = library.read("lab.csv")
    assert read.columns["tension_start_n"].tolist() == [20 + k / 8 for k in range(ROWS)]
    shown = read._repr_html_()
    assert "tension_start_n" in shown
    assert "nan" not in shown
    figure = read.plot()
    assert [axes.get_ylabel() for axes in figure.axes] == ["N"]
    assert len(read.plot("tension_end_n", "time_s").axes) == 2
    with pytest.raises(library.InputError, match="no_such is no signal of this trial"):
        read.plot("no_such")
