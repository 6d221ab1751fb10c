"""CANopenNode on the kernel's CAN, as a device and as a master: what `bowden node` and `bowden lss` do with it.

BOWDEN_CANOPEN_LINUX is a checkout of CANopenNode/CANopenLinux with its submodule, built by make; without it these
tests skip. Nothing of it is part of this project.
"""

from __future__ import annotations

import io
import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from bowden.cli.app import run
from eds.cia402 import State, state_of
from master.network.socketcan import KernelBus

pytestmark = pytest.mark.guest("native", "uml")

CHECKOUT = Path(os.environ.get("BOWDEN_CANOPEN_LINUX", Path(__file__).resolve().parents[2] / "build" / "CANopenLinux"))
PROGRAM = CHECKOUT / "canopend"
EDS = CHECKOUT / "CANopenNode" / "example" / "DS301_profile.eds"
NODE, MASTER = 4, 100


@pytest.fixture(autouse=True)
def at_hand() -> None:
    if not PROGRAM.is_file() or not EDS.is_file():
        pytest.skip(f"{PROGRAM} is absent; build CANopenNode/CANopenLinux there, or name it in BOWDEN_CANOPEN_LINUX")


class Answer(NamedTuple):
    """Exit status and output of a command line."""

    status: int
    stdout: str
    stderr: str

    @property
    def json(self) -> Any:
        assert self.status == 0, self
        return json.loads(self.stdout)


def typed(channel: str, *words: object) -> Answer:
    """Run one command line of `bowden` on a channel of the kernel."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = run([*map(str, words), "--interface", "socketcan", "--channel", channel])
    return Answer(status, out.getvalue(), err.getvalue())


@contextmanager
def canopend(channel: str, folder: Path, node_id: int, *more: str) -> Iterator[subprocess.Popen[str]]:
    """CANopenNode's program on a channel: a device, or with `-c` a master with a gateway."""
    command = [str(PROGRAM), channel, "-i", str(node_id), "-s", f"{folder}/", *more]
    with KernelBus(channel) as bus, subprocess.Popen(
            command, cwd=folder, text=True, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL) as process:
        try:
            if node_id != 255:
                boot = bus.recv(20.0)
                assert boot is not None
                assert boot.arbitration_id == 0x700 + node_id
            yield process
        finally:
            process.kill()


@contextmanager
def master(channel: str, folder: Path) -> Iterator[Callable[[str], str]]:
    """CANopenNode as master: a function that passes a command to its gateway (CiA 309-3) and returns the answer."""
    path = folder / "gateway"
    with canopend(channel, folder, MASTER, "-c", f"local-{path}"), socket.socket(socket.AF_UNIX) as gateway:
        gateway.settimeout(20.0)
        gateway.connect(str(path))
        with gateway.makefile("rw") as stream:
            def asked(command: str) -> str:
                stream.write(f"[1] {command}\n")
                stream.flush()
                return stream.readline().removeprefix("[1] ").strip()

            yield asked


@contextmanager
def served(channel: str, *words: str) -> Iterator[None]:
    """`bowden node serve` in a process of its own, booted."""
    command = [sys.executable, "-c", "from bowden.cli import main; main()", "node", "serve", "knee_drive",
               "--node-id", "5", *words, "--interface", "socketcan", "--channel", channel]
    with KernelBus(channel) as bus, subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        try:
            boot = bus.recv(60.0)
            assert boot is not None
            assert boot.arbitration_id == 0x705
            yield
        finally:
            process.terminate()


def test_a_backup_holds_what_the_device_holds_and_restores_it(tmp_path: Path, own: str) -> None:
    file = tmp_path / "node.dcf"
    with canopend(own, tmp_path, NODE):
        typed(own, "node", "backup", NODE, "-o", file, "--eds", EDS)
        assert typed(own, "node", "compare", NODE, file).stdout == "0 parameters differ.\n"
        assert typed(own, "node", "write", NODE, "1017", "345", "--eds", EDS).status == 0
        assert typed(own, "node", "compare", NODE, file, "--json").status == 1
        restored = typed(own, "node", "restore", NODE, file, "--json").json["restored"]
        assert [one["index"] for one in restored] == ["1017:00"]
        assert typed(own, "node", "compare", NODE, file).stdout == "0 parameters differ.\n"


def test_the_settings_of_a_pdo_come_back(tmp_path: Path, own: str) -> None:
    file = tmp_path / "node.dcf"
    with canopend(own, tmp_path, NODE):
        mapped = typed(own, "node", "pdo", NODE, "--eds", EDS, "--map", "tpdo1=1001", "--set", "tpdo1.type=254",
                       "--json")
        assert mapped.status == 0, mapped
        typed(own, "node", "backup", NODE, "-o", file, "--eds", EDS)
        assert typed(own, "node", "pdo", NODE, "--eds", EDS, "--map", "tpdo1=1001,1001", "--set",
                     "tpdo1.type=1").status == 0
        changed = typed(own, "node", "compare", NODE, file, "--json")
        assert changed.status == 1
        assert typed(own, "node", "restore", NODE, file).status == 0
        assert typed(own, "node", "compare", NODE, file).stdout == "0 parameters differ.\n"
        (pdo,) = [one for one in typed(own, "node", "pdo", NODE, "--eds", EDS, "--json").json["pdos"]
                  if one["pdo"] == "tpdo1"]
        assert ([one["object"] for one in pdo["mapping"]], pdo["type"]) == (["1001:00"], 254)


def test_an_unconfigured_device_is_found_once_and_gets_its_node_id(tmp_path: Path, own: str) -> None:
    with canopend(own, tmp_path, 255):
        scanned = typed(own, "lss", "scan", "--json").json
        assert len(scanned["unconfigured"]) == 1
        assert typed(own, "lss", "assign", "9", "--json").json["booted"] is True
        assert typed(own, "node", "info", "9", "--json").json["node"] == 9
        assert typed(own, "lss", "scan").stdout == "0 unconfigured devices.\n"


def test_a_c_master_reads_and_drives_a_served_node(tmp_path: Path, own: str) -> None:
    with served(own, "--profile", "402"), master(own, tmp_path) as asked:
        assert asked("5 r 0x1018 1 u32") == str(0xB0DE00)
        assert asked("5 r 0x1008 0 vs").strip("\"") == "Bowden knee drive"
        for word in (6, 7, 15):
            assert asked(f"5 w 0x6040 0 u16 {word}") == "OK"
        assert state_of(int(asked("5 r 0x6041 0 u16"))) is State.OPERATION_ENABLED
        assert asked("5 start") == "OK"
        assert "ERROR" in asked("5 r 0x5fff 0 u8")
