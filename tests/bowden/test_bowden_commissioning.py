"""docs/commissioning.md, typed in its order on one virtual drive that has no node id."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bowden.testing import CanBus
from eds import packaged
from physics.calibration import nominal, write

PAGE = (Path(__file__).parents[2] / "docs" / "commissioning.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_page_shows_what_its_commands_print(bowden: Callable[..., Any], can_bus: CanBus, here: Path) -> None:
    (here / "eds").mkdir()
    shutil.copy(packaged("knee_drive"), here / "eds" / "drive.eds")
    (here / "calibration.toml").write_text(write(nominal()))
    can_bus.add_node("knee_drive", 255, serial=42)
    can_bus.open()
    for block in re.findall(r"```console\n(.*?)```", PAGE, re.DOTALL):
        for command in re.split(r"(?m)^\$ ", block)[1:]:
            line, _, shown = command.partition("\n")
            own_bench = "emcy" in line or "check bench" in line  # without a bus, or on the simulated bench
            bus = () if own_bench else ("--interface", "bowden", "--channel", can_bus.channel)
            told = bowden(*shlex.split(line)[1:], *bus)
            assert told.stdout + told.stderr == shown.rstrip() + "\n", line


def test_the_python_of_the_page_runs(capsys: Any) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(compile(program, "commissioning.md", "exec"), {})
    assert capsys.readouterr().out.startswith("CiA 402 drive\n")
