"""CAN logs with a frame that is cut in its payload: each such frame is listed with its line, or the log is refused."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

import trial

Run = Callable[..., Any]
FRAMES = 60
SERVO = bytes.fromhex("37129D520000F6FF")


def log(path: Path) -> list[str]:
    """Write `FRAMES` whole frames, every third of them the servo's PDO; return the lines of the text."""
    with can.Logger(path) as writer:
        for k in range(FRAMES):
            writer.on_message_received(can.Message(
                timestamp=1.7e9 + k / 1000, arbitration_id=(0x80, 0x181, 0x184)[k % 3], is_extended_id=False,
                channel=1, data=(b"", SERVO, b"\x12\x34\x56\x78")[k % 3]))
    return [] if path.suffix == ".blf" else path.read_text().splitlines(keepends=True)


def cut(path: Path, keep: str, *, last: bool) -> int:
    """Cut the 20th servo PDO behind `keep`, as the last line without an end if `last`; return the line's number."""
    lines = log(path)
    at = [k for k, line in enumerate(lines) if "181" in line and "37" in line][15]
    short = lines[at][:lines[at].index(keep) + len(keep)]
    path.write_text("".join(lines[:at]) + (short if last else short + "\n" + "".join(lines[at + 1:])))
    return at + 1


@pytest.mark.parametrize("last", [False, True], ids=["mid", "last"])
@pytest.mark.parametrize(("name", "keep", "listed"), [
    ("a.log", "#3712", "PDO 181 has 2 of the 8 bytes that are mapped; kept as a frame, without a value"),
    ("a.log", "#37129", "181#37129' is no whole frame; left out"),
    ("a.asc", "d 8 37 12", "identifier 181 has 2 of the 8 bytes that its length states; left out"),
    ("a.asc", "d 8 37 12 9D 52 00 00 F6 F", "the last byte of identifier 181 has one of two digits; left out"),
    ("a.asc", "  181", "181' is not read as a frame; left out"),
    ("a.trc", "8    37 12 9D", "identifier 181 has 3 of the 8 bytes that its length states; left out"),
    ("a.trc", " DT ", "DT' is not read as a frame; left out")])
def test_a_cut_frame_is_listed_by_its_line(
        bowden: Run, here: Path, name: str, keep: str, listed: str, last: bool) -> None:
    line = cut(Path(name), keep, last=last)
    told = bowden("import", name, "-o", "a.mcap", "--json")
    assert told.status == 0, told
    damage = json.loads(told.stdout)["damage"]
    assert [place for place in damage if place.startswith(f"line {line}: ") and place.endswith(listed)], damage
    shown = bowden("import", name, "-o", "b.mcap")
    assert all(f"  {place}\n" in shown.stdout for place in damage)
    if not listed.startswith("PDO"):  # bowden info reads no declaration
        assert listed in " ".join(bowden("info", name).stdout.split())
    if name == "a.log" and not listed.startswith("PDO"):
        assert bowden("monitor", name).stderr == "".join(f"bowden: {name}: {place}.\n" for place in damage)
    kept = len(trial.open(Path("a.mcap")).frames)
    assert kept <= FRAMES if "kept" in listed else kept < FRAMES


@pytest.mark.parametrize(("name", "keep"), [
    ("a.asc", "Rx   d"), ("a.trc", "8    37 1"), ("a.csv", ",8")])
def test_a_cut_line_that_cannot_be_read_is_refused_with_its_number(
        bowden: Run, here: Path, name: str, keep: str) -> None:
    if name == "a.csv":
        lines = log(Path(name))
        at = next(k for k, line in enumerate(lines) if "0x181" in line)
        Path(name).write_text("".join(lines[:at]) + lines[at].rpartition(",")[0] + "\n" + "".join(lines[at + 1:]))
        line = at + 1
    else:
        line = cut(Path(name), keep, last=False)
    told = bowden("import", name, "-o", "a.mcap")
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1), told
    assert told.stderr.startswith(f"bowden: {name}: line {line}: ")
    assert not Path("a.mcap").exists()


@pytest.mark.parametrize("name", ["a.log", "a.asc", "a.trc", "a.csv", "a.blf"])
def test_a_whole_log_is_listed_without_damage(bowden: Run, here: Path, name: str) -> None:
    log(Path(name))
    told = bowden("import", name, "-o", "a.mcap", "--json")
    result = json.loads(told.stdout)
    assert (result["damage"], result["counts"]["frames"]) == ([], FRAMES)


