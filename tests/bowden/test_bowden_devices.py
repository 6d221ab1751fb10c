"""A bought drive in bench.toml: it takes the knee's place, or what it lacks is said before anything runs."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from bowden.bench import configuration
from bowden.sweep import rows
from eds.bench.bench_network import KNEE, WireLayout, wire
from eds.declaration import text_of
from eds.dictionary import key
from trial.convert.frames import rows_of
from trial.decode import Follower, cycles

VENDOR = Path(__file__).parents[1] / "eds" / "vendor_drive.eds"
TABLE = f'[knee]\nfile = "vendor_drive.eds"\nposition = "3010"\nposition_scale = {2 * math.pi / 524_288!r}\n'

COUNT = 2 * math.pi / 524_288
"""One count of that drive, rad."""


@pytest.fixture
def bench(here: Path) -> Path:
    """A configuration beside its vendor's file."""
    shutil.copy(VENDOR, here)
    (here / "bench.toml").write_text(TABLE)
    return here / "bench.toml"


def test_a_device_of_the_configuration_is_on_the_wire(bench: Path) -> None:
    assert wire(configuration.read(bench)["network"]).tpdo[0x180 + KNEE].keys == (key(0x6041), key(0x3010))


def test_the_configuration_that_a_trial_carries_names_the_device(bench: Path) -> None:
    assert 'position = "3010"' in configuration.as_text(configuration.read(bench))


def test_check_passes_a_device_that_fits(bench: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    """It fits the wire; that nobody holds its torque needs a reason."""
    status, out, _ = bowden("check", "config", bench, "--json")
    assert (status, "streams" in json.loads(out)) == (1, True)
    assert json.loads(out)["held_by_nobody"] == ["torque of the joint drive of knee"]
    bench.write_text(TABLE + '[limits]\nraised = "its maker bounds the torque at 8 N·m"\n')
    assert bowden("check", "config", bench, "--json")[0] == 0


def test_check_says_what_a_device_lacks(bench: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    bench.write_text(TABLE.replace("3010", "9999"))
    status, out, _ = bowden("check", "config", bench, "--json")
    assert status == 1
    assert "no object 9999" in json.loads(out)["lacks"][0]


def test_a_key_that_no_table_gives_is_unknown(bench: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    bench.write_text("[network]\nbench = []\n")
    status, out, err = bowden("check", "config", bench)
    assert (status, out) == (2, "")
    assert "unknown key bench" in err


def heard(described: WireLayout) -> list[tuple[int, int, bytes]]:
    """A SYNC, the knee's answer at −0.5 rad, and the next SYNC: time, ns, COB-ID, data."""
    plan = described.tpdo[0x180 + KNEE]
    return [(0, 0x080, b""), (100, plan.cob_id, plan.pack_si(0.0, -0.5)), (1_000_000, 0x080, b"")]


def test_a_bought_drive_is_seen_by_who_follows_the_bus(bench: Path) -> None:
    described = wire(configuration.read(bench)["network"])
    follower = Follower(described)
    *_, ended = [follower.frame(*frame) for frame in heard(described)]
    assert ended is not None
    assert dict(zip(follower.names, ended[1], strict=True))["knee_angle_rad"] == pytest.approx(-0.5, abs=COUNT)


def test_a_bought_drive_is_seen_in_a_log(bench: Path) -> None:
    described = wire(configuration.read(bench)["network"])
    rows = rows_of([(at, can_id, 0, len(data), 0, False, data) for at, can_id, data in heard(described)])
    assert cycles(rows, described).columns["knee_angle_rad"][0] == pytest.approx(-0.5, abs=COUNT)


def test_the_packaged_declaration_gives_the_packaged_network(here: Path) -> None:
    (here / "bench.toml").write_text(text_of("bench"))
    assert configuration.read(here / "bench.toml") == configuration.read(None)


def test_a_declared_device_may_be_a_bought_one(bench: Path) -> None:
    mapped = f'type = "joint_drive"\n{TABLE.removeprefix("[knee]")}'
    own = configuration.read(bench)
    bench.write_text(text_of("bench").replace('type = "joint_drive"\n', mapped))
    assert configuration.read(bench) == own


def test_a_device_is_mapped_in_one_table(bench: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    declared = text_of("bench").replace('type = "joint_drive"\n', 'type = "joint_drive"\nposition_scale = 1e-5\n')
    bench.write_text(TABLE + declared)
    status, out, err = bowden("check", "config", bench)
    assert (status, out) == (2, "")
    assert "[knee] stands beside [[device]]" in err


def test_a_row_of_a_sweep_holds_its_bench_as_text(bench: Path) -> None:
    sections = configuration.read(bench)
    (row,) = json.loads(json.dumps(rows.rows(sections, {}, [])))
    assert rows.table(row, "network") == sections["network"]
    (paper,) = rows.rows(configuration.read(None), {}, [])
    assert (paper[rows.DECLARED], rows.table(paper, "network")) == ("", configuration.read(None)["network"])


def test_the_wire_of_another_bench_is_planned(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    (here / "legs.toml").write_text(text_of("bench_two_legs"))
    status, out, _ = bowden("check", "config", "legs.toml", "--json")
    told = json.loads(out)
    assert (status, told["rate_that_fits_hz"]) == (0, 500)
    assert {"TPDO1 right_end", "targets 2", "EMCY left_start"} <= {stream["name"] for stream in told["streams"]}


def test_a_bench_that_does_not_fit_is_refused(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    (here / "legs.toml").write_text(text_of("bench_two_legs").replace("rate_hz = 500", "rate_hz = 1000"))
    status, out, err = bowden("check", "config", "legs.toml")
    assert (status, out) == (2, "")
    assert "lower rate_hz to 500" in err


def test_ropes_that_act_alike_on_one_joint_are_refused(here: Path, bowden: Callable[..., tuple[int, str, str]]) -> None:
    (here / "two.toml").write_text(text_of("bench_antagonists").replace('acts = "extends"\n', ""))
    status, out, err = bowden("trial", "--config", "two.toml", "-o", "trial.mcap")
    assert (status, out, list(here.glob("*.mcap"))) == (2, "", [])
    assert "its force paths act as flexes, flexes" in err
