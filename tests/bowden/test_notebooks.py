"""The notebooks run from top to bottom, and their stored outputs are those of today."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.bowden.notebook_outputs import FOLDER, executed

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SHARED = FOLDER.parents[1] / "shared" / "data"


def printed(notebook: dict[str, Any]) -> list[str]:
    """Return the printed text of each output."""
    return ["".join(output["text"]) for cell in notebook["cells"] for output in cell.get("outputs", [])
            if output["output_type"] == "stream"]


@pytest.mark.exhaustive
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_prints_as_stored(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    stored = json.loads(path.read_text(encoding="utf-8"))
    if '"shared"' in str(stored["cells"]) and not SHARED.is_dir():
        pytest.skip("its recordings are in ../shared/data, which is not part of the repository")
    assert printed(executed(stored)) == printed(stored)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_executed_with_a_figure(path: Path) -> None:
    cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert any("image/png" in output.get("data", {}) for cell in cells for output in cell["outputs"])
