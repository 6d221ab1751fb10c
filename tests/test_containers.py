"""Containers: the Dockerfile's steps as far as they need no Docker, and packages that cannot be written."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from bowden.cli.app import whole
from parameters import compile_cache

ROOT = Path(__file__).parents[1]


def test_the_dockerfile_installs_extras_that_exist_and_types_a_command_that_exists() -> None:
    steps = [line.split(maxsplit=1) for line in (ROOT / "Dockerfile").read_text().splitlines() if line]
    installed = next(text for word, text in steps if word == "RUN" and text.startswith("pip"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = re.search(r"\[(.*)\]", installed)
    assert extras is not None
    assert set(extras[1].split(",")) <= set(project["optional-dependencies"])
    constraints = shlex.split(installed)[shlex.split(installed).index("-c") + 1]
    assert (ROOT / Path(constraints).relative_to("source")).is_file()
    command = whole().commands["doctor"]
    assert "--compile" in {name for option in command.params for name in option.opts}
    python = next(text for word, text in steps if word == "FROM").partition(":")[2].partition("-")[0]
    assert project["requires-python"] == f">={python}"


def test_a_temporary_cache_is_used_only_where_nothing_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(compile_cache.VARIABLE, "")
    monkeypatch.setenv(compile_cache.FONTS, "")
    none = Path("/proc/none")
    assert compile_cache.prepare(none, {"HOME": str(tmp_path)}) is None
    assert not os.environ[compile_cache.FONTS]
    for packages, environment in ((tmp_path, {}), (none, {"NUMBA_CACHE_DIR": "x"})):
        assert compile_cache.prepare(packages, environment) is None
        assert os.environ[compile_cache.FONTS], "matplotlib would complain twice"
    made = compile_cache.prepare(none, {"HOME": "/proc/none", "NUMBA_CACHE_DIR": ""})
    assert made is not None
    assert os.environ[compile_cache.VARIABLE] == str(made)
    assert capsys.readouterr().err.count("\n") == 1


ELSEWHERE = """
import numba, numpy, scipy.optimize, scipy.signal  # their own builds for other systems need none of these names
import can, canopen, mcap.reader, mcap.writer, rich.progress, typer
import concurrent.futures.process, ctypes, multiprocessing.popen_spawn_posix, os, select, signal, socket, sys, time

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name in {"fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
for module, starts in (
    (os, ("O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "chown", "fchmod", "fork", "getegid", "geteuid",
          "getgid", "getgroups", "getpriority", "getuid", "killpg", "mkfifo", "nice", "posix_", "pread", "pwrite",
          "sched_", "setsid", "statvfs", "sync", "uname")),
    (socket, ("AF_CAN", "AF_NETLINK", "AF_PACKET", "CAN_", "CMSG", "MSG_DONTWAIT", "PF_CAN", "SCM_", "SOL_CAN")),
    (signal, ("SIGALRM", "SIGCHLD", "SIGHUP", "SIGPIPE", "SIGQUIT", "SIGUSR", "alarm", "pthread_", "setitimer")),
    (time, ("CLOCK_", "clock_get", "pthread_")), (select, ("EPOLL", "epoll", "poll")),
):
    for name in [name for name in vars(module) if name.startswith(starts)]:
        delattr(module, name)

from bowden.cli.app import run

if __name__ == "__main__":  # a watch's process imports this file, too
    for line in sys.stdin.read().splitlines():
        status, *words = line.split()
        assert run(words) == int(status), line
"""
"""Program that runs command lines without the modules and names that Python has on Linux alone."""


def test_commands_on_the_virtual_bus_need_nothing_of_linux(tmp_path: Path) -> None:
    (tmp_path / "elsewhere.py").write_text(ELSEWHERE, encoding="utf-8")
    short = "trial --cycles 1 --settle 0 --period 1.0"
    lines = (f"0 {short} -o a.mcap", "0 export a.mcap -o a.csv", "0 import a.csv -o b.mcap", "0 info b.mcap",
             "0 report a.mcap -o a.html", "0 node scan", "1 doctor --interface socketcan --channel can0 --for 0.1",
             f"2 {short} --interface socketcan --channel can0 -o c.mcap")
    told = subprocess.run([sys.executable, "elsewhere.py"], input="\n".join(lines), capture_output=True, text=True,
                          cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False)
    assert told.returncode == 0, told.stderr
    assert told.stdout.count("SocketCAN is a part of Linux alone") == 1
    assert told.stderr.splitlines()[-1] == (
        "bowden: interface socketcan: is a part of Linux alone; name the adapter's own interface of python-can: "
        "--interface pcan, kvaser, slcan, ….")


@pytest.mark.exhaustive
def test_a_trial_is_watched_without_anything_of_linux(tmp_path: Path) -> None:
    (tmp_path / "elsewhere.py").write_text(ELSEWHERE, encoding="utf-8")
    lines = ("0 trial --cycles 4 -o good.mcap", "0 trial --cycles 4 --seed 1 --watch --healthy good.mcap -o a.mcap",
             "0 sweep --grid cycles=1 --grid settle=0 --workers 2 -o s.csv")
    told = subprocess.run([sys.executable, "elsewhere.py"], input="\n".join(lines), capture_output=True, text=True,
                          cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False)
    assert told.returncode == 0, told.stderr
    assert "the watch has ended" not in told.stderr


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_a_console_without_greek_letters_shows_a_help(encoding: str) -> None:
    told = subprocess.run([sys.executable, "-c", "from bowden.cli import main; main()", "diagnose", "--help"],
                          capture_output=True, cwd=ROOT, env={**os.environ, "PYTHONIOENCODING": encoding}, check=False)
    assert (told.returncode, told.stderr) == (0, b"")


@pytest.mark.exhaustive
def test_read_only_packages_without_a_home_run_with_one_sentence(tmp_path: Path) -> None:
    inside = (f"mount --bind {ROOT} {ROOT} && mount -o remount,ro,bind {ROOT} && cd {tmp_path} && "
              f"env -u NUMBA_CACHE_DIR -u XDG_CACHE_HOME HOME=/proc/none {sys.executable} -c "
              "'import physics.forward.force_path'")
    told = subprocess.run(["unshare", "-m", "sh", "-c", inside], capture_output=True, text=True, check=False)
    if "unshare" in told.stderr or "mount:" in told.stderr:
        pytest.skip("this user may not mount")
    assert told.returncode == 0, told.stderr
    assert told.stderr.count("\n") == 1
    assert "NUMBA_CACHE_DIR" in told.stderr
