"""`bowden monitor`: a conversation on the bus, live and from a log, in words."""

from __future__ import annotations

import contextlib
import io
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

import bowden as bowden_library
from bowden.testing import CanBus
from bowden.testing.conversation import SdoStep, converse
from eds import packaged

Run = Callable[..., Any]
STEPS = [SdoStep(0x1018, 1), SdoStep(0x1008, 0), SdoStep(0x1008, 0, block=True), SdoStep(0x1017, 0, b"\x64\x00"),
         SdoStep(0x1018, 1, b"\0\0\0\0"), SdoStep(0x9999, 0)]


@pytest.fixture
def log(can_bus: CanBus, here: Path) -> Path:
    """A candump log of a boot, SDO transfers of every kind, NMT, PDOs and an EMCY of our knee drive."""
    node = can_bus.add_node("knee_drive", 5)
    converse(can_bus, 5, STEPS)
    can_bus.send(0x000, b"\x01\x05")
    can_bus.send(0x7E5, b"\x04\x01" + bytes(6))
    can_bus.run(0.15)
    node.emergency(0x4310, register=0x08)
    can_bus.run(0.01)
    with can.CanutilsLogWriter(here / "bus.log", channel="can0") as writer:
        for frame in can_bus.frames():
            writer.on_message_received(can.Message(frame.time_ns / 1e9, frame.cob_id, data=frame.data,
                                                   is_extended_id=False))
    return here / "bus.log"


def words(bowden: Run, *more: object) -> list[str]:
    told = bowden("monitor", *more, "--eds", f"5={packaged('knee_drive')}", "--json")
    assert told.status == 0, told.stderr
    return [json.loads(line)["text"] for line in told.stdout.splitlines()]


def test_a_log_is_told_in_words(bowden: Run, log: Path) -> None:
    told = words(bowden, log)
    name = "1008:00 Manufacturer device name"
    for line in ("boot-up", "SDO read 1018:01 Identity object: Vendor-ID = 11591168 (0x00B0DE00)",
                 "SDO write 1017:00 Producer heartbeat time = 100 (0x0064)", "NMT start, node 5",
                 "heartbeat OPERATIONAL",
                 "SDO abort of 1018:01 Identity object: Vendor-ID: 0x06010002 attempt to write a read-only object",
                 "SDO abort of 9999:00: 0x06020000 object does not exist in the object dictionary",
                 "EMCY 4310 excess temperature of the drive, register 09",
                 "LSS: switch state 01 00 00 00 00 00 00"):
        assert line in told, line
    assert told.count(f"SDO read {name} = 'Bowden knee drive'") == 2
    assert any(line.startswith("tpdo1: Statusword ") for line in told)


def test_what_is_shown_can_be_chosen(bowden: Run, log: Path) -> None:
    assert words(bowden, log, "--only", "emcy") == ["EMCY 4310 excess temperature of the drive, register 09"]
    assert words(bowden, log, "--node", "6") == []
    told = bowden("monitor", log, "--table", "--json")
    table = json.loads(told.stdout)
    assert (told.status, table["lost"]) == (0, 0)
    assert sum(each["frames"] for each in table["identifiers"]) == len(log.read_text().splitlines())


def test_a_live_bus_is_told_too(bowden: Run, can_bus: CanBus, here: Path) -> None:
    can_bus.add_node("knee_drive", 5)
    can_bus.open()
    can_bus.after(0.1, lambda: can_bus.send(0x000, b"\x01\x00"))
    at = "--interface", "bowden", "--channel", can_bus.channel, "--for", "0.2"
    told = words(bowden, *at)
    assert "NMT start, all nodes" in told
    assert any(line.startswith("tpdo1: Statusword ") for line in told)
    full = can_bus.open()
    assert full.lost == 0


class SlowTerminal(io.StringIO):
    """A terminal on which each line takes 10 ms of bus time."""

    def __init__(self, bus: CanBus) -> None:
        super().__init__()
        self.bus = bus

    def write(self, text: str) -> int:
        """Write, and let bus time pass at the end of a line."""
        if text.endswith("\n"):
            self.bus.run(0.01)
        return super().write(text)


