"""The drives' own limits: written at bring-up, read back, listed by holder; a bought drive without a tension limit."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from bowden import Experiment, run
from bowden.bench import configuration
from bowden.cli.app import run as command_line
from eds.bench.bench_network import KNEE, SERVO, Network, wire
from eds.dictionary import key
from master import settings
from master.cycle.log import Log
from master.limit_holders import NOBODY, holders, unheld
from master.motion import experiment_run
from master.network import bringup
from master.network.drive_limits import TORQUE, DriveLimit, drive_limits
from master.network.link import Link
from master.settings import Limits
from parameters import InputError
from physics.reference import paper_reference
from tests.faults import bought_drive, plants
from trial.read import open as opened
from virtual_bus.bus import BowdenBus

if TYPE_CHECKING:
    from conftest import Composer

CHANNELS = itertools.count()
LOWERED = Limits(start_n=40.0, end_n=30.0, knee_low_rad=-1.2, knee_rad_s=7.0, rope_m_s=0.5, knee_n_m=8.0)


def read(link: Link, node: int, index: int, sub: int = 0, *, signed: bool = True) -> int:
    return int.from_bytes(link.sdo_read(node, index, sub), "little", signed=signed)


def test_bring_up_writes_the_drives_limits(composer: Composer) -> None:
    """A limit lowered for a person is lowered in the drives: 40 N at START are 44 N and 48 N in the servo."""
    link, tap = composer.link()
    described = wire(Network())
    bringup.bring_up(link, described, Log(tap, None, 0x201), drive_limits(described, LOWERED))
    assert (read(link, SERVO, 0x2012), read(link, SERVO, 0x2013)) == (4400, 4800)
    assert [read(link, SERVO, index) for index in (0x6072, 0x60E0, 0x60E1)] == [1200] * 3  # (40 + 80) N at 20 mm
    assert read(link, SERVO, 0x607F) == 562_500
    assert (read(link, KNEE, 0x607D, 1), read(link, KNEE, 0x607D, 2)) == (-71_755, 12_740)
    assert read(link, KNEE, 0x6072) == 1250
    bringup.bring_up(link, described, Log(tap, None, 0x201), drive_limits(described, Limits()))
    assert (read(link, SERVO, 0x2012), read(link, SERVO, 0x2013)) == (9000, 11000)


@pytest.mark.parametrize(("limit", "sentence"), [
    (DriveLimit(TORQUE, 0x6072, 0, 65_000, "130 N·m"), r"servo \(node 1\): Max torque \(0x6072:00\) does not take"),
    (DriveLimit(TORQUE, 0x1010, 1, 0x65766173, "1 N·m"), r"servo \(node 1\): .* reads \d+ after 1702257011"),
])
def test_a_drive_that_does_not_take_or_keep_a_limit_is_refused(
    composer: Composer, limit: DriveLimit, sentence: str
) -> None:
    link, tap = composer.link()
    with pytest.raises(bringup.BringUpError, match=sentence):
        bringup.bring_up(link, wire(Network()), Log(tap, None, 0x201), {SERVO: [limit]})


def test_every_function_of_the_packaged_benches_has_a_holder() -> None:
    for shape in ("bench", "bench_start_only", "bench_no_knee_drive", "bench_antagonists", "bench_two_legs"):
        from eds.declaration import packaged

        rows = holders(wire(Network(bench=packaged(shape))), Limits())
        assert unheld(rows) == [], shape


@pytest.fixture
def bought(tmp_path: Path) -> Path:
    """A configuration whose servo is a bought drive."""
    bought_drive.write_eds(tmp_path)
    (tmp_path / "bench.toml").write_text(bought_drive.TABLE)
    return tmp_path / "bench.toml"


def test_a_bought_drive_without_a_tension_limit_is_bounded_by_its_torque(bought: Path) -> None:
    described = wire(configuration.read(bought)["network"])
    assert key(0x2012) not in described.nodes[SERVO].dictionary.entries
    limits = {limit.index: limit.value for limit in drive_limits(described, Limits())[SERVO]}
    assert limits[0x6072] == 600  # 1.2 N·m at 20 mm are 60 N, which swing to 120 N


def test_a_limit_that_nobody_holds_needs_a_reason_or_a_monitor(
    bought: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the master lost no drive watches START; a stock servo without torque limits has two such functions."""
    assert command_line(["check", "config", str(bought)]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "safety functions" in said
    assert "nobody holds START tension without the master of leg; commands ask for --raise-limits REASON." in said
    bought.write_text(bought_drive.TABLE + '[limits]\nraised = "a weak link parts at 80 N"\n')
    assert command_line(["check", "config", str(bought)]) == 0
    assert "of leg; reason: a weak link parts at 80 N." in capsys.readouterr().out
    bought.write_text(bought_drive.TABLE + '[monitor]\nfile = "packaged"\n')
    assert command_line(["check", "config", str(bought)]) == 0
    assert "nobody holds" not in capsys.readouterr().out
    bought.write_text(bought_drive.TABLE)
    eds = bought.with_name(bought_drive.NAME)
    text = eds.read_text(encoding="latin-1")
    for index in ("6072", "60E0", "60E1"):
        text = text.replace(f"[{index}]", f"[Was{index}]")
    eds.write_text(text, encoding="latin-1")
    assert command_line(["check", "config", str(bought), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["held_by_nobody"] == ["START tension without the master of leg", "torque of the rope drive of leg"]
    assert command_line(["home", "--config", str(bought)]) == 2
    assert "nobody holds START tension without the master of leg" in capsys.readouterr().err
    with pytest.raises(InputError, match="nobody holds START tension without the master of leg"):
        run(Experiment(configuration=bought, cycles=1, settle=0))
    described = wire(configuration.read(bought)["network"])
    watched = holders(described, Limits(), {"START tension without the master": "65 N"})
    assert [row.held_by for row in watched if row.function.startswith("START tension")] == ["master", "monitor"]
    assert NOBODY in {row.held_by for row in watched}


def ran(bought: Path, act: Callable[[plants.Breakable], None], peak_n: float = 40.0) -> tuple[Any, plants.Breakable]:
    """Run a trial of a bought servo drive, with a fault in the plant from the first gait cycle on."""
    channel = f"bought-{next(CHANNELS)}"
    bus = BowdenBus(channel, plant="tests.faults.plants:breakable", seed=3)
    bought_drive.fit(bus.bench)
    plant = plants.made[-1]
    act(plant)
    network = configuration.read(bought)["network"]
    setup = experiment_run.ExperimentSetup(
        paper_reference(peak_n, 2.0), network=network, gait=settings.Gait(peak_n=peak_n, period_s=2.0, cycles=2))
    try:
        return experiment_run.run(Link(bus, bus.time_ns), None, None, setup), plant
    finally:
        bus.shutdown()


def test_a_trial_with_a_bought_drive_completes_within_its_torque(bought: Path) -> None:
    result, plant = ran(bought, lambda plant: None)
    assert result.stop_reason is None
    assert max(row[2] for row in plant.true) < 50.0


def from_s(start_s: float, sense: Callable[[Any], Any]) -> Callable[[plants.Breakable], None]:
    def act(plant: plants.Breakable) -> None:
        plant.sense = lambda now_ns, felt: sense(felt) if now_ns > start_s * 1e9 else felt
    return act


@pytest.mark.parametrize("start_s", [
    4.6, *(pytest.param(4.0 + 0.1 * n, marks=pytest.mark.exhaustive) for n in range(20))])
def test_a_bought_drive_with_a_reversed_velocity_stays_within_starts_limit(bought: Path, start_s: float) -> None:
    """Without the torque limit that bring-up writes, START reached 201 N and END 171 N."""
    reverse = from_s(start_s, lambda felt: felt._replace(servo_velocity_m_s=-felt.servo_velocity_m_s))
    result, plant = ran(bought, reverse)
    assert result.stop_reason is not None
    assert max(row[1] for row in plant.true) <= 120.0


def test_the_trials_file_has_the_table(tmp_path: Path) -> None:
    path = tmp_path / "trial.mcap"
    assert command_line(["trial", "--cycles", "1", "--settle", "0", "--period", "1.1", "-o", str(path)]) == 0
    table = opened(path).attachments["safety_functions.csv"].decode()
    assert 'START tension,leg,"drive, master",0x2012 90 N; 0x2013 110 N,120 N,' in table


def test_the_page_has_the_table_of_the_packaged_bench() -> None:
    page = (Path(__file__).parents[2] / "docs" / "safety.md").read_text(encoding="utf-8")
    table = page.split("<!-- safety functions: begin -->\n")[1].split("<!-- safety functions: end -->")[0]
    rows = holders(wire(Network()), Limits())
    assert table.splitlines()[2:] == [f"| {' | '.join(cell or '–' for cell in row.cells)} |" for row in rows]


def test_doctor_shows_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    command_line(["doctor", "--for", "0.1", "--json"])
    told = json.loads(capsys.readouterr().out)["safety_functions"]
    assert told[0] == {"function": "START tension", "of": "leg", "drive": "0x2012 90 N; 0x2013 110 N",
                       "master": "120 N", "monitor": "", "held_by": "drive, master"}
