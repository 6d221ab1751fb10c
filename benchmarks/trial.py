"""What recording costs the control thread, and what reading a trial costs, beside the `mcap` library.

    python -m benchmarks.trial

Record: eight frames and one row of /cycle per cycle, timed in the control thread. The peer is mcap's own writer with
1 MiB zstd chunks written in place, given the same bytes. Read: every column of /cycle as float64, and every frame;
the peer is mcap's reader with the ROS 2 decoder. Both sides run in this process, on the same file. Wall times.
"""

from __future__ import annotations

import struct
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

import trial
from trial.mcap_file import cdr

CYCLES, READ_CYCLES, LONG_CYCLES = 20_000, 5_000, 600_000
FRAMES = 8
Step = Callable[[int, list[float], list[bytes]], None]


def content() -> tuple[list[list[float]], list[list[bytes]]]:
    """Return rows and frames that compress as a bench's do: motions with sensor noise, statuswords, zeros."""
    random = np.random.default_rng(1)
    row = np.arange(1000)
    table = np.zeros((len(trial.SIGNALS), 1000))
    for column in range(13):
        table[column] = np.round(np.sin(row / 150 + column) * 40 + random.normal(0, 0.02, 1000), 3)
    counts = random.integers(0, 1 << 12, (1000, FRAMES))
    frames = [[struct.pack("<HIH", 0x1237, 100_000 + count, 0) for count in line] for line in counts.tolist()]
    return table.T.tolist(), frames


def ours(recorder: trial.Recorder) -> Step:
    """Return what the master does in one cycle with the recorder."""
    def step(time_ns: int, values: list[float], frames: list[bytes]) -> None:
        for number, data in enumerate(frames):
            recorder.frame(time_ns + number * 60_000, 0x181 + number, data)
        recorder.cycle(time_ns, values)
    return step


def inline(writer: Writer) -> Step:
    """Return the same with mcap's own writer."""
    names = [signal.name for signal in trial.SIGNALS]
    frame_schema = writer.register_schema(cdr.FRAME_SCHEMA_NAME, "ros2msg", cdr.FRAME_SCHEMA.encode())
    cycle_schema = writer.register_schema(cdr.CYCLE_SCHEMA_NAME, "ros2msg", cdr.cycle_schema(names).encode())
    frame_channel = writer.register_channel(cdr.FRAMES, "cdr", frame_schema)
    cycle_channel = writer.register_channel(cdr.CYCLE, "cdr", cycle_schema)
    frame_struct, cycle_struct = struct.Struct("<IiII8sI3?B8s"), struct.Struct(f"<IiI{len(names)}d")

    def step(time_ns: int, values: list[float], frames: list[bytes]) -> None:
        for number, data in enumerate(frames):
            stamp = time_ns + number * 60_000
            seconds, rest = divmod(stamp, 1_000_000_000)
            writer.add_message(frame_channel, stamp, frame_struct.pack(
                cdr.LITTLE_ENDIAN, seconds, rest, 8, b"can0/rx", 0x181 + number, False, False, False, 8, data), stamp)
        seconds, rest = divmod(time_ns, 1_000_000_000)
        writer.add_message(cycle_channel, time_ns, cycle_struct.pack(cdr.LITTLE_ENDIAN, seconds, rest, *values),
                           time_ns)
    return step


def timed(step: Step, cycles: int, pause_s: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the µs that each cycle took in this thread; `pause_s` between them leaves the writer its time."""
    rows, frames = content()
    spent = np.empty(cycles)
    for number in range(cycles):
        began = time.perf_counter()
        step(number * 1_000_000, rows[number % 1000], frames[number % 1000])
        spent[number] = time.perf_counter() - began
        if pause_s:
            time.sleep(pause_s)
    return spent * 1e6


def record(folder: Path) -> None:
    """Print what a cycle costs on both sides."""
    for label, threaded, pause_s in (("with a writer thread", True, 0.0005), ("written in place", False, 0.0)):
        recorder = trial.Recorder(folder / "ours.mcap", metadata={}, attachments={}, threaded=threaded, overwrite=True)
        spent = timed(ours(recorder), CYCLES, pause_s)
        recorder.close({})
        tell(f"trial.Recorder, {label}", spent)
    with (folder / "peer.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start("ros2")
        spent = timed(inline(writer), CYCLES, 0.0)
        writer.finish()  # type: ignore[no-untyped-call]
    tell("mcap.writer, 1 MiB chunks in place", spent)


def tell(label: str, spent: np.ndarray[tuple[int], np.dtype[np.float64]]) -> None:
    """Print one line of the recording table."""
    print(f"{label:38s} median {np.median(spent):6.1f} µs   mean {spent.mean():6.1f} µs   worst {spent.max():8.1f} µs")


def read(folder: Path) -> None:
    """Print how fast both sides read one file, and the ratio."""
    path = written(folder / "read.mcap", READ_CYCLES)
    began = time.perf_counter()
    opened = trial.open(path)
    messages = len(opened.time_ns) + len(opened.frames)
    own = messages / (time.perf_counter() - began)
    with path.open("rb") as file:
        began = time.perf_counter()
        count = sum(1 for _ in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
        peer = count / (time.perf_counter() - began)
    print(f"read {messages} messages: trial.open {own:,.0f}/s, mcap reader with decoder {peer:,.0f}/s, "
          f"ratio {own / peer:.0f}")


def ten_minutes(folder: Path) -> None:
    """Print how long a trial of 600 000 cycles and 4.8 million frames takes to open."""
    path = written(folder / "long.mcap", LONG_CYCLES)
    began = both()
    opened = trial.open(path)
    wall, cpu = both() - began
    frames = len(opened.frames)
    more_wall, more_cpu = both() - began - (wall, cpu)
    print(f"ten minutes at 1 kHz ({path.stat().st_size / 1e6:.0f} MB): /cycle in {wall:.2f} s ({cpu:.2f} s CPU), "
          f"{frames} frames in {more_wall:.2f} s ({more_cpu:.2f} s CPU) more")


def both() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the wall's and this process's seconds: on a machine that others use they are not the same."""
    return np.array([time.perf_counter(), time.process_time()])


def written(path: Path, cycles: int) -> Path:
    """Write a trial of `cycles` cycles."""
    recorder = trial.Recorder(path, metadata={}, attachments={}, threaded=False)
    timed(ours(recorder), cycles, 0.0)
    recorder.close({})
    return path


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        record(Path(name))
        read(Path(name))
        ten_minutes(Path(name))
