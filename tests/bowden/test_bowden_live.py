"""`bowden live`: a trial played with the controls of its page, and a bus that is only listened to."""

from __future__ import annotations

import http.client
import json
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

import trial
from bowden.live import feeds
from bowden.live.feeds import TrialPlayer
from bowden.live.state import LiveState
from eds.bench.bench_network import Network
from trial.mcap_file import cdr
from trial.playback import PlayerControl

PATIENCE_S = 60.0  # a server that says nothing for so long has hung
ROWS, PERIOD_NS, FIRST_NS = 3000, 1_000_000, 10**9
EITHER = "a live view shows a trial or a bus; give either a file or --interface."
LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove-layout.json"
MS = 1_000_000


def record(path: Path) -> Path:
    recorder = trial.Recorder(path, metadata={}, attachments={}, threaded=False)
    for row in range(ROWS):
        at = FIRST_NS + row * PERIOD_NS
        recorder.frame(at, 0x181, row.to_bytes(8, "little"))
        recorder.cycle(at, [float(row * 100 + column) for column in range(len(trial.SIGNALS))])
    recorder.event(FIRST_NS + 5, "nmt", "servo", "configured.")
    recorder.close({"outcome": "completed"})
    return path


def _interruptible() -> None:
    """Take Ctrl-C, which a shell lets what it started in the background ignore."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Looked:
    """A trial in a player and its page's state, on a clock that the test moves; somebody watches."""

    def __init__(self, path: Path, speed: float = 1.0) -> None:
        self.now_ns = 0
        self.shown: LiveState = feeds.state(path.name, "recorded", Network())
        self.player = TrialPlayer(trial.open(path), speed, lambda: self.now_ns, self.shown)
        self.shown.watchers = 1

    def look(self, after_ms: float) -> dict[str, Any]:
        """Return the whole content of the page after so many milliseconds of the clock."""
        for _ in range(round(after_ms)):
            self.now_ns += MS
            self.player.look()
        self.player.look()
        self.shown.digest()
        with self.shown.changed:
            content, _ = self.shown.message((-1, 0, 0))
        return content


def test_a_trial_is_played_once_from_its_beginning_to_its_end(tmp_path: Path) -> None:
    looked = Looked(record(tmp_path / "trial.mcap"), speed=10.0)
    content = looked.look(1000)
    place = trial.COLUMNS.index("tension_end_n")
    assert [row[0] for row in content["rows"]] == pytest.approx(np.arange(0, ROWS * 1e-3, 5e-3))
    assert [row[3] for row in content["rows"]] == [float(row * 100 + place) for row in range(0, ROWS, 5)]
    assert content["events"] == [(0.0, "nmt", "servo", "configured.")]
    assert content["status"] == "ended"
    assert content["player"] == {"at_s": pytest.approx(2.999), "length_s": pytest.approx(2.999), "speed": 10.0}


def test_pause_holds_a_seek_shows_what_was_before_and_play_goes_on(tmp_path: Path) -> None:
    looked = Looked(record(tmp_path / "trial.mcap"))
    assert looked.look(100)["player"]["at_s"] == pytest.approx(0.1, abs=2e-3)
    looked.player.request(PlayerControl.PAUSE, None, None)
    held = looked.look(500)
    assert (held["status"], held["player"]["at_s"]) == ("paused", pytest.approx(0.1, abs=2e-3))
    looked.player.request(PlayerControl.SEEK, None, 2.0)
    sought = looked.look(1)
    assert (sought["status"], sought["player"]["at_s"], sought["rows"][-1][0]) == ("paused", 2.0, 1.995)
    assert len(sought["rows"]) == 400
    looked.player.request(PlayerControl.PLAY, 4.0, None)
    ended = looked.look(300)
    assert (ended["status"], ended["rows"][-1][0]) == ("ended", 2.995)
    assert len(ended["rows"]) == ROWS // 5
    looked.player.request(PlayerControl.SEEK, None, 1e300)
    assert looked.look(1)["player"]["at_s"] == pytest.approx(2.999)


def test_nothing_is_played_before_somebody_watches(tmp_path: Path) -> None:
    looked = Looked(record(tmp_path / "trial.mcap"))
    looked.shown.watchers = 0
    assert (looked.look(50)["status"], looked.look(50)["rows"]) == ("waiting", [])


