"""Hidden effects through the whole stack: a plant written apart behind nodes, wire and master, then the file alone.

The rule of this file: what is compared with the truth is what the recorded trial gives; nothing else is handed on.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bowden.app import run
from diagnosis.finder import diagnose
from trial import read

SEED = 4


def recorded(folder: Path, capsys: pytest.CaptureFixture[str], name: str, *options: object) -> Path:
    """Record ten gait cycles by the command line; the plant's name is not written into the trial."""
    path = folder / f"{name}.mcap"
    arguments = ("trial", "--period", 1.3, "--serial", 0, "--seed", SEED, "--json", "-o", path, *options)
    assert run([str(argument) for argument in arguments]) == 0, capsys.readouterr().err
    assert json.loads(capsys.readouterr().out)["outcome"] == "completed"
    return path


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["cable_friction", "end_offset"])
def test_an_effect_hidden_behind_the_nodes_is_named_from_the_trial(
    effect: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trial = recorded(tmp_path, capsys, "measured", "--plant", f"tests.hidden.plugin:{effect}")
    healthy = recorded(tmp_path, capsys, "healthy", "--plant", "tests.hidden.plugin:healthy")
    assert effect.encode() not in trial.read_bytes()
    found = diagnose([trial], healthy=[healthy])
    assert found.verdict in ("found", "ambiguous")
    assert effect in found.rivals


@pytest.mark.parametrize(("wire", "share", "aged"), [
    ("lost_share = 0.03", 0.03, True),
    # 0.7 ms after its place is past the deadline and not past the next SYNC: missed by the step, not by the record
    ("late_s = 0.0007\nlate_share = 0.03", 0.03, False),
])
def test_a_fault_of_the_wire_shows_in_the_trial(
    wire: str, share: float, aged: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "wire.toml"
    model.write_text(f"[bus]\n{wire}\n", encoding="utf-8")
    path = recorded(tmp_path, capsys, "faulty", "--plant-model", model, "--cycles", 3)
    columns = read.open(path).columns
    # some 7000 control cycles of four PDOs and a chance of 0.03: three standard deviations of a share are 0.006
    assert np.mean(columns["missed_inputs"]) == pytest.approx(4 * share, abs=0.015)
    for name in ("servo", "knee", "start"):
        late = columns[f"{name}_pdo_age_ns"] > 0 if aged else columns[f"{name}_pdo_arrival_ns"] > 650_000
        assert np.mean(late) == pytest.approx(share, abs=0.01)
    assert b"lost_share" not in path.read_bytes()
