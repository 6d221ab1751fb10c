"""Every command of docs/bench.md runs as it is written there, on `udp_multicast` in place of the page's interface.

The machine may be busy and the page's rates are for an idle one: a configuration that waits is added, and the trials
are dry and short.  What only an administrator may type is listed, not run.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from benchmarks.socketcan import adapters

pytestmark = pytest.mark.walltime
ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "bench.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
LINES = [line.partition("  #")[0].strip() for language, block in BLOCKS if not language
         for line in block.splitlines()]
COMMANDS = [line for line in LINES if re.match(r"(\.venv/bin/)?bowden ", line)]
BY_HAND = r"(git clone .*|sudo (modprobe|ip|setcap|sysctl) .*|candump .*)"
PORT = 52_000 + os.getpid() % 10_000
GROUP = "239.74.163.3"
HERE = ["--interface", "udp_multicast", "--channel", GROUP, "--option", f"port={PORT}", "--option", "hop_limit=0"]
SHORT = ["--dry-run", "--cycles", "1", "--settle", "0", "--period", "1"]
PATIENT = """[network]
rate_hz = 100
heartbeat_timeout_ms = 30000
targets_deadline_ms = 10000
start_deadline_cycles = 100
[limits]
stale_cycles = 100
[homing]
rope_m_s = 0.01
"""
PATIENCE_S = 60.0
LOOKS = {"doctor": (0, 1), "live": (0,)}
"""Exit statuses of commands whose answer depends on this computer; 0 of all others."""


def typed(command: str) -> list[str]:
    """The arguments of a command of the page, on this computer's multicast."""
    words = shlex.split(command.removeprefix(".venv/bin/"))[1:]
    onto = [at for at, word in enumerate(words) if word in ("--interface", "--channel", "--option")]
    kept = [word for at, word in enumerate(words) if not {at, at - 1} & set(onto)]
    if onto:
        kept += [*HERE, *(["--config", "patient.toml"] if kept[0] != "bench" else ["--rate", "100"])]
    if kept[0] == "trial":
        kept += [*SHORT, "--overwrite"]
    return kept + ["--for", "0.2"] * (kept[0] in ("doctor", "live"))


def test_the_rates_of_adapters_are_what_the_benchmark_prints() -> None:
    assert adapters() in PAGE


@pytest.fixture(scope="module")
def nodes() -> Iterator[None]:
    """The page's first `bowden bench`, in a process of its own."""
    served = next(command for command in COMMANDS if " bench " in command)
    multicast: dict[str, Any] = {"interface": "udp_multicast", "channel": GROUP, "port": PORT, "hop_limit": 0}
    try:
        listening = can.Bus(**multicast)
    except (can.CanError, OSError) as error:
        pytest.skip(f"no multicast on this computer: {error}")
    command = [sys.executable, "-c", "from bowden.cli import main; main()", *typed(served)]
    quiet = subprocess.DEVNULL
    with listening, subprocess.Popen(command, cwd=ROOT, stdout=quiet, stderr=quiet) as process:
        assert listening.recv(PATIENCE_S) is not None, "the bench did not boot"
        yield
        process.terminate()
        process.wait(PATIENCE_S)


def test_nothing_on_the_page_is_left_out() -> None:
    others = [line for line in LINES if line and line not in COMMANDS]
    assert [line for line in others if not re.fullmatch(BY_HAND, line)] == []
    assert len(COMMANDS) > 15


@pytest.mark.exhaustive
@pytest.mark.usefixtures("nodes")
def test_the_commands_run_in_their_order(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    (here / "patient.toml").write_text(PATIENT)
    (here / "faults.toml").write_text('[[fault]]\nkind = "power_off"\nnode = 4\n')
    for command in COMMANDS:
        arguments = typed(command)
        if arguments[0] != "bench":
            status, out, err = bowden(*arguments)
            assert status in LOOKS.get(arguments[0], (0,)), (command, out, err)


def test_every_test_that_the_page_names_exists() -> None:
    named = set(re.findall(r"`(test_\w+)`", PAGE))
    written = {name for path in (ROOT / "tests").glob("*/test_*.py")
               for name in re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)}
    assert named - written == set()
