"""What is recorded is what any reader finds, byte for byte the same each time, or a stated failure."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import example_trials
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Chunk, DataEnd, Metadata
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

import trial
from eds.declaration import ObservedPart, packaged
from parameters import InputError
from trial.mcap_file import cdr
from trial.record import FLUSH_NS
from trial.recover import recover
from trial.signals import COLUMNS, CycleRow, with_observers


def test_a_cycle_row_has_a_field_for_each_signal_of_the_table() -> None:
    assert CycleRow._fields == COLUMNS


def test_values_of_a_cycle_row_stand_under_their_signals_with_observers_and_own_columns() -> None:
    bench = packaged()
    kind = replace(bench.devices[0].type, observed=(ObservedPart("position", "again_m", "m", "rope position"),))
    bench = replace(bench, devices=(replace(bench.devices[0], type=kind), *bench.devices[1:]))
    names = [signal.name for signal in with_observers(bench)]
    observed = [name for name in names if name not in COLUMNS]
    assert len(observed) == 1
    row = CycleRow(**{name: float(place) for place, name in enumerate(COLUMNS)})
    assert row.values((), ()) == tuple(row)
    found = dict(zip([*names, "own"], row.values([-1.0] * len(observed), (7.0,)), strict=True))
    assert found == row._asdict() | dict.fromkeys(observed, -1.0) | {"own": 7.0}


def test_mcaps_own_reader_finds_summary_indexes_and_attachments(recorded: Path) -> None:
    with recorded.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = {summary.channels[number].topic: count
                  for number, count in summary.statistics.channel_message_counts.items()}
        assert counts == {"/can/frames": 5600, "/cycle": 700, "/events": 14}
        assert summary.statistics.message_end_time == 699 * 1_000_000 + 7 * 60_000
        assert len(summary.chunk_indexes) == summary.statistics.chunk_count
        assert [attached.name for attached in reader.iter_attachments()] == list(example_trials.ATTACHMENTS)
        assert [named.name for named in reader.iter_metadata()] == ["trial", "result"]
        times = [message.log_time for _, _, message in reader.iter_messages()]
    assert times == sorted(times)
    assert len(times) == 6314


def test_every_checksum_holds_read_as_a_stream(recorded: Path) -> None:
    with recorded.open("rb") as file:
        assert sum(1 for _ in StreamReader(file, validate_crcs=True).records) > 6314


def test_what_explains_the_trial_comes_first_and_its_result_last(recorded: Path) -> None:
    with recorded.open("rb") as file:
        order = [record for record in StreamReader(file, emit_chunks=True).records
                 if isinstance(record, Chunk | Metadata | Attachment | DataEnd)]
    assert [getattr(record, "name", "") for record in order[:3]] == ["trial", *example_trials.ATTACHMENTS]
    assert {type(record) for record in order[3:-2]} == {Chunk}
    assert (order[-2].name, type(order[-1])) == ("result", DataEnd)


def test_a_decoder_that_knows_only_the_schemas_reads_the_same_values(recorded: Path) -> None:
    opened = trial.open(recorded)
    with recorded.open("rb") as file:
        decoded = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    cycles = [row for _, channel, _, row in decoded if channel.topic == "/cycle"]
    for name in trial.COLUMNS:
        assert np.array_equal([getattr(row, name) for row in cycles], opened.columns[name], equal_nan=True)
    frames = [row for _, channel, _, row in decoded if channel.topic == "/can/frames"]
    assert [row.header.frame_id for row in frames[:3]] == ["can0/rx", "can1/rx", "can0/rx"]
    assert frames[7].header.frame_id == "can1/tx"
    assert [row.id for row in frames] == opened.frames["can_id"].tolist()
    assert [list(row.data) for row in frames] == opened.frames["data"].tolist()
    assert [row.header.stamp.sec * 10**9 + row.header.stamp.nanosec for row in frames] \
        == opened.frames["time_ns"].tolist()
    events = [(row.kind, row.source, row.text) for _, channel, _, row in decoded if channel.topic == "/events"]
    assert events == [tuple(event[1:]) for event in opened.events]


def test_a_chunk_holds_at_most_64_kib_and_100_ms_of_one_topic(recorded: Path) -> None:
    with recorded.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for chunk in summary.chunk_indexes:
        assert chunk.uncompressed_size <= 65_536
        assert chunk.message_start_time // FLUSH_NS == chunk.message_end_time // FLUSH_NS
        assert len(chunk.message_index_offsets) == 1


def test_the_file_depends_on_what_was_recorded_and_on_nothing_else(tmp_path: Path) -> None:
    script = "import sys; from pathlib import Path; sys.path[:0] = sys.argv[2:]; import example_trials; " \
             "example_trials.write(Path(sys.argv[1]))"
    files = []
    for seed in "1", "2":
        files.append(tmp_path / seed / "any name.mcap")
        files[-1].parent.mkdir()
        subprocess.run([sys.executable, "-c", script, str(files[-1]), str(Path(example_trials.__file__).parent),
                        str(Path(trial.__file__).parent.parent)],
                       check=True, env={**os.environ, "PYTHONHASHSEED": seed})
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_writer_thread_writes_the_same_channels(tmp_path: Path) -> None:
    placed = trial.open(example_trials.write(tmp_path / "placed.mcap"))
    threaded = trial.open(example_trials.write(tmp_path / "threaded.mcap", threaded=True))
    assert threaded.digest() == placed.digest()
    assert (threaded.lost_cycles, placed.lost_cycles) == (0, 0)


@pytest.mark.walltime
def test_what_waits_is_written_when_the_bus_falls_silent(tmp_path: Path) -> None:
    path = tmp_path / "silent.mcap"
    recorder = trial.Recorder(path, metadata={}, attachments={})
    begun = path.stat().st_size
    recorder.frame(0, 0x701, b"\x05")
    for _ in range(100_000_000):  # ends as soon as the file has grown
        if path.stat().st_size > begun:
            break
    assert path.stat().st_size > begun
    recorder.frame(1, 0x702, b"\x05")
    recorder.close({})
    assert trial.open(path).frames["can_id"].tolist() == [0x701, 0x702]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_disk_that_stalls_blocks_nothing_and_loses_nothing(tmp_path: Path) -> None:
    pipe, path = tmp_path / "pipe", tmp_path / "trial.mcap"
    os.mkfifo(pipe)
    reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    os.set_blocking(reading, True)
    recorder = trial.Recorder(pipe, metadata={}, attachments={}, threaded=True, overwrite=True)
    example_trials.record(recorder, 1000)  # 400 KB packed into a pipe that holds 64 and that nobody reads yet
    with path.open("wb") as file:
        parts = iter(lambda: os.read(reading, 65536), b"")
        copying = threading.Thread(target=file.writelines, args=(parts,))
        copying.start()
        recorder.close({})
        copying.join()
    os.close(reading)
    opened = trial.open(path)
    assert (len(opened.time_ns), len(opened.frames), opened.lost_cycles) == (1000, 8000, 0)


def test_an_existing_file_is_kept_unless_told_otherwise(recorded: Path) -> None:
    before = recorded.read_bytes()
    with pytest.raises(InputError, match="the file exists"):
        trial.Recorder(recorded, metadata={}, attachments={})
    assert recorded.read_bytes() == before
    trial.Recorder(recorded, metadata={}, attachments={}, overwrite=True, threaded=False).close({})
    assert len(trial.open(recorded).time_ns) == 0


@pytest.mark.parametrize("name", ["no such folder/trial.mcap", "."])
def test_a_path_that_cannot_be_written_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"cannot be written|the file exists"):
        trial.Recorder(tmp_path / name, metadata={}, attachments={})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_disk_full_from_the_start_is_refused() -> None:
    with pytest.raises(InputError, match="No space left"):
        trial.Recorder("/dev/full", metadata={}, attachments={}, overwrite=True)


def test_a_run_refused_before_it_starts_leaves_nothing(tmp_path: Path) -> None:
    recorder = trial.Recorder(tmp_path / "refused.mcap", metadata={}, attachments={})
    recorder.frame(0, 0x80, b"")
    recorder.discard()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("threaded", [False, True])
def test_a_disk_that_fills_ends_the_recording_with_the_file_whole(tmp_path: Path, threaded: bool) -> None:
    path, limit = tmp_path / "full.mcap", 200_000
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = trial.Recorder(path, metadata={}, attachments={}, threaded=threaded)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))  # the kernel then refuses as a full disk does
        with pytest.raises(trial.RecordingError, match=r"full\.mcap: recording stopped \(File too large\)"):
            example_trials.record(recorder, 1_000_000)  # the writer may be a few blocks behind
        example_trials.record(recorder, 10)  # the safe stop goes on, unrecorded
        recorder.close({})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.stat().st_size <= limit
    assert recorder.failure is not None
    found = recover(path, tmp_path / "mended.mcap")
    assert found.damaged == 0
    opened = trial.open(tmp_path / "mended.mcap")
    assert opened.frames["can_id"][:8].tolist() == list(range(0x181, 0x189))
    assert len(opened.frames) + len(opened.time_ns) + len(opened.events) == found.messages > 1000


def test_what_is_no_frame_or_at_no_time_is_refused(tmp_path: Path) -> None:
    recorder = trial.Recorder(tmp_path / "trial.mcap", metadata={}, attachments={}, threaded=False)
    with pytest.raises(ValueError, match="at most 8 bytes, channels 0 to 15"):
        recorder.frame(0, 0x181, bytes(9))
    with pytest.raises(ValueError, match="at most 8 bytes, channels 0 to 15"):
        recorder.frame(0, 0x181, b"", 0, 16)
    with pytest.raises(ValueError, match="does not begin before 0"):
        recorder.frame(-1, 0x181, b"")
    with pytest.raises(ValueError, match="does not begin before 0"):
        recorder.cycle(-1, example_trials.values(0))
    with pytest.raises(ValueError, match="does not begin before 0"):
        recorder.event(-1, "nmt", "servo", "boot-up")
    recorder.close({})
    assert len(trial.open(recorder.path).frames) == 0


def test_remote_extended_and_error_frames_keep_what_they_are(tmp_path: Path) -> None:
    recorder = trial.Recorder(tmp_path / "trial.mcap", metadata={}, attachments={}, threaded=False)
    recorder.frame(1, 0x1ABCDEF0, b"\1\2\3", cdr.REMOTE | cdr.EXTENDED, 15)
    recorder.frame(2, 0x20000004, bytes(8), cdr.ERROR)
    recorder.close({})
    found = trial.open(recorder.path).frames
    assert found["can_id"].tolist() == [0x1ABCDEF0, 0x20000004]
    assert found["flags"].tolist() == [cdr.REMOTE | cdr.EXTENDED, cdr.ERROR]
    assert found["dlc"].tolist() == [3, 8]
    assert found["channel"].tolist() == [15, 0]
