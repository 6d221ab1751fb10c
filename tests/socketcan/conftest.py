"""Where these tests run: on this kernel if it has CAN, else in a guest kernel, else not at all, with the reason.

The rule of this file: a test is an ordinary test either way.  A file's marker `guest(place, …)` names where its tests
may run, best first; all tests share one guest, and the guest's own reports are handed on as they are.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.warm import FOR_GUESTS, warm_guests

ROOT = Path(__file__).resolve().parents[2]
GUEST = ROOT.parent / "shared" / "run_in_vm.sh"
INSIDE = "CANVM" in os.environ
REPORTS = "BOWDEN_GUEST_REPORTS"
NO_GUEST = 125
NATIVE, UML = "native", "uml"
LIMIT_S = 1800
"""Wall time that one guest may take: several times what it needs on idle cores."""
MEMORY_MIB = 2048
_CHANNELS = ("vcan0", "vcan1")

_OWN = "vcan7"

Reports = dict[str, list[dict[str, Any]]]


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", f"guest(place, …): where a file's tests may run: {NATIVE}, {UML}")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents and item.get_closest_marker("guest"):
            item.add_marker(pytest.mark.socketcan)


@cache
def lacks() -> str | None:
    """Why this kernel cannot run the tests; None where it can."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return f"this kernel has no CAN ({errno.errorcode[error.errno or 0]})"
    absent = [name for name in _CHANNELS if not Path("/sys/class/net", name).exists()]
    if absent:
        return f"no interface {' and '.join(absent)} (sudo ip link add {absent[0]} type vcan)"
    return "only root may take interfaces down" if os.geteuid() else None


def in_guest(item: pytest.Item) -> bool:
    """Return whether a test goes to the guest: it may run there, and this kernel cannot run it."""
    marker = item.get_closest_marker("guest")
    return not INSIDE and marker is not None and UML in marker.args and lacks() is not None


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> bool | None:
    """Take the reports of a test from its guest; None lets it run here."""
    if not in_guest(item):
        return None
    if _STASH not in item.session.stash:
        item.session.stash[_STASH] = _in_guest([other.nodeid for other in item.session.items if in_guest(other)])
    said, why = item.session.stash[_STASH]
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports_of = said.get(item.nodeid, [])
    ended = any(report["when"] == "teardown" for report in reports_of)
    for report in reports_of if ended else [_absent(item, why)]:
        read = item.config.hook.pytest_report_from_serializable(config=item.config, data=report)
        if isinstance(read.longrepr, list):  # a skip's place and reason, a tuple before it was written as JSON
            read.longrepr = tuple(read.longrepr)
        item.ihook.pytest_runtest_logreport(report=read)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


_STASH = pytest.StashKey[tuple[Reports, str]]()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests ran in a guest, and why."""
    if (session := terminalreporter._session) is not None and _STASH in session.stash:
        said = session.stash[_STASH][0]
        terminalreporter.write_line(f"kernel's CAN: {len(said)} tests ran in a guest, {UML}: {lacks()}")


def _in_guest(chosen: list[str]) -> tuple[Reports, str]:
    """Run tests in a guest; their reports by node id, and what became of the rest ("skip: …" or "fail: …")."""
    if not GUEST.exists():
        return {}, f"skip: not run: {lacks()}, and {GUEST.name} is absent"
    warm_guests()
    lean = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    with tempfile.TemporaryDirectory() as folder, open(Path(tempfile.gettempdir(), "canvm.lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        reports = Path(folder, "reports.jsonl")
        ended = subprocess.run(
            [GUEST, "-b", UML, "-t", str(LIMIT_S), "-m", str(MEMORY_MIB), "-w", folder, "--",
             sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "socketcan", *chosen],
            cwd=ROOT, text=True, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env={**os.environ, **FOR_GUESTS, **lean, REPORTS: str(reports)})
        lines = reports.read_text().splitlines() if reports.exists() else []
    said: Reports = {}
    for line in map(json.loads, lines):
        said.setdefault(line["nodeid"], []).append(line)
    outcome = "skip: not run: no guest could be had" if ended.returncode == NO_GUEST else "fail: the guest ended"
    return said, f"{outcome} ({ended.returncode}):\n{ended.stdout[-4000:]}"


def _absent(item: pytest.Item, why: str) -> dict[str, Any]:
    """The report of a test that the guest did not tell of."""
    verdict, _, text = why.partition(": ")
    failed = verdict == "fail"
    report = pytest.TestReport(
        item.nodeid, item.location, dict.fromkeys(item.keywords, 1), "failed" if failed else "skipped",
        text if failed else (str(item.path), item.location[1] or 0, text), "call" if failed else "setup")
    data: dict[str, Any] = item.config.hook.pytest_report_to_serializable(config=item.config, report=report)
    return data


@pytest.fixture
def own() -> Iterator[str]:
    """An interface on which nobody else speaks; the test may remove it."""
    subprocess.run(f"ip link add {_OWN} type vcan && ip link set {_OWN} up", shell=True, check=True)
    yield _OWN
    subprocess.run(["ip", "link", "del", _OWN], check=False, stderr=subprocess.DEVNULL)


@pytest.hookimpl(trylast=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """In the guest: write every report down for the kernel outside."""
    if INSIDE and REPORTS in os.environ:
        with open(os.environ[REPORTS], "a", encoding="utf-8") as file:
            file.write(json.dumps(report._to_json() | {"$report_type": "TestReport"}) + "\n")
