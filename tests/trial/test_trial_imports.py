"""Files of others become trials with every change counted, or are refused with the row."""

from __future__ import annotations

import gzip
import math
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import can
import example_trials
import numpy as np
import pytest
from mcap.writer import Writer

import trial
from eds.bench.bench_network import Network, wire
from parameters import InputError
from parameters.files import READ_LIMIT
from trial.convert import candump, csv_table
from trial.convert.contents import contents
from trial.convert.frames import rows_of
from trial.convert.imports import import_file, raw_content
from trial.mcap_file import cdr
from trial.signals import SIGNALS, Signal

WIRE = wire(Network())
CABLE = Path(__file__).parents[3] / "shared" / "data" / "cable_drive"


def cycle_frames(start_ns: int, row: int) -> list[tuple[int, int, bytes]]:
    """Return SYNC, four TPDOs and the targets of one cycle, in units that the wire holds exactly."""
    return [
        (start_ns, 0x80, b""),
        (start_ns + 100_000, 0x181, WIRE.tpdo[0x181].pack_si(0x1237, 0.01 + row * 1e-6, 0.5)),
        (start_ns + 200_000, 0x182, WIRE.tpdo[0x182].pack_si(0x0237, math.radians(-0.001 * row))),
        (start_ns + 300_000, 0x183, WIRE.tpdo[0x183].pack_si(20.5 + row * 0.01)),
        (start_ns + 400_000, 0x184, WIRE.tpdo[0x184].pack_si(-0.25)),
        (start_ns + 500_000, 0x201, WIRE.targets.pack_si(0.02 + row * 1e-6, math.radians(-5))),
    ]