def test_every_frame_is_shown_or_counted_as_lost(bowden: Run, can_bus: CanBus) -> None:
    """A frame each millisecond, ten times as fast as the terminal, into a receive queue of eight."""
    can_bus.open()
    for number in range(100):
        can_bus.after(1e-3 * (number + 1), lambda: can_bus.send(0x123, b"\x01"))
    with contextlib.redirect_stdout(SlowTerminal(can_bus)) as slow:
        told = bowden("monitor", "--interface", "bowden", "--channel", can_bus.channel, "--option", "rx_queue=8",
                      "--for", "0.5", "--json")
    shown = [json.loads(line)["can_id"] for line in slow.getvalue().splitlines()]
    assert shown == [0x123] * len(shown)
    lost = re.search(r"(\d+) frames were lost, because they came faster than they were read", told.stderr)
    assert told.status == 0
    assert lost is not None
    assert (len(shown) + int(lost[1]), int(lost[1]) > 50) == (100, True)


@pytest.mark.parametrize("more", [
    ("absent.log",), ("--only", "pdo,nothing"), ("--node", "x"), ("--eds", "knee.eds"), ("--eds", "5=absent.eds")])
def test_bad_input_is_one_sentence(bowden: Run, here: Path, more: tuple[str, ...]) -> None:
    told = bowden("monitor", *more)
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1), told


def test_unreadable_frames_are_shown_as_bytes(bowden: Run, here: Path) -> None:
    (here / "odd.log").write_text(
        "(0.000000) can0 085#01\n(0.100000) can0 000#01\n(0.200000) can0 585#43\n(0.300000) can0 185#01\n"
        "(0.400000) can0 0CF00400#0102\n(0.500000) can0 123#\n(0.600000) can0 705#\n")
    assert words(bowden, "odd.log") == [
        "EMCY of 1 bytes: 01", "NMT of 1 bytes: 01", "SDO frame of 1 bytes: 43", "tpdo1: 1 bytes in place of 2: 01",
        "extended identifier: 01 02", "", "heartbeat empty"]


@pytest.fixture
def trial(here: Path) -> bowden_library.Trial:
    """A short trial: its PDOs have the mapping that bring-up writes, another one than the EDS files' own."""
    return bowden_library.run(bowden_library.Experiment(period_s=0.6, cycles=1, settle=0), output=here / "trial.mcap")


def test_the_pdos_of_the_bench_have_the_mapping_that_bring_up_writes(bowden: Run, trial: Any) -> None:
    told = [json.loads(line)["text"] for line in bowden("monitor", trial.path, "--only", "pdo", "--json").stdout
            .splitlines()]
    targets = [line for line in told if line.startswith("targets: ")]
    assert targets[-1].startswith("targets: Target position of 1 ")
    assert re.search(r"Target position of 1 \S+ m, Target position of 2 \S+ rad$", targets[-1])
    assert re.search(r"tpdo1: Statusword 0x\w{4} \(.+?\), Position actual value \S+ m, Torque actual value \S+ N·m$",
                     "\n".join(told), re.MULTILINE)
    assert not [line for line in told if "bytes in place of" in line]


def test_a_dbc_decodes_the_trials_frames_to_its_own_signals(bowden: Run, trial: Any, here: Path) -> None:
    cantools = pytest.importorskip("cantools")
    assert bowden("monitor", trial.path, "--table", "--dbc", here / "bench.dbc").status == 0
    layout = cantools.database.load_file(here / "bench.dbc")
    frames = trial.frames
    start = layout.get_message_by_frame_id(0x183)
    assert start.get_signal_by_name("AI_input_PV_1").unit == "N"
    decoded = {start.decode(bytes(frame["data"][:frame["dlc"]]))["AI_input_PV_1"]
               for frame in frames[frames["can_id"] == 0x183]}
    recorded = trial.columns["tension_start_n"]
    assert {round(float(value), 2) for value in recorded[np.isfinite(recorded)]} <= {round(v, 2) for v in decoded}
    again = bowden("monitor", trial.path, "--table", "--dbc", here / "bench.dbc")
    assert again.status == 2
    assert "the file exists" in again.stderr


def test_the_decoded_values_are_written_as_mf4(bowden: Run, trial: Any, here: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    assert bowden("monitor", trial.path, "--table", "--mf4", here / "bench.mf4").status == 0
    with asammdf.MDF(here / "bench.mf4") as file:
        told = file.get("node4_tpdo1.AI_input_PV_1")
    assert told.unit == "N"
    assert len(told.samples) == int((trial.frames["can_id"] == 0x184).sum())
    recorded = trial.columns["tension_end_n"]
    assert float(told.samples.max()) == pytest.approx(float(np.nanmax(recorded)), abs=1e-9)
