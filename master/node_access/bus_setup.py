"""Nodes of a bus and a `bus.yml`: a file's PDOs and writes into the nodes, and the nodes' settings into a file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from eds.cia301 import COB_ID_INVALID, RPDO_BASE, TPDO_BASE
from eds.dictionary import Dictionary, key
from eds.dictionary import read as read_eds
from eds.files.bus_yml import BusPdo, BusYmlDevice
from master.network.link import Link
from master.network.sdo import SdoError
from master.node_access import object_text, pdo_settings
from master.node_access.node_scan import FoundNode
from master.node_access.pdo_settings import TPDO
from master.node_access.remote_node import NodeAccess
from parameters import InputError

_HEARTBEAT: Final = 0x1017


def apply(link: Link, device: BusYmlDevice, folder: Path) -> list[str]:
    """Write heartbeat, SDO list and PDOs of a device into its node; return each in words.

    Raises `InputError` where the EDS, read from `folder`, or the node excludes one.
    """
    dictionary = read_eds(folder / device.eds, device.node_id) if device.eds else None
    node = NodeAccess(link, device.node_id, dictionary)
    writes = list(device.writes)
    if (heartbeat := device.other.get("heartbeat_producer")) is not None:
        writes.append((_HEARTBEAT, 0, heartbeat))
    done = []
    for index, sub, value in writes:
        at = key(index, sub)
        try:
            node.write_bytes(at, node.encoded(at, str(value)))
        except SdoError as error:
            raise InputError(f"{device.name}: {error}; change or remove this write.") from None
        done.append(f"{object_text.shown_key(at)} {node.name(at)} = {value}".replace("  ", " "))
    for pdo in device.pdos:
        _configure(node, device, pdo)
        done.append(f"{pdo.name} {'on' if pdo.enabled else 'off'}")
    return done


def _configure(node: NodeAccess, device: BusYmlDevice, pdo: BusPdo) -> None:
    index = pdo_settings.index_of(pdo.name)
    if not pdo.enabled:
        return _disable(node, device, pdo, index)
    settings = {"cob_id": _cob_id(node, device, pdo), "type": pdo.transmission, "inhibit": pdo.inhibit,
                "event_timer": pdo.event_timer}
    mapped = None if pdo.mapping is None else pdo_settings.words(
        ",".join(f"{at:04X}:{sub:02X}" for at, sub in pdo.mapping), node.dictionary)
    pdo_settings.configure(node.link, device.node_id, index, mapped,
                           {name: value for name, value in settings.items() if value is not None})


def _disable(node: NodeAccess, device: BusYmlDevice, pdo: BusPdo, index: int) -> None:
    try:
        old = int.from_bytes(node.link.sdo_read(device.node_id, index, 1), "little")
        cob_id = _cob_id(node, device, pdo)
        off = (old if cob_id is None else old & ~0x7FF | cob_id) | COB_ID_INVALID
        node.link.sdo_write(device.node_id, index, 1, off.to_bytes(4, "little"))
    except SdoError as error:
        raise InputError(f"{device.name}: {pdo.name}: {error}; remove it from the file.") from None


def _cob_id(node: NodeAccess, device: BusYmlDevice, pdo: BusPdo) -> int | None:
    """Return the identifier that the file gives; "auto" is CiA 301's for PDO 1 to 4, else the EDS's."""
    if pdo.cob_id != "auto":
        return None if pdo.cob_id is None else int(pdo.cob_id)
    number = int(pdo.name[4:])
    if number <= 4:
        return (TPDO_BASE if pdo.name.startswith("t") else RPDO_BASE) + 0x100 * (number - 1) + device.node_id
    entry = None if node.dictionary is None else node.dictionary.entries.get(
        key(pdo_settings.index_of(pdo.name), 1))
    return entry.initial & 0x7FF if entry is not None and isinstance(entry.initial, int) else None


def described(link: Link, found: FoundNode) -> BusYmlDevice:
    """Return a node as a device of a file: identity, heartbeat, PDOs as they are set now."""
    identity = {name: number for name, number in (found.identity or {}).items() if name != "device_type"}
    names = {"vendor": "vendor_id", "product": "product_code", "revision": "revision_number", "serial": "serial_number"}
    heartbeat = NodeAccess(link, found.node_id).number(_HEARTBEAT)
    other = {names[name]: number for name, number in identity.items()}
    if heartbeat:
        other["heartbeat_producer"] = heartbeat
    dictionary = found.dictionary
    file = "" if dictionary is None else Path(dictionary.path).name
    pdos = tuple(_pdos(link, found.node_id, dictionary))
    return BusYmlDevice(f"node_{found.node_id}", found.node_id, file, pdos, (), other)


def _pdos(link: Link, node_id: int, dictionary: Dictionary | None) -> Iterator[BusPdo]:
    for state in pdo_settings.read_all(link, node_id, dictionary):
        timer = state.parameters["event_timer"] if state.object >= TPDO else None  # of an RPDO it is the deadline
        yield BusPdo(state.name, state.valid, (state.parameters["cob_id"] or 0) & 0x7FF, state.parameters["type"],
                     state.parameters["inhibit"] or None, timer or None,
                     tuple((word >> 16, word >> 8 & 0xFF) for word in state.mapping))
