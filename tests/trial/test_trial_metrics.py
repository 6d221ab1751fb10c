"""Each figure against one computed by hand from a record made for it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from trial import metrics
from trial.metrics import zero_phase

RATE_HZ, PERIOD_S, CYCLES, PEAK_N = 1000, 2.0, 4, 40.0
ROWS = int(RATE_HZ * PERIOD_S * CYCLES)
Floats = NDArray[np.float64]


def columns(end_error: Floats | float = 0.0) -> dict[str, Floats]:
    """Return the columns of a trial whose END is desired plus `end_error`."""
    row = np.arange(ROWS)
    phase = row % 2000 / 20.0
    rise, fall = np.sin(np.pi * (phase - 10) / 20), np.sin(np.pi * (30 - phase) / 20)
    desired = PEAK_N * np.where((phase >= 10) & (phase < 20), rise, np.where((phase >= 20) & (phase < 30), fall, 0))
    return {"gait_percent": phase, "cycle": np.floor(row / 2000), "desired_force_n": desired,
            "tension_end_n": desired + end_error}


def figures(found: dict[str, Floats], true: Floats | None = None, settle: int = 1) -> dict[str, float | None]:
    return metrics.figures(found, peak_n=PEAK_N, rate_hz=RATE_HZ, cycles=CYCLES, settle=settle, true_end_n=true)


def test_the_names_are_those_of_the_command_line() -> None:
    plain = ["relative_rmse_percent", "relative_rmse_window_percent", "max_idle_tension_n", "peak_jump_n"]
    assert list(figures(columns())) == plain + [f"true_{name}" for name in plain]


def test_a_constant_error_is_its_own_rmse_and_no_jump() -> None:
    found = figures(columns(0.8), columns(-0.4)["tension_end_n"])
    assert found["relative_rmse_percent"] == pytest.approx(2.0)
    assert found["relative_rmse_window_percent"] == pytest.approx(2.0)
    assert found["true_relative_rmse_percent"] == pytest.approx(1.0)
    assert found["true_max_idle_tension_n"] == pytest.approx(0.4)
    assert found["true_peak_jump_n"] == pytest.approx(0.0, abs=1e-12)
    # the low-pass rounds the corners at 10 % and 30 %, a little of which reaches 8 % and 32 %
    assert found["max_idle_tension_n"] == pytest.approx(0.8, abs=0.01)


def test_an_error_only_in_the_window_weighs_by_its_share_of_the_cycle() -> None:
    phase = columns()["gait_percent"]
    inside = (phase >= 10) & (phase <= 30)
    found = figures(columns(np.where(inside, 1.0, 0.0)))
    assert found["relative_rmse_window_percent"] == pytest.approx(2.5)
    assert found["relative_rmse_percent"] == pytest.approx(2.5 * math.sqrt(inside.mean()))


def test_settling_cycles_and_what_follows_the_last_are_left_out() -> None:
    early = np.where(columns()["cycle"] < 1, 10.0, 0.0)
    assert figures(columns(early))["relative_rmse_percent"] == 0.0
    assert figures(columns(early), settle=0)["relative_rmse_percent"] == pytest.approx(12.5)
    late = columns(np.where(columns()["cycle"] == 3, 10.0, 0.0))
    late["cycle"] = late["cycle"] + 1.0
    assert figures(late)["relative_rmse_percent"] == 0.0


def test_idle_is_beyond_8_and_32_percent_only() -> None:
    phase = columns()["gait_percent"]
    near = np.where((phase >= 8) & (phase <= 32), 3.0, 0.0)
    assert figures(columns(), columns(near)["tension_end_n"])["true_max_idle_tension_n"] == 0.0
    far = np.where(phase == 50, -3.0, 0.0)
    assert figures(columns(), columns(far)["tension_end_n"])["true_max_idle_tension_n"] == 3.0


def test_a_step_at_the_peak_is_the_jump_and_elsewhere_is_not() -> None:
    phase = columns()["gait_percent"]
    at_peak = np.where(phase >= 20, 1.5, 0.0)
    found = figures(columns(at_peak), columns(at_peak)["tension_end_n"])
    assert found["true_peak_jump_n"] == pytest.approx(1.5)
    jump = found["peak_jump_n"]
    assert jump is not None
    assert 1.0 < jump < 1.5  # low-passed at 20 Hz, a step takes about 20 ms
    elsewhere = np.where(phase >= 23, 1.5, 0.0)
    assert figures(columns(), columns(elsewhere)["tension_end_n"])["true_peak_jump_n"] == pytest.approx(0.0)


def test_the_low_pass_has_no_phase_and_halves_at_20_hz() -> None:
    time = np.arange(4000) / RATE_HZ
    for hertz, gain in ((1.0, 1.0), (20.0, 0.5), (200.0, 0.0)):
        smooth = metrics.lowpass(np.sin(2 * np.pi * hertz * time), RATE_HZ)
        assert smooth is not None
        # away from the ends; 1e-3: the bilinear transform bends 20 Hz at 1 kHz by less
        assert smooth[1000:3000] == pytest.approx(gain * np.sin(2 * np.pi * hertz * time)[1000:3000], abs=1e-3)


def test_without_truth_or_with_too_much_unknown_there_is_no_figure() -> None:
    found = figures(columns())
    assert all(found[name] is None for name in found if name.startswith("true_"))
    gaps = columns()
    gaps["tension_end_n"][4000:4040] = np.nan  # 40 of 6000 scored rows
    assert figures(gaps)["relative_rmse_percent"] == 0.0
    gaps["tension_end_n"][4000:4100] = np.nan
    assert figures(gaps)["relative_rmse_percent"] is None
    gaps["tension_end_n"][:] = np.nan
    assert set(figures(gaps).values()) == {None}


def test_figures_read_by_block_are_those_of_the_whole() -> None:
    noise = np.random.default_rng(1).normal(0.0, 1.0, ROWS)
    found = columns(noise)
    found["tension_end_n"][[0, 900, 901, 4000]] = np.nan
    found["true_end_n"] = columns(noise / 3)["tension_end_n"]
    whole = figures(found, found["true_end_n"])
    by_block = metrics.figures_of_blocks(
        lambda: ({name: one[at:at + 1111] for name, one in found.items()} for at in range(0, ROWS, 1111)),
        peak_n=PEAK_N, rate_hz=RATE_HZ, cycles=CYCLES, settle=1)
    assert by_block == pytest.approx(whole, rel=1e-12)  # sums in another order
    assert None not in whole.values()


def test_each_cycle_has_its_own_figures_and_together_they_are_the_trials() -> None:
    found = columns(np.where(columns()["cycle"] == 2, 0.8, 0.4))
    true = columns()["tension_end_n"]
    each = [metrics.figures(found, peak_n=PEAK_N, rate_hz=RATE_HZ, cycles=cycle + 1, settle=cycle, true_end_n=true)
            for cycle in range(CYCLES)]
    assert [row["relative_rmse_percent"] for row in each] == pytest.approx([1.0, 1.0, 2.0, 1.0])
    assert {row["true_relative_rmse_percent"] for row in each} == {0.0}
    assert list(each[0]) == list(figures(found))
    whole = figures(found, settle=0)["relative_rmse_percent"]
    assert whole == pytest.approx(math.sqrt(np.mean([(row["relative_rmse_percent"] or 0.0) ** 2 for row in each])))


@pytest.mark.parametrize(("rows", "rate_hz"), [(12, 200.0), (500, 1000.0)])
def test_the_low_pass_is_scipy_s(rows: int, rate_hz: float) -> None:
    from scipy.signal import butter, sosfiltfilt

    values = np.random.default_rng(rows).normal(20.0, 5.0, rows)
    expected = sosfiltfilt(butter(2, 20.0, fs=rate_hz, output="sos"), values)
    np.testing.assert_allclose(zero_phase(values, 20.0, rate_hz), expected, rtol=1e-11)
