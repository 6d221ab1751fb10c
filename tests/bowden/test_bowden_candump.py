"""`bowden monitor` with candump's lines in all its formats, CiA 402's words, and a configuration's own names."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

import trial
from eds.cia402 import text_of
from trial.read import path_names

Run = Callable[..., Any]
FORMATS = {
    "log": "(1.500000) can0 701#05\n(1.600000) can0 601#R\n(1.700000) can0 1F334455#11223344\n",
    "log, direction": "(1.500000) can0 701#05 R\n(1.600000) can0 601#R0 T\n(1.700000) can0 1F334455#11.22.33.44 R\n",
    "plain": "  can0  701   [1]  05\n  can0  601   [0]  remote request\n  can0  1F334455   [4]  11 22 33 44\n",
    "absolute": " (1.500000)  can0  701   [1]  05\n (1.600000)  can0  601   [0]  remote request\n"
                " (1.700000)  can0  1F334455   [4]  11 22 33 44   '.\"3D'\n",
    "extra": " (1.500000)  can0  RX - -  701   [1]  05\n (1.600000)  can0  TX - -  601   [0]  remote request\n\n"
             " (1.700000)  can0  RX - -  1F334455   [4]  11 22 33 44\n",
    "date": " (2026-11-26 22:00:01.500000)  can0  701   [1]  05\n can0  601   [0]  remote request\n"
            " can0  1F334455   [4]  11 22 33 44\n",
    "colours": "\x1b[34m  can0  701   [1]  05\x1b[0m\n  can0  601   [0]  remote request\n"
               "  can0 1F334455 [4]  11 22 33 44\n",
}


@pytest.mark.parametrize("text", FORMATS.values(), ids=FORMATS)
@pytest.mark.parametrize("way", ["file", "stdin"])
def test_every_format_of_candump_is_read(
        bowden: Run, here: Path, monkeypatch: pytest.MonkeyPatch, text: str, way: str) -> None:
    Path("a.log").write_text(text)
    monkeypatch.setattr("sys.stdin", io.StringIO(text))
    told = bowden("monitor", "a.log" if way == "file" else "-")
    assert told.status == 0, told.stderr
    words = [line[12:].split(maxsplit=1) for line in told.stdout.splitlines()]
    assert [word[0] for word in words] == ["701", "601", "1F334455"]
    assert words[0][1].endswith("heartbeat OPERATIONAL")
    assert words[1][1].endswith("remote request of 0 bytes")


@pytest.mark.parametrize("line", [
    "can0 701 [1]", "(1.0) can0 701#0", "(1.0) can0 701##0112233", "can0  701   [12]  " + "00 " * 12, "hello"])
def test_another_line_is_listed_and_the_frames_around_it_are_shown(bowden: Run, here: Path, line: str) -> None:
    Path("a.log").write_text(f"(1.0) can0 701#05\n{line}\n(1.1) can0 703#05\n")
    told = bowden("monitor", "a.log")
    assert (told.status, told.stderr.count("\n")) == (0, 1), told
    assert told.stderr.startswith("bowden: a.log: line 2: ")
    assert told.stderr.endswith("is a CAN FD frame; left out.\n" if "##" in line or "[12]" in line
                                else "is no whole frame; left out.\n")
    assert [shown.split()[1] for shown in told.stdout.splitlines()] == ["701", "703"]


@pytest.mark.parametrize(("text", "refused"), [
    ("hello\nyou\n", "a.log: holds no classical CAN frame (line 1: 'hello' is no whole frame; left out); record it "
                     "with candump -L."),
    ("(1.0) can0 701#05\nhello\nyou\n", "a.log: 2 lines are not as candump -L writes them; give such a log.")])
def test_a_text_of_other_lines_is_refused(bowden: Run, here: Path, text: str, refused: str) -> None:
    Path("a.log").write_text(text)
    told = bowden("monitor", "a.log")
    assert (told.status, told.stderr.splitlines()[-1]) == (2, f"bowden: {refused}")


def test_lines_that_never_are_frames_are_refused_before_they_end(
        bowden: Run, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = io.StringIO("hello\n" * 1000)
    monkeypatch.setattr("sys.stdin", lines)
    told = bowden("monitor", "-")
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1), told
    assert lines.readline() == "hello\n"


@pytest.mark.parametrize(("torn", "damage"), [
    ("(1.2) can0 7", "'(1.2) can0 7' is no whole frame; left out"),
    ("(1.2) can0 704#7", "'(1.2) can0 704#7' is no whole frame; left out"),
    ("(1.2) can0 704#05", "the last line has no end, so bytes of its frame may be missing; kept")])
def test_a_torn_last_line_is_listed_and_the_frames_before_it_are_shown(
        bowden: Run, here: Path, torn: str, damage: str) -> None:
    Path("a.log").write_text("(1.0) can0 701#05\n(1.1) can0 703#05\n" + torn)
    told = bowden("monitor", "a.log")
    assert (told.status, told.stderr) == (0, f"bowden: a.log: line 3: {damage}.\n")
    assert told.stdout.splitlines()[-1].split()[2] == ("4" if damage.endswith("kept") else "3")


def test_a_torn_blf_is_remarked(bowden: Run, here: Path) -> None:
    with can.BLFWriter("a.blf") as writer:
        writer.on_message_received(can.Message(1.0, 0x701, data=b"\x05", is_extended_id=False))
    Path("torn.blf").write_bytes(Path("a.blf").read_bytes()[:-3])
    assert bowden("monitor", "a.blf").stderr == ""
    told = bowden("monitor", "torn.blf")
    assert (told.status, "3 bytes are missing at its end" in told.stderr) == (0, True), told


FOREIGN = "".join(f"({k / 100:.6f}) can0 {0x301 + k % 3:03X}#0011\n" for k in range(100))


@pytest.mark.parametrize("command", [
    "diagnose foreign.mcap", "fit foreign.mcap -o model.toml", "simulate foreign.mcap",
    "diagnose foreign.mcap --healthy foreign.mcap"])
def test_a_trial_of_frames_alone_is_refused_as_what_it_is(bowden: Run, here: Path, command: str) -> None:
    Path("foreign.log").write_text(FOREIGN)
    assert bowden("import", "foreign.log", "-o", "foreign.mcap").status == 0
    told = bowden(*command.split())
    assert (told.status, told.stderr) == (2, (
        "bowden: foreign.mcap: holds CAN frames and no signal: no cycle of the bench's PDOs is among them; say bowden "
        "monitor foreign.mcap to see the frames, and import the log with --config of its bench.\n"))


def test_a_trial_without_identification_is_refused_in_words(bowden: Run, here: Path) -> None:
    Path("foreign.log").write_text(FOREIGN)
    assert bowden("import", "foreign.log", "-o", "foreign.mcap").status == 0
    told = bowden("identify", "all", "--from", "foreign.mcap", "-o", "calibration.toml")
    assert (told.status, told.stderr) == (2, (
        "bowden: foreign.mcap: records no experiment of an identification; give a trial of bowden identify.\n"))


def test_the_log_of_another_bench_is_imported_by_its_declaration(bowden: Run, here: Path) -> None:
    assert bowden("init", "--shape", "bench_two_legs", "-o", "bench.toml").status == 0
    assert bowden("trial", "--config", "bench.toml", "--dry-run", "--cycles", 1, "--settle", 0, "--period", 1,
                  "-o", "a.mcap").status == 0
    assert bowden("export", "a.mcap", "-o", "a.log").status == 0
    assert bowden("import", "a.log", "-o", "b.mcap", "--config", "bench.toml").status == 0
    made, imported = trial.open(Path("a.mcap")), trial.open(Path("b.mcap"))
    assert path_names(imported) == path_names(made) == ("left", "right")
    names = {name for name in made.columns if "tension" in name}
    assert len(names) == 4
    assert names <= set(imported.columns)


@pytest.mark.slow
def test_a_bench_is_fitted_from_its_imported_log(bowden: Run, here: Path) -> None:
    """The log ends between a SYNC and the targets that answer it: the last row has no target."""
    assert bowden("trial", "--cycles", 3, "--settle", 0, "--period", 1, "-o", "a.mcap").status == 0
    assert bowden("export", "a.mcap", "-o", "a.log").status == 0
    assert bowden("import", "a.log", "-o", "b.mcap").status == 0
    told = bowden("fit", "b.mcap", "-o", "model.toml")
    assert told.status == 0, told
    assert re.search(r"servo_target_m lacks 1 of \d+ values", told.stdout)


def test_statusword_controlword_and_mode_are_in_words(bowden: Run, here: Path) -> None:
    Path("a.log").write_text("(1.0) can0 58B#4B41600037060000\n(1.1) can0 58B#4F6160000AFFFFFF\n")
    told = bowden("monitor", "a.log", "--eds", f"11={Path(__file__).resolve().parents[2] / 'eds' / 'knee_drive.eds'}")
    assert "= 1591 (0x0637) = Operation enabled, remote, target reached" in told.stdout
    assert "= 10 = CST" in told.stdout
    assert text_of(0x6841, 0x0008) == "Fault"
    assert text_of(0x6040, 0x010F) == "enable operation, halt"
    assert text_of(0x6064, 0x0F) == text_of(0x6041, "text") == ""


def test_a_configuration_declares_the_simulated_bench_and_its_names(bowden: Run, here: Path) -> None:
    config = Path(__file__).resolve().parents[2] / "eds" / "bench_two_legs.toml"
    assert bowden("node", "read", "right_end", "1018:01", "--config", config).status == 0
    assert "708  heartbeat" in bowden("monitor", "--for", "0.2", "--table", "--config", config).stdout
    told = bowden("tare", "right_start", "--config", config)
    assert (told.status, "completed" in told.stdout) == (0, True), told.stderr
    told = bowden("tare", "wrong", "--config", config, "--path", "right")
    assert (told.status, told.stderr.count("\n")) == (2, 1)
