"""The live page: who may watch and stop, what it is told, how old it says that is, and the button's safe stop."""

from __future__ import annotations

import contextlib
import http.client
import json
import multiprocessing
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

import trial
from bowden.live import feeds
from bowden.live.page_process import MOST_WAITING, SEND_NS, PageProcess
from bowden.live.state import LiveState
from bowden.live.web import MOST_PENDING, LivePage, address
from eds.bench.bench_network import Network
from parameters import InputError
from trial.convert.frames import rows_of

PATIENCE_S = 120.0
MS = 1_000_000


class Clock:
    """Seconds that stand until they are moved."""

    def __init__(self) -> None:
        self.seconds = 100.0

    def __call__(self) -> float:
        return self.seconds


def state(clock: Clock | None = None, kind: str = "bus") -> LiveState:
    return LiveState("bench 7", kind, clock or Clock(), 1_000_000, (1, 2, 3, 4), 0.2, decode_events=kind == "bus")


def fill(shown: LiveState, seconds: float = 1.0) -> None:
    """Feed some seconds of a bus: a row each ms, heartbeats of the servo each 100 ms, one EMCY of the knee."""
    for at in range(0, round(seconds * 1e9), MS):
        shown.force(at, 30.0, 31.0, float("nan"))
        shown.frame(at, 0x181, bytes(8))
        if at % (100 * MS) == 0:
            shown.frame(at, 0x701, b"\x05")
    shown.frame(at, 0x082, bytes((0x31, 0x81, 1, 0, 0, 0, 0, 0)))


@contextmanager
def page(where: str = "0", stop: Any = None, shown: LiveState | None = None) -> Iterator[LivePage]:
    served = LivePage(shown or state(), where, stop, "" if stop else "Press Ctrl-C where the trial runs.")
    try:
        yield served
    finally:
        served.close()


def ask(
    served: LivePage, path: str, method: str = "GET", **headers: str
) -> tuple[int, str, http.client.HTTPResponse]:
    """Make one request; `Host` as a browser sends it unless given."""
    client = http.client.HTTPConnection("127.0.0.1", served.port, timeout=PATIENCE_S)
    client.putrequest(method, path, skip_host=True)
    for name, value in {"Host": f"127.0.0.1:{served.port}", **headers}.items():
        client.putheader(name.replace("_", "-"), value)
    client.endheaders()
    answer = client.getresponse()
    text = answer.read().decode()
    client.close()
    return answer.status, text, answer


def first_message(served: LivePage, query: str = "") -> dict[str, Any]:
    with socket.create_connection(("127.0.0.1", served.port), PATIENCE_S) as client:
        client.sendall(f"GET /stream{query} HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\n\r\n".encode())
        with client.makefile("rb") as file:
            while not (line := file.readline()).startswith(b"data: "):
                assert line, "the stream has ended"
            told: dict[str, Any] = json.loads(line[6:])
            return told


@pytest.mark.parametrize(("text", "wanted"), [
    ("8080", ("127.0.0.1", 8080)), ("0.0.0.0:0", ("0.0.0.0", 0)), ("[::1]:80", ("::1", 80)), ("lab:1", ("lab", 1))])
def test_an_address_is_a_port_or_host_and_port(text: str, wanted: tuple[str, int]) -> None:
    assert address(text) == wanted


@pytest.mark.parametrize("text", ["", "lab", "70000", ":80", "lab:", "80x", "-1"])
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=re.escape(f"--web {text}: expected [HOST:]PORT")):
        address(text)


def test_a_port_that_is_taken_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(InputError, match="cannot listen there"):
        LivePage(state(), str(taken.getsockname()[1]))


def test_the_page_is_one_file_that_may_load_nothing_but_its_stream() -> None:
    with page() as served:
        status, html, answer = ask(served, "/")
    assert status == 200
    policy = answer.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'nonce-")
    assert "frame-ancestors 'none'" in policy
    assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=\"(?!data:,)", html)
    assert "uPlot" in html
    assert html.count(f'nonce="{policy.partition("nonce-")[2].partition(chr(39))[0]}"') == 2