@contextmanager
def served(*arguments: object) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """`bowden live` in a process of its own; the port it says it has."""
    process = subprocess.Popen(
        [sys.executable, "-c", "from bowden.cli import main; main()", "live", "--web", "0", "--json",
         *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=_interruptible)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line, process.stderr.read() if process.stderr else ""
        yield json.loads(line)["port"], process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.walltime
def test_the_controls_of_a_page_reach_the_player_with_token_and_origin_only(tmp_path: Path) -> None:
    with served(record(tmp_path / "trial.mcap")) as (port, process):
        token = _answer(port, "GET", "/").split('const TOKEN = "')[1].split('"')[0]
        own = {"X-Bowden-Token": token, "Origin": f"http://127.0.0.1:{port}"}
        assert _answer(port, "POST", "/player?control=seek&at=1.5&speed=2", **own) == "Done.\n"
        client = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        client.request("GET", "/stream")
        stream = client.getresponse()
        while not (line := stream.readline()).startswith(b"data: ") or json.loads(line[6:])["player"]["at_s"] != 1.5:
            assert line
        assert json.loads(line[6:])["player"]["speed"] == 2.0
        for refused in ("control=end", "control=seek&at=nan", "control=seek&at=x", "speed=2"):
            assert _answer(port, "POST", f"/player?{refused}", **own).startswith("A recorded trial takes control=play")
        assert "token and its origin" in _answer(port, "POST", "/player?control=play", Origin=own["Origin"])
        client.close()
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130


def _answer(port: int, method: str, path: str, **headers: str) -> str:
    client = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    client.request(method, path, headers=headers)
    text = client.getresponse().read().decode()
    client.close()
    return text


def test_a_bus_is_followed_and_nothing_is_sent_on_it() -> None:
    shown = feeds.state("virtual", "bus", Network(), decode_events=True)
    feed = feeds.BusFeed(Network(), shown)
    with can.Bus("live", interface="virtual") as bus, can.Bus("live", interface="virtual") as listening:
        for can_id, data in ((0x080, b""), (0x183, (1234).to_bytes(2, "little")), (0x701, b"\0"), (0x080, b"")):
            bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            message = listening.recv(PATIENCE_S)
            assert message is not None
            feed.take(message)
        assert bus.recv(0) is None
    shown.digest()
    with shown.changed:
        content, _ = shown.message((-1, 0, 0))
    assert [event[1:] for event in content["events"]] == [("nmt", "servo", "boot-up")]
    assert [row[1:] for row in content["rows"]] == [(None, 12.34, None)]


@pytest.mark.walltime
def test_a_port_that_is_taken_is_refused(bowden: Callable[..., Any], here: Path) -> None:
    record(here / "trial.mcap")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        told = bowden("live", "trial.mcap", "--web", taken.getsockname()[1], "--json")
    assert (told.status, told.stdout) == (2, "")
    assert "cannot listen there" in told.stderr


@pytest.mark.parametrize(("arguments", "sentence"), [
    ((), EITHER),
    (("trial.mcap", "--interface", "virtual"), EITHER),
    (("trial.mcap", "--speed", "0"), "--speed 0: expected 0.001 … 1000; give another one."),
    (("none.mcap",), "none.mcap: "),
    (("--interface", "nonesuch"), "interface nonesuch: cannot be opened"),
])
def test_what_cannot_be_shown_is_refused(
    bowden: Callable[..., Any], here: Path, arguments: tuple[str, ...], sentence: str
) -> None:
    record(here / "trial.mcap")
    told = bowden("live", *arguments, "--web", 0, "--json")
    assert (told.status, told.stdout) == (2, "")
    assert told.stderr.startswith(f"bowden: {sentence}")


@pytest.mark.walltime
def test_a_bus_that_fails_ends_it_with_status_1(bowden: Callable[..., Any], here: Path) -> None:
    def serve_and_break_off(listening: socket.socket) -> None:
        client, _ = listening.accept()
        client.sendall(b"< hi >")
        for _ in ("open", "rawmode"):
            assert client.recv(64)
            client.sendall(b"< ok >")
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.close()

    with socket.create_server(("127.0.0.1", 0)) as listening:
        remote = threading.Thread(target=serve_and_break_off, args=(listening,))
        remote.start()
        told = bowden("live", "--interface", "socketcand", "--channel", "can0", "--option", "host=127.0.0.1",
                      "--option", f"port={listening.getsockname()[1]}", "--web", 0, "--json")
        remote.join()
    assert told.status == 1
    assert told.stderr.startswith("bowden: the bus has failed: ")
    assert json.loads(told.stdout)["port"] > 0


def test_the_layout_names_signals_that_there_are_and_shows_every_panel() -> None:
    layout = json.loads(LAYOUT.read_text())
    text = json.dumps(layout["configById"])
    named = {path.removeprefix("/cycle.") for path in _values(layout["configById"]) if path.startswith("/cycle.")}
    assert named
    assert named <= set(trial.COLUMNS)
    assert {path.split(".")[0] for path in _values(layout["configById"]) if path.startswith("/")} <= {
        cdr.CYCLE, cdr.EVENTS, cdr.FRAMES}
    assert "tension_end_n" in text
    assert set(_leaves(layout["layout"])) == set(layout["configById"])


def _values(node: Any) -> list[str]:
    children = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    return [node] if isinstance(node, str) else [value for child in children for value in _values(child)]


def _leaves(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else [*_leaves(node["first"]), *_leaves(node["second"])]
