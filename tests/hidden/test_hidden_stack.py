"""Hidden effects through the whole stack: a plant written apart behind nodes, wire and master, then the file alone.

The rule of this file: what is compared with the truth is what the recorded trial gives; nothing else is handed on.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from bowden.cli.app import run
from diagnosis.finder import diagnose
from diagnosis.findings import Findings
from physics.parameters import PARAMETERS
from trial import read

SEED = 4
PERIOD_S, CYCLES = 1.1, 5
LOST = "lost_share = 0.02"


class Hidden(NamedTuple):
    """What is put behind the nodes: a plant of `tests.hidden.plugin`, a fault of the wire, and the name to be found."""

    plant: str
    wire: str = ""

    @property
    def names(self) -> set[str]:
        return {"lost_pdo"} if self.wire else set() if self.plant in ("healthy", "resonance") else set(
            self.plant.split("+"))


HIDDEN = (
    Hidden("end_offset"), Hidden("start_gain"), Hidden("presliding"), Hidden("knee_backlash"), Hidden("end_filter"),
    Hidden("cable_friction"), Hidden("end_offset+knee_backlash"), Hidden("resonance"), Hidden("healthy"),
    Hidden("healthy", LOST))
SHORT = {Hidden("knee_backlash"): "found", Hidden("resonance"): "unexplained", Hidden("healthy"): "none",
         Hidden("healthy", LOST): "ambiguous"}
"""A case of each verdict that three gait cycles give as five do."""
SHORT_CYCLES = 3


def record(path: Path, plant: str, wire: str = "", seed: int = SEED, cycles: int = CYCLES) -> Path:
    """Record gait cycles by the command line; the plant's name is not written into the trial."""
    arguments = ["trial", "--period", PERIOD_S, "--serial", 0, "--seed", seed, "--cycles", cycles, "--plant",
                 f"tests.hidden.plugin:{plant}", "--json", "-o", path]
    if wire:
        model = path.with_suffix(".toml")
        model.write_text(f"[bus]\n{wire}\n", encoding="utf-8")
        arguments += ["--plant-model", model]
    assert run([str(argument) for argument in arguments]) == 0
    return path


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short trial of a like bench in the reference condition."""
    return record(tmp_path_factory.mktemp("good") / "good.mcap", "healthy", seed=SEED + 2, cycles=SHORT_CYCLES)


def hide(hidden: Hidden, path: Path, cycles: int) -> Path:
    """Record a case; its trial does not name what is hidden in it."""
    record(path, hidden.plant, hidden.wire, cycles=cycles)
    # every trial carries the calibration, which has parameters of these names
    assert not any(name.encode() in path.read_bytes() for name in hidden.names - {"presliding", *PARAMETERS})
    return path


@pytest.mark.parametrize(("hidden", "verdict"), [
    pytest.param(hidden, verdict, id=verdict, marks={
        "unexplained": pytest.mark.exhaustive}.get(verdict, pytest.mark.slow))
    for hidden, verdict in SHORT.items()])
def test_three_cycles_give_the_verdict_and_the_name(hidden: Hidden, verdict: str, good: Path, tmp_path: Path) -> None:
    found = diagnose([hide(hidden, tmp_path / "hidden.mcap", SHORT_CYCLES)], healthy=[good])
    assert found.verdict == verdict
    assert hidden.names <= set(found.rivals)
    assert hidden.names or not found.rivals


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[Hidden, Findings]:
    """Every case's diagnosis, beside one trial of a like bench in the reference condition."""
    folder = tmp_path_factory.mktemp("hidden")
    healthy = record(folder / "good.mcap", "healthy", seed=SEED + 2)
    return {hidden: diagnose([hide(hidden, folder / f"{i}.mcap", CYCLES)], healthy=[healthy])
            for i, hidden in enumerate(HIDDEN)}


def said(told: dict[Hidden, Findings], holds: Callable[[Hidden, Findings], bool]) -> dict[str, str]:
    """What was said of the cases of which something holds."""
    return {f"{h.plant} {h.wire}".strip(): f"{d.verdict} {', '.join(d.rivals)}" for h, d in told.items() if holds(h, d)}


@pytest.mark.exhaustive
def test_no_wrong_name_is_given(told: dict[Hidden, Findings]) -> None:
    assert not said(told, lambda h, d: bool(d.rivals) and not h.names & set(d.rivals))


@pytest.mark.exhaustive
def test_nothing_is_wrong_with_a_healthy_bench(told: dict[Hidden, Findings]) -> None:
    assert told[Hidden("healthy")].verdict == "none"


@pytest.mark.exhaustive
def test_what_no_catalogue_has_is_not_named(told: dict[Hidden, Findings]) -> None:
    assert told[Hidden("resonance")].verdict == "unexplained"


@pytest.mark.exhaustive
def test_effects_behind_the_nodes_are_in_the_class(told: dict[Hidden, Findings]) -> None:
    missed = said(told, lambda h, d: bool(h.names) and not h.names <= set(d.rivals))
    # of eight, some are near the limit of five short cycles beside one healthy trial
    assert len(missed) <= 2, missed


@pytest.mark.parametrize(("wire", "share", "aged"), [
    ("lost_share = 0.03", 0.03, True),
    # 0.7 ms after its place is past the deadline and not past the next SYNC: missed by the step, not by the record
    pytest.param("late_s = 0.0007\nlate_share = 0.03", 0.03, False, marks=pytest.mark.exhaustive),
])
@pytest.mark.slow
def test_a_fault_of_the_wire_shows_in_the_trial(
    wire: str, share: float, aged: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = record(tmp_path / "faulty.mcap", "healthy", wire, cycles=3)
    assert json.loads(capsys.readouterr().out)["outcome"] == "completed"
    columns = read.open(path).columns
    # some 7000 control cycles of four PDOs and a chance of 0.03: three standard deviations of a share are 0.006
    assert np.mean(columns["missed_inputs"]) == pytest.approx(4 * share, abs=0.015)
    for name in ("servo", "knee", "start"):
        late = columns[f"{name}_pdo_age_ns"] > 0 if aged else columns[f"{name}_pdo_arrival_ns"] > 650_000
        assert np.mean(late) == pytest.approx(share, abs=0.01)
    assert b"lost_share" not in path.read_bytes()