def log_text(cycles: int = 50, start_ns: int = 1_700_000_000_000_000_000, stamp_ns: int = 1000) -> str:
    rows = [(time // stamp_ns * stamp_ns, identifier, 0, len(data), 0, False, data)
            for row in range(cycles) for time, identifier, data in cycle_frames(start_ns + row * 1_000_000, row)]
    return "".join(candump.lines(rows_of(rows)))


def imported(folder: Path, name: str, content: str | bytes, **options: object) -> tuple[trial.Trial, dict[str, int]]:
    source, target = folder / name, folder / "imported.mcap"
    source.write_bytes(content.encode() if isinstance(content, str) else content)
    report = import_file(source, target, **options)  # type: ignore[arg-type]
    opened = trial.open(target)
    assert opened.result == report.as_json()
    counts = report.as_json()["counts"]
    assert isinstance(counts, dict)
    return opened, counts


def test_a_candump_log_is_decoded_by_the_pdo_plans(tmp_path: Path) -> None:
    opened, counts = imported(tmp_path, "bench.log", log_text())
    row = np.arange(50)
    expected = {
        "time_s": row * 1e-3, "servo_statusword": np.full(50, 0x1237), "servo_position_m": 0.01 + row * 1e-6,
        "servo_force_n": np.full(50, 25.0), "knee_statusword": np.full(50, 0x0237),
        "knee_angle_rad": np.radians(-0.001 * row), "tension_start_n": 20.5 + row * 0.01,
        "tension_end_n": np.full(50, -0.25), "servo_target_m": 0.02 + row * 1e-6,
        "knee_target_rad": np.full(50, math.radians(-5)), "servo_velocity_m_s": np.append(np.nan, np.full(49, 1e-3)),
        "servo_pdo_arrival_ns": np.full(50, 1e5), "knee_pdo_arrival_ns": np.full(50, 2e5),
        "start_pdo_arrival_ns": np.full(50, 3e5), "end_pdo_arrival_ns": np.full(50, 4e5),
    }
    assert set(opened.columns) == set(expected)
    for name, values in expected.items():
        # 1e-7: the feed constant of the drum is a whole number of micrometres for ten revolutions
        assert opened.columns[name] == pytest.approx(values, abs=1e-12, rel=1e-7, nan_ok=True), name
    assert counts == {"frames": 300, "cycles": 50}
    assert opened.time_ns[0] == 1_700_000_000_000_000_000


@pytest.mark.parametrize("ending", [".asc", ".blf", ".trc", ".log.gz"])
def test_other_logs_give_the_same_columns(tmp_path: Path, ending: str) -> None:
    plain = tmp_path / "bench.log"
    plain.write_text(log_text())
    other = tmp_path / f"bench{ending}"
    if ending == ".log.gz":
        other.write_bytes(gzip.compress(plain.read_bytes()))
    else:
        with can.LogReader(plain) as reader, can.Logger(other) as writer:
            for message in reader:
                message.channel = 1
                writer.on_message_received(message)
    import_file(plain, tmp_path / "plain.mcap")
    import_file(other, tmp_path / "other.mcap")
    expected, found = trial.open(tmp_path / "plain.mcap").columns, trial.open(tmp_path / "other.mcap").columns
    assert set(found) == set(expected)
    for name, values in expected.items():
        # .trc and .asc stamp to 0.1 ms and 1 µs at best
        if not name.endswith("_ns") and name not in ("time_s", "servo_velocity_m_s"):
            assert np.array_equal(found[name], values, equal_nan=True), name


def test_what_real_logs_carry_is_kept_counted_and_reported(tmp_path: Path) -> None:
    extra = "\n".join((
        "(1700000000.000600) can0 081#",                      # EMCY of length 0
        "(1700000000.000601) can0 082#1081110000000000",      # EMCY as it should be
        "(1700000000.000602) can0 000#01",                    # NMT of length 1
        "(1700000000.000603) can0 000#8002",                  # NMT: node 2 to pre-operational
        "(1700000000.000604) can0 703#00",                    # boot-up
        "(1700000000.000605) can0 201#R8",                    # remote frame
        "(1700000000.000606) can0 1ABCDEF0#11",               # extended frame
        "(1700000000.000607) can0 20000088#0000000000000000", # error frame
        "(1700000000.000608) can1 181#3712",                  # another channel
        "(1700000000.000609) can0 184#05",                    # a PDO cut short
        "(1700000000.000610) can0 123##1AABB",                # CAN FD
        "(1700000000.0006", "",                               # the last line of a killed candump
    ))
    opened, counts = imported(tmp_path, "real.log", log_text() + extra)
    assert counts == {
        "frames": 310, "cycles": 50, "short_emcy": 1, "short_nmt": 1, "remote_frames": 1, "extended_frames": 1,
        "error_frames": 1, "short_end_pdos": 1, "fd_frames": 1, "malformed_lines": 1,
    }
    assert len(opened.frames) == 310
    assert [event[1:] for event in opened.events] == [
        ("emcy", "knee", "error code 0x8110, error register 0x11"),
        ("nmt", "master", "enter pre-operational: node 2"),
        ("nmt", "start", "boot-up"),
    ]
    assert not np.isnan(opened.columns["tension_end_n"]).any()


def test_stamps_of_10_ms_are_kept_on_frames_and_spread_over_cycles(tmp_path: Path) -> None:
    opened, counts = imported(tmp_path, "coarse.log", log_text(stamp_ns=10_000_000))
    assert counts == {"frames": 300, "cycles": 50, "coarse_stamps": 45}
    assert opened.columns["time_s"] == pytest.approx(np.arange(50) * 1e-3)
    assert set(np.diff(opened.frames["time_ns"])) == {0, 10_000_000}


def test_a_clock_set_back_is_counted_and_time_goes_on(tmp_path: Path) -> None:
    later = log_text(10, start_ns=86_400_000_000_000)
    opened, counts = imported(tmp_path, "clock.log", log_text(10) + later)
    assert counts["clock_steps"] == 1
    assert (np.diff(opened.time_ns) > 0).all()
    assert len(opened.time_ns) == 20


def test_lost_and_repeated_pdos_are_missing_knowledge_and_counted(tmp_path: Path) -> None:
    lines = log_text(10).splitlines(keepends=True)
    lost = [line for number, line in enumerate(lines) if number not in (6 * 3 + 4, 6 * 7 + 5)]
    opened, counts = imported(tmp_path, "lost.log", "".join(lost[:8] + lost[7:8] + lost[8:]))
    assert counts == {"frames": 59, "cycles": 10, "missing_end_pdos": 1, "missing_target_pdos": 1,
                      "repeated_servo_pdos": 1}
    assert np.flatnonzero(np.isnan(opened.columns["tension_end_n"])).tolist() == [3]
    assert np.flatnonzero(np.isnan(opened.columns["knee_target_rad"])).tolist() == [7]


def test_a_sensor_without_a_value_is_unknown_not_minus_327_newton(tmp_path: Path) -> None:
    opened, _ = imported(tmp_path, "lost.log", log_text(3).replace("184#E7FF", "184#0080", 1))
    assert np.isnan(opened.columns["tension_end_n"]).tolist() == [True, False, False]


def test_a_log_without_sync_keeps_its_frames(tmp_path: Path) -> None:
    lines = [line for line in log_text(3).splitlines(keepends=True) if " 080#" not in line]
    opened, counts = imported(tmp_path, "nosync.log", "".join(lines))
    assert counts == {"frames": 15}
    assert opened.columns == {}


def test_canonical_headers_need_no_map(tmp_path: Path) -> None:
    text = "time_s,servo_position_m,tension_end_n,torque\n0.5,0.01,,7\n0.501,0.011,nan,7\n0.502,0.012,3.5,7\n"
    opened, counts = imported(tmp_path, "bench.csv", text)
    assert opened.columns["time_s"].tolist() == [0.5, 0.501, 0.502]
    assert opened.time_ns.tolist() == [500_000_000, 501_000_000, 502_000_000]
    assert opened.columns["tension_end_n"] == pytest.approx([math.nan, math.nan, 3.5], nan_ok=True)
    assert counts == {"rows": 3, "unknown_values": 2}
    assert opened.result is not None
    assert opened.result["left_out"] == ["torque"]
    assert opened.units == {"time_s": "s", "servo_position_m": "m", "tension_end_n": "N"}


def test_a_map_names_units_factors_and_offsets(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(
        '[time_s]\ncolumn = "t"\nunit = "ms"\n'
        '[servo_position_m]\ncolumn = "rope"\nunit = "mm"\nscale = -1\noffset = 0.5\n'
        '[start_pdo_age_ns]\ncolumn = "age"\nunit = "us"\n')
    mapped = csv_table.read_map(tmp_path / "map.toml")
    opened, _ = imported(tmp_path, "bench.csv.gz", gzip.compress(b"t,rope,age\n0,1,3\n2,5,4\n"), mapped=mapped)
    assert opened.columns["time_s"] == pytest.approx([0, 0.002])
    assert opened.columns["servo_position_m"] == pytest.approx([0.499, 0.495])
    assert opened.columns["start_pdo_age_ns"] == pytest.approx([3000, 4000])


def test_degrees_over_percent_are_the_one_alias(tmp_path: Path) -> None:
    opened, _ = imported(tmp_path, "gait.csv", "time_s,gait_percent,knee_angle_deg\n0,0,-90\n1,50,-45\n")
    assert opened.columns["knee_angle_rad"] == pytest.approx([-math.pi / 2, -math.pi / 4])
    opened, _ = imported(tmp_path, "knee.csv", "time_s,knee_angle_deg\n0,-90\n1,-45\n", overwrite=True)
    assert "knee_angle_rad" not in opened.columns


def test_repeated_rows_and_negative_times_are_mended_and_counted(tmp_path: Path) -> None:
    opened, counts = imported(tmp_path, "bench.csv", "time_s,cycle\n-0.5,0\n-0.4,0\n-0.4,0\n0,1\n")
    assert opened.time_ns.tolist() == [0, 100_000_000, 500_000_000]
    assert opened.columns["time_s"].tolist() == [-0.5, -0.4, 0.0]
    assert counts == {"rows": 4, "repeated_rows": 1, "shifted_ns": 500_000_000}


def foreign_table(path: Path, unit: str, times: tuple[int, ...]) -> None:
    recorder = trial.Recorder(path, metadata={}, attachments={}, threaded=False,
                              signals=(Signal("servo_position_m", unit, "x"), Signal("mass", "kg", "m")))
    for time_ns in times:
        recorder.cycle(time_ns, (5.0, 1.0))
    recorder.close({})


def test_a_foreign_table_is_converted_by_its_stated_units_and_times_mended(tmp_path: Path) -> None:
    foreign_table(tmp_path / "mm.mcap", "mm", (0, 10, 10, 30))
    report = import_file(tmp_path / "mm.mcap", tmp_path / "imported.mcap")
    opened = trial.open(tmp_path / "imported.mcap")
    assert opened.columns["servo_position_m"].tolist() == [0.005] * 4
    assert opened.time_ns.tolist() == [0, 10, 20, 30]
    assert report.left_out == ["mass"]
    assert report.counts["coarse_stamps"] == 1


def test_frames_of_any_ros_2_recording_are_read(tmp_path: Path) -> None:
    path = tmp_path / "rosbag.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(cdr.FRAME_SCHEMA_NAME, "ros2msg", cdr.FRAME_SCHEMA.encode())
        channel = writer.register_channel("/from_can_bus", "cdr", schema)
        text = writer.register_channel("/rosout", "json", writer.register_schema("Log", "jsonschema", b"{}"))
        for time_ns, can_id, data in cycle_frames(5_000_000, 1):
            frame_id = b"vcan0\0"
            body = struct.pack("<iII6s2xI3?B8s", 0, time_ns, len(frame_id), frame_id, can_id, False, False, False,
                               len(data), data)
            writer.add_message(channel, time_ns, b"\0\1\0\0" + body, time_ns)
        writer.add_message(channel, 6_000_000, b"\0\1\0\0short", 6_000_000)
        writer.add_message(text, 6_000_000, b"{}", 6_000_000)
        writer.finish()  # type: ignore[no-untyped-call]
    report = import_file(path, tmp_path / "imported.mcap")
    opened = trial.open(tmp_path / "imported.mcap")
    assert opened.columns["tension_start_n"].tolist() == [20.51]
    assert report.channels == {"vcan0": 0}
    assert report.left_out == ["/rosout"]
    assert report.counts["malformed_frames"] == 1


CSV_REFUSED = {
    "no time": ("servo_position_m\n1\n", "has no column time_s"),
    "header only": ("time_s,cycle\n", "a header and no rows"),
    "empty": ("", "the file is empty"),
    "blank lines": ("\n\n", "row 1 is no header"),
    "a column twice": ("time_s,cycle,cycle\n0,0,0\n", "names the column 'cycle' 2 times"),
    "a word": ("time_s,cycle\n0,0\n1,zero\n", "row 3: cycle = 'zero' is not a number"),
    "an infinite value": ("time_s,cycle\n0,0\n1,inf\n", "row 3: cycle = inf is not finite"),
    "a value whose square overflows": ("time_s,cycle\n0,0\n1,1e300\n", "row 3: cycle = 1e\\+300 is larger than any"),
    "a short row": ("time_s,cycle\n0,0\n1\n", "row 3 has 1 cells, the header 2"),
    "a row without time": ("time_s,cycle\n0,0\n,1\n", "row 3 has no time"),
    "time that falls": ("time_s,cycle\n0,0\n1,0\n0.5,1\n", r"row 4: time_s = 0.5 does not rise"),
    "one time, two values": ("time_s,cycle\n0,0\n1,0\n1,1\n", r"row 4: time_s = 1 stands in the row before too"),
    "time in nanoseconds": ("time_s,cycle\n1700000000000000000,0\n1700000000001000000,0\n", "is it in another unit"),
}


@pytest.mark.parametrize("case", CSV_REFUSED)
def test_a_table_that_contradicts_itself_is_refused_by_its_row(tmp_path: Path, case: str) -> None:
    text, message = CSV_REFUSED[case]
    source = tmp_path / "bench.csv"
    source.write_text(text)
    with pytest.raises(InputError, match=message) as refused:
        import_file(source, tmp_path / "imported.mcap")
    assert str(refused.value).startswith(f"{source}: ")
    assert not (tmp_path / "imported.mcap").exists()


MAP_REFUSED = {
    "no signal": ("[rope]\ncolumn = \"x\"\n", "is no signal"),
    "no table": ("time_s = 1\n", "is no table"),
    "an unknown key": ("[time_s]\ncolum = \"x\"\n", "unknown key colum; did you mean column"),
    "a wrong unit": ("[time_s]\ncolumn = \"t\"\nunit = \"mm\"\n", "unit = 'mm' does not fit time_s; expected one of s"),
    "no such column": ("[time_s]\ncolumn = \"x\"\n", "which is no column of the file; expected one of t"),
}


@pytest.mark.parametrize("case", MAP_REFUSED)
def test_a_map_that_does_not_fit_is_refused(tmp_path: Path, case: str) -> None:
    text, message = MAP_REFUSED[case]
    (tmp_path / "map.toml").write_text(text)
    (tmp_path / "bench.csv").write_text("t\n0\n1\n")
    with pytest.raises(InputError, match=message):
        import_file(tmp_path / "bench.csv", tmp_path / "a.mcap", mapped=csv_table.read_map(tmp_path / "map.toml"))


def blf_bomb() -> bytes:
    """Return a BLF file with one container of zeros."""
    packed = zlib.compress(bytes(100 << 20), 9)
    head = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 32 + len(packed), 10) + struct.pack("<H6xL4x", 2, 100 << 20)
    return b"LOGG" + struct.pack("<L", 144) + bytes(136) + head + packed


FILES_REFUSED: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "missing": ("none.log", lambda path: None, "no such file"),
    "missing table": ("none.csv", lambda path: None, "no such file"),
    "unknown ending": ("bench.xyz", lambda path: path.touch(), r"the ending .xyz names no format"),
    "no log": ("bench.log", lambda path: path.write_text("a\nb\nc\n"), "3 lines are not as candump -L writes them"),
    "no gzip": ("bench.csv.gz", lambda path: path.write_bytes(b"time_s\n0\n"), "cannot be read"),
    "a torn gzip": ("bench.csv.gz", lambda path: path.write_bytes(gzip.compress(b"time_s\n0\n" * 99)[:-9]),
                    "cannot be read"),
    "a bomb": ("bench.csv.gz", lambda path: path.write_bytes(gzip.compress(bytes(300 << 20), 9)), "unpacks to more"),
    "a bombed log": ("bench.log.gz", lambda path: path.write_bytes(gzip.compress((b"x" * 65_000 + b"\n") * 5000, 9)),
                     "unpacks to more"),
    "an endless line": ("bench.log.gz", lambda path: path.write_bytes(gzip.compress(bytes(9 << 20), 9)),
                        "a line is longer than"),
    "a bombed blf": ("bench.blf", lambda path: path.write_bytes(blf_bomb()), "a container unpacks to more"),
    "a gzipped asc": ("bench.asc.gz", lambda path: path.write_bytes(gzip.compress(b"date Mon Foo\n")),
                      "holds no CAN frame"),
    "no blf": ("bench.blf", lambda path: path.write_bytes(b"LOGG" + bytes(99)), "after 0 frames"),
    "no asc": ("bench.asc", lambda path: path.write_text("date Mon Foo\n"), "holds no CAN frame"),
    "an empty log": ("bench.log", lambda path: path.write_text("\n"), "holds no CAN frame"),
}


