"""A curve file is used as it says, or refused with the row that is wrong."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from parameters import InputError
from trial.curves import read_curve, read_strides, repeats_after

GAIT = Path(__file__).parents[3] / "shared" / "data" / "gait"
needs_gait = pytest.mark.skipif(not GAIT.is_dir(), reason="the recorded gait data are not beside this checkout")


def knee_rows(strides: float = 1.0, begin_s: float = 7.0) -> list[str]:
    """Return a knee motion of 1.2 s a stride at 100 Hz, most extended at the beginning of each."""
    angle = [-0.45 + 0.35 * math.cos(2 * math.pi * k / 120) for k in range(round(120 * strides))]
    return ["time_s,knee_angle_rad", *(f"{begin_s + k / 100:.2f},{value:.6f}" for k, value in enumerate(angle))]


def written(folder: Path, rows: list[str]) -> Path:
    path = folder / "knee.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_percent_and_degrees_become_radians(tmp_path: Path) -> None:
    rows = ["gait_percent,knee_angle_deg,knee_torque_nm", *(f"{k},{-30 - k / 10},{k}" for k in range(100))]
    curve = read_curve(written(tmp_path, rows), "knee_angle_rad")
    assert curve.percent.tolist() == list(range(100))
    assert curve.values == pytest.approx(np.radians([-30 - k / 10 for k in range(100)]))
    assert (curve.strides, curve.bridged, curve.trimmed) == (1, 0, 0)
    assert math.isnan(curve.stride_s)


def test_a_recording_that_begins_at_seven_seconds_begins_its_cycle_there(tmp_path: Path) -> None:
    curve = read_curve(written(tmp_path, knee_rows()), "knee_angle_rad")
    assert curve.begins == 7.0
    assert curve.stride_s == pytest.approx(1.2)
    assert curve.percent[0] == 0.0
    assert curve.percent[-1] == pytest.approx(100 * 119 / 120)


def test_of_several_strides_the_first_is_taken_and_their_number_said(tmp_path: Path) -> None:
    curve = read_curve(written(tmp_path, knee_rows(strides=3.6)), "knee_angle_rad")
    assert curve.strides == 3
    assert curve.stride_s == pytest.approx(1.2)
    assert curve.values[0] == pytest.approx(-0.1)
    assert "the first of 3 strides of 1.20 s" in curve.note()


def test_a_motion_that_does_not_repeat_is_one_stride() -> None:
    assert repeats_after(np.linspace(0, 1, 100)) is None
    assert repeats_after(np.zeros(100)) is None
    assert repeats_after(np.cos(np.arange(300) / 100 * 2 * np.pi)) == 100


def test_lost_values_are_bridged_up_to_a_tenth_of_a_second_and_counted(tmp_path: Path) -> None:
    rows = knee_rows()
    for row in (*range(20, 29), 50, 1, 120):
        rows[row] = rows[row].split(",")[0] + ","
    curve = read_curve(written(tmp_path, rows), "knee_angle_rad")
    assert (curve.bridged, curve.trimmed) == (10, 2)
    whole = read_curve(written(tmp_path, knee_rows()), "knee_angle_rad")
    # a straight line over 0.1 s of this motion is off by at most f''·h²/8 = 0.35·(2π/1.2)²·0.1²/8
    assert np.abs(curve.values - whole.values[1:-1]).max() < 0.012
    assert "10 missing values bridged, 2 missing values at the ends left out" in curve.note()


def test_semicolons_with_decimal_commas_a_row_of_units_and_nan_are_read_as_they_are_meant(tmp_path: Path) -> None:
    plain = read_curve(written(tmp_path, knee_rows()), "knee_angle_rad")
    german = [row.replace(",", ";").replace(".", ",") for row in knee_rows()]
    german[20] = german[20].split(";")[0] + ";NaN"
    curve = read_curve(written(tmp_path, [german[0], "s;rad", *german[1:]]), "knee_angle_rad")
    assert curve.percent.tolist() == plain.percent.tolist()
    assert np.delete(curve.values, 19).tolist() == np.delete(plain.values, 19).tolist()
    assert curve.bridged == 1


def test_a_desired_force_needs_no_knee(tmp_path: Path) -> None:
    rows = ["gait_percent,desired_force_n", *(f"{k},{max(0, 40 - abs(k - 20) * 4)}" for k in range(101))]
    curve = read_curve(written(tmp_path, rows), "desired_force_n")
    assert curve.values.max() == 40.0
    assert len(curve.percent) == 101


REFUSED = {
    "empty": ([""], "the file is empty"),
    "header only": (["time_s,knee_angle_rad"], "a header and no rows"),
    "one row": (knee_rows()[:2], "1 rows with a value"),
    "wrong headers": (["t,angle", "0,0"], "row 1 is t, angle; expected the columns time_s, knee_angle_rad or"),
    "degrees over time": (["time_s,knee_angle_deg", "0,0"], "expected the columns"),
    "a column twice": (["time_s,knee_angle_rad,time_s", "0,0,0"], "names the column 'time_s' 2 times"),
    "another unit": (["time_s,knee_angle_rad", "s,deg", "0,0"], "knee_angle_rad is in deg by the row of units"),
    "unreadable": ([*knee_rows()[:9], "7.08,abc"], r"row 10: knee_angle_rad = 'abc' is not a number"),
    "infinite": ([*knee_rows()[:9], "inf,-0.3"], r"row 10: time_s = inf is not finite"),
    "no time": ([*knee_rows()[:9], ",-0.3"], r"row 10 has no time_s"),
    "time that stands": ([*knee_rows()[:9], "7.07,-0.3"], r"row 10: time_s = 7.07 does not rise, 7.07 came before"),
    "time that falls": ([*knee_rows()[:9], "6.0,-0.3"], r"row 10: time_s = 6 does not rise"),
    "a short row": ([*knee_rows()[:9], "7.08"], "row 10 has 1 cells, the header 2"),
    "degrees called radians": (["time_s,knee_angle_rad", "0,-28.4"], r"knee_angle_rad = -28.4 is not believable"),
    "flexion positive": (["time_s,knee_angle_rad", "0,0.5"], "flexion is negative"),
    "a long gap": ([*knee_rows()[:30], *knee_rows()[40:]], r"no value from time_s = 7.28 to 7.39, at most 0.1 s"),
    "half a cycle": (["gait_percent,knee_angle_deg", *(f"{k},-30" for k in range(50))], "covers 0 … 49 only"),
    "beyond a cycle": (["gait_percent,knee_angle_deg", *(f"{k},-30" for k in range(110))], "from 0 to 109"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_a_knee_motion_is_refused_by_its_row(tmp_path: Path, case: str) -> None:
    rows, message = REFUSED[case]
    path = written(tmp_path, rows)
    with pytest.raises(InputError, match=message) as refused:
        read_curve(path, "knee_angle_rad")
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


def test_a_negative_force_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, ["time_s,desired_force_n", "0,-1"])
    with pytest.raises(InputError, match="a rope only pulls"):
        read_curve(path, "desired_force_n")


@pytest.mark.parametrize("content", [b"\xff\xfe\x00time", b"\x89MCAP0\r\n\x00\x00"])
def test_a_file_that_is_no_text_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "knee.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"knee\.csv: "):
        read_curve(path, "knee_angle_rad")
    with pytest.raises(InputError, match="no such file"):
        read_curve(tmp_path / "none.csv", "knee_angle_rad")
    with pytest.raises(InputError, match="cannot be read"):
        read_curve(tmp_path, "knee_angle_rad")


@needs_gait
def test_recorded_cycles_are_read_whole() -> None:
    for number in range(1, 12):
        curve = read_curve(GAIT / f"cycle_{number:02}.csv", "knee_angle_rad")
        assert curve.percent.tolist() == list(range(100))
        assert -1.35 < curve.values.min() < curve.values.max() < 0.1


@needs_gait
def test_a_treadmill_recording_with_lost_markers_yields_its_stride() -> None:
    curve = read_curve(GAIT / "treadmill_markers.csv", "knee_angle_rad")
    assert (curve.strides, curve.bridged) == (2, 10)
    assert curve.stride_s == pytest.approx(1.19, abs=0.011)  # as its description says, to one sample
    assert curve.begins == 7.15


def numbered(strides: int, name: str = "stride") -> list[str]:
    rows = [f"{i},{at},{-20.0 - i - 10.0 * math.cos(2.0 * math.pi * at / 100.0):.3f}"
            for i in range(strides) for at in range(0, 100, 2)]
    return [f"{name},gait_percent,knee_angle_deg", *rows]


@pytest.mark.parametrize("name", ["stride", "cycle"])
def test_strides_are_read_by_the_column_that_numbers_them(tmp_path: Path, name: str) -> None:
    path = written(tmp_path, numbered(3, name))
    found = read_strides(path)
    assert [round(math.degrees(one.values[0]), 2) for one in found] == [-30.0, -31.0, -32.0]
    first = read_curve(path, "knee_angle_rad")
    assert first.strides == 3
    assert np.array_equal(first.values, found[0].values)


def test_a_recording_in_time_is_cut_into_its_strides(tmp_path: Path) -> None:
    found = read_strides(written(tmp_path, knee_rows(strides=3.6)))
    assert len(found) >= 2
    assert np.ptp([one.stride_s for one in found]) < 0.03


def test_a_stride_number_that_comes_twice_is_refused(tmp_path: Path) -> None:
    rows = numbered(2)
    with pytest.raises(InputError, match="row 102: stride = 0 comes a second time; number each stride once"):
        read_strides(written(tmp_path, [*rows, *rows[1:51]]))
