"""python-can's own programs read and write trials, found by entry point as any plug-in is."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import can
import example_trials
import numpy as np
import pytest

import trial
from parameters import InputError
from trial.convert.frames import ChannelNumbers
from trial.convert.python_can import McapReader, McapWriter, TrialMessage, read_log
from trial.mcap_file import cdr

ROOT = Path(trial.__file__).parent.parent
LOG = """\
(1700000000.000000) can0 080#
(1700000000.000123) can0 181#3706102700000A00
(1700000000.000256) can1 081#
(1700000000.000300) can0 201#R4
(1700000000.000301) can0 1ABCDEF0#0102
(1700000000.010000) can0 20000088#0000000000000000
(1700000000.010500) can0 701#05
"""


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """Return an environment in which the readers are installed by entry point, whatever this one has."""
    info = tmp_path / "site" / "bowden_mcap-0.dist-info"
    info.mkdir(parents=True)
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bowden-mcap\nVersion: 0\n")
    (info / "entry_points.txt").write_text("".join(
        f"[{group}]\n" + "".join(f"{name} = {place}\n" for name, place in declared[group].items())
        for group in ("can.io.message_reader", "can.io.message_writer")))
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(info.parent), str(ROOT)])}


def run(environment: dict[str, str], *words: str) -> str:
    done = subprocess.run([sys.executable, *words], env=environment, check=True, capture_output=True, text=True)
    return done.stdout


def test_logconvert_there_and_back_changes_nothing(tmp_path: Path, installed: dict[str, str]) -> None:
    before, between, after = tmp_path / "a.log", tmp_path / "b.mcap", tmp_path / "c.log"
    before.write_text(LOG)
    run(installed, "-m", "can.logconvert", str(before), str(between))
    run(installed, "-m", "can.logconvert", str(between), str(after))
    expected = list(can.LogReader(before))
    for one, other in zip(expected, McapReader(between), strict=True):
        # a float holds the seconds of today to 0.24 µs; python-can leaves an error frame without its channel
        assert one.equals(other, timestamp_delta=1e-6, check_channel=one.channel is not None)
    back = list(can.LogReader(after))
    back[3].dlc = 4  # python-can's candump writer leaves out the length of a remote frame
    for one, other in zip(expected, back, strict=True):
        assert one.equals(other, timestamp_delta=1e-6, check_channel=one.channel is not None)


def test_player_plays_a_trial_onto_a_bus(tmp_path: Path, installed: dict[str, str]) -> None:
    path = example_trials.write(tmp_path / "trial.mcap", cycles=3)
    script = (
        "import sys, can, can.player, threading\n"
        "bus = can.Bus('x', interface='virtual')\n"
        f"sys.argv = ['player', '-i', 'virtual', '-c', 'x', {str(path)!r}]\n"
        "can.player.main()\n"
        "print([message.arbitration_id for message in iter(lambda: bus.recv(0), None)])\n"
        "bus.shutdown()\n"
    )
    played = run(installed, "-c", script).splitlines()[-1]
    assert played == str([0x181 + frame for frame in range(8)] * 3)


def test_logger_and_log_reader_know_a_trial_by_its_ending(tmp_path: Path, installed: dict[str, str]) -> None:
    script = (
        "import sys, can\n"
        "with can.Logger(sys.argv[1]) as logger:\n"
        "    for number in range(3):\n"
        "        logger(can.Message(timestamp=number, arbitration_id=0x181 + number, data=bytes(number)))\n"
        "with can.LogReader(sys.argv[1]) as reader:\n"
        "    print(type(logger).__name__, [(row.arbitration_id, row.timestamp, row.dlc) for row in reader])\n"
    )
    told = run(installed, "-c", script, str(tmp_path / "logged.mcap")).strip()
    assert told == f"McapWriter {[(0x181 + number, float(number), number) for number in range(3)]}"


def test_logger_records_a_bus_through_its_notifier(tmp_path: Path) -> None:
    path = tmp_path / "logged.mcap"
    with can.Bus("logged", interface="virtual", receive_own_messages=True) as bus:
        writer = McapWriter(path)
        for number in range(5):
            bus.send(can.Message(arbitration_id=0x180 + number, is_extended_id=False, data=bytes(number)))
            received = bus.recv(0)
            assert received is not None
            writer.on_message_received(received)
        assert writer.file_size() > 0
        writer.stop()
    opened = trial.open(path)
    assert opened.frames["can_id"].tolist() == [0x180, 0x181, 0x182, 0x183, 0x184]
    assert opened.frames["dlc"].tolist() == [0, 1, 2, 3, 4]
    assert opened.columns == {}


def test_messages_of_a_trial_carry_exact_times(tmp_path: Path) -> None:
    path = tmp_path / "exact.mcap"
    exact = 1_700_000_000_123_456_789
    writer = McapWriter(path)
    writer.on_message_received(TrialMessage(exact, arbitration_id=5, data=b"\1", channel="can1", is_rx=False))
    writer.on_message_received(can.Message(timestamp=1.5, arbitration_id=6, is_remote_frame=True, dlc=3, channel=None))
    writer.stop()
    first, second = McapReader(path)
    assert isinstance(first, TrialMessage)
    assert (first.time_ns, first.channel, first.is_rx, bytes(first.data)) == (exact, "can1", False, b"\1")
    assert (second.timestamp, second.is_remote_frame, second.dlc, bytes(second.data)) == (1.5, True, 3, b"")


def test_frames_that_a_trial_cannot_hold_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "fd.mcap"
    writer = McapWriter(path)
    writer.on_message_received(can.Message(is_fd=True, data=bytes(64)))
    writer.on_message_received(can.Message(arbitration_id=1, channel="vcan3"))
    writer.stop()
    opened = trial.open(path)
    assert len(opened.frames) == 1
    assert opened.result == {"fd_frames": 1, "channels": {"vcan3": 3}}


def test_the_bytes_that_a_cut_log_lacks_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "log.blf"
    with can.BLFWriter(path) as writer:
        for k in range(20_000):
            writer.on_message_received(can.Message(timestamp=k / 1000, arbitration_id=k % 500, data=k.to_bytes(8)))
    whole = path.read_bytes()
    frames = read_log(path)
    assert (len(frames.rows), frames.counts["missing_bytes"]) == (20_000, 0)
    path.write_bytes(whole[:-1000])
    frames = read_log(path)
    assert 0 < len(frames.rows) < 20_000
    assert frames.counts["missing_bytes"] == 1000


def test_what_cannot_be_done_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be appended to"):
        McapWriter(tmp_path / "a.mcap", append=True)
    (tmp_path / "b.mcap").write_bytes(b"no trial at all")
    with pytest.raises(InputError, match="not an MCAP file"):
        list(McapReader(tmp_path / "b.mcap"))


def test_channels_keep_their_numbers_where_they_can() -> None:
    numbers = ChannelNumbers()
    assert [numbers.number(name) for name in ("can2", "vcan2", None, "can0", "can17", "can2")] == [2, 0, 1, 3, 4, 2]
    for number in range(11):
        numbers.number(f"bus{number}x")
    with pytest.raises(ValueError, match="is the seventeenth"):
        numbers.number("one more")


def test_flags_survive_the_way_through_messages(tmp_path: Path) -> None:
    recorder = trial.Recorder(tmp_path / "a.mcap", metadata={}, attachments={}, threaded=False)
    recorder.frame(7, 0x1ABCDEF0, bytes(3), cdr.REMOTE | cdr.EXTENDED, 15)
    recorder.frame(8, 0x88, bytes(8), cdr.ERROR, sent=True)
    recorder.close({})
    writer = McapWriter(tmp_path / "b.mcap")
    for message in McapReader(tmp_path / "a.mcap"):
        writer.on_message_received(message)
    writer.stop()
    assert np.array_equal(trial.open(tmp_path / "a.mcap").frames, trial.open(tmp_path / "b.mcap").frames)


def test_a_trial_loads_python_can_without_pandas_and_mdf_frames_are_still_read(tmp_path: Path) -> None:
    pytest.importorskip("asammdf")
    log = tmp_path / "bus.mf4"
    script = (
        "import sys; from bowden.bench import light_imports; light_imports.load(); import can\n"
        "assert 'can' in sys.modules and 'pandas' not in sys.modules and 'asammdf' not in sys.modules\n"
        "from trial.convert.python_can import _mdf_reader, read_log\n"
        "reader = _mdf_reader(); writer = sys.modules['can.io.mf4'].MF4Writer(sys.argv[1])\n"
        "frame = can.Message(timestamp=1.0, arbitration_id=0x181, is_extended_id=False, data=b'ab')\n"
        "writer.on_message_received(frame)\n"
        "writer.stop(); from pathlib import Path; print(len(read_log(Path(sys.argv[1])).rows))\n")
    told = subprocess.run([sys.executable, "-W", "ignore", "-c", script, str(log)], capture_output=True, text=True,
                          check=False)
    assert (told.returncode, told.stdout.strip()) == (0, "1"), told.stderr
