"""Fixtures and figures for the tests of all rooms: processor time of the run, and a page in headless Chromium."""

from __future__ import annotations

import base64
import fcntl
import gc
import io
import itertools
import json
import os
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

from tests.warm import warm

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
         "--disable-background-networking", "--disable-component-update", "--hide-scrollbars", "--window-size=1200,900")
AS_3_AND_4 = """import os, sys
os.dup2(int(sys.argv[1]), 3)
os.dup2(int(sys.argv[2]), 4)
os.execv(sys.argv[3], sys.argv[3:])"""  # the descriptors at which --remote-debugging-pipe reads and writes
PATIENCE_S = 120.0  # a browser that says nothing for so long has hung


# The same examples in every run: a test fails where it is changed, not one day by chance.  BOWDEN_DRAWN_EXAMPLES=1
# draws others.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("drawn", deadline=None)
settings.load_profile("drawn" if "BOWDEN_DRAWN_EXAMPLES" in os.environ else "repeatable")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--cpu N`, which lists the N tests that took the most processor time."""
    parser.addoption("--cpu", type=int, default=0, metavar="N", help="list the N tests with the most CPU seconds")


def _cpu_s() -> float:
    """Processor time of this process and of its ended children, user and system, in s."""
    return sum(os.times()[:4])


def pytest_configure(config: pytest.Config) -> None:
    """Compile what a trial needs before workers start, so that they do not compile side by side."""
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        warm()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test that opens a browser as exhaustive, before `-m` selects; let those on real time run three times.

    A busy computer may stop a test on real threads or sockets for longer than a bench tolerates.
    """
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.exhaustive)
        if item.get_closest_marker("walltime"):
            item.add_marker(pytest.mark.flaky(reruns=2))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Attach a test's CPU seconds, with those of the fixtures made for it, to its reports."""
    before = _cpu_s()
    item.user_properties.append(("cpu_from_s", before))
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Report the CPU seconds since the test began."""
    report = yield
    if report.when == "teardown":
        report.user_properties.append(("cpu_s", _cpu_s() - dict(item.user_properties)["cpu_from_s"]))
    return report


def pytest_collection_finish() -> None:
    """Exempt modules and tests from the garbage collection with which a trial begins: 0.2 s of CPU in each trial."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the CPU seconds of the run: this process, its workers, and the programs that tests started."""
    taken = [(dict(report.user_properties)["cpu_s"], report.nodeid)
             for reports in terminalreporter.stats.values() for report in reports
             if getattr(report, "when", None) == "teardown"]
    for cpu_s, name in sorted(taken, reverse=True)[:config.getoption("cpu")]:
        terminalreporter.write_line(f"{cpu_s:7.2f} s CPU  {name}")
    terminalreporter.write_line(f"{_cpu_s():.0f} s of processor time")


@pytest.fixture(scope="session", autouse=True)
def _signals_as_at_a_terminal() -> Iterator[None]:
    """A shell starts a background job with SIGINT and SIGQUIT ignored, nohup any with SIGHUP; a child inherits that,
    and ends by none of them."""
    wanted = {signal.SIGINT: signal.default_int_handler, signal.SIGQUIT: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in wanted.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


class Box(NamedTuple):
    """A rectangle of the document, in CSS pixels."""

    x: float
    y: float
    width: float
    height: float


class Browser:
    """One page in Chromium, spoken to over its debugging pipe; `requests` and `complaints` since `open`."""

    def __init__(self, profile: Path) -> None:
        assert CHROMIUM is not None
        (ours_in, theirs_out), (theirs_in, ours_out) = os.pipe(), os.pipe()
        high = [fcntl.fcntl(fd, fcntl.F_DUPFD, 20) for fd in (theirs_in, theirs_out)]
        self._process = subprocess.Popen(
            [sys.executable, "-c", AS_3_AND_4, *map(str, high), CHROMIUM, *FLAGS, f"--user-data-dir={profile}",
             "--remote-debugging-pipe", "about:blank"],
            pass_fds=high, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for fd in (theirs_in, theirs_out, *high):
            os.close(fd)
        self._in, self._out, self._rest = ours_in, ours_out, b""
        self._numbers = itertools.count(1)
        self._session: str | None = None
        self._loaded: str | None = None  # the document whose load event came last
        self.requests: list[str] = []
        self.complaints: list[str] = []
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(target["targetId"] for target in targets if target["type"] == "page")
        self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.call("Page.setLifecycleEventsEnabled", enabled=True)

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a method of the Chrome DevTools protocol and return its result."""
        number = next(self._numbers)
        request = {"id": number, "method": method, "params": parameters}
        if self._session:
            request["sessionId"] = self._session
        os.write(self._out, json.dumps(request).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]

    def _receive(self) -> Any:
        while b"\0" not in self._rest:
            assert select.select([self._in], [], [], PATIENCE_S)[0], "Chromium says nothing"
            data = os.read(self._in, 1 << 20)
            assert data, "Chromium has ended"
            self._rest += data
        text, _, self._rest = self._rest.partition(b"\0")
        message = json.loads(text)
        told, event = message.get("method"), message.get("params", {})
        if told == "Page.lifecycleEvent" and event["name"] == "load":
            self._loaded = event["loaderId"]
        elif told == "Network.requestWillBeSent":
            self.requests.append(event["request"]["url"])
        elif told == "Runtime.exceptionThrown":
            self.complaints.append(event["exceptionDetails"].get("exception", {}).get("description", "exception"))
        elif told == "Log.entryAdded":
            self.complaints.append(event["entry"]["text"])
        return message

    def open(self, path: Path) -> None:
        """Load a file and wait until it is loaded and drawn."""
        self.visit(path.resolve().as_uri())
        self.settle()

    def visit(self, url: str) -> None:
        """Load an address and wait until it is loaded; what a page before it still asked for is forgotten."""
        self.leave()
        self._load(url)

    def leave(self) -> None:
        """Load an empty page, so that no script of the page before it runs on, and forget what that page asked for."""
        self._load("about:blank")
        self.requests.clear()
        self.complaints.clear()

    def _load(self, url: str) -> None:
        """Navigate, and wait until that very document has loaded: a load event of the page before it is not its own."""
        wanted = self.call("Page.navigate", url=url)["loaderId"]
        while self._loaded != wanted:
            self._receive()

    def settle(self) -> None:
        """Wait until what was asked for is painted."""
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(0))))")

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression, awaited."""
        found = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def box(self, selector: str) -> Box:
        """Scroll the element that a CSS selector finds into view and return where it stands in the window."""
        return Box(*self.run(
            f"(() => {{ const element = document.querySelector({json.dumps(selector)});"
            "element.scrollIntoView({block: 'center', behavior: 'instant'});"
            "const box = element.getBoundingClientRect(); return [box.x, box.y, box.width, box.height]; })()"))

    def mouse(self, kind: str, x: float, y: float, clicks: int = 1) -> None:
        """Send a mouse event: mousePressed, mouseMoved or mouseReleased."""
        button = "none" if kind == "mouseMoved" else "left"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=clicks)

    def pixels(self, box: Box) -> NDArray[np.uint8]:
        """Return a part of the window as it is shown: (height, width, 3)."""
        from matplotlib.image import imread

        x, y = self.run("[scrollX, scrollY]")
        place = box._replace(x=box.x + x, y=box.y + y)._asdict()
        data = self.call("Page.captureScreenshot", format="png", clip={**place, "scale": 1})["data"]
        shown: NDArray[np.float64] = imread(io.BytesIO(base64.b64decode(data)), format="png")
        return (shown[:, :, :3] * 255).astype(np.uint8)

    def close(self) -> None:
        """End the browser."""
        self._session = None
        self.call("Browser.close")
        self._process.wait(PATIENCE_S)
        os.close(self._in)
        os.close(self._out)


class Typed(NamedTuple):
    """Exit status and output of a command line."""

    status: int
    stdout: str
    stderr: str


@pytest.fixture
def bowden(capsys: pytest.CaptureFixture[str]) -> Callable[..., Typed]:
    """Run one command line in this process."""
    from bowden.cli.app import run

    def command(*arguments: object) -> Typed:
        status = run([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return Typed(status, out, err)

    return command


@pytest.fixture
def plain_catalogue() -> Iterator[None]:
    """After the test the catalogue has the packaged effects alone: those of files are of the whole process."""
    from physics.effects import catalogue, own_effects

    yield
    for name in own_effects.OWN:
        del catalogue._effects[name]
    own_effects.OWN.clear()


@pytest.fixture
def browser(opened_browser: Browser) -> Iterator[Browser]:
    """The session's browser at an empty page, and left so: no page of one test is alive in the next."""
    opened_browser.leave()
    yield opened_browser
    opened_browser.leave()


@pytest.fixture(scope="session")
def opened_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for the whole session, with a profile of its own."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    opened = Browser(tmp_path_factory.mktemp("chromium"))
    yield opened
    opened.close()
