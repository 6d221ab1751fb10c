"""`bowden doctor` on the kernel's CAN: what is there, what is not, and what to type."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.socketcan import rig

pytestmark = pytest.mark.guest("native", "uml")


def findings(folder: Path, channel: str) -> dict[str, dict[str, object]]:
    told = rig.bowden(folder, "doctor", "--interface", "socketcan", "--channel", channel, "--for", 0.1).wait()
    assert told.status == int(told.result["faults"] > 0), told
    return {finding["what"]: finding for finding in told.result["findings"]}


def test_the_doctor_finds_the_bench_and_names_what_is_wrong(tmp_path: Path, own: str) -> None:
    with rig.bench(tmp_path, own, *rig.patient(tmp_path)):
        seen = findings(tmp_path, own)
        assert str(seen["time stamps"]["seen"]) == "of the kernel", "a virtual interface has no clock of its own"
        for what in ("interface", "bus load", "error frames", "other masters", "permissions",
                     "servo (node 1)", "knee (node 2)", "start (node 3)", "end (node 4)"):
            assert seen[what]["good"], seen[what]
        assert "as servo_drive.eds says" in str(seen["servo (node 1)"]["seen"])
        rig.shell(f"ip link set {own} down")
        down = findings(tmp_path, own)
        assert down["interface"]["remedy"] == f"sudo ip link set {own} up"
        assert "servo (node 1)" not in down
    absent = findings(tmp_path, "can9")["interface"]
    assert not absent["good"]
    assert "can9 does not exist; there is" in str(absent["seen"])
    assert "sudo ip link add can9 type vcan" in str(absent["remedy"])
