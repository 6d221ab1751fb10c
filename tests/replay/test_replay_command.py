"""`bowden replay --onto bus`, as it is typed."""

from __future__ import annotations

import io
import itertools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from eds.cia301 import Frame
from trial.read import Trial
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.wire.station import Station

CHANNELS = itertools.count()
Heard = list[tuple[int, Frame]]


@pytest.fixture
def listened() -> Iterator[Callable[[], tuple[str, Heard]]]:
    """Names of channels with one listener each, and what it hears."""
    opened: list[BowdenBus] = []

    def make() -> tuple[str, Heard]:
        heard: Heard = []
        bench = Bench([], master_turnaround_ns=0)
        bench.wire.attach(Station("listener", lambda frame, now_ns: heard.append((now_ns, frame))))
        name = f"replay-command-{next(CHANNELS)}"
        opened.append(BowdenBus(name, bench=bench))
        return name, heard

    yield make
    for bus in opened:
        bus.shutdown()


def test_frames_are_played_with_filters_speed_and_loop(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], listened: Callable[[], tuple[str, Heard]]
) -> None:
    trial, (channel, heard) = recorded(), listened()
    told = bowden("replay", trial.path, "--onto", "bus", "--interface", "bowden", "--channel", channel,
                  "--direction", "tx", "--node", 1,
                  "--cob-id", "0x201", "--from", 5, "--to", 5.1, "--speed", 0.5, "--loop", 3, "--json")
    assert told.status == 0, told
    result = json.loads(told.stdout)
    assert (result["frames"], result["passes"], result["lost_frames"], result["state"]) == (300, 3, 0, "ended")
    assert result["lateness_max_us"] == 0.0
    played = heard[result["restored_frames"]:]
    assert {frame.can_id for _, frame in played} == {0x201}
    first = [at for at, _ in played[::100]]
    assert [b - a for a, b in itertools.pairwise(first)] == [200_000_000] * 2  # 100 ms at half speed, the same frame


def test_the_bus_is_restored_where_playing_begins_later(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], listened: Callable[[], tuple[str, Heard]]
) -> None:
    trial, (channel, heard) = recorded(), listened()
    told = bowden("replay", trial.path, "--onto", "bus", "--interface", "bowden", "--channel", channel,
                  "--from", 3, "--to", 3.01, "--json")
    restored = json.loads(told.stdout)["restored_frames"]
    assert [frame.data.hex() for _, frame in heard[:4]] == ["0101", "0102", "0103", "0104"]
    assert sorted(frame.can_id for _, frame in heard[4:restored]) == [0x181, 0x182, 0x183, 0x184, 0x201, 0x301]


def test_frames_that_nodes_on_the_bus_send_too_are_not_taken_and_it_is_said(
    recorded: Callable[..., Trial], bowden: Callable[..., Any]
) -> None:
    words = ("replay", recorded().path, "--onto", "bus", "--from", 5, "--to", 5.05)
    told = bowden(*words, "--direction", "both")
    assert told.status == 1
    assert "--direction tx leaves out" in told.stderr
    told = bowden(*words, "--direction", "tx")
    assert (told.status, told.stderr) == (0, "")


def test_onto_the_simulated_bench_go_the_frames_that_the_recorder_sent(
    recorded: Callable[..., Trial], bowden: Callable[..., Any]
) -> None:
    trial = recorded()
    told = bowden("replay", trial.path, "--onto", "bus", "--to", 0.6)
    assert told.status == 0, told
    first = trial.frames["time_ns"] - trial.frames["time_ns"].min() <= 600_000_000
    sent = int(trial.frames["sent"][first].sum())
    assert f"{sent} frames in 1 passes, 0 not taken by the bus" in told.stdout
    assert "--direction both plays all" in told.stderr


def test_a_log_that_was_only_listened_to_is_refused_onto_the_simulated_bench(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.log").write_text("".join(f"({k / 1000:.6f}) can0 181#3712000000000000\n" for k in range(1, 50)))
    assert bowden("import", "a.log", "-o", "a.mcap").status == 0
    told = bowden("replay", "a.mcap", "--onto", "bus")
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1), told
    assert "a.mcap: holds no frame that its recorder sent" in told.stderr
    trial = recorded()
    told = bowden("replay", trial.path, "--onto", "bus", "--cob-id", "0x7ff")
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1), told


def test_channels_are_mapped(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], listened: Callable[[], tuple[str, Heard]]
) -> None:
    trial, (used, heard), (unused, silence) = recorded(), listened(), listened()
    told = bowden("replay", trial.path, "--onto", "bus", "--map", f"0={used}", "--map", f"3={unused}", "--to", 0.3)
    assert told.status == 0, told
    assert len(heard) > 4
    assert silence == []


def test_steps_are_lines_of_standard_input(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], listened: Callable[[], tuple[str, Heard]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trial, (channel, heard) = recorded(), listened()
    monkeypatch.setattr("sys.stdin", io.StringIO("\n\n0.3\n\npause\n\n"))
    told = bowden("replay", trial.path, "--onto", "bus", "--interface", "bowden", "--channel", channel,
                  "--cob-id", "0x701", "--cob-id", "0x702",
                  "--step")
    assert told.status == 0, told
    assert [line.split()[2] for line in told.stdout.splitlines()[:3]] == ["701", "702", "701"]
    assert [frame.can_id for _, frame in heard] == [0x701, 0x702, 0x000, 0x000, 0x701]


@pytest.mark.parametrize(("options", "why"), [
    (("--onto", "moon"), "bus, controller, plant"),
    (("--onto", "bus", "--map", "x"), "NUMBER=CHANNEL"),
    (("--onto", "bus", "--cob-id", "servo"), "CAN identifier"),
    (("--onto", "bus", "--speed", "0"), "0.001"),
    (("--onto", "bus", "--loop", "0"), "from 1"),
    (("--onto", "bus", "--node", "77"), "no recorded frame"),
    (("--onto", "bus", "--interface", "virtual", "--serial", "2"), "simulated benches"),
    (("--onto", "controller", "--speed", "2"), "--speed means nothing to --onto controller"),
    (("--onto", "plant", "--from", "2"), "--from means nothing to --onto plant"),
    (("--onto", "bus", "--nodes-only", "--loop", "2"), "--loop means nothing to --onto bus --nodes-only"),
    (("--onto", "plant", "--nodes-only"), "belongs to --onto bus"),
    (("--onto", "bus", "--output", "x.mcap"), "--output means nothing to --onto bus"),
])
def test_bad_options_are_one_sentence(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], options: tuple[str, ...], why: str
) -> None:
    trial = recorded()
    told = bowden("replay", trial.path, *options)
    assert told.status == 2
    assert told.stdout == ""
    assert why in told.stderr
