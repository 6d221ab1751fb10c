"""Columns come back under their names and units, or not at all."""

from __future__ import annotations

from pathlib import Path

import example_trials
import numpy as np
import pytest

import trial
from parameters import InputError
from trial.signals import COLUMNS, SIGNALS, Signal

DESIGNED = [
    "time_s", "gait_percent", "servo_target_m", "servo_position_m", "servo_velocity_m_s", "servo_force_n",
    "knee_target_rad", "knee_angle_rad", "tension_start_n", "tension_end_n", "desired_force_n",
    "estimated_end_force_n", "cycle",
]


def test_the_designed_names_come_first_and_each_has_a_unit() -> None:
    assert list(COLUMNS[:len(DESIGNED)]) == DESIGNED
    assert len(set(COLUMNS)) == len(COLUMNS)
    assert all(signal.unit and signal.text for signal in SIGNALS)


def test_columns_units_events_and_result_come_back(recorded: Path) -> None:
    opened = trial.open(recorded)
    assert tuple(opened.columns) == COLUMNS
    for position, name in enumerate(COLUMNS):
        expected = [example_trials.values(row)[position] for row in range(700)]
        assert np.array_equal(opened.columns[name], expected, equal_nan=True)
        assert opened.columns[name].flags.c_contiguous
    assert opened.units["servo_position_m"] == "m"
    assert opened.time_ns.tolist() == [row * 1_000_000 for row in range(700)]
    assert opened.events[1] == (50_000_000, "nmt", "servo", "row 50")
    assert opened.metadata == example_trials.METADATA
    assert opened.attachments == example_trials.ATTACHMENTS
    assert opened.result == example_trials.RESULT
    assert opened.derived == {signal.name for signal in SIGNALS if signal.derived}


def test_frames_come_back_in_order(recorded: Path) -> None:
    frames = trial.open(recorded).frames
    assert len(frames) == 5600
    assert frames["can_id"][:8].tolist() == list(range(0x181, 0x189))
    assert frames["dlc"][:8].tolist() == list(range(1, 9))
    assert frames["sent"][:8].tolist() == [False] * 7 + [True]
    assert frames["channel"][:8].tolist() == [0, 1] * 4
    assert bytes(frames["data"][8 * 321 + 3])[:4] == (8 * 321 + 3).to_bytes(4, "little")


def test_the_digest_sees_channels_and_not_attachments(tmp_path: Path) -> None:
    def digest(name: str, note: bytes, last: float) -> str:
        recorder = trial.Recorder(tmp_path / name, metadata={"note": name}, attachments={"note": note}, threaded=False,
                                  signals=(Signal("time_s", "s", "time"), Signal("mass_kg", "kg", "mass")))
        recorder.cycle(0, (0.0, 1.0))
        recorder.cycle(1, (1.0, last))
        recorder.close({})
        return trial.open(tmp_path / name).digest()

    assert digest("a", b"1", 2.0) == digest("b", b"2", 2.0)
    assert digest("c", b"1", 2.0) != digest("d", b"1", np.nextafter(2.0, 3.0))


def test_an_empty_trial_opens_empty(tmp_path: Path) -> None:
    opened = trial.open(example_trials.write(tmp_path / "empty.mcap", cycles=0))
    assert len(opened.time_ns) == 0
    assert len(opened.frames) == 0
    assert {len(column) for column in opened.columns.values()} == {0}


def test_frames_of_a_file_that_was_replaced_are_not_taken_for_its_own(recorded: Path) -> None:
    opened = trial.open(recorded)
    recorded.unlink()
    example_trials.write(recorded, cycles=701)
    with pytest.raises(InputError, match="changed since it was opened"):
        len(opened.frames)


@pytest.mark.parametrize("library", ["pandas", "pyarrow"])
def test_a_table_is_one_call_away(recorded: Path, library: str) -> None:
    module = pytest.importorskip(library)
    columns = trial.open(recorded).columns
    table = module.DataFrame(columns) if library == "pandas" else module.table(dict(columns))
    assert table.shape == (700, len(COLUMNS))
