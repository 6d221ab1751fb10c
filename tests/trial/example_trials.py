"""A small trial with every kind of content, for the tests of this room."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import trial

METADATA = {"specimen": "fabric 3", "operator": "bench crew"}
ATTACHMENTS = {"servo_drive.eds": b"[FileInfo]\nFileName=servo_drive.eds\n", "commit": b"0123abcd\n"}
RESULT: dict[str, object] = {"relative_rmse_percent": 2.25, "outcome": "completed", "stop_reason": None}
PERIOD_NS = 1_000_000
FRAMES_A_CYCLE = 8


def values(row: int) -> list[float]:
    """Return one recognisable row of /cycle, with an unknown value in it."""
    found = [row * 0.001, *(math.sin(0.01 * row + column) for column in range(1, len(trial.SIGNALS)))]
    found[trial.COLUMNS.index("step_duration_ns")] = math.nan
    return found


def record(recorder: trial.Recorder, cycles: int) -> None:
    """Record `cycles` control cycles of eight frames, and an event every 50."""
    for row in range(cycles):
        start = row * PERIOD_NS
        for frame in range(FRAMES_A_CYCLE):
            recorder.frame(start + frame * 60_000, 0x181 + frame, (row * 8 + frame).to_bytes(8, "little")[:frame + 1],
                           sent=frame == 7, channel=frame % 2)
        recorder.cycle(start, values(row))
        if row % 50 == 0:
            recorder.event(start, "nmt", "servo", f"row {row}")


def write(
    path: Path, cycles: int = 700, *, threaded: bool = False, result: Mapping[str, object] = RESULT
) -> Path:
    """Write a whole trial of `cycles` control cycles."""
    recorder = trial.Recorder(path, metadata=METADATA, attachments=ATTACHMENTS, threaded=threaded)
    record(recorder, cycles)
    recorder.close(result)
    return path
