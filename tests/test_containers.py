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
import typer.main

from bowden.cli.app import app, load
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
    load()
    command = typer.main.get_command(app).commands["doctor"]  # type: ignore[attr-defined]
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