@pytest.mark.parametrize("headers", [
    {"Host": "evil.example:{port}"}, {"Host": "127.0.0.1:1"}, {"Host": "127.0.0.1"}, {"Host": "10.0.0.1:{port}"},
    {"Host": "u@127.0.0.1:{port}"}, {"Host": ""}, {"Origin": "http://evil.example"}, {"Origin": "null"},
    {"Origin": "https://127.0.0.1:{port}"}, {"Sec_Fetch_Site": "cross-site"}, {"Sec_Fetch_Site": "same-site"}])
def test_other_names_and_other_sites_get_nothing(headers: dict[str, str]) -> None:
    with page() as served:
        given = {name: value.format(port=served.port) for name, value in headers.items()}
        status, text, _ = ask(served, "/stream", **given)
        assert (status, served.token in text) == (403, False)
        assert ask(served, "/stop", "POST", **given)[0] == 403


def test_localhost_is_this_server_too() -> None:
    with page() as served:
        assert ask(served, "/", Host=f"localhost:{served.port}", Origin=f"http://localhost:{served.port}")[0] == 200
        assert "token" not in served.url


def test_beyond_loopback_the_token_is_needed() -> None:
    with page("0.0.0.0:0") as served:
        assert ask(served, "/")[0] == 403
        assert ask(served, "/stream?token=wrong")[0] == 403
        assert ask(served, "/?token=%C3%A9")[0] == 403
        assert ask(served, f"/?token={served.token}")[0] == 200
        assert ask(served, f"/?token={served.token}", Host=f"evil.example:{served.port}")[0] == 403
        assert served.url.endswith(f":{served.port}/?token={served.token}")
        assert first_message(served, f"?token={served.token}")["name"] == "bench 7"


def test_a_stop_needs_token_and_origin_and_happens_once_asked() -> None:
    asked: list[int] = []
    with page(stop=lambda: asked.append(1)) as served:
        own = f"http://127.0.0.1:{served.port}"
        assert ask(served, "/stop")[0] == 404
        for headers in ({}, {"Origin": own}, {"X_Bowden_Token": served.token},
                        {"Origin": own, "X_Bowden_Token": served.token[:-1]},
                        {"Origin": "http://evil.example", "X_Bowden_Token": served.token}):
            assert ask(served, "/stop", "POST", **headers)[0] == 403
        assert asked == []
        assert ask(served, "/stop", "POST", Origin=own, X_Bowden_Token=served.token)[0] == 202
        assert asked == [1]
        assert first_message(served)["stop"] == {"can": True, "why": "", "asked": True}


def test_the_stop_button_is_reached_under_two_hundred_half_open_connections() -> None:
    """Each of them sends half a request; the oldest are closed, and whoever asks for something is heard."""
    asked: list[int] = []
    with page(stop=lambda: asked.append(1)) as served, contextlib.ExitStack() as opened:
        silent = []
        for _ in range(200):
            client = opened.enter_context(socket.create_connection(("127.0.0.1", served.port), PATIENCE_S))
            client.sendall(b"GET / HTTP/1.1\r\nHost: ")
            silent.append(client)
        headers = {"Origin": f"http://127.0.0.1:{served.port}", "X_Bowden_Token": served.token}
        assert ask(served, "/stop", "POST", **headers)[0] == 202
        assert asked == [1]
        assert ask(served, "/")[0] == 200
        for client in silent[:200 - MOST_PENDING - 2]:
            with contextlib.suppress(ConnectionResetError):
                assert client.recv(1) == b"", "the oldest are closed"


def test_who_cannot_stop_the_bench_says_what_to_press() -> None:
    with page() as served:
        assert first_message(served)["stop"] == {
            "can": False, "why": "Press Ctrl-C where the trial runs.", "asked": False}
        status, text, _ = ask(served, "/stop", "POST", Origin=f"http://127.0.0.1:{served.port}",
                              X_Bowden_Token=served.token)
    assert (status, text) == (409, "Press Ctrl-C where the trial runs.\n")


