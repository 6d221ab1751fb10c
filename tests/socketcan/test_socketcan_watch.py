"""A trial over the kernel's CAN is diagnosed while it runs, and does not wait for its watch."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.socketcan import rig
from tests.socketcan.conftest import NATIVE, lacks

pytestmark = pytest.mark.guest(NATIVE)  # a guest of one core has none left for the watch beside a trial

GAIT = ("--rate", 100, "--peak", 40, "--cycles", 3, "--period", 4)
GAIN = 1.06
"""START's gain on the changed bench, 20 times the deviation between sessions."""


def test_a_changed_bench_is_named_while_its_trial_runs(tmp_path: Path) -> None:
    if (reason := lacks()) is not None:
        pytest.skip(f"not run: {reason}")
    good, changed = tmp_path / "good.mcap", tmp_path / "changed.toml"
    changed.write_text(f"[effects.start_gain]\nstart_gain = {GAIN}\n", encoding="utf-8")
    assert rig.bowden(tmp_path, "trial", "-o", good, *GAIT).wait().status == 0
    with rig.bench(tmp_path, "vcan0", "--rate", 100, "--plant-model", changed):
        told = rig.trial(tmp_path, "vcan0", *GAIT, "--watch", "--healthy", good).wait()
    assert told.status == 0, (told.result["stop_reason"], told.result["watch"]["cycles"])
    watch = told.result["watch"]
    assert watch["remark"] is None
    assert [one["cycle"] for one in watch["cycles"]] == [0, 1, 2]
    assert "start_gain" in watch["cycles"][-1]["suspected"]
    offline = rig.bowden(tmp_path, "diagnose", tmp_path / "trial.mcap", "--healthy", good).wait().result
    # it may be a fault of the wire: a guest on a loaded machine delays PDOs
    assert [watch["diagnosis"][key] for key in ("verdict", "class", "causes")] == [
        offline[key] for key in ("verdict", "class", "causes")]
