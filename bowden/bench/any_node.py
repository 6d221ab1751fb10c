"""Any CANopen node as a Python object: `with bowden.Node(5, eds="vendor.eds", bus=…) as node`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bowden.bench import buses
from bowden.bench.buses import BusSettings
from eds.cia301 import Abort
from eds.dictionary import Dictionary, read
from master.network.link import Link, LinkError
from master.network.sdo import SdoError
from master.node_access import lss_master, node_scan
from master.node_access import remote_node as access
from parameters import InputError

BITRATE = 1_000_000

_ADVICE = {
    Abort.NO_OBJECT: "bowden node objects lists the objects of its EDS",
    Abort.NO_SUBINDEX: "give another sub-index, such as 1018:01",
    Abort.READ_ONLY: "write another object", Abort.WRITE_ONLY: "read another object",
    Abort.DEVICE_STATE: "change its NMT or drive state first", Abort.LOCAL_CONTROL: "release its local control first",
    Abort.TOO_LONG: "give --type or its EDS", Abort.TOO_SHORT: "give --type or its EDS",
    Abort.LENGTH: "give --type or its EDS",
}
"""Remedies of SDO refusals by abort code."""


def advice(error: SdoError) -> str:
    """Return what to do about an SDO that failed: the remedy of its abort code, or the checks of a silent node."""
    if error.code is None:
        return "check node id, bit rate, supply and cable (bowden node scan)"
    return next((text for code, text in _ADVICE.items() if code == error.code), "see the device's manual")


@contextmanager
def linked(bus: BusSettings, bitrate: int = BITRATE) -> Iterator[Link]:
    """Open a bus and a link on it that sends no heartbeat; raises `InputError` where bus or node fails."""
    with buses.opened_one(bus, bitrate) as opened:
        try:
            yield Link(opened, buses.clock_of(opened), heartbeat_ms=None)
        except SdoError as error:
            raise InputError(f"{error}; {advice(error)}.") from None
        except LinkError as error:
            raise InputError(f"bus: {error}; see bowden doctor.") from None


def dictionary_of(link: Link, node_id: int, eds: Path | None) -> Dictionary | None:
    """Return the node's dictionary: a file given, the fitting one of a folder, else a packaged one that fits.

    Raises `InputError` where a folder has none that fits the node's identity.
    """
    if eds is not None and not eds.is_dir():
        return read(eds, node_id)
    try:
        identity = access.NodeAccess(link, node_id).identity()
    except SdoError as error:
        raise InputError(f"{error}; {advice(error)}.") from None
    found = node_scan.fitting(identity, node_scan.files_of(eds), node_id)
    if found is None and eds is not None:
        raise InputError(f"{eds}: no EDS in it fits node {node_id} (vendor 0x{identity.get('vendor', 0):08X}, product "
                         f"0x{identity.get('product', 0):08X}); add the device's file or name it.")
    return found


class Lss(lss_master.LssMaster):
    """An LSS master (CiA 305), as a context manager that opens its bus: `scan`, `choose`, `configure_node_id`, `store`.

    Leaving it switches all devices to waiting. Raises `InputError` for bad input and for a bus that fails; methods
    raise `master.node_access.lss_master.LssRefusalError` where a device refuses.
    """

    def __init__(self, *, bus: BusSettings | None = None, bitrate: int = BITRATE,
                 answer_ns: int = lss_master.ANSWER_NS) -> None:
        self._opened = ExitStack()
        super().__init__(self._opened.enter_context(linked(bus or buses.simulated(), bitrate)), answer_ns)

    def __enter__(self) -> Lss:
        return self

    def __exit__(self, *_exc: object) -> None:
        with self._opened:
            self.leave()


class Node(access.NodeAccess):
    """Any CANopen node, as a context manager that opens its bus.

    `eds` is a file or a folder of them; `bus` comes from `bowden.bus()` and is the simulated bench without one. Raises
    `InputError` for bad input and for a bus that fails; methods raise `master.network.sdo.SdoError` for a refusal.
    """

    def __init__(self, node_id: int, *, bus: BusSettings | None = None, eds: str | Path | None = None,
                 bitrate: int = BITRATE) -> None:
        self._opened = ExitStack()
        link = self._opened.enter_context(linked(bus or buses.simulated(), bitrate))
        try:
            super().__init__(link, node_id, dictionary_of(link, node_id, None if eds is None else Path(eds)))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the bus."""
        self._opened.close()

    def __enter__(self) -> Node:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()