def test_an_asc_log_of_decimal_bytes_may_have_bytes_of_one_digit(bowden: Run, here: Path) -> None:
    Path("a.asc").write_text(
        "date Sat Nov 28 12:00:00.000 2026\nbase dec  timestamps absolute\ninternal events logged\n"
        "   0.100000 1  385             Rx   d 2 55 7\n   0.200000 1  385             Rx   d 2 55 8\n")
    result = json.loads(bowden("import", "a.asc", "-o", "a.mcap", "--json").stdout)
    assert result["counts"]["frames"] == 2
    assert "cut_frames" not in result["counts"]


@pytest.mark.parametrize("closed", [True, False], ids=["header with its size", "header of a killed logger"])
def test_a_cut_blf_names_the_frame_after_which_bytes_are_missing(bowden: Run, here: Path, closed: bool) -> None:
    log(Path("a.blf"))
    whole = bytearray(Path("a.blf").read_bytes())
    if not closed:
        whole[16:24] = bytes(8)
    Path("a.blf").write_bytes(whole[:-200])
    result = json.loads(bowden("import", "a.blf", "-o", "a.mcap", "--json").stdout)
    assert 0 < result["counts"]["frames"] < FRAMES
    (place,) = [place for place in result["damage"] if "missing" in place]
    assert place.startswith(f"after frame {result['counts']['frames']}: ")


def test_of_many_cut_frames_the_first_are_listed_and_the_others_counted(bowden: Run, here: Path) -> None:
    lines = log(Path("a.asc"))
    Path("a.asc").write_text("".join(line.replace(" 52 00 00 F6 FF", "") for line in lines))
    assert FRAMES // 3 == 20
    assert len(json.loads(bowden("import", "a.asc", "-o", "a.mcap", "--json").stdout)["damage"]) == 20
    Path("a.asc").write_text("".join(line.replace(" 52 00 00 F6 FF", "").replace(" 34 56 78", "") for line in lines))
    damage = json.loads(bowden("import", "a.asc", "-o", "b.mcap", "--json").stdout)["damage"]
    assert damage[-1] == "and 20 more such places"


def test_monitor_lists_the_first_damaged_lines_and_counts_the_others(bowden: Run, here: Path) -> None:
    lines = log(Path("a.log")) * 3
    Path("a.log").write_text("".join(line.replace("F6FF", "F6F") if k % 2 else line for k, line in enumerate(lines)))
    listed = json.loads(bowden("import", "a.log", "-o", "a.mcap", "--json").stdout)["damage"]
    assert len(listed) == 21
    assert bowden("monitor", "a.log").stderr.splitlines() == [f"bowden: a.log: {place}." for place in listed]


@pytest.mark.parametrize(("name", "keep"), [("a.asc", "d 8 37 12"), ("a.trc", "8    37 12 9D")])
def test_monitor_remarks_a_cut_frame(bowden: Run, here: Path, name: str, keep: str) -> None:
    cut(Path(name), keep, last=False)
    told = bowden("monitor", name)
    assert (told.status, told.stderr.count("\n")) == (0, 1), told.stderr
    assert re.search(rf"{name}: frame \d+, 181, is cut: it has [23] of 8 bytes", told.stderr)


def test_monitor_shows_the_frames_before_a_line_that_cannot_be_read(bowden: Run, here: Path) -> None:
    cut(Path("a.trc"), "8    37 1", last=False)
    told = bowden("monitor", "a.trc")
    assert told.status == 2
    assert re.search(r"a.trc: after frame \d+: .*; mend the file or cut it there\.", told.stderr)


def test_bytes_that_a_logger_writes_with_one_digit_are_kept(bowden: Run, here: Path) -> None:
    Path("a.asc").write_text("base hex  timestamps absolute\ninternal events logged\n"
                             " 0.1 1  181  Rx   d 8 1 2 3 4 5 6 7 8\n")
    result = json.loads(bowden("import", "a.asc", "-o", "a.mcap", "--json").stdout)
    assert (result["counts"]["frames"], result["damage"]) == (1, [])


def test_a_log_of_cut_frames_alone_is_refused_with_the_first(bowden: Run, here: Path) -> None:
    Path("a.asc").write_text("base hex  timestamps absolute\ninternal events logged\n 0.1 1  181  Rx   d 8 37 12\n")
    told = bowden("import", "a.asc", "-o", "a.mcap")
    assert (told.status, told.stderr) == (2, (
        "bowden: a.asc: holds no whole CAN frame (line 3: identifier 181 has 2 of the 8 bytes that its length states; "
        "left out); give a log that is not cut.\n"))
