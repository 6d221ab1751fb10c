"""python-can's own tests of two buses on one wire, run on ours.

The class comes from python-can's source distribution (`.ci/nightly` fetches it from the package index and says where by
BOWDEN_PYTHON_CAN_TESTS); without it the tests are skipped.  What differs is listed in `DIFFERENT` with its reason.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import sys
import unittest
from pathlib import Path
from typing import Any

import can
import pytest

pytestmark = pytest.mark.exhaustive
SUITE = Path(os.environ.get("BOWDEN_PYTHON_CAN_TESTS", "build/foreign/python-can/test"))
NUMBERS = itertools.count()
DIFFERENT = {
    "test_fd_message": "the bench is classical CAN; a CAN FD message raises can.CanError",
    "test_fd_message_with_brs": "the bench is classical CAN; a CAN FD message raises can.CanError",
    "test_timestamp": "bus time passes in recv alone, so sleeping moves no time stamp",
    "test_timestamp_is_absolute": "bus time counts from when the bench was switched on, so that trials repeat",
    "test_unique_message_instances": "sockets share a message, which saves a copy a frame; who changes one copies it",
}


def case() -> Any:
    """The class, on our interface; the nodes have booted and are silent until a master speaks to them."""
    if not (SUITE / "back2back_test.py").exists():
        pytest.skip(f"python-can's tests are not in {SUITE}; .ci/nightly fetches them")
    name = "python_can_suite"
    package = importlib.util.spec_from_file_location(name, SUITE / "__init__.py",
                                                     submodule_search_locations=[str(SUITE)])
    assert package is not None
    sys.modules.setdefault(name, importlib.util.module_from_spec(package))
    module = importlib.import_module(f"{name}.back2back_test")

    class OnOurBus(module.Back2BackTestCase):  # type: ignore[name-defined,misc]
        def setUp(self) -> None:
            channel = f"suite {next(NUMBERS)}"
            self.CHANNEL_1 = self.CHANNEL_2 = channel
            self.INTERFACE_1 = self.INTERFACE_2 = "bowden"
            self.bus1, self.bus2 = (can.Bus(channel=channel, interface="bowden", bitrate=500_000, fd=False,
                                            single_handle=True) for _ in range(2))
            while self.bus1.recv(1.0) is not None:
                pass
            while self.bus2.recv(0) is not None:
                pass

    return OnOurBus


NAMES = (
    "test_no_message", "test_multiple_shutdown", "test_timestamp", "test_standard_message",
    "test_extended_message", "test_remote_message", "test_dlc_less_than_eight", "test_unique_message_instances",
    "test_fd_message", "test_fd_message_with_brs", "test_fileno", "test_timestamp_is_absolute",
    "test_sub_second_timestamp_resolution", "test_send_periodic_duration",
)


@pytest.mark.parametrize("name", NAMES)
def test_python_cans_own_test_passes_on_our_bus(name: str) -> None:
    if name in DIFFERENT:
        pytest.skip(DIFFERENT[name])
    result = unittest.TestResult()
    case()(name).run(result)
    assert result.testsRun == 1
    assert result.wasSuccessful(), [*result.errors, *result.failures]


def test_no_test_of_the_suite_is_forgotten() -> None:
    assert {name for name in dir(case()) if name.startswith("test_")} == {
        *NAMES, "test_message_is_rx", "test_message_is_rx_receive_own_messages"}  # python-can skips these two itself
