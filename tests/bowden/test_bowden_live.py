"""`bowden live` with a client of its protocol (foxglove.sdk.v1), which speaks WebSocket (RFC 6455) itself."""

from __future__ import annotations

import base64
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

import trial
from eds.bench.bench_network import Network, wire
from trial.follow import Follower
from trial.mcap_file import cdr

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: pip install 'bowden-bench[live]'")
PATIENCE_S = 60.0  # a server that says nothing for so long has hung
ROWS, PERIOD_NS, FIRST_NS = 3000, 1_000_000, 10**9
PLAY, PAUSE = 0, 1
PLAYING, PAUSED, ENDED = 0, 1, 3
EITHER = "bowden live shows a trial or a bus; give either a file or --interface."
MESSAGE, TIME, STATE = 1, 2, 5  # opcodes of binary messages from the server
LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove-layout.json"


class Client:
    """A WebSocket client; `channels` are the ids of the topics that the server advertised."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode())
        self._file = self._socket.makefile("rb", buffering=0)
        self._kept: defaultdict[int, deque[bytes]] = defaultdict(deque)
        assert b" 101 " in self._file.readline()
        while self._file.readline() != b"\r\n":
            pass
        self.info = json.loads(self.receive())
        self.channels: dict[str, dict[str, Any]] = {}
        while len(self.channels) < 3:
            told = json.loads(self.receive())
            self.channels |= {channel["topic"]: channel for channel in told.get("channels", ())}

    def receive(self) -> bytes:
        """Return the next message."""
        _, length = self._exactly(2)
        if length > 125:
            length = int.from_bytes(self._exactly(2 if length == 126 else 8), "big")
        return self._exactly(length)

    def _exactly(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            more = self._socket.recv(size - len(data))
            assert more, "the server has hung up"
            data += more
        return data

    def binary(self, opcode: int) -> bytes:
        """Return the next binary message with this opcode, without it; those of other opcodes are kept."""
        while not self._kept[opcode]:
            message = self.receive()
            self._kept[message[0]].append(message[1:])
        return self._kept[opcode].popleft()

    def has(self, opcode: int) -> bool:
        """Take in what has come and return whether a binary message with this opcode is among it."""
        while select.select([self._socket], [], [], 0)[0]:
            message = self.receive()
            self._kept[message[0]].append(message[1:])
        return bool(self._kept[opcode])

    def message(self) -> tuple[int, bytes]:
        """Return time and payload of the next message of a topic."""
        head = self.binary(MESSAGE)
        return struct.unpack("<Q", head[4:12])[0], head[12:]

    def send(self, payload: bytes, opcode: int) -> None:
        """Send one message, masked as clients must."""
        length = bytes([0x80 | len(payload)]) if len(payload) < 126 else b"\xfe" + struct.pack(">H", len(payload))
        self._socket.sendall(bytes([0x80 | opcode]) + length + bytes(4) + payload)

    def subscribe(self, *topics: str) -> None:
        """Subscribe to topics."""
        wanted = [{"id": number, "channelId": self.channels[topic]["id"]} for number, topic in enumerate(topics)]
        self.send(json.dumps({"op": "subscribe", "subscriptions": wanted}).encode(), 1)

    def control(self, command: int, speed: float = 1.0, seek_ns: int | None = None) -> tuple[int, int, float, bool]:
        """Ask the player for something; returns the status, time (ns), speed and seek of its answer."""
        name = os.urandom(4).hex().encode()
        self.send(struct.pack("<BBfBQI", 3, command, speed, seek_ns is not None, seek_ns or 0, len(name)) + name, 2)
        while True:
            state = self.binary(STATE)
            if state.endswith(name):
                status, at_ns, told, sought = struct.unpack_from("<BQf?", state)
                return status, at_ns, told, sought

    def close(self) -> None:
        """Hang up."""
        self._file.close()
        self._socket.close()


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


@contextmanager
def served(*arguments: object) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """`bowden live` in a process of its own; the port it says it has."""
    process = subprocess.Popen(
        [sys.executable, "-c", "from bowden.cli import main; main()", "live", "--port", "0", "--json",
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
def test_a_client_subscribes_receives_the_trial_pauses_seeks_and_plays_to_the_end(tmp_path: Path) -> None:
    opened = trial.open(record(tmp_path / "trial.mcap"))
    with served(opened.path) as (port, process), closing(Client(port)) as client:
        assert "playbackControl" in client.info["capabilities"]
        assert client.info["dataStartTime"] == {"sec": 1, "nsec": 0}
        assert client.info["dataEndTime"] == {"sec": 3, "nsec": 999_000_000}
        cycle = client.channels[cdr.CYCLE]
        assert (cycle["encoding"], cycle["schemaEncoding"]) == ("cdr", "ros2msg")
        assert cdr.cycle_columns(cycle["schema"]) == trial.COLUMNS
        assert cycle["metadata"]["tension_end_n"] == "N"
        client.subscribe(cdr.CYCLE)
        for row in range(50):  # it begins with the first who watches, and nothing is left out
            at, payload = client.message()
            assert at == FIRST_NS + row * PERIOD_NS
            assert np.frombuffer(payload, "<f8", offset=12).tolist() == [row * 100.0 + column for column in
                                                                        range(len(trial.SIGNALS))]
        sought = FIRST_NS + 2000 * PERIOD_NS + 1
        status, at, _, did_seek = client.control(PAUSE, seek_ns=sought)
        assert (status, at, did_seek) == (PAUSED, sought, True)
        assert client.control(PLAY, speed=4.0)[:3] == (PLAYING, sought, 4.0)
        rows = []
        while not rows or rows[-1] < FIRST_NS + (ROWS - 1) * PERIOD_NS:
            rows.append(client.message()[0])
        after = rows.index(sought - 1)  # the last row before the seek shows where it stands
        assert rows[after:] == [FIRST_NS + row * PERIOD_NS for row in range(2000, ROWS)]
        assert client.binary(STATE)[0] == ENDED
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130


@pytest.mark.walltime
def test_a_bus_is_followed_and_nothing_is_sent_on_it() -> None:
    from bowden.live.viewer import Viewer

    follower = Follower(wire(Network()))
    viewer = Viewer("virtual", "127.0.0.1", 0, follower.units)
    with closing(viewer), closing(Client(viewer.port)) as client:
        assert "playbackControl" not in client.info["capabilities"]
        client.subscribe(cdr.CYCLE, cdr.EVENTS)
        event, row = followed(follower, viewer, client)
    assert cdr.event_strings(event) == ("nmt", "servo", "boot-up")
    values = dict(zip(follower.names, np.frombuffer(row, "<f8", offset=12).tolist(), strict=True))
    assert values["tension_start_n"] == pytest.approx(12.34)
    assert values["start_pdo_arrival_ns"] >= 0
    assert np.isnan(values["tension_end_n"])


def followed(follower: Follower, viewer: Any, client: Client) -> tuple[bytes, bytes]:
    """Run a bus until the client has been told an event and a row; returns both."""
    from bowden.live.relay import Relay

    told: dict[bool, bytes] = {}
    with can.Bus("live", interface="virtual") as bus, can.Bus("live", interface="virtual") as heard:
        relay = Relay(follower, viewer)
        while len(told) < 2:
            for can_id, data in ((0x080, b""), (0x183, (1234).to_bytes(2, "little")), (0x701, b"\0"), (0x080, b"")):
                bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
                message = heard.recv(PATIENCE_S)
                assert message is not None
                relay.take(message)
            while client.has(MESSAGE):
                _, payload = client.message()
                told[len(payload) == 12 + 8 * len(follower.names)] = payload
            if True in told and not np.isfinite(np.frombuffer(told[True], "<f8", offset=12)).sum() > 2:
                del told[True]  # a row between two SYNCs that follow each other
        assert bus.recv(0) is None
    return told[False], told[True]


@pytest.mark.walltime
def test_a_port_that_is_taken_is_refused(bowden: Callable[..., Any], here: Path) -> None:
    record(here / "trial.mcap")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        told = bowden("live", "trial.mcap", "--port", taken.getsockname()[1], "--json")
    assert (told.status, told.stdout) == (2, "")
    assert "cannot listen there" in told.stderr


@pytest.mark.parametrize(("arguments", "sentence"), [
    ((), EITHER),
    (("trial.mcap", "--interface", "virtual"), EITHER),
    (("trial.mcap", "--speed", "0"), "--speed 0: expected 0.001 … 1000; give another one."),
    (("none.mcap",), "none.mcap: "),
    (("--interface", "nonesuch"), "interface nonesuch, channel None: cannot be opened"),
])
def test_what_cannot_be_shown_is_refused(
    bowden: Callable[..., Any], here: Path, arguments: tuple[str, ...], sentence: str
) -> None:
    record(here / "trial.mcap")
    told = bowden("live", *arguments, "--port", 0, "--json")
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
                      "--option", f"port={listening.getsockname()[1]}", "--port", 0, "--json")
        remote.join()
    assert told.status == 1
    assert told.stderr.startswith("bowden: the bus has failed: ")
    assert json.loads(told.stdout)["port"] > 0


def test_without_the_sdk_it_says_what_to_install(
    bowden: Callable[..., Any], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(here / "trial.mcap")
    monkeypatch.setitem(sys.modules, "foxglove", None)
    told = bowden("live", "trial.mcap", "--port", 0)
    assert told.status == 2
    assert told.stderr == "bowden: bowden live needs foxglove-sdk; say pip install 'bowden-bench[live]'.\n"


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