def test_the_stream_tells_forces_nodes_load_and_events_with_their_age() -> None:
    clock = Clock()
    shown = state(clock)
    fill(shown, 2.0)
    shown.digest()
    clock.seconds += 2.3
    with shown.changed:
        told, seen = shown.message((-1, 0, 0))
        again, _ = shown.message(seen)
    assert told["age_s"] == pytest.approx(2.3)
    assert len(told["rows"]) == 400  # 2 s, a row each 5 ms
    assert told["rows"][0] == (0.0, 30.0, 31.0, None)
    assert (again["rows"], again["events"]) == ([], [])
    servo, knee = told["nodes"][:2]
    assert (servo["name"], servo["state"], servo["age_s"]) == ("servo", "operational", pytest.approx(0.099))
    assert (knee["state"], knee["age_s"]) == (None, None)
    assert told["load_percent"] == pytest.approx(13.0, abs=1.5)  # about 130 bits a ms at 1 Mbit/s
    assert told["events"] == [(1.999, "emcy", "knee", "error code 0x8131, error register 0x01")]


def test_without_data_it_says_so_and_before_time_goes_back_nothing_stays() -> None:
    shown = state()
    with shown.changed:
        told, seen = shown.message((-1, 0, 0))
    assert (told["status"], told["age_s"], told["load_percent"], told["rows"]) == ("waiting", None, None, [])
    fill(shown, 3.0)
    shown.digest()
    shown.force(0, 1.0, 2.0, 3.0)
    shown.digest()
    with shown.changed:
        told, seen = shown.message(seen)
    assert [row[1:] for row in told["rows"]] == [(1.0, 2.0, 3.0)]
    assert {node["state"] for node in told["nodes"]} == {None}


