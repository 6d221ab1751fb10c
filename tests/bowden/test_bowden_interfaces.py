"""Other interfaces of python-can, their options passed through: `udp_multicast` and `virtual`, and can.conf.

The bench and the command talk in wall time; the configuration is patient, so that a busy machine changes nothing.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import pytest

from virtual_bus.build import build
from virtual_bus.bus_options import Options
from virtual_bus.serve import serve

pytestmark = pytest.mark.walltime
PATIENCE_S = 60.0
PORT = 22_000 + os.getpid() % 20_000
GROUP = "239.74.163.2"
RATE_HZ = 50
PATIENT = f"""[network]
rate_hz = {RATE_HZ}
heartbeat_timeout_ms = 30000
targets_deadline_ms = 10000
start_deadline_cycles = 100
[limits]
stale_cycles = 100
"""
DRY = ("trial", "--dry-run", "--peak", 20, "--period", 1, "--cycles", 1, "--settle", 0, "--json", "-o", "trial.mcap",
       "--config", "bench.toml")
Bowden = Callable[..., tuple[int, str, str]]


@pytest.fixture
def patient(here: Path) -> Path:
    """A working directory with a configuration that waits."""
    (here / "bench.toml").write_text(PATIENT)
    return here


@contextmanager
def in_a_process(channel: str, *options: str) -> Iterator[None]:
    """`bowden bench` on udp_multicast, which has heard itself called."""
    multicast: dict[str, Any] = {"interface": "udp_multicast", "channel": GROUP, "port": PORT, "hop_limit": 0}
    try:
        listening = can.Bus(**multicast)
    except (can.CanError, OSError) as error:
        pytest.skip(f"no multicast on this computer: {error}")
    command = [sys.executable, "-c", "from bowden.cli import main; main()", "bench", "--json", "--interface",
               "udp_multicast", "--channel", channel, *options, "--rate", str(RATE_HZ)]
    root = Path(__file__).resolve().parents[2]
    with listening, subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                     env={**os.environ, "PYTHONPATH": str(root)}) as process:
        heard = listening.recv(PATIENCE_S)
        assert heard is not None, "the bench did not boot"
        yield
        process.terminate()
        process.communicate(timeout=PATIENCE_S)


@contextmanager
def in_a_thread(channel: str) -> Iterator[None]:
    """The same bench on python-can's `virtual`, which does not leave this process."""
    ended, booted = threading.Event(), threading.Event()
    hidden = build(Options(rate_hz=RATE_HZ), channel)
    with can.Bus(channel, interface="virtual") as bus, can.Bus(channel, interface="virtual") as listening:
        thread = threading.Thread(target=serve, args=(bus, hidden, time.monotonic_ns, ended.is_set))
        thread.start()
        booted.set() if listening.recv(PATIENCE_S) else None
        try:
            assert booted.is_set()
            yield
        finally:
            ended.set()
            thread.join(PATIENCE_S)
    hidden.close()


@pytest.mark.slow
def test_a_trial_runs_over_udp_multicast_with_its_options(patient: Path, bowden: Bowden) -> None:
    options = ("--option", f"port={PORT}", "--option", "hop_limit=0")
    with in_a_process(GROUP, *options):
        status, out, err = bowden(*DRY, "--interface", "udp_multicast", "--channel", GROUP, *options)
    assert (status, json.loads(out)["outcome"]) == (0, "completed"), (out, err)


def test_what_the_command_line_leaves_out_is_read_from_can_conf(
    patient: Path, bowden: Bowden, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(patient))
    (patient / "can.conf").write_text(f"[default]\nchannel = {GROUP}\nport = {PORT}\nhop_limit = 0\n")
    with in_a_process(GROUP, "--option", f"port={PORT}", "--option", "hop_limit=0"):
        status, out, err = bowden("node", "backup", "servo", "-o", "servo.dcf", "--json", "--interface",
                                  "udp_multicast")
    assert status == 0, (out, err)
    assert json.loads(out)["parameters"] > 20


def test_a_trial_runs_over_an_interface_that_hides_sync_from_its_sender(patient: Path, bowden: Bowden) -> None:
    with in_a_thread("interfaces"):
        status, out, err = bowden(*DRY, "--interface", "virtual", "--channel", "interfaces")
    assert (status, json.loads(out)["outcome"]) == (0, "completed"), (out, err)


def test_an_option_that_the_interface_does_not_know_is_told(patient: Path, bowden: Bowden) -> None:
    status, out, err = bowden(*DRY, "--interface", "udp_multicast", "--channel", GROUP, "--option", "port=far")
    assert (status, out) == (2, "")
    assert "interface udp_multicast, channel 239.74.163.2: cannot be opened" in err