@pytest.mark.parametrize("case", FILES_REFUSED)
def test_a_file_that_is_not_what_its_ending_says_is_refused(tmp_path: Path, case: str) -> None:
    name, make, message = FILES_REFUSED[case]
    make(tmp_path / name)
    with pytest.raises(InputError, match=message):
        import_file(tmp_path / name, tmp_path / "imported.mcap")
    assert not (tmp_path / "imported.mcap").exists()


def test_the_contents_of_an_hour_need_the_memory_of_a_minute(tmp_path: Path) -> None:
    peaks, chunks = [], (500, 4500)
    for count in chunks:
        path = tmp_path / f"{count}.mcap"
        with path.open("wb") as file:
            writer = Writer(file, chunk_size=1)
            writer.start()
            channel = writer.register_channel("/one", "json", writer.register_schema("one", "jsonschema", b"{}"))
            for k in range(count):
                writer.add_message(channel, k * 1_000_000, b"{}", k * 1_000_000)
            writer.finish()
        tracemalloc.start()
        found = contents(path)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert found.streams[0].messages == count
        assert found.seconds == pytest.approx((count - 1) * 1e-3)
    # its place, size and channels in 32 bytes, twice 16 to sort by time; the objects of a reader took 900
    assert (peaks[1] - peaks[0]) / (chunks[1] - chunks[0]) < 100


