"""A report is opened as its reader opens it: offline, in a browser, zoomed, looked at."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import trial
from parameters import InputError
from trial import metrics
from trial.read import Event
from trial.report import overview, trial_page, words
from trial.report.page import Page
from trial.report.plot import Plot, Series

RATE_HZ = 200
PERIOD_S = 2.0
PEAK_N = 40.0
METADATA = {"experiment": "gait", "controller": "paper", "peak_n": "40.0", "period_s": "2.0", "cycles": "3",
            "settle": "1", "rate_hz": str(RATE_HZ), "bitrate": "1000000", "commit": "0123abcd"}
HOSTILE = "</script><script>document.title='owned'</script><img src=x onerror=\"document.title='owned'\">"


LINE_PX = 36.0
"""Height of a cell of one line, with its padding."""


def frame_bits(frames: Any) -> Any:
    return 55 + 10 * frames["dlc"].astype(np.int64)


def row(number: int, cycles: int) -> dict[str, float]:
    """One control cycle of a trial whose END is 5 % too large."""
    seconds = number / RATE_HZ
    cycle, phase = divmod(seconds / PERIOD_S, 1)
    desired = max(0.0, PEAK_N * math.sin(math.pi * (phase - 0.1) / 0.2)) if 0.1 < phase < 0.3 else 0.0
    return {
        "time_s": seconds, "gait_percent": 100 * phase, "cycle": min(cycle, cycles - 1), "desired_force_n": desired,
        "tension_end_n": 1.05 * desired, "tension_start_n": 1.3 * desired, "servo_position_m": 0.01 * math.sin(seconds),
        "servo_target_m": 0.01 * math.sin(seconds + 0.01), "servo_pdo_arrival_ns": 130_000 + 1000 * (number % 3),
        "servo_pdo_age_ns": 0, "sync_jitter_ns": 500 * (number % 5), "missed_inputs": 0, "missed_outputs": 0, "held": 0}


def write(path: Path, *, cycles: int = 3, metadata: dict[str, str] = METADATA, lacks: str = "") -> Path:
    """Record a small gait trial with frames and events."""
    recorder = trial.Recorder(path, metadata=metadata, attachments={"bench.toml": b"[gait]\n"}, threaded=False)
    recorder.event(0, "nmt", "servo", HOSTILE)
    for number in range(int(cycles * PERIOD_S * RATE_HZ)):
        values = row(number, cycles)
        if lacks:
            values.pop(lacks)
        time_ns = 1_000_000_000 + number * 1_000_000_000 // RATE_HZ
        recorder.frame(time_ns, 0x080, b"")
        recorder.frame(time_ns + 200_000, 0x181, bytes(8))
        recorder.frame(time_ns + 400_000, 0x581, bytes(8))
        recorder.cycle(time_ns, [values.get(name, math.nan) for name in trial.COLUMNS])
    recorder.close({"outcome": "completed", "stop_reason": None, "friction_half_width_m": 0.0008123053360643067})
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of a small trial."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    trial_page.write(trial.open(write(path.with_suffix(".mcap"))), path, frame_bits, bound_percent=59.9)
    return path


def data(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="page-data">(.*?)</script>', text, re.S)
    assert found is not None
    content: dict[str, Any] = json.loads(found[1])
    return content


def test_a_report_names_nothing_to_load(written: Path) -> None:
    text = written.read_text()
    assert not re.search(r"""(src|href|action|url)\s*[=(]\s*["']?\s*(https?:|//)""", text)
    assert not re.search(r"\b(fetch|XMLHttpRequest|WebSocket|EventSource|importScripts|sendBeacon)\b", text)
    assert "default-src 'none'" in text


def test_opened_it_asks_for_nothing_and_complains_of_nothing(browser: Any, written: Path) -> None:
    browser.open(written)
    assert browser.requests == [written.as_uri()]
    assert browser.complaints == []


def test_every_plot_shows_its_colours(browser: Any, written: Path) -> None:
    browser.open(written)
    plots = data(written.read_text())["plots"]
    assert len(plots) > 8
    for plot in plots:
        shown = browser.pixels(browser.box(f"#{plot['id']} .u-over")).reshape(-1, 3).astype(int)
        for colour in {series["colour"] for series in plot["series"][-1:]}:  # what is drawn last lies on top
            wanted = [int(colour[at:at + 2], 16) for at in (1, 3, 5)]
            near = np.abs(shown - wanted).sum(axis=1) < 90  # lines are antialiased on white
            assert near.sum() > 30, (plot["id"], plot["y_label"], colour)
        assert len(np.unique(shown, axis=0)) > 4, plot["id"]


def windows(browser: Any, written: Path) -> dict[str, list[tuple[float, float]]]:
    """The x window of each chart by the group it belongs to."""
    found: dict[str, list[tuple[float, float]]] = {}
    for name, low, high in browser.run(
            "[...bowden.groups].flatMap(([name, group]) => group.charts.map("
            "chart => [name, chart.scales.x.min, chart.scales.x.max]))"):
        found.setdefault(name, []).append((low, high))
    return found


def test_dragging_zooms_every_plot_over_time_and_a_double_click_shows_all(browser: Any, written: Path) -> None:
    browser.open(written)
    box = browser.box("#plot-0 .u-over")
    before, whole = browser.pixels(box), windows(browser, written)
    low, high = whole["time_s"][0]
    y = box.y + box.height / 2
    browser.mouse("mouseMoved", box.x + 0.25 * box.width, y)
    browser.mouse("mousePressed", box.x + 0.25 * box.width, y)
    browser.mouse("mouseMoved", box.x + 0.5 * box.width, y)
    browser.mouse("mouseReleased", box.x + 0.5 * box.width, y)
    browser.settle()
    zoomed = windows(browser, written)
    pixel = (high - low) / box.width
    assert len(set(zoomed["time_s"])) == 1
    assert len(zoomed["time_s"]) > 5
    assert zoomed["time_s"][0] == pytest.approx((low + 0.25 * (high - low), low + 0.5 * (high - low)), abs=2 * pixel)
    assert zoomed["gait_percent"] == whole["gait_percent"]
    assert browser.run("!document.querySelector('.window').hidden")
    assert (browser.pixels(box) != before).any(axis=2).mean() > 0.002
    for clicks in (1, 2):
        browser.mouse("mousePressed", box.x + 40, y, clicks)
        browser.mouse("mouseReleased", box.x + 40, y, clicks)
    browser.settle()
    assert windows(browser, written) == whole
    assert browser.run("document.querySelector('.window').hidden")


def test_a_name_above_a_plot_hides_its_lines(browser: Any, written: Path) -> None:
    browser.open(written)
    browser.run("document.querySelector('.legend button').click()")
    hidden = browser.run("bowden.groups.get('time_s').charts[0].series.map(series => series.show)")
    assert hidden[1] is False
    assert all(hidden[2:])


def test_every_number_can_be_read(browser: Any, written: Path) -> None:
    browser.open(written)
    cells = browser.run("""[...document.querySelectorAll('dd, td, .value')].filter(cell => /\\d/.test(cell.textContent))
        .map(cell => [cell.textContent, cell.getBoundingClientRect().width, cell.getBoundingClientRect().height])""")
    assert len(cells) > 20
    assert [text for text, width, height in cells if height > max(width, LINE_PX)] == []
    assert "0.812 mm" in [text for text, *_ in cells]
    shown = [text for text, *_ in cells if re.fullmatch(r"−?[\d.]+ ?[^\d.]*", text)]
    times = r"−?\d+\.\d{6}"  # of events, in whole microseconds
    assert [text for text in shown if len(re.sub(r"\D", "", text.partition(".")[2]).lstrip("0")) > 3
            and not re.fullmatch(times, text)] == []


def test_text_of_the_file_stays_text(browser: Any, written: Path) -> None:
    assert HOSTILE not in written.read_text()
    assert HOSTILE in unescape(written.read_text())
    browser.open(written)
    assert browser.run("document.title") == "Trial report.mcap"
    assert browser.run("document.querySelectorAll('section img').length") == 0


def test_the_figures_are_those_of_metrics(written: Path) -> None:
    recorded = trial.open(written.with_suffix(".mcap"))
    found = metrics.figures(recorded.columns, peak_n=PEAK_N, rate_hz=RATE_HZ, cycles=3, settle=1)
    assert found["relative_rmse_percent"] is not None
    for name, unit, _ in trial_page.FIGURES:
        assert f'<div class="value">{found[name]:.3g} <span class="unit">{unit}</span>' in written.read_text()


def test_what_is_not_recorded_is_named_and_not_drawn(tmp_path: Path) -> None:
    recorded = trial.open(write(tmp_path / "a.mcap", lacks="tension_end_n"))
    text = trial_page.build(recorded, frame_bits, {}, None).html()
    assert "No figures of force: END (measured) not known." in text
    assert re.search(r"Not in this trial: [^<]*END \(measured\)", text)
    tips = {series["tip"] for plot in data(text)["plots"] for series in plot["series"]}
    assert "tension_start_n" in tips
    assert not any(tip.startswith("tension_end_n") for tip in tips)


def test_events_of_trouble_are_marked_where_they_happened(tmp_path: Path) -> None:
    opened = trial.open(write(tmp_path / "a.mcap"))
    events = (*opened.events, Event(2_500_000_000, "safety", "master", "START lost"))
    text = trial_page.build(dataclasses.replace(opened, events=events), frame_bits, {}, None).html()
    assert data(text)["plots"][0]["marks"] == [1.5]
    assert "mark 1 events (emcy, miss, safety, warning)" in text


def test_the_interval_of_the_estimate_is_a_band(tmp_path: Path) -> None:
    opened = trial.open(write(tmp_path / "a.mcap"))
    assert data(trial_page.build(opened, frame_bits, {}, None).html())["plots"][0]["series"][0]["high"] is None
    columns = {**opened.columns, "estimated_end_force_n": opened.columns["tension_end_n"],
               "estimated_end_half_n": np.full(len(opened.time_ns), 1.5)}
    text = trial_page.build(dataclasses.replace(opened, columns=columns), frame_bits, {}, None).html()
    band = data(text)["plots"][0]["series"][0]
    assert band["label"] == "END (estimated), 95 % interval"
    np.testing.assert_allclose(array(text, band["high"]) - array(text, band["y"]), 3.0, atol=1e-5)  # float32 of 40 N


def test_the_load_is_that_of_whole_windows(tmp_path: Path) -> None:
    text = trial_page.build(trial.open(write(tmp_path / "a.mcap")), frame_bits, {}, None).html()
    plot = next(plot for plot in data(text)["plots"] if plot["series"][0]["label"] == "all frames")
    load = array(text, plot["series"][0]["y"])
    bits = RATE_HZ * (55 + 2 * 135)
    np.testing.assert_allclose(load[:-1], 100 * bits / 1e6, rtol=1e-6)  # float32
    assert np.isnan(load[-1])
    assert [series["label"] for series in plot["series"]] == ["all frames", "SYNC and PDOs", "SDO"]


def test_a_setting_that_nobody_stated_is_read_off_the_columns_and_said(tmp_path: Path) -> None:
    recorded = trial.open(write(tmp_path / "a.mcap", metadata={"specimen": "fabric 3"}))
    text = trial_page.build(recorded, frame_bits, {}, None).html()
    assert "Read off the columns: peak_n, rate_hz, cycles." in text
    assert "kbit/s" in json.dumps([plot["y_label"] for plot in data(text)["plots"]])


@pytest.mark.parametrize(("frames", "plots"), [(0, 0), (1, 1)])
def test_a_recording_without_control_cycles_has_a_report(
    tmp_path: Path, browser: Any, frames: int, plots: int
) -> None:
    with_none = trial.Recorder(tmp_path / "a.mcap", metadata={}, attachments={}, threaded=False)
    for _ in range(frames):
        with_none.frame(5, 0x181, b"\0")
    with_none.close({})
    trial_page.write(trial.open(tmp_path / "a.mcap"), tmp_path / "a.html", frame_bits)
    browser.open(tmp_path / "a.html")
    assert browser.complaints == []
    assert browser.run("document.documentElement.dataset.drawn") == str(plots)
    text = browser.run("document.body.innerText")
    assert ("Bus load" in text) == bool(frames)
    assert "No figures of force" in text


def test_a_trial_of_ten_minutes_stays_below_ten_megabytes_and_keeps_its_peak(tmp_path: Path) -> None:
    rows, peak_at = 600_000, 123_457
    short = trial.open(write(tmp_path / "a.mcap"))
    time_ns = np.arange(rows) * 1_000_000
    rng = np.random.default_rng(1)
    columns = {name: rng.normal(size=rows) for name in short.columns}
    columns |= {"cycle": np.floor(np.arange(rows) / 2000), "gait_percent": np.arange(rows) % 2000 / 20.0}
    columns["tension_end_n"][peak_at] = 4321.5
    long = dataclasses.replace(short, time_ns=time_ns, columns=columns, metadata=METADATA | {"cycles": "300"})
    text = trial_page.build(long, frame_bits, {}, None).html()
    assert len(text) < 10_000_000
    assert f"every 30 ms ({rows} rows in {overview.BINS} bins)" in text
    force = data(text)["plots"][0]
    at = [series["tip"] for series in force["series"]].index("tension_end_n")
    assert force["series"][at]["label"] == "END (measured)"
    values = array(text, force["series"][at]["y"])
    assert values.max() == 4321.5
    assert abs(array(text, force["x"])[values.argmax()] - peak_at / 1000) <= 0.03


def array(text: str, number: int) -> Any:
    import base64

    packed = data(text)["arrays"][number]
    return np.frombuffer(base64.b64decode(packed["data"]), f"<{packed['type']}")


def test_a_plot_refuses_what_it_cannot_draw() -> None:
    page = Page("a")
    with pytest.raises(ValueError, match="must not fall"):
        page.plot(Plot("a", [1, 0], [Series("a", [1, 2], "#000000")], "x", "y"))
    with pytest.raises(ValueError, match="2 values of x"):
        page.plot(Plot("a", [0, 1], [Series("a", [1, 2, 3], "#000000")], "x", "y"))


def test_a_report_is_kept_unless_told_and_its_place_must_exist(tmp_path: Path) -> None:
    page = Page("a")
    page.text("first")
    page.write(tmp_path / "a.html")
    with pytest.raises(InputError, match="the file exists; give another name or --overwrite"):
        page.write(tmp_path / "a.html")
    page.write(tmp_path / "a.html", overwrite=True)
    with pytest.raises(InputError, match="cannot be written"):
        page.write(tmp_path / "none" / "a.html")
    assert [path.name for path in tmp_path.iterdir()] == ["a.html"]


def test_the_summary_has_labels_in_words_and_folds_digests() -> None:
    told = {"peak_n": "40.0", "commit": "0a1b2c", "course": "ff00", "signal": 0, "day": {"offset_m": 1.0}, "notes": "",
            "my_rig": "7", "outcome": '"completed"', "stop_reason": "null",
            "friction_half_width_m": "0.0005158193832210658"}
    assert words.shown(told) == {"peak force": "40 N", "my rig": "7", "ended": "completed",
                                  "rope travel to reverse friction at homing": "0.516 mm"}
    assert words.folded(told) == {"commit": "0a1b2c", "course": "ff00", "signal": 0, "day": {"offset_m": 1.0}}


def test_an_entry_of_a_result_is_a_text_with_units_and_three_digits() -> None:
    homed = {"left": {"friction_half_width_m": 0.0005163860578846439, "day": [0.7374133169065539, -0.5]}}
    assert words.plain("homed", homed) == "left rope travel to reverse friction at homing 0.516 mm; day 0.737, -0.5"
    assert words.plain("duration_s", 18.878770000000003) == "18.9 s"
    assert words.quantities([1.3e-5, math.nan, None], "m/N") == (["13", "–", "–"], "µm/N")


def test_numbers_as_text_are_aligned_like_numbers() -> None:
    page = Page("a", "b")
    page.table(("constant", "reference", "unit"), [("rope", "−1.3", "mm"), ("knee", "–", "°"), ("k", "3.1e−07", "m")])
    assert page.html().count('<td class="figure">') == 3
