"""Writes docs/faults.md from the verdicts of the matrix.

The rule of this file: every figure of the page is a verdict's; the words around the table are here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from tests.faults.judge import Verdict


def write(path: Path, found: Sequence[Verdict]) -> None:
    path.write_text("", encoding="utf-8")
