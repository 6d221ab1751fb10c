"""The pytest plugin: fixtures `can_bus` and `canopen_node`, the marker `can_bus`, `--golden-update`, `--can-seed`.

The rule of this file: nothing but pytest is imported until a test uses a fixture.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Generator, Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from bowden.testing.can_bus import CanBus
    from bowden.testing.canopen_node import CanopenNode

SHOWN = 20
"""Frames of the bus that the report of a failed test shows, the newest last."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the plugin."""
    group = parser.getgroup("bowden.testing", "virtual CANopen bus")
    group.addoption("--golden-update", action="store_true", help="write golden frame files instead of comparing")
    group.addoption("--can-seed", type=int, default=0, metavar="N", help="added to the seed of every test's can_bus")


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker."""
    config.addinivalue_line("markers", "can_bus(bitrate=1_000_000, node_turnaround_ns=0, master_turnaround_ns=0): "
                                       "options of the fixture can_bus")


@pytest.fixture
def can_bus(request: pytest.FixtureRequest) -> Iterator[CanBus]:
    """A virtual CAN bus for this test alone, at 0 ns; its seed is that of the test's name."""
    from bowden import own_packages

    hidden = own_packages.hidden()
    if hidden is not None:
        pytest.fail(f"bowden.testing: {hidden}", pytrace=False)
    from bowden.testing.can_bus import CanBus

    marker = request.node.get_closest_marker("can_bus")
    seed = zlib.crc32(request.node.nodeid.encode()) + request.config.getoption("--can-seed")
    update = request.config.getoption("--golden-update")

    class GoldenBus(CanBus):
        """Bus of a test, whose golden files are beside the test."""

        def assert_golden(self, path: Any = None, *, update: bool = update) -> None:
            name = path or f"golden/{request.node.name}.txt"
            super().assert_golden(request.path.parent / name, update=update)

    bus = GoldenBus(seed=seed, **(marker.kwargs if marker else {}))
    request.node.stash[_BUS] = bus
    yield bus
    bus.close()


@pytest.fixture
def canopen_node(can_bus: CanBus, request: pytest.FixtureRequest) -> Callable[..., CanopenNode]:
    """Add a node to `can_bus`: `canopen_node(eds, node_id)`; a relative path is taken from the test's folder."""
    from eds.dictionary import PACKAGED, Dictionary

    def add(eds: Any, node_id: int | None = None, **options: Any) -> CanopenNode:
        if not isinstance(eds, Dictionary) and str(eds) not in PACKAGED:
            beside = request.path.parent / str(eds)
            eds = beside if beside.exists() else eds
        return can_bus.add_node(eds, node_id, **options)

    return add


_BUS = pytest.StashKey["CanBus"]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None],
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the newest frames and the seed to the report of a failed test."""
    report = yield
    bus = item.stash.get(_BUS, None)
    if bus is not None and report.when == "call" and report.failed:
        frames = bus.frames()
        text = "\n".join(map(str, frames[-SHOWN:]))
        report.sections.append((f"can_bus: {len(frames)} frames, seed {bus.seed}, {bus.now_ns} ns", text))
    return report
