"""The library: docs/library.md and docs/controllers.md run against the installed wheel, and what a caller relies on."""

from __future__ import annotations

import gc
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bowden
from bowden.progress import Silent
from trial.mcap_file import cdr

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("bowden", "diagnosis", "eds", "estimation", "logbook", "master", "nodes", "parameters", "physics",
            "safety_monitor", "trial", "virtual_bus")
SHORT = bowden.Experiment(period_s=0.6, cycles=1, settle=0)
MORE = """
import numpy as np
assert trial.outcome == again.outcome == after.outcome == "completed", (trial, again, after)
assert np.array_equal(frame["tension_start_n"], start) and start.dtype == np.float64
assert frame.attrs["units"]["tension_start_n"] == "N"
assert trial.digest() == again.digest()
assert trial.metadata["controller"] == "extended" and "calibration.toml" in trial.attachments
assert "peak_n" in refused
assert model.bench == "virtual 3"
assert found.verdict == "found" and [cause["effect"] for cause in found.causes] == ["start_gain"], found
assert simulation.residuals["tension_start_n"].shape == simulation.time_ns.shape
assert after.metadata["controller_model"] == "start_gain"
assert len(digests) == 1
"""


def blocks(page: str, language: str) -> list[str]:
    """The code blocks of a page."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel of this source tree in it, made without a network."""
    place = tmp_path_factory.mktemp("wheel")
    source, installed = place / "source", place / "site"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-index", "--no-build-isolation", "--no-deps", "-w", str(place), str(source)],
                   check=True, capture_output=True)
    subprocess.run([*pip, "install", "--no-index", "--no-deps", "--target", str(installed),
                    *map(str, place.glob("*.whl"))], check=True, capture_output=True)
    return installed


