"""`bowden monitor` with candump's lines in all its formats, CiA 402's words, and a configuration's own names."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eds.cia402 import text_of

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
def test_another_line_is_named(bowden: Run, here: Path, line: str) -> None:
    Path("a.log").write_text("(1.0) can0 701#05\n" + line + "\n")
    told = bowden("monitor", "a.log")
    assert (told.status, told.stderr.count("\n")) == (2, 1), told
    assert "a.log:2: " in told.stderr


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
