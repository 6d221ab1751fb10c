"""docs/safety.md: every test that it names exists, and its table of checks is that of the code."""

from __future__ import annotations

import re
from pathlib import Path

from benchmarks import supervision
from benchmarks.supervision import COMPARED, NAMES
from master.cycle.safety import Condition
from master.motion.checks import CHECKS

ROOT = Path(__file__).parents[2]


def test_every_claim_names_a_test_that_exists() -> None:
    named = set(re.findall(r"`(test_\w+)`", (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")))
    defined = {name for path in (ROOT / "tests").rglob("test_*.py")
               for name in re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)}
    assert len(named) > 30
    assert named <= defined


def test_the_page_prints_the_table_of_checks() -> None:
    assert supervision.table() in (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")


def test_every_condition_and_every_measured_share_belongs_to_a_check() -> None:
    assert {check.condition for check in CHECKS} == set(Condition)
    assert {check.healthy for check in CHECKS} - {""} == {*NAMES, *COMPARED}
    assert len({check.name for check in CHECKS}) == len(CHECKS)