def outside(site: Path, folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder outside the repository, with the installed wheel."""
    told = subprocess.run([sys.executable, "-W", "error", *command], cwd=folder, capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": str(site), "PYTHONSAFEPATH": "1"}, check=False)
    assert told.returncode == 0, told.stderr
    return told


@pytest.mark.exhaustive
def test_the_notebook_runs_outside_the_repository_against_the_installed_wheel(site: Path, tmp_path: Path) -> None:
    code = "\n".join(blocks("library.md", "python"))
    check = f"import bowden, pathlib\nassert pathlib.Path(bowden.__file__).is_relative_to({str(site)!r})\n"
    told = outside(site, tmp_path, "-c", check + code + MORE)
    assert told.stderr == ""
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == ["calibration.toml", "diagnosis.html", "trial.html", "trial.mcap"]


@pytest.mark.exhaustive
def test_the_controller_of_the_page_runs_and_replays_bit_for_bit(site: Path, tmp_path: Path) -> None:
    code, commands = blocks("controllers.md", "python")[0], blocks("controllers.md", "sh")[0]
    assert len(code[code.index("class "):].splitlines()) <= 20
    (tmp_path / "integral.py").write_text(code, encoding="utf-8")
    for line in commands.splitlines():
        said = outside(site, tmp_path, str(site / "bin" / "bowden"), *line.split()[1:], "--json")
    assert '"same": true' in said.stdout
    trial = bowden.Trial(tmp_path / "integral.mcap")
    assert trial.units["lacking_force_n"] == "N"
    assert np.nanmax(trial.columns["lacking_force_n"]) > 1.0
    assert np.isnan(trial.columns["lacking_force_n"][0])


def test_the_packages_are_typed_and_the_names_are_there() -> None:
    folders = {path.parent for package in PACKAGES for path in (ROOT / package).rglob("__init__.py")}
    assert [folder for folder in folders if not (folder / "py.typed").exists()] == []
    assert set(bowden._HOMES) == set(bowden.__all__) <= set(dir(bowden))
    assert all(getattr(bowden, name) is not None for name in bowden.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        bowden.nothing  # noqa: B018


def test_the_contract_against_the_command_line_names_every_part_of_the_library() -> None:
    linter = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    (named,) = (set(contract["source_modules"]) for contract in linter["contracts"]
                if "bowden.cli" in contract.get("forbidden_modules", ()))
    parts = {path.stem for path in (ROOT / "bowden").iterdir()
             if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert {f"bowden.{part}" for part in parts - {"__init__", "cli"}} | set(PACKAGES) - {"bowden"} == named


def test_importing_it_imports_nothing_heavy() -> None:
    code = "import bowden, sys; print(sorted({'numpy', 'typer', 'can', 'canopen', 'numba'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_nothing_is_printed_and_a_temporary_trial_is_removed_with_its_object(capfd: pytest.CaptureFixture[str]) -> None:
    trial = bowden.run(SHORT)
    folder = trial.path.parent
    columns = trial.columns
    assert len(columns["time_s"]) == len(trial) == len(trial.time_ns)
    assert capfd.readouterr() == ("", "")
    del trial
    gc.collect()
    assert not folder.exists()
    assert np.isfinite(columns["time_s"]).all()


def test_progress_is_handed_in() -> None:
    shares: list[float] = []

    class Heard(Silent):
        @contextmanager
        def running(self, what: str) -> Iterator[Callable[[float], None]]:
            yield shares.append

    bowden.run(SHORT, progress=Heard())
    assert shares == sorted(shares)
    assert 0.0 < shares[-1] <= 1.0


@pytest.mark.parametrize(("call", "says"), [
    (lambda: bowden.run(bowden.Experiment(cycles=0)), "cycles"),
    (lambda: bowden.run(bowden.Experiment(name="dance")), "dance"),
    (lambda: bowden.run(bowden.Experiment(controller="no_such:Thing")), "no_such:Thing"),
    (lambda: bowden.run(bowden.Experiment(model="none.toml")), "none.toml"),
    (lambda: bowden.run(SHORT, output="/none/trial.mcap"), "/none"),
    (lambda: bowden.run(SHORT, bus=bowden.bus("no_such_interface", "can0")), "no_such_interface"),
    (lambda: bowden.simulated(serial=-1), "serial -1"),
    (lambda: bowden.bus("bowden"), "bowden.simulated"),
    (lambda: bowden.Trial("none.mcap"), "none.mcap"),
    (lambda: bowden.identify("everything"), "everything"),
    (lambda: bowden.identify(trials=["a.mcap"], bus=bowden.simulated()), "without a bus"),
    (lambda: bowden.Diagnosis().fit("none.mcap"), "none.mcap"),
    (lambda: bowden.Diagnosis().diagnose([]), "no trial"),
    (lambda: bowden.fit([]), "no trial given"),
    (lambda: bowden.fit(["none.mcap"]), "none.mcap"),
    (lambda: bowden.compare("none.mcap", "more.mcap"), "none.mcap"),
    (lambda: bowden.export("none.mcap", "table.csv"), "none.mcap"),
    (lambda: bowden.doctor(config="none.toml"), "none.toml"),
    (lambda: bowden.verify(bowden.nominal()), "no effect"),
    (lambda: bowden.verify("none.toml"), "none.toml"),
    (lambda: bowden.verify("none.toml", bowden.Experiment(model="some.toml")), "leave it out"),
    (lambda: bowden.record(bowden.simulated(), "bus.mcap", seconds=1.0), "bowden.run"),
    (lambda: bowden.record(bowden.bus("virtual", "none"), "bus.mcap"), "seconds or frames"),
    (lambda: bowden.replay.onto("bus", "none.mcap"), "bowden replay"),
    (lambda: bowden.replay.onto("plant", "none.mcap"), "none.mcap"),
    (lambda: bowden.sweep.over({"peek": [40]}, "table.csv"), "did you mean peak?"),
])
def test_bad_input_is_one_sentence(call: Callable[[], object], says: str, tmp_path: Path,
                                   monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(bowden.InputError) as raised:
        call()
    assert says in str(raised.value)
    assert "\n" not in str(raised.value)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> bowden.Trial:
    """A short trial in a file."""
    return bowden.run(SHORT, output=tmp_path_factory.mktemp("trial") / "a.mcap")


def test_a_trial_is_exported_compared_and_replayed(trial: bowden.Trial, tmp_path: Path) -> None:
    other = bowden.run(SHORT, bus=bowden.simulated(seed=1))
    assert bowden.export(trial, tmp_path / "a.csv") == len(trial)
    assert np.array_equal(bowden.read(tmp_path / "a.csv").columns["tension_end_n"], trial.columns["tension_end_n"])
    with pytest.raises(bowden.InputError, match="exists"):
        bowden.export(trial, tmp_path / "a.csv")
    assert bowden.compare(trial, trial.path).same
    differing = {row.name for row in bowden.compare(trial, other).signals if row.rms > 0}
    assert "tension_start_n" in differing
    assert bowden.replay.onto("controller", trial).same
    assert bowden.replay.onto("plant", trial.path).same
    assert not bowden.replay.onto("plant", trial, bus=bowden.simulated(2)).same


@pytest.mark.exhaustive
def test_a_bench_is_fitted_to_the_friction_that_it_was_made_with() -> None:
    walk = bowden.Experiment(period_s=1.1, cycles=4, settle=0)
    rubbing = bowden.simulated(serial=0, plant_model={"plant": {"mu1": 0.11}})
    trial = bowden.run(walk, bus=rubbing)
    fitted = bowden.fit([trial])
    from physics.parameters import ESTIMATED, healthy

    assert all(p.low <= fitted.simulation[name] <= p.high for name, p in ESTIMATED.items()
               if name in fitted.simulation)
    assert fitted.simulation_evidence["mu1"].low <= 0.11 <= fitted.simulation_evidence["mu1"].high
    # rope and fabric share the friction that one gait shows: at the loaded knee their sum is determined
    whole, made = (p["mu1"] * p["theta1"] + p["mu2"] * (p["phi0"] + 0.5 * p["fabric_wrap"])
                   for p in (fitted.simulation, healthy() | {"mu1": 0.11}))
    assert whole == pytest.approx(made, rel=0.05)
    assert fitted.fitted["tension_end_n"]["unseen_rms_n"] < 0.02 * 40.0


def test_a_told_controller_is_verified_against_one_that_is_not() -> None:
    effect = {"start_gain": {"start_gain": 1.15}}
    model = bowden.BenchModel(effects=effect)
    found = bowden.verify(model, SHORT, bus=bowden.simulated(plant_model={"effects": effect}))
    assert found.judged_by == "true_relative_rmse_percent"
    assert found.before.figures["controller"] == found.after.figures["controller"] == "extended"
    assert found.gain_percent is not None
    before, after = (trial.figures[found.judged_by] for trial in (found.before, found.after))
    assert found.gain_percent == pytest.approx(100.0 * (1.0 - after / before))
    assert found.gain_percent > 20.0


@pytest.mark.slow
def test_a_simulated_bench_is_examined_and_a_table_is_swept(tmp_path: Path) -> None:
    found = bowden.doctor(seconds=0.1)
    nodes = [finding for finding in found if "(node " in finding.what]
    assert len(nodes) == 4, found
    assert all(finding.good for finding in nodes), nodes
    rows = bowden.sweep.over({"peak": [30, 40], "cycles": [1], "settle": [0], "period": [0.6]},
                             tmp_path / "table.csv", workers=1)
    assert [float(row["gait.peak_n"]) for row in rows] == [30.0, 40.0]
    assert {row["outcome"] for row in rows} == {"completed"}


@pytest.mark.walltime
def test_a_bus_is_recorded_by_who_only_listens(tmp_path: Path) -> None:
    import can

    with can.Bus(interface="virtual", channel="recorded from Python") as sender, ThreadPoolExecutor(1) as pool:
        listening = pool.submit(bowden.record, bowden.bus("virtual", "recorded from Python"), tmp_path / "bus.mcap",
                                frames=3, seconds=20.0)
        while not listening.done():
            sender.send(can.Message(arbitration_id=0x80, is_extended_id=False))
            sender.recv(0.01)
    made = listening.result()
    assert made.frames == 3
    assert set(bowden.Trial(tmp_path / "bus.mcap").frames["can_id"]) == {0x80}


@pytest.mark.parametrize("name", ["master", "trial"])
def test_what_hides_a_package_is_named_in_one_sentence(name: str, tmp_path: Path) -> None:
    (tmp_path / f"{name}.py").write_text("", encoding="utf-8")
    paths = os.pathsep.join((str(tmp_path), str(ROOT)))
    for code, status in (("from bowden.cli import main; main(['--version'])", 2), ("import bowden; bowden.run", 1)):
        told = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False,
                              env={**os.environ, "PYTHONPATH": paths})
        assert told.returncode == status, told.stderr
        said = told.stderr.splitlines()[-1]
        assert f"{name}.py hides the package {name} of bowden-bench" in said
        assert "rename that file" in said


@pytest.mark.slow
def test_a_healthy_fit_is_made_once_and_says_what_a_single_diagnosis_says(monkeypatch: pytest.MonkeyPatch) -> None:
    from diagnosis.evidence import evidence_finder
    from diagnosis.finder import diagnose

    fits: list[Any] = []
    fit = evidence_finder.fit_reference
    monkeypatch.setattr(evidence_finder, "fit_reference",
                        lambda *given, **more: fits.append(given) or fit(*given, **more))
    walk = bowden.Experiment(period_s=1.1, cycles=3, settle=0)
    healthy, trial = (bowden.run(walk, bus=bowden.simulated(serial=2, seed=seed)) for seed in range(2))
    told = bowden.Diagnosis().fit(healthy).diagnose(trial)
    assert len(fits) == 1
    assert diagnose([trial.path], healthy=[healthy.path]).as_json() == told.as_json()


def test_the_cycle_of_a_packaged_controller_has_no_column_more(trial: bowden.Trial) -> None:
    with trial.path.open("rb") as file:
        assert cdr.CYCLE.encode() in file.read()
    from trial.signals import COLUMNS

    assert tuple(trial.columns) == COLUMNS


@pytest.mark.exhaustive
def test_the_testing_module_is_a_name_of_the_library(site: Path, tmp_path: Path) -> None:
    said = outside(site, tmp_path, "-c", "import bowden; print(bowden.testing.CanBus.__name__)")
    assert said.stdout == "CanBus\n"


def test_no_page_installs_a_package_that_no_index_has() -> None:
    for page in ("tutorial.md", "library.md", "sweep.md"):
        text = (ROOT / "docs" / page).read_text(encoding="utf-8")
        assert not re.search(r"^pip install '?bowden-bench", text, re.MULTILINE), page
