"""A device type outside the repository: a CiA 406 encoder from a wheel, on the wire, in `/cycle`, report, doctor."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import bowden as api
from bowden.bench import configuration
from eds.declaration import text_of
from trial.read import open as opened

Command = Callable[..., tuple[int, str, str]]
PLUGIN = Path(__file__).parent / "encoder_plugin"
BUILD = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"
DEVICE = '\n[[device]]\nname = "joint"\nnode_id = 5\ntype = "encoder_cia406"\n'


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of the plug-in, built and unpacked."""
    folder = tmp_path_factory.mktemp("plug_in")
    source = folder / "source"
    for file in (path for path in PLUGIN.rglob("*") if path.suffix in (".py", ".toml", ".eds")):
        (source / file.relative_to(PLUGIN)).parent.mkdir(parents=True, exist_ok=True)
        (source / file.relative_to(PLUGIN)).write_bytes(file.read_bytes())
    subprocess.run([sys.executable, "-c", BUILD, folder], cwd=source, check=True, capture_output=True)
    (wheel,) = folder.glob("encoder406-*.whl")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder / "site")
    return folder / "site"


@pytest.fixture
def installed(site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a bench that declares the encoder, whose package Python finds."""
    monkeypatch.syspath_prepend(site)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bench.toml").write_text("[network]\nrate_hz = 500\n" + text_of("bench") + DEVICE)
    return tmp_path


@pytest.mark.slow
def test_an_encoder_from_a_wheel_is_measured_with(installed: Path, bowden: Command) -> None:
    status, out, err = bowden("check", "config", "bench.toml", "--json")
    assert not err
    told = json.loads(out)
    assert "TPDO1 joint" in {stream["name"] for stream in told["streams"]}
    assert (status, told["rate_that_fits_hz"]) == (0, 500)

    trial = installed / "trial.mcap"
    made = api.run(api.Experiment(peak_n=20, period_s=1, cycles=3, configuration=installed / "bench.toml"),
                   output=trial)
    assert (made.outcome, made.figures["missed_cycles"]) == ("completed", 0)
    recorded = opened(trial)
    assert recorded.units["joint_flexion_rad"] == "rad"
    assert 0x185 in recorded.frames["can_id"]
    flexion, angle = recorded.columns["joint_flexion_rad"], recorded.columns["knee_angle_rad"]
    assert np.isfinite(flexion).all()
    assert flexion.max() > 1.0
    assert np.abs(flexion + angle)[angle < 0.0].max() < 0.02
    assert {"encoder.eds", "bench.toml"} <= set(recorded.attachments)

    assert bowden("report", trial, "-o", "report.html")[0] == 0
    assert "joint_flexion_rad" in Path("report.html").read_text()
    assert bowden("replay", trial, "--onto", "controller", "--json")[0] == 0
    _, out, _ = bowden("doctor", "--for", 0.1, "--interface", "bowden", "--channel", "observed", "--config",
                       "bench.toml", "--json")  # its exit status depends on the computer's timer
    (found,) = [finding for finding in json.loads(out)["findings"] if finding["what"] == "joint (node 5)"]
    assert found["good"]


def test_a_bench_whose_encoder_is_lost_stops(installed: Path) -> None:
    bus = api.simulated(faults=[{"kind": "cut", "node": 5, "start_s": 3.0}])
    made = api.run(api.Experiment(peak_n=20, period_s=1, cycles=2, configuration=installed / "bench.toml"), bus=bus)
    assert (made.outcome, made.figures["stop_reason"]) == ("stopped", "heartbeat lost: joint, for 250 ms")


def test_a_type_that_nobody_offers_is_refused(here: Path, bowden: Command) -> None:
    (here / "bench.toml").write_text(text_of("bench") + DEVICE.replace("encoder_cia406", "camera"))
    status, out, err = bowden("check", "config", "bench.toml")
    assert (status, out) == (2, "")
    assert "entry point of bowden.devices" in err


def test_the_plug_in_is_short() -> None:
    lines = (PLUGIN / "encoder406" / "__init__.py").read_text().splitlines()
    assert len([line for line in lines if line.strip()]) <= 60


def test_the_packaged_bench_has_no_observer() -> None:
    assert configuration.read(None)["network"].bench.observers == ()


def test_the_page_shows_the_plug_in_as_it_is() -> None:
    page = (Path(__file__).parents[2] / "docs" / "devices.md").read_text()
    assert (PLUGIN / "encoder406" / "__init__.py").read_text() in page
