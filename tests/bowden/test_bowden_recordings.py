"""What is in a file, a part of it, several as one, a bus recorded by who only listens, two trials in one page."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import numpy as np
import pytest
from mcap.writer import Writer

import trial
from bowden.trials.recording import BusRecording
from eds.bench.bench_network import Network, wire
from parameters import InputError
from trial.mcap_file import cdr
from trial.mcap_file.container import MAGIC

WIRE = wire(Network())
PERIOD_NS = 1_000_000
ROWS = 400


def made(path: Path, *, offset: float = 0.0) -> Path:
    """A trial of four gait cycles of 100 rows with a frame, and now and then an event, in each."""
    recorder = trial.Recorder(path, metadata={"operator": "N. N.", "peak_n": "40", "cycles": "4"},
                              attachments={"notes.txt": b"as it was"}, threaded=False)
    names = list(trial.COLUMNS)
    for row in range(ROWS):
        values = [1.0 + offset] * len(names)
        told = {"time_s": row / 1000, "gait_percent": float(row % 100), "cycle": float(row // 100),
                "tension_end_n": row / 10 + offset, "desired_force_n": row / 10}
        for name, value in told.items():
            values[names.index(name)] = value
        recorder.frame(row * PERIOD_NS, 0x80, b"")
        recorder.cycle(row * PERIOD_NS, values)
        if row % 50 == 0:
            recorder.event(row * PERIOD_NS, "nmt", "servo", "boot-up")
    recorder.close({"outcome": "completed"})
    return path


def test_info_tells_of_a_trial_what_is_in_it(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    made(here / "a.mcap")
    status, out, err = bowden("info", "a.mcap", "--json")
    told = json.loads(out)
    assert (status, err) == (0, "")
    streams = {one["name"]: one for one in told["streams"]}
    assert streams["/cycle"]["messages"] == ROWS
    assert streams["/cycle"]["rate_hz"] == pytest.approx(1000)
    assert streams["/cycle"]["gaps"] == 0
    assert {one["name"]: one["unit"] for one in told["columns"]} == {
        signal.name: signal.unit for signal in trial.SIGNALS}
    assert told["about"]["operator"] == "N. N."
    assert told["attachments"] == {"notes.txt": 9}
    assert "operator: N. N." in bowden("info", "a.mcap")[1]


@pytest.mark.parametrize(("columns", "cut"), [(80, set()), (60, {"can_msgs/msg/Frame", "bowden/msg/Cycle",
                                                                 "bowden/msg/Event"}), (20, None)])
def test_a_table_breaks_lines_at_blanks_and_cuts_a_word_only_where_the_terminal_has_no_room(
    here: Path, bowden: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch, columns: int,
    cut: set[str] | None
) -> None:
    made(here / "a.mcap")
    streams = json.loads(bowden("info", "a.mcap", "--json")[1])["streams"]
    monkeypatch.setenv("COLUMNS", str(columns))
    status, out, err = bowden("info", "a.mcap")
    assert (status, err) == (0, "")
    table = out.split("streams\n")[1].split("\ncolumns")[0]
    assert max(map(len, table.splitlines())) <= columns
    words = {word for one in streams for word in (
        one["name"], one["kind"], str(one["messages"]), f"{one['rate_hz']:.2f}")} | {"longest", "gap", "(Hz)"}
    assert cut is None or {word for word in words if word not in table} == cut


@pytest.mark.parametrize(("name", "text", "expected"), [
    ("lab.csv", "time_s;force\ns;N\n0;1,5\n0,1;2\n0,2;3\n0,5;4\n", ("table of 4 rows", "delimiter semicolon")),
    ("bus.log", "(1.000000) can0 080#\n(1.001000) can0 080#\n(1.002000) can0 183#0100\n", ("SYNC", "TPDO of start")),
])
def test_info_tells_of_any_format(
    here: Path, bowden: Callable[..., tuple[int, str, str]], name: str, text: str, expected: tuple[str, ...]
) -> None:
    (here / name).write_text(text)
    status, out, err = bowden("info", name)
    assert (status, err) == (0, "")
    assert all(word in out for word in expected)


def test_info_counts_gaps_of_a_table(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    rows = [k for k in range(100) if not 40 < k < 50]
    (here / "lab.csv").write_text("time_s,tension_end_n\n" + "".join(f"{k / 100},1\n" for k in rows))
    stream = json.loads(bowden("info", "lab.csv", "--json")[1])["streams"][0]
    assert (stream["gaps"], stream["longest_gap_s"]) == (1, pytest.approx(0.1))


def test_a_cut_keeps_what_explains_it_and_the_parts_merge_to_the_whole(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    whole = trial.open(made(here / "whole.mcap"))
    assert bowden("cut", "whole.mcap", "--to", 0.15, "-o", "a.mcap")[0] == 0
    assert bowden("cut", "whole.mcap", "--from", 0.15, "-o", "b.mcap")[0] == 0
    part = trial.open(here / "b.mcap")
    assert part.columns["time_s"].tolist() == whole.columns["time_s"][150:].tolist()
    assert (part.lost_cycles, part.metadata["operator"], part.attachments) == (0, "N. N.", {"notes.txt": b"as it was"})
    assert (part.result or {})["outcome"] == "cut"
    assert bowden("merge", "b.mcap", "a.mcap", "-o", "again.mcap")[0] == 0
    again = trial.open(here / "again.mcap")
    assert again.digest() == whole.digest()
    assert again.attachments == {"notes.txt": b"as it was"}


def test_a_table_of_one_row_is_listed_and_neither_cut_nor_merged(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    (here / "one.csv").write_text("time_s,tension_start_n\n0,1\n")
    assert bowden("info", "one.csv")[::2] == (0, "")
    for words in (("cut", "one.csv", "--to", "1"), ("merge", "one.csv", "one.csv")):
        status, _, err = bowden(*words, "-o", "a.mcap")
        assert (status, "not an MCAP file; give a recorded trial, or make one: bowden import" in err) == (2, True), err


@pytest.mark.parametrize("content", [b"hello", bytes(20), MAGIC, b""])
def test_what_is_no_whole_recording_is_refused_in_one_sentence(
    here: Path, bowden: Callable[..., tuple[int, str, str]], content: bytes
) -> None:
    (here / "x.mcap").write_bytes(content)
    for words in (("info", "x.mcap"), ("cut", "x.mcap", "--from", "1", "-o", "part.mcap")):
        status, out, err = bowden(*words)
        assert (status, out, err.count("\n"), err.startswith("bowden: x.mcap: ")) == (2, "", 1, True), err


def test_a_cut_takes_gait_cycles(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    made(here / "whole.mcap")
    assert bowden("cut", "whole.mcap", "--gait", "1-2", "-o", "part.mcap")[0] == 0
    assert np.unique(trial.open(here / "part.mcap").columns["cycle"]).tolist() == [1.0, 2.0]


CUT_REFUSED = {
    "nothing said": ((), "nothing says what to keep"),
    "both kinds": (("--gait", "1", "--to", "1"), "give one kind"),
    "no gait cycle": (("--gait", "7-9"), "has no gait cycle from 7 to 9"),
    "no number": (("--gait", "x"), "expected a gait cycle"),
    "backwards": (("--from", "0.2", "--to", "0.1"), "--to is not after --from"),
    "beyond the end": (("--from", "9"), "nothing was recorded there; it lasts 0.399 s"),
}


@pytest.mark.parametrize("case", CUT_REFUSED)
def test_a_cut_that_leaves_nothing_is_refused(
    here: Path, bowden: Callable[..., tuple[int, str, str]], case: str
) -> None:
    arguments, message = CUT_REFUSED[case]
    made(here / "whole.mcap")
    status, out, err = bowden("cut", "whole.mcap", *arguments, "-o", "part.mcap")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert message in err
    assert not (here / "part.mcap").exists()


def test_recordings_that_overlap_are_not_merged_and_other_topics_are(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    made(here / "a.mcap")
    made(here / "b.mcap", offset=1.0)
    status, _, err = bowden("merge", "a.mcap", "b.mcap", "-o", "both.mcap")
    assert status == 2
    assert "overlaps that of a.mcap" in err
    with (here / "camera.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/camera", "json", writer.register_schema("Image", "jsonschema", b"{}"))
        for row in range(5):
            writer.add_message(channel, row * 10 * PERIOD_NS, b"{}", 0)
        writer.finish()  # type: ignore[no-untyped-call]
    assert bowden("merge", "a.mcap", "camera.mcap", "-o", "both.mcap")[0] == 0
    streams = {one["name"]: one["messages"] for one in json.loads(bowden("info", "both.mcap", "--json")[1])["streams"]}
    assert streams == {"/can/frames": ROWS, "/cycle": ROWS, "/events": 8, "/camera": 5}


def test_compare_writes_both_trials_into_one_page_and_ends_with_1_where_they_differ(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    made(here / "a.mcap")
    made(here / "b.mcap", offset=0.5)
    made(here / "same.mcap")
    assert bowden("compare", "a.mcap", "same.mcap")[0] == 0
    status, out, err = bowden("compare", "a.mcap", "b.mcap", "--report", "page.html")
    assert (status, err) == (1, "")
    assert "Page: page.html" in out
    assert "figure" in out.split("Set up")[0]
    assert "tension_end_n" in out
    assert len([line for line in out.splitlines() if line[0] not in "┏┃┡│└"]) <= 7
    everything = bowden("compare", "a.mcap", "b.mcap", "--all")[1]
    assert "signals, A − B" in everything
    page = (here / "page.html").read_text()
    assert "A: a.mcap · B: b.mcap" in page
    assert all(f"{name}, A − B" in page for name in ("tension_end_n", "desired_force_n", "servo_position_m"))
    assert re.search(r">END \(measured\)<.*?<td>N</td>", page)
    assert bowden("compare", "a.mcap", "b.mcap", "--report", "a.mcap", "--overwrite")[0] == 2
    assert bowden("compare", "a.mcap", "b.mcap", "--report", "page.pdf")[0] == 2


def test_the_page_of_a_table_shows_what_a_table_has_and_nothing_that_cannot_be(
    here: Path, bowden: Callable[..., tuple[int, str, str]]
) -> None:
    (here / "lab.csv").write_text("time_s,tension_start_n,tension_end_n\n" + "".join(
        f"{k / 100},{20 + k % 9},{10 + k % 9}\n" for k in range(300)))
    assert bowden("import", "lab.csv", "-o", "lab.mcap")[0] == 0
    assert bowden("report", "lab.mcap", "-o", "lab.html")[0] == 0
    page = (here / "lab.html").read_text()
    shown = re.sub(r"<(script|style)[^>]*>.*?</\1>|<!--.*?-->", "", page, flags=re.DOTALL)
    assert "Sampling" in shown
    assert "tension_start_n" in page
    for word in ("SYNC", "PDO arrival", "Bus load", "CAN frames", "Motion", "Events", "{", "}", "[]"):
        assert word not in shown.replace(shown[shown.find("Not in this trial"):].split("</p>")[0], ""), word


def frames(count: int) -> Iterator[can.Message]:
    """What a bench says: SYNC and its TPDOs, once a millisecond."""
    for row in range(count):
        at = 5.0 + row / 1000
        yield can.Message(timestamp=at, arbitration_id=0x80, is_extended_id=False, channel="can0")
        yield can.Message(timestamp=at + 1e-4, arbitration_id=0x183, is_extended_id=False, channel="can0",
                          data=WIRE.tpdo[0x183].pack_si(20.0 + row / 100))
    yield can.Message(timestamp=at + 1e-3, arbitration_id=0x703, data=b"\0", is_extended_id=False, channel="can0")
    yield can.Message(timestamp=at + 2e-3, arbitration_id=0x703, data=bytes(12), is_fd=True, channel="can0")


def test_a_recorded_bus_is_a_trial_and_full_files_follow_each_other_without_a_frame_lost(tmp_path: Path) -> None:
    with BusRecording(tmp_path / "bus.mcap", WIRE, about={"interface": "test"}, max_ns=50_000_000) as recording:
        for message in frames(200):
            recording.take(message)
    told = recording.as_json()
    assert (told["frames"], told["left_out"]) == (401, 1)
    assert [path.name for path in recording.files] == [f"bus-{part:03}.mcap" for part in range(1, 6)]
    opened = [trial.open(path) for path in recording.files]
    assert sum(len(one.frames) for one in opened) == 401
    tension = np.concatenate([one.columns["tension_start_n"] for one in opened])
    assert tension == pytest.approx(20.0 + np.arange(199) / 100)  # the last cycle is not ended by a SYNC
    assert [event[1:] for one in opened for event in one.events] == [("nmt", "start", "boot-up")]
    assert opened[1].metadata["part"] == "2"
    with pytest.raises(InputError, match="the file exists"):
        BusRecording(tmp_path / "bus.mcap", WIRE, about={}, max_ns=1)


def test_rotation_by_size_closes_whole_files(tmp_path: Path) -> None:
    with BusRecording(tmp_path / "bus.mcap", WIRE, about={}, max_bytes=10_000, threaded=False) as recording:
        for message in frames(3000):
            recording.take(message)
    assert len(recording.files) > 1
    assert sum(len(trial.open(path).frames) for path in recording.files) == 6001


@pytest.mark.walltime
def test_record_hears_a_bus_and_sends_nothing(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    with can.Bus("record", interface="virtual", receive_own_messages=True) as sender:
        def echo(message: can.Message) -> None:
            sender.send(message)  # each frame begets the next, so that there are some whenever the recorder opens

        notifier = can.Notifier(sender, [echo])
        sender.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        status, out, err = bowden("record", "--interface", "virtual", "--channel", "record", "--frames", 20, "--json",
                                  "-o", "bus.mcap")
        notifier.stop()
    assert status == 0, err
    assert json.loads(out)["frames"] == 20
    assert set(trial.open(here / "bus.mcap").frames["can_id"]) == {0x80}
    assert cdr.FRAMES in {one["name"] for one in json.loads(bowden("info", "bus.mcap", "--json")[1])["streams"]}


def test_a_bus_that_cannot_be_opened_leaves_no_file(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    status, out, err = bowden("record", "--interface", "nonesuch", "-o", "bus.mcap")
    assert (status, out, list(here.iterdir())) == (2, "", [])
    assert err.startswith("bowden: interface nonesuch: cannot be opened")
    assert err.endswith("; no --channel was given.\n")
