"""Torn, changed and hostile files: an error with its reason, or what survived, exactly; never a wrong number."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import example_trials
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk, ChunkIndex
from mcap.writer import Writer

import trial
from parameters import InputError
from trial.mcap_file import cdr, container
from trial.recover import recover
from trial.signals import Signal

LAST_BYTES, STEP = 200 * 1024, 1499  # 1499 is prime, so that cuts fall everywhere in records
TIME = Signal("time_s", "s", "time")


def survivors(path: Path) -> dict[str, list[tuple[int, int, bytes]]]:
    """Return sequence, time and payload of each message by topic, as mcap's own reader sees them."""
    found: dict[str, list[tuple[int, int, bytes]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            found.setdefault(channel.topic, []).append((message.sequence, message.log_time, message.data))
    return found


def flushed(path: Path) -> list[tuple[int, int]]:
    """Return (end of chunk, messages in all chunks up to it) for each chunk."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        ends, total = [], 0
        for chunk in sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset):
            file.seek(min(chunk.message_index_offsets.values()) + 11)
            total += struct.unpack("<I", file.read(4))[0] // 16
            ends.append((chunk.chunk_start_offset + chunk.chunk_length, total))
    return ends


@pytest.mark.exhaustive
def test_a_file_torn_anywhere_gives_back_at_least_what_was_flushed(tmp_path: Path) -> None:
    whole = example_trials.write(tmp_path / "whole.mcap", cycles=500)
    data, chunks, original = whole.read_bytes(), flushed(whole), survivors(whole)
    assert len(data) > LAST_BYTES
    torn, mended = tmp_path / "torn.mcap", tmp_path / "mended.mcap"
    for cut in range(len(data) - LAST_BYTES, len(data), STEP):
        torn.write_bytes(data[:cut])
        with pytest.raises(InputError, match="bowden recover"):
            trial.open(torn)
        found = recover(torn, mended, overwrite=True)
        assert found.messages >= max((total for end, total in chunks if end <= cut), default=0)
        opened = trial.open(mended)
        for column, name in enumerate(trial.COLUMNS):
            expected = [example_trials.values(row)[column] for row in range(len(opened.time_ns))]
            assert np.array_equal(opened.columns[name], expected, equal_nan=True)
    for topic, messages in survivors(mended).items():
        assert messages == original[topic][:len(messages)]


def test_mcaps_own_reader_opens_a_torn_file_only_in_file_order(tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(example_trials.write(tmp_path / "whole.mcap").read_bytes()[:150_000])
    count = 0
    with torn.open("rb") as file, pytest.raises(Exception, match=r"^$|Could not|EndOfFile"):  # noqa: PT012
        for _ in NonSeekingReader(file).iter_messages(log_time_order=False):
            count += 1
    found = recover(torn, tmp_path / "mended.mcap")
    assert found.messages >= count > 0


@pytest.mark.parametrize("threaded", [False, True])
def test_a_killed_process_loses_at_most_150_ms(tmp_path: Path, threaded: bool) -> None:
    torn = tmp_path / "killed.mcap"
    script = (
        "import sys, os, signal; sys.path[:0] = sys.argv[2:]; import example_trials, trial; "
        f"r = trial.Recorder(sys.argv[1], metadata={{}}, attachments={{}}, threaded={threaded}); "
        "example_trials.record(r, 777); r._writer.join(); os.kill(os.getpid(), signal.SIGKILL)"
    )
    rooms = [str(Path(example_trials.__file__).parent), str(Path(trial.__file__).parent.parent)]
    # the writer is joined, not closed: how far behind the thread is allowed to be is a matter of its 100 ms
    ended = subprocess.run([sys.executable, "-c", script, str(torn), *rooms], check=False, env=dict(os.environ))
    assert ended.returncode == -signal.SIGKILL
    recover(torn, tmp_path / "mended.mcap")
    opened = trial.open(tmp_path / "mended.mcap")
    assert opened.time_ns[-1] >= (777 - 150) * example_trials.PERIOD_NS
    assert opened.frames["time_ns"][-1] >= (777 - 150) * example_trials.PERIOD_NS
    assert opened.recovered is not None
    assert opened.result is None


BENCH = """
import mmap, select, struct, sys, time
sys.path[:0] = sys.argv[3:]
import trial
with open(sys.argv[2], "r+b") as file:
    told = mmap.mmap(file.fileno(), 8)
recorder = trial.Recorder(sys.argv[1], metadata={}, attachments={}, threaded=True)
began, row = time.monotonic_ns(), 0
while True:  # a bench at 1 kHz that ends only by being killed; what it has told of outlives it
    now = time.monotonic_ns() - began
    for number in range(8):
        recorder.frame(now, 0x181 + number, struct.pack("<q", row))
    recorder.cycle(now, [row] * len(trial.SIGNALS))
    told[:] = struct.pack("<q", now)
    row += 1
    select.select([], [], [], 0.001)
"""


@pytest.mark.walltime
@pytest.mark.parametrize("after_ms", [333, 450, 599])
def test_a_bench_killed_at_any_moment_loses_at_most_150_ms(tmp_path: Path, after_ms: int) -> None:
    torn, told = tmp_path / "killed.mcap", tmp_path / "told"
    told.write_bytes(bytes(8))
    rooms = str(Path(trial.__file__).parent.parent)
    bench = subprocess.Popen([sys.executable, "-c", BENCH, str(torn), str(told), rooms])
    while int.from_bytes(told.read_bytes(), "little") < after_ms * 1_000_000:
        assert bench.poll() is None
    bench.kill()
    assert bench.wait() == -signal.SIGKILL
    last_ns = int.from_bytes(told.read_bytes(), "little")
    recover(torn, tmp_path / "mended.mcap")
    opened = trial.open(tmp_path / "mended.mcap")
    assert last_ns - opened.time_ns[-1] <= 150_000_000
    assert last_ns - opened.frames["time_ns"][-1] <= 150_000_000
    assert opened.columns["time_s"].tolist() == list(range(len(opened.time_ns)))
    assert opened.lost_cycles == 0


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return example_trials.write(tmp_path_factory.mktemp("small") / "small.mcap", cycles=30)


@settings(max_examples=150, deadline=None)
@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_is_an_error_and_costs_what_it_touched(small: Path, place: float, bit: int) -> None:
    data = bytearray(small.read_bytes())
    data[int(place * len(data))] ^= 1 << bit
    changed, mended = small.with_name("changed.mcap"), small.with_name("mended.mcap")
    changed.write_bytes(data)
    with pytest.raises(InputError):
        trial.open(changed)
    try:
        recover(changed, mended, overwrite=True)
    except InputError:
        assert int(place * len(data)) < 8  # the magic itself
        return
    original = survivors(small)
    for topic, messages in survivors(mended).items():
        assert set(messages) <= set(original.get(topic, [])), topic


def test_a_description_misread_as_a_message_is_left_out(small: Path) -> None:
    data = small.read_bytes()
    at, changed = len(container.MAGIC), bytearray(data)
    while data[at] != container.CHANNEL:  # the first channel's description
        at += 9 + int.from_bytes(data[at + 1:at + 9], "little")
    changed[at] = container.MESSAGE
    torn, mended = small.with_name("changed.mcap"), small.with_name("mended.mcap")
    torn.write_bytes(changed)
    found = recover(torn, mended, overwrite=True)
    assert survivors(mended) == survivors(small)
    assert found.damaged == 1


def test_a_changed_chunk_is_left_out_and_seen_as_lost_cycles(tmp_path: Path) -> None:
    whole = example_trials.write(tmp_path / "whole.mcap", cycles=500)
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    table = next(number for number, channel in summary.channels.items() if channel.topic == "/cycle")
    second = [chunk for chunk in summary.chunk_indexes if table in chunk.message_index_offsets][1]
    data = bytearray(whole.read_bytes())
    data[second.chunk_start_offset + second.chunk_length // 2] ^= 0x10
    (tmp_path / "changed.mcap").write_bytes(data)
    with pytest.raises(InputError, match="bits were changed"):
        trial.open(tmp_path / "changed.mcap")
    assert recover(tmp_path / "changed.mcap", tmp_path / "mended.mcap").damaged == 1
    opened = trial.open(tmp_path / "mended.mcap")
    assert opened.lost_cycles == 100
    assert len(opened.time_ns) == 400
    assert len(opened.frames) == 4000


def bomb(path: Path, size: int, chunks: int) -> None:
    """Write a file whose /cycle chunks unpack to `size` zero bytes each."""
    recorder = trial.Recorder(path, metadata={}, attachments={}, threaded=False, signals=(TIME,))
    made = recorder._writer._container
    packed = zstandard.ZstdCompressor(level=19).compress(bytes(size))
    for _ in range(chunks):
        at, chunk = made.position, container._record(Chunk("zstd", packed, 0, 0, 0, size))
        made._write(chunk)
        made._summarise(container.CHUNK_INDEX, container._record(
            ChunkIndex(len(chunk), at, "zstd", len(packed), 0, 0, {2: 0}, 0, size)))
    recorder.close({})


@pytest.mark.parametrize(("size", "chunks"), [(400 << 20, 1), (32 << 20, 20)])
def test_a_zip_bomb_is_refused_before_it_unpacks(tmp_path: Path, size: int, chunks: int) -> None:
    path = tmp_path / "bomb.mcap"
    bomb(path, size, chunks)
    assert path.stat().st_size < 2 << 20
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="would unpack to"):
            trial.open(path)
        recover(path, tmp_path / "mended.mcap")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 150 << 20  # a 64 MiB chunk, its input and numpy's small change


def table(path: Path, signals: tuple[Signal, ...], times: tuple[int, ...] = (0, 1, 2)) -> None:
    recorder = trial.Recorder(path, metadata={}, attachments={}, threaded=False, signals=signals)
    for time_ns in times:
        recorder.cycle(time_ns, [float(time_ns)] * len(signals))
    recorder.close({})


def foreign(path: Path, topic: str, encoding: str = "json") -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Any", "jsonschema", b"{}")
        writer.add_message(writer.register_channel(topic, encoding, schema), 0, b"{}", 0)
        writer.finish()  # type: ignore[no-untyped-call]


def short_messages(path: Path) -> None:
    """Write /cycle messages that do not have the length their schema states."""
    recorder = trial.Recorder(path, metadata={}, attachments={}, threaded=False, signals=(TIME,))
    message = cdr.MESSAGE_HEAD.pack(cdr.MESSAGE, 22 + 12, 2, 0, 0, 0) + bytes(12)
    recorder._writer._container.chunk(message, {2: (np.zeros(1, np.int64), np.zeros(1, np.int64))})
    recorder.close({})


REFUSED: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (lambda path: None, "no such file"),
    "a folder": (lambda path: path.mkdir(), "cannot be read"),
    "empty": (lambda path: path.write_bytes(b""), "the file is empty"),
    "no MCAP": (lambda path: path.write_bytes(b"time_s,knee\n0,0\n" * 9), "not an MCAP file"),
    "magic only": (lambda path: path.write_bytes(container.MAGIC), "cut off before its end"),
    "foreign": (lambda path: foreign(path, "/tf"), "has no topic /cycle"),
    "foreign cycle": (lambda path: foreign(path, "/cycle"), "not a stamp and float64 columns"),
    "wrong unit": (lambda path: table(path, (TIME, Signal("servo_position_m", "mm", "position"))),
                   "servo_position_m is in mm, expected m"),
    "a column twice": (lambda path: table(path, (TIME, TIME)), "has the column time_s twice"),
    "repeated time": (lambda path: table(path, (TIME,), (5, 6, 6)), "row 3 is at 6 ns, not after the row before"),
    "time going back": (lambda path: table(path, (TIME,), (5, 6, 4)), "row 3 is at 4 ns, not after the row before"),
    "wrong layout": (short_messages, "do not have the layout their schema states"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_trial_is_refused_with_its_reason(tmp_path: Path, case: str) -> None:
    make, message = REFUSED[case]
    path = tmp_path / "case.mcap"
    make(path)
    with pytest.raises(InputError, match=message) as refused:
        trial.open(path)
    assert str(refused.value).startswith(f"{path}: ")


def test_recover_keeps_what_is_there_and_refuses_what_is_nothing(recorded: Path, tmp_path: Path) -> None:
    before = recorded.read_bytes()
    with pytest.raises(InputError, match="the torn file itself"):
        recover(recorded, recorded, overwrite=True)
    (tmp_path / "there").touch()
    with pytest.raises(InputError, match="the file exists"):
        recover(recorded, tmp_path / "there")
    (tmp_path / "nothing").write_bytes(container.MAGIC + b"\xff" * 100)
    with pytest.raises(InputError, match="no topic survived"):
        recover(tmp_path / "nothing", tmp_path / "new")
    assert recorded.read_bytes() == before
    assert not (tmp_path / "new").exists()


def test_a_foreign_file_is_recovered_too(tmp_path: Path) -> None:
    foreign(tmp_path / "foreign.mcap", "/tf")
    data = (tmp_path / "foreign.mcap").read_bytes()
    (tmp_path / "torn.mcap").write_bytes(data[:-30])
    assert recover(tmp_path / "torn.mcap", tmp_path / "mended.mcap").messages == 1
    assert survivors(tmp_path / "mended.mcap") == {"/tf": [(0, 0, b"{}")]}