@pytest.mark.parametrize("ending", ["asc", "blf", "trc", "csv", "log", "xlsx"])
def test_a_file_beyond_the_memory_is_refused_before_it_is_read(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"long.{ending}"
    with path.open("wb") as file:
        file.truncate(READ_LIMIT + 1)
    with pytest.raises(InputError, match=f"long.{ending}: is longer than {READ_LIMIT} bytes; cut it"):
        raw_content(path)


def test_a_map_for_a_can_log_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bench.log").write_text(log_text(1))
    with pytest.raises(InputError, match="a map does not apply"):
        import_file(tmp_path / "bench.log", tmp_path / "a.mcap", mapped={})


@pytest.mark.skipif(not CABLE.is_dir(), reason="the recorded cable-drive data are not beside this checkout")
def test_a_real_cable_drive_is_imported_whole(tmp_path: Path) -> None:
    source = CABLE / "fit" / "sine_0.1hz_load20.csv.gz"
    report = import_file(source, tmp_path / "imported.mcap")
    opened = trial.open(tmp_path / "imported.mcap")
    with gzip.open(source, "rt") as lines:
        rows = sum(1 for _ in lines) - 1
    assert len(opened.time_ns) + report.counts["repeated_rows"] == rows
    assert set(opened.columns) == {"time_s", "servo_position_m", "tension_start_n", "knee_angle_rad", "tension_end_n",
                                   "cycle"}


def test_every_unit_of_a_signal_can_be_written_in_a_map() -> None:
    for signal in SIGNALS:
        assert csv_table.SignalSource(column="x", unit=signal.unit).factor(signal.name, "here") == 1.0


def test_a_trial_of_ours_passes_through_unchanged(tmp_path: Path) -> None:
    import_file(example_trials.write(tmp_path / "ours.mcap"), tmp_path / "again.mcap")
    before, after = trial.open(tmp_path / "ours.mcap"), trial.open(tmp_path / "again.mcap")
    assert np.array_equal(before.frames, after.frames)
    for name, column in before.columns.items():
        assert np.array_equal(column, after.columns[name], equal_nan=True)
