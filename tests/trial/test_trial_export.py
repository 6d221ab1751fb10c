"""What is exported reads back the same, in the programs it is meant for."""

from __future__ import annotations

from pathlib import Path

import can
import numpy as np
import pytest

import trial
from parameters import InputError
from trial.convert.export import export
from trial.convert.imports import import_file
from trial.mcap_file import cdr
from trial.signals import Signal


@pytest.mark.parametrize("ending", [".csv", ".csv.gz"])
def test_a_table_comes_back_bit_for_bit(recorded: Path, tmp_path: Path, ending: str) -> None:
    opened = trial.open(recorded)
    target = tmp_path / f"out{ending}"
    assert export(opened, target) == 700
    import_file(target, tmp_path / "back.mcap")
    back = trial.open(tmp_path / "back.mcap")
    assert set(opened.columns) - set(back.columns) == {"step_duration_ns"}  # unknown throughout
    for name, column in back.columns.items():
        assert np.array_equal(column, opened.columns[name], equal_nan=True)
    assert np.array_equal(back.time_ns, opened.time_ns)


def test_an_unknown_value_is_an_empty_cell(tmp_path: Path) -> None:
    recorder = trial.Recorder(tmp_path / "a.mcap", metadata={}, attachments={}, threaded=False,
                              signals=(Signal("time_s", "s", ""), Signal("tension_end_n", "N", "")))
    recorder.cycle(0, (0.0, np.nan))
    recorder.cycle(1_000_000, (0.001, 1e-17))
    recorder.close({})
    export(trial.open(tmp_path / "a.mcap"), tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == "time_s,tension_end_n\n0,\n0.001,1e-17\n"


def test_the_same_trial_gives_the_same_archive(recorded: Path, tmp_path: Path) -> None:
    for name in ("one.csv.gz", "two.csv.gz"):
        export(trial.open(recorded), tmp_path / name)
    assert (tmp_path / "one.csv.gz").read_bytes() == (tmp_path / "two.csv.gz").read_bytes()


def test_parquet_holds_columns_with_units_and_nulls(recorded: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    opened = trial.open(recorded)
    export(opened, tmp_path / "out.parquet")
    table = parquet.read_table(tmp_path / "out.parquet")
    assert table.schema.field("servo_position_m").metadata == {b"unit": b"m"}
    assert table["servo_position_m"].to_numpy().tolist() == opened.columns["servo_position_m"].tolist()
    assert table.num_rows == 700


@pytest.mark.parametrize("ending", [".log", ".asc", ".blf", ".trc"])
def test_frames_reach_python_cans_readers(recorded: Path, tmp_path: Path, ending: str) -> None:
    frames = trial.open(recorded).frames
    target = tmp_path / f"out{ending}"
    assert export(trial.open(recorded), target) == len(frames)
    found = list(can.LogReader(target))
    assert [message.arbitration_id for message in found] == frames["can_id"].tolist()
    assert [bytes(message.data) for message in found] == [
        bytes(data[:dlc]) for data, dlc in zip(frames["data"], frames["dlc"], strict=True)]
    start = found[0].timestamp
    times = [message.timestamp - start for message in found]
    # .trc counts tenths of a millisecond from a start that it holds in days
    assert times == pytest.approx(frames["time_ns"] / 1e9, abs=2e-4 if ending == ".trc" else 2e-6)


def test_candump_keeps_remote_extended_error_and_direction(tmp_path: Path) -> None:
    recorder = trial.Recorder(tmp_path / "a.mcap", metadata={}, attachments={}, threaded=False)
    recorder.frame(1_000_001_234_567, 0x1ABCDEF0, bytes(3), cdr.REMOTE | cdr.EXTENDED, 2)
    recorder.frame(1_000_002_000_000, 0x88, bytes(8), cdr.ERROR, sent=True)
    recorder.frame(1_000_003_000_000, 0x181, b"\x0a\xff")
    recorder.close({})
    export(trial.open(tmp_path / "a.mcap"), tmp_path / "a.log")
    assert (tmp_path / "a.log").read_text() == (
        "(1000.001234) can2 1ABCDEF0#R3 R\n(1000.002000) can0 20000088#0000000000000000 T\n"
        "(1000.003000) can0 181#0AFF R\n")
    import_file(tmp_path / "a.log", tmp_path / "b.mcap")
    before, after = trial.open(tmp_path / "a.mcap").frames, trial.open(tmp_path / "b.mcap").frames
    for name in ("can_id", "flags", "dlc", "channel", "sent", "data"):
        assert np.array_equal(before[name], after[name])


@pytest.mark.parametrize("ending", [".csv", ".csv.gz", ".log", ".asc", ".blf"])
def test_an_export_tells_how_far_it_is(recorded: Path, tmp_path: Path, ending: str) -> None:
    told: list[float] = []
    export(trial.open(recorded), tmp_path / f"out{ending}", progress=told.append)
    assert told == sorted(told)
    assert (told[0] > 0, told[-1]) == (True, 1.0)


def test_an_existing_file_is_kept_and_a_wrong_ending_refused(recorded: Path, tmp_path: Path) -> None:
    opened, target = trial.open(recorded), tmp_path / "out.csv"
    target.write_text("mine")
    with pytest.raises(InputError, match="the file exists"):
        export(opened, target)
    assert target.read_text() == "mine"
    export(opened, target, overwrite=True)
    assert target.read_text().startswith("time_s,")
    for name, message in (("out.xls", "the ending .xls names no format"), ("no folder/out.csv", "cannot be written"),
                          ("no folder/out.blf", "cannot be written")):
        with pytest.raises(InputError, match=message):
            export(opened, tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.csv", "trial.mcap"]


def test_a_trial_without_cycles_has_no_table(tmp_path: Path) -> None:
    recorder = trial.Recorder(tmp_path / "a.mcap", metadata={}, attachments={}, threaded=False)
    recorder.close({})
    with pytest.raises(InputError, match="has no cycles to write"):
        export(trial.open(tmp_path / "a.mcap"), tmp_path / "a.csv")
    assert not (tmp_path / "a.csv").exists()
