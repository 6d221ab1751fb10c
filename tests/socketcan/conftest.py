"""Where these tests run: on this kernel if it has CAN, else in a guest kernel, else not at all, with the reason.

The rule of this file: a test is an ordinary test either way.  All tests of one file share one guest, chosen by the
file's marker `guest(back end, seconds)`; the guest's own reports are handed on as they are.
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
from pathlib import Path
from typing import Any

import pytest

from tests.socketcan.warm import ENVIRONMENT, warm

ROOT = Path(__file__).resolve().parents[2]
GUEST = ROOT.parent / "shared" / "run_in_vm.sh"
INSIDE = "CANVM" in os.environ
REPORTS = "BOWDEN_GUEST_REPORTS"
NO_GUEST = 125
_CHANNELS = ("vcan0", "vcan1")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "guest(backend, seconds): the guest kernel that a file's tests want")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents and item.get_closest_marker("guest"):
            item.add_marker(pytest.mark.socketcan)


def kernel_lacks() -> str | None:
    """Why this kernel cannot run the tests itself; None where it can."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return f"this kernel has no CAN ({errno.errorcode[error.errno or 0]})"
    absent = [name for name in _CHANNELS if not Path("/sys/class/net", name).exists()]
    return f"no interface {' and '.join(absent)} (sudo ip link add {absent[0]} type vcan)" if absent else None


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> bool | None:
    """Take the reports of a test from its file's guest; None lets it run here."""
    marker = item.get_closest_marker("guest")
    if INSIDE or marker is None or (kernel_lacks() is None and marker.args[0] == "uml"):
        return None
    reports = item.session.stash.setdefault(_STASH, {})
    if item.path not in reports:
        chosen = [other.nodeid for other in item.session.items if other.path == item.path]
        reports[item.path] = _in_guest(chosen, *marker.args)
    said, why = reports[item.path]
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports_of = said.get(item.nodeid, [])
    ended = any(report["when"] == "teardown" for report in reports_of)
    for report in reports_of if ended else [_absent(item, why)]:
        read = item.config.hook.pytest_report_from_serializable(config=item.config, data=report)
        item.ihook.pytest_runtest_logreport(report=read)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


_STASH = pytest.StashKey[dict[Path, tuple[dict[str, list[dict[str, Any]]], str]]]()


def _in_guest(chosen: list[str], backend: str, seconds: int) -> tuple[dict[str, list[dict[str, Any]]], str]:
    """Run tests in a guest; their reports by node id, and what became of the rest ("skip: …" or "fail: …")."""
    if not GUEST.exists():
        return {}, f"skip: not run: {kernel_lacks() or 'this needs emulated controllers'}, and {GUEST} is absent"
    warm()
    lean = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    with tempfile.TemporaryDirectory() as folder, open(Path(tempfile.gettempdir(), "canvm.lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        reports = Path(folder, "reports.jsonl")
        ended = subprocess.run(
            [GUEST, "-b", backend, "-t", str(seconds), "-w", folder, "--", sys.executable, "-m", "pytest", "-q",
             "-p", "no:cacheprovider", "-m", "socketcan", *chosen], cwd=ROOT, text=True, check=False,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env={**os.environ, **ENVIRONMENT, **lean, REPORTS: str(reports)})
        lines = reports.read_text().splitlines() if reports.exists() else []
    said: dict[str, list[dict[str, Any]]] = {}
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


@pytest.hookimpl(trylast=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """In the guest: write every report down for the kernel outside."""
    if INSIDE and REPORTS in os.environ:
        with open(os.environ[REPORTS], "a", encoding="utf-8") as file:
            file.write(json.dumps(report._to_json() | {"$report_type": "TestReport"}) + "\n")
