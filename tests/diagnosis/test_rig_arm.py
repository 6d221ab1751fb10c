"""Joints of an arm that were recorded together: each drive diagnosed with the motion of the other links.

The rule of this file: the arm is `rigs.two_link_arm`, its torques by the textbook's equations of two links.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from bowden import Diagnosis
from bowden.cli.app import run
from diagnosis.finder import Finder
from diagnosis.findings import Findings
from estimation.data.table import Table, read, table
from parameters import InputError
from tests.diagnosis import rigs

FOREARM_KG, UPPER_M, LOWER_M, TIP_KG = 1.2, 0.35, 0.3, 0.2


def arm(seed: int, joint: str, tip_kg: float = 0.0, elbow_coulomb: float = 0.25) -> Table:
    return table(f"arm_{seed}.csv", rigs.two_link_arm(seed, tip_kg, elbow_coulomb), joint=joint)


@cache
def known(joint: str) -> Finder:
    return Finder().fit([arm(1, joint), arm(2, joint)])


def constants(found: Findings) -> dict[str, float]:
    assert found.evidence is not None
    return {name: shift["from"] for name, shift in found.evidence["shifts"].items()}


def test_the_elbows_constants_are_those_of_the_arms_equations() -> None:
    found = known("elbow").diagnose([arm(3, "elbow")])
    told = constants(found)
    assert found.verdict == "none"
    assert told["unbalance"] == pytest.approx(FOREARM_KG * 9.81 * 0.5 * LOWER_M, rel=0.01)
    assert told["link_elbow"] == pytest.approx(FOREARM_KG * LOWER_M**2 / 3.0, rel=0.03)
    assert told["between_shoulder_elbow"] == pytest.approx(FOREARM_KG * UPPER_M * 0.5 * LOWER_M, rel=0.03)
    assert told["inertia"] == pytest.approx(0.01, rel=0.1)


def test_the_shoulder_carries_both_links() -> None:
    told = constants(known("shoulder").diagnose([arm(3, "shoulder")]))
    assert told["weight_elbow"] == pytest.approx(FOREARM_KG * 9.81 * 0.5 * LOWER_M, rel=0.02)
    assert told["unbalance"] == pytest.approx((2.0 * 0.5 + FOREARM_KG) * 9.81 * UPPER_M, rel=0.01)


@pytest.mark.slow
def test_a_mass_at_the_tip_is_told_from_either_joint() -> None:
    for joint, own in (("elbow", 9.81 * LOWER_M), ("shoulder", 9.81 * UPPER_M)):
        found = known(joint).diagnose([arm(4, joint, TIP_KG)])
        cause = found.causes[0]
        assert cause["effect"] == "unbalance"
        assert cause["parameters"]["unbalance"]["value"] - cause["was"]["unbalance"] == pytest.approx(
            TIP_KG * own, rel=0.05)


def test_friction_of_the_elbow_is_told_there_and_nowhere_else() -> None:
    elbow, shoulder = (known(joint).diagnose([arm(5, joint, elbow_coulomb=0.45)]) for joint in ("elbow", "shoulder"))
    assert elbow.causes[0]["effect"] == "drive_coulomb"
    assert elbow.causes[0]["parameters"]["drive_coulomb"]["value"] == pytest.approx(0.45, rel=0.1)
    assert shoulder.verdict == "none"


def test_without_the_other_joint_the_elbow_cannot_be_predicted() -> None:
    def alone(seed: int) -> Table:
        both = rigs.two_link_arm(seed)
        return table(f"elbow_{seed}.csv", {name.removeprefix("elbow."): values for name, values in both.items()
                                           if not name.startswith("shoulder.")})

    found = Finder().fit([alone(1), alone(2)]).diagnose([alone(3)])
    assert found.verdict == "refused"
    assert "do not fit" in found.warnings[0]


def test_a_table_of_several_joints_needs_the_name_of_one(tmp_path: Path) -> None:
    columns = rigs.two_link_arm(1)
    file = tmp_path / "arm.csv"
    rows = np.column_stack(list(columns.values()))[:400]
    np.savetxt(file, rows, delimiter=",", header=",".join(columns), comments="")
    with pytest.raises(InputError, match="records shoulder, elbow; name one with --path"):
        read(file)
    with pytest.raises(InputError, match="has no path wrist; expected one of shoulder, elbow"):
        read(file, "wrist")
    with pytest.raises(InputError, match="has no path wrist; it records a single one"):
        table("one.csv", rigs.pendulum(1), joint="wrist")
    with pytest.raises(InputError, match="name one with --path"):
        Diagnosis().fit([file])
    assert read(file, "elbow").joints == ("shoulder", "elbow")
    assert "shoulder.servo_position_m" in read(file, "elbow")


@pytest.mark.slow
def test_the_commands_take_the_joint_as_a_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = []
    for seed in (1, 2, 3):
        columns = rigs.two_link_arm(seed)
        files.append(str(tmp_path / f"arm_{seed}.csv"))
        np.savetxt(files[-1], np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns),
                   comments="")
    assert run(["diagnose", files[2], "--healthy", files[0]]) == 2
    assert "records shoulder, elbow; name one with --path" in capsys.readouterr().err
    assert run(["diagnose", files[2], "--healthy", files[0], "--healthy", files[1], "--path", "elbow"]) == 0
    assert "Path elbow." in capsys.readouterr().out
    model = tmp_path / "elbow.toml"
    assert run(["fit", files[0], files[1], "--path", "elbow", "-o", str(model)]) == 0
    assert "[rig.unbalance]" in model.read_text(encoding="utf-8")


def test_a_table_of_several_force_paths_is_read_path_by_path() -> None:
    both = {"time_s": np.arange(3.0), "left.tension_start_n": np.ones(3), "right.tension_start_n": np.zeros(3)}
    both["remark.version"] = np.zeros(3)  # no header of ours: no path
    left = table("legs.csv", both, joint="left")
    assert list(left.columns) == ["time_s", "tension_start_n"]
    assert left["tension_start_n"][0] == 1.0
