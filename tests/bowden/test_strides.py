"""A trial of strides that differ, through the wire: the force follows the felt phase, and a replay has the same steps.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bowden.cli.app import run
from tests.stride_files import written

STRIDES = 4


def trial(folder: Path, capsys: pytest.CaptureFixture[str], name: str, *options: str, status: int = 0
          ) -> dict[str, Any]:
    knee = written(folder / "strides.csv")
    ended = run(["trial", "--knee", str(knee), "--period", "1.2", "--strides", str(STRIDES), "--controller",
                 "extended", "--seed", "2", "-o", str(folder / name), "--json", *options])
    told = capsys.readouterr().out
    assert ended == status, told
    return json.loads(told)


def test_the_force_follows_a_phase_that_is_felt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = trial(tmp_path, capsys, "walk.mcap")
    walk = found["walk"]
    assert found["outcome"] == "completed"
    assert found["cycles"] == STRIDES
    assert walk["strides"] == walk["assisted"] == STRIDES - 1
    assert walk["interrupted"] == 0
    assert walk["phase_error_rms_percent"] < 1.5
    assert walk["rmse_percent"]["worst"] < 1.2
    assert walk["judged_by"] == "true END"
    assert walk["idle_n"] < 1.0
    assert walk["off_phase_ms"] == 0.0
    assert len({round(one["period_s"], 3) for one in walk["by_stride"]}) == STRIDES
    assert run(["replay", str(tmp_path / "walk.mcap"), "--onto", "controller"]) == 0


def test_a_soft_start_raises_the_force_before_the_first_stride(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from trial import read

    found = trial(tmp_path, capsys, "soft.mcap", "--soft-start", "2")
    assert found["outcome"] == "completed"
    columns = read.open(tmp_path / "soft.mcap").columns
    before = columns["desired_force_n"][:int(np.flatnonzero(columns["cycle"] == 0)[0])]
    thirds = [before[-1200 * (k + 1):len(before) - 1200 * k].max() for k in (1, 0)]
    assert thirds == pytest.approx([40.0 / 3.0, 80.0 / 3.0], rel=1e-3)
    page = tmp_path / "soft.html"
    assert run(["report", str(tmp_path / "soft.mcap"), "-o", str(page)]) == 0
    assert "more than 3 N off phase (ms)" in page.read_text(encoding="utf-8")


def test_a_wearer_who_stops_is_asked_for_no_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from trial import read

    found = trial(tmp_path, capsys, "stop.mcap", "--stops", "1")
    assert [one["kind"] for one in found["walk"]["by_stride"]] == ["walk"] * STRIDES + ["rest"]
    assert found["walk"]["off_phase_ms"] < 100.0
    columns = read.open(tmp_path / "stop.mcap").columns
    standing = np.flatnonzero(columns["cycle"] == STRIDES)[500:-500]
    assert (columns["desired_force_n"][standing] == 0.0).all()
    assert (columns["phase_share"][standing] == -1.0).all()


@pytest.mark.parametrize(("options", "sentence"), [
    (["--strides", "4"], "--strides: the knee's motion has no recorded strides; give them with --knee FILE."),
    (["--stops", "1"], "stumbles, stops and sits are drawn among recorded strides; say how many with --strides."),
    (["--phase", "heard"], "walk.phase = 'heard', expected clock or felt; choose one."),
])
def test_what_cannot_be_walked_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], sentence: str
) -> None:
    assert run(["trial", "-o", str(tmp_path / "none.mcap"), *options]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "none.mcap").exists()


@pytest.mark.exhaustive
@pytest.mark.parametrize("migration_m", [6e-3, -6e-3, 30e-3, -30e-3])
def test_a_garment_that_migrates_stops_no_trial_but_beyond_the_stated_range(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], migration_m: float
) -> None:
    """The zero moves by 0.1 mm a stride, which is followed, or by 0.6 mm, which is more than is followed."""
    from trial import read

    model = tmp_path / "migrating.toml"
    model.write_text(f"""[[terms]]
carrier = "zero"
modulation = "time_sine"
parameters = {{ hz = 0.0025 }}
coefficients = [{migration_m}, 0.0]
intervals = [[{migration_m}, {migration_m}], [0.0, 0.0]]
unit = "m"
part = "rope"
words = "zero of the rope"
""", encoding="utf-8")
    stops = abs(migration_m) > 6e-3
    found = trial(tmp_path, capsys, "walk.mcap", "--strides", "16", "--plant-model", str(model), status=int(stops))
    followed = read.open(tmp_path / "walk.mcap").columns["followed_zero_m"]
    assert np.nanmax(np.abs(followed)) > 0.8e-3
    if stops:
        assert "that slipped" in found["stop_reason"]
        return
    assert found["outcome"] == "completed"
    assert found["walk"]["rmse_percent"]["worst"] < 2.0
    assert found["walk"]["idle_n"] < 2.0