class Recording:
    """A recorder that keeps what it was told."""

    def __init__(self) -> None:
        self.told: list[tuple[Any, ...]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *told: self.told.append((name, *told))


@contextmanager
def trial_page(stop: Callable[[], None] = lambda: None) -> Iterator[PageProcess]:
    served = PageProcess(feeds.setup("bench 7", Network()), "0", stop)
    try:
        yield served
    finally:
        served.close()


@contextmanager
def stream_of(url: str) -> Iterator[tuple[Iterator[dict[str, Any]], Callable[[], int]]]:
    """The messages of a page, and what presses its stop button."""
    split = urlsplit(url)
    client = http.client.HTTPConnection("127.0.0.1", split.port or 0, timeout=PATIENCE_S)
    client.request("GET", "/")
    token = re.search(r'TOKEN = "([^"]+)"', client.getresponse().read().decode())
    assert token
    client.close()

    def press() -> int:
        client.request("POST", "/stop", headers={"Origin": f"http://{split.netloc}", "X-Bowden-Token": token[1]})
        return client.getresponse().status

    with socket.create_connection(("127.0.0.1", split.port or 0), PATIENCE_S) as stream:
        stream.sendall(f"GET /stream HTTP/1.1\r\nHost: {split.netloc}\r\n\r\n".encode())
        yield (json.loads(line[6:]) for line in stream.makefile("rb") if line.startswith(b"data: ")), press


def test_a_feed_records_first_and_tells_the_stop_from_the_trials_own_thread() -> None:
    asked, recording = threading.Event(), Recording()
    with trial_page(asked.set) as served, stream_of(served.url) as (messages, press):
        feed = feeds.TrialFeed(served, feeds.places(Network(), feeds.FORCES))
        sink, row = feed.beside(recording), [0.0] * len(trial.SIGNALS)
        sink.frame(1, 0x701, b"\x7f")
        sink.frames(memoryview(rows_of([(2, 0x702, 0, 1, 0, False, b"\x05")]).tobytes()), 1, 2)
        sink.cycle(2, row)
        assert press() == 202
        assert asked.wait(PATIENCE_S)
        sink.cycle(3, row)
        sink.cycle(4, row)
        feed.ended("interrupted: by the page")
        told = next(told for told in messages if told["status"] == "ended")
    assert [node["state"] for node in told["nodes"][:3]] == ["pre-operational", "operational", None]
    assert told["sentence"] == "interrupted: by the page"
    assert [one[0] for one in recording.told] == ["frame", "frames", "cycle", "cycle", "event", "cycle"]
    assert recording.told[4][4] == "safe stop requested by the live page's button."


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs POSIX signals")
def test_a_page_that_takes_nothing_or_is_killed_holds_nobody_up() -> None:
    """Ten minutes of a bus for a page that was stopped: what waits stays bounded, and every call returns."""
    rows = rows_of([(0, 0x181, 0, 8, 0, False, bytes(8))] * 1000).tobytes()
    with trial_page() as served:
        [page_id] = [child.pid for child in multiprocessing.active_children() if child.name == "bowden live page"]
        os.kill(page_id, signal.SIGSTOP)
        for at in range(600):
            for part in range(10):
                served.frames(rows)
                served.force(at * 1_000_000_000 + part * SEND_NS, 1.0, 2.0, 3.0)
            assert served.waits <= MOST_WAITING
        assert served.waits > MOST_WAITING // 2
        os.kill(page_id, signal.SIGKILL)
        served.force(0, 1.0, 2.0, 3.0)
        served.status("ended")


def test_a_trial_is_refused_a_page_at_a_port_that_is_taken() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(InputError, match="cannot listen there"):
        PageProcess(feeds.setup("bench 7", Network()), str(taken.getsockname()[1]), lambda: None)


def bowden(*arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", "from bowden.cli import main; main()", *map(str, arguments)],
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.walltime
def test_the_button_stops_a_trial_safely_and_the_file_says_so(tmp_path: Path) -> None:
    output = tmp_path / "trial.mcap"
    process = bowden("trial", "--cycles", 2000, "-o", output, "--web", 0, "--json")
    try:
        assert process.stderr is not None
        while not (found := re.search(r"live page: (http\S+)", process.stderr.readline())):
            assert process.poll() is None
        with stream_of(found[1]) as (messages, press):
            assert next(told for told in messages if told["rows"])
            assert press() == 202
            *_, last = messages
        text, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode != 0
    told = json.loads(text)
    assert told["outcome"] == "stopped"
    assert told["stop_reason"].startswith("interrupted")
    assert last["status"] == "ended"
    assert last["sentence"] == told["stop_reason"]
    events = [event.text for event in trial.open(output).events]
    assert "safe stop requested by the live page's button." in events


def until(browser: Any, condition: str) -> None:
    """Wait in the page until a JavaScript condition holds."""
    browser.run(f"new Promise(done => {{ const look = () => {condition} ? done(0) : setTimeout(look, 20); look(); }})")


def text_of(browser: Any, name: str) -> str:
    return str(browser.run(f"document.getElementById('{name}').textContent"))


@pytest.mark.walltime
def test_a_browser_shows_it_greys_what_is_old_and_stops(browser: Any) -> None:
    clock, asked = Clock(), list[int]()
    shown = state(clock, "trial")
    with page(stop=lambda: asked.append(1), shown=shown) as served:
        browser.visit(served.url)
        until(browser, "document.getElementById('age').textContent === 'no data yet'")
        fill(shown)
        # The page may be told some of these rows before the rest: wait for what is looked at, not for its neighbour.
        until(browser, "document.getElementById('start').textContent === '31.0'")
        until(browser, "document.getElementById('nodes').textContent.includes('operational')")
        until(browser, "document.querySelector('#plot canvas') && !document.body.classList.contains('stale')")
        assert (text_of(browser, "start"), text_of(browser, "end"), text_of(browser, "error")) == ("31.0", "–", "–")
        assert "servo (1)operational" in text_of(browser, "nodes")
        assert "never heard" in text_of(browser, "nodes")
        clock.seconds += 2.3
        until(browser, "document.body.classList.contains('stale')")
        until(browser, "/^no data for [2-9]\\.\\d s$/.test(document.getElementById('age').textContent)")
        assert "the state is the last one told" in text_of(browser, "nodes")
        browser.run("document.getElementById('stop').click()")
        until(browser, "document.getElementById('why').textContent === 'Safe stop requested.'")
        assert asked == [1]
        assert browser.complaints == []
        assert {urlsplit(url).netloc for url in browser.requests if url.startswith("http")} == {
            f"127.0.0.1:{served.port}"}
    until(browser, "document.getElementById('age').textContent.startsWith('no connection to bowden')")
    assert browser.run("document.getElementById('stop').disabled")


@pytest.mark.walltime
def test_a_click_in_a_running_gait_takes_the_tension_off(browser: Any, tmp_path: Path) -> None:
    output = tmp_path / "trial.mcap"
    process = bowden("trial", "--cycles", 2000, "-o", output, "--web", 0, "--json")
    try:
        assert process.stderr is not None
        while not (found := re.search(r"live page: (http\S+)", process.stderr.readline())):
            assert process.poll() is None
        browser.visit(found[1])
        until(browser, "Number(document.getElementById('desired').textContent) > 20")  # no force is desired in homing
        browser.run("document.getElementById('stop').click()")
        until(browser, "document.getElementById('status').textContent === 'ended'")
        text, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert json.loads(text)["outcome"] == "stopped"
    columns = trial.open(output).columns
    assert columns["cycle"].max() >= 0.0
    assert columns["tension_start_n"].max() > 20.0
    assert columns["tension_start_n"][-1] < 5.0
    assert columns["tension_end_n"][-1] < 5.0


@pytest.mark.walltime
def test_a_recorded_trial_is_played_in_the_page(browser: Any, tmp_path: Path) -> None:
    recorder = trial.Recorder(tmp_path / "short.mcap", metadata={}, attachments={}, threaded=False)
    row = [float(place) for place in range(len(trial.SIGNALS))]
    for at in range(0, 400 * MS, MS):
        recorder.frame(at, 0x701, b"\x05")
        recorder.cycle(at, row)
    recorder.event(5, "nmt", "servo", "<b>configured</b>")
    recorder.close({"outcome": "completed"})
    process = bowden("live", tmp_path / "short.mcap", "--web", 0, "--json")
    try:
        assert process.stdout is not None
        browser.visit(json.loads(process.stdout.readline())["web"])
        until(browser, "document.getElementById('status').textContent === 'ended'")
        until(browser, "document.getElementById('events').textContent.endsWith('</b>')")
        assert text_of(browser, "kind") == "RECORDED trial"
        assert text_of(browser, "events").endswith("nmtservo<b>configured</b>")
        assert float(text_of(browser, "start")) == trial.SIGNALS.index(
            next(one for one in trial.SIGNALS if one.name == "tension_start_n"))
        assert text_of(browser, "why") == feeds.RECORDED
        assert text_of(browser, "played") == "0.4 of 0.4 s"
        browser.run("document.getElementById('play').click()")
        until(browser, "document.getElementById('play').textContent === 'Pause'")
        until(browser, "document.getElementById('status').textContent === 'ended'")
        assert browser.run("document.getElementById('stop').disabled")
    finally:
        process.kill()
        process.communicate()


def test_the_bus_of_a_network_has_its_nodes_and_their_time_out() -> None:
    made = feeds.state("can0", "bus", Network())
    with made.changed:
        told, _ = made.message((-1, 0, 0))
    assert [node["name"] for node in told["nodes"]] == ["servo", "knee", "start", "end"]
    assert told["silent_s"] == pytest.approx(Network().heartbeat_timeout_ms * 1e-3)
