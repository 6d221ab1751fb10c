"""canopen's own tests of its client against its local node, run against our device core in the local node's place.

The classes come from canopen's source distribution (`.ci/nightly` fetches it from the package index and says where by
BOWDEN_CANOPEN_TESTS); without it the tests are skipped.  What differs is listed in `DIFFERENT` with its reason.  The
devices are made of canopen's own sample.eds, on python-can's `virtual` bus, in a thread of their own.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import sys
import threading
import time
import unittest
from pathlib import Path
from typing import Any

import can
import canopen
import pytest
from canopen.pdo import PDO, RPDO, TPDO
from canopen.sdo.base import SdoBase

from eds.cia301 import Abort, Frame, NmtState
from eds.dictionary import key, read
from nodes.core.application import Application
from nodes.core.device import Device

pytestmark = [pytest.mark.exhaustive, pytest.mark.walltime]
SUITE = Path(os.environ.get("BOWDEN_CANOPEN_TESTS", "build/foreign/canopen/test"))
NUMBERS = itertools.count()
LOOK_S = 0.002
"""Longest time between two looks at a device's own timers."""
DIFFERENT = {
    "test_abort": "0x1001 is there without an application to write it: an error register of 0, as CiA 301 wants it",
    "test_block_download_not_supported": "block transfers are supported; 0x1008 is refused for being constant",
    "test_block_upload_switch_to_expedite_upload": "a block upload is a block upload for short objects, too",
    "test_callbacks": "canopen's callbacks stand in for an application; ours is nodes.core.application.Application",
    "test_expedited_download_wrong_datatype": "too many bytes are 0607 0012h (too long), no 0607 0010h",
    "test_expedited_upload": "sample.eds maps 0x6040, which it lacks: such an RPDO stays invalid (bit 31)",
    "test_receive_abort_request": "the core keeps no last abort; one that comes ends the transfer",
}
NAMES = (
    "test_abort", "test_block_download_not_supported", "test_block_upload_switch_to_expedite_upload", "test_callbacks",
    "test_expedited_download", "test_expedited_download_wrong_datatype", "test_expedited_upload",
    "test_expedited_upload_default_value_real", "test_expedited_upload_default_value_visible_string",
    "test_nmt_state_initializing_to_preoper", "test_read", "test_receive_abort_request", "test_save",
    "test_segmented_download", "test_segmented_upload", "test_slave_send_heartbeat", "test_start_remote_node",
    "test_two_nodes_on_the_bus", "test_upload_zero_length",
)


class Local(canopen.node.base.BaseNode, SdoBase):  # type: ignore[misc]
    """The device from its own side, by the names that the suite uses: `sdo`, `nmt`, `pdo`."""

    def __init__(self, served: Served, node_id: int, dictionary: Any) -> None:
        SdoBase.__init__(self, 0, 0, dictionary)
        canopen.node.base.BaseNode.__init__(self, node_id, dictionary)
        self.network = canopen.Network()
        self.sdo = self.nmt = self
        self.tpdo, self.rpdo = TPDO(self), RPDO(self)
        self.pdo = PDO(self, self.rpdo, self.tpdo)
        self._lock = served.lock
        self._device = Device(read(SUITE / "sample.eds", node_id), node_id, Application())
        served.add(self._device)

    def upload(self, index: int, subindex: int) -> bytes:
        """Read as an SDO client does."""
        with self._lock:
            found = self._device.upload(key(index, subindex), time.monotonic_ns())
        if isinstance(found, Abort):
            raise canopen.SdoAbortedError(found)
        return found

    def download(self, index: int, subindex: int, data: bytes, force_segment: bool = False) -> None:
        """Write as an SDO client does; constants as an application does."""
        at = key(index, subindex)
        with self._lock:
            if self._device.objects.may_download(at, None) is None:
                refused = self._device.download(at, data, time.monotonic_ns())
                if refused:
                    raise canopen.SdoAbortedError(refused)
            else:
                self._device.values[at] = data

    def stop_heartbeat(self) -> None:
        """Produce none any more."""
        self.download(0x1017, 0, bytes(2))

    @property
    def state(self) -> str:
        """The NMT state as canopen names it."""
        with self._lock:
            return self._device.state.name.replace("_", "-")

    @state.setter
    def state(self, name: str) -> None:
        with self._lock:
            if name == "INITIALISING":
                self._device.nmt.initialise(True, time.monotonic_ns())
            else:
                self._device.nmt.enter(NmtState[name.replace("-", "_")], time.monotonic_ns())


class Served:
    """Devices on a `virtual` bus, in a thread."""

    def __init__(self, channel: str) -> None:
        self.lock = threading.RLock()
        self._devices: list[Device] = []
        self._bus = can.Bus(channel, interface="virtual")
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def add(self, device: Device) -> None:
        """Switch a device on."""
        with self.lock:
            device.power_on(time.monotonic_ns())
            self._devices.append(device)

    def close(self) -> None:
        """End thread and bus."""
        self._ended.set()
        self._thread.join()
        self._bus.shutdown()

    def _run(self) -> None:
        while not self._ended.is_set():
            heard = self._bus.recv(LOOK_S)
            with self.lock:
                for device in self._devices:
                    if heard is not None:
                        device.receive(Frame(heard.arbitration_id, bytes(heard.data)), time.monotonic_ns())
                    device.poll(time.monotonic_ns())
                    while device.outbox:
                        frame = device.outbox.popleft()
                        self._bus.send(can.Message(
                            arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))


def cases() -> dict[str, Any]:
    """The suite's classes with our devices for local nodes, by the names of their tests."""
    if not (SUITE / "test_local.py").exists():
        pytest.skip(f"canopen's tests are not in {SUITE}; .ci/nightly fetches them")
    name = "canopen_suite"
    package = importlib.util.spec_from_file_location(name, SUITE / "__init__.py",
                                                     submodule_search_locations=[str(SUITE)])
    assert package is not None
    sys.modules.setdefault(name, importlib.util.module_from_spec(package))
    module = importlib.import_module(f"{name}.test_local")
    found = {}
    for base in (module.TestSDO, module.TestPDO):
        made = type(f"{base.__name__}OnOurDevice", (base,), {
            "setUpClass": classmethod(_set_up), "tearDownClass": classmethod(_tear_down)})
        found |= dict.fromkeys(unittest.TestLoader().getTestCaseNames(made), made)
    return found


def _set_up(case: Any) -> None:
    channel = f"canopen-suite-{next(NUMBERS)}"
    case.network1 = canopen.Network()
    case.network1.NOTIFIER_SHUTDOWN_TIMEOUT = 0.0
    case.network1.connect(channel, interface="virtual")
    case.served = Served(channel)
    eds = str(SUITE / "sample.eds")
    case.remote_node, case.remote_node2 = (case.network1.add_node(number, eds) for number in (2, 3))
    case.local_node, case.local_node2 = (
        Local(case.served, number, case.network1[number].object_dictionary) for number in (2, 3))


def _tear_down(case: Any) -> None:
    case.network1.disconnect()
    case.served.close()


@pytest.mark.parametrize("name", NAMES)
def test_canopens_own_test_passes_on_our_device(name: str) -> None:
    found = cases()
    if name in DIFFERENT:
        pytest.skip(DIFFERENT[name])
    result = unittest.TestResult()
    unittest.TestSuite([found[name](name)]).run(result)
    assert result.testsRun == 1
    assert result.wasSuccessful(), [*result.errors, *result.failures]


def test_no_test_of_the_suite_is_forgotten() -> None:
    assert set(cases()) == set(NAMES)
