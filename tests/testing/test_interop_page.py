"""docs/interop.md: each cell is what the service does on the virtual bus today."""

from __future__ import annotations

import logging

import pytest

from benchmarks.frame import filled
from tests.foreign import interop
from tests.foreign.peers import npm_absent

LINES = interop.PAGE.read_text(encoding="utf-8").splitlines()
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in LINES
        if line.startswith("| ") and "---" not in line]


@pytest.fixture(autouse=True)
def _quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)


def column(head: str, stack: str) -> dict[str, str]:
    """Cells of one stack by service, in the table whose first head is `head`."""
    first = next(number for number, row in enumerate(ROWS) if row[0] == head)
    at = ROWS[first].index(stack)
    ended = [number for number, row in enumerate(ROWS) if row[0] in ("device", "master", "test") and number > first]
    return {row[0]: row[at] for row in ROWS[first + 1:ended[0]]}


@pytest.mark.parametrize("stack", ["bowden", "canopen (Python)"])
def test_the_cells_of_python_stacks_are_those_of_the_page(stack: str) -> None:
    assert column("device", stack) == {name: interop.cell(interop.DEVICES[stack], service)
                                       for name, service in interop.DEVICE_SERVICES.items()}
    assert column("master", stack) == {name: interop.cell(interop.MASTERS[stack], service)
                                       for name, service in interop.MASTER_SERVICES.items()}


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore")
def test_the_page_is_what_the_command_writes() -> None:
    if absent := npm_absent():
        pytest.skip(absent)
    try:
        assert filled(interop.PAGE, interop.tables()) == interop.PAGE.read_text(encoding="utf-8")
    finally:
        logging.disable(logging.NOTSET)


def test_what_is_not_ours_has_a_reason_and_what_is_ours_works() -> None:
    cells = [cell for head in ("device", "master") for stack in interop.DEVICES
             for cell in column(head, stack).values()]
    assert [cell for cell in cells if cell != "yes" and len(cell.removeprefix("no: ")) < 8] == []
    assert {cell for head in ("device", "master") for cell in column(head, "bowden").values()} == {"yes"}
