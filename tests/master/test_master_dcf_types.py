"""Backup and restore of a foreign device: every data type, strings that INI text cannot hold, PDOs, concise DCF."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import bowden as library
from bowden.testing import CanBus
from bowden.testing.strategies import values
from eds import dictionary
from eds.datatype import DataType
from eds.dictionary import key
from master.node_access import dcf
from parameters import InputError

FIRST = 0x2000
TYPES = [kind for kind in DataType if kind is not DataType.BOOLEAN] + [DataType.BOOLEAN]
COMPACT = 0x2100, DataType.VISIBLE_STRING


def eds_of_all_types(path: Path) -> Path:
    """Write an EDS with an object of each data type and a compact array of strings."""
    lines = ["[DeviceInfo]", "ProductName=All types", "", "[1000]", "ParameterName=Device type", "ObjectType=7",
             "DataType=7", "AccessType=ro", "DefaultValue=0x191"]
    for place, kind in enumerate(TYPES):
        lines += ["", f"[{FIRST + place:X}]", f"ParameterName={kind.name}", f"ObjectType={2 if kind == 15 else 7}",
                  f"DataType={int(kind):#x}", "AccessType=rw"]
    lines += ["", f"[{COMPACT[0]:X}]", "ParameterName=Names", "ObjectType=8", f"DataType={int(COMPACT[1]):#x}",
              "AccessType=rw", "CompactSubObj=3", "", "[DeviceComissioning]", "NodeID=99", "Baudrate=500"]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def eds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return eds_of_all_types(tmp_path_factory.mktemp("types") / "all.eds")


@contextmanager
def reached(bus: CanBus, eds: Path) -> Iterator[tuple[library.Node, dcf.NamedNode]]:
    """Yield node 5 as `bowden node` reaches it, and its entry."""
    bus.open()
    with library.Node(5, bus=library.simulated(channel=bus.channel), eds=eds) as node:
        assert node.dictionary is not None
        yield node, dcf.NamedNode(5, "node 5", node.dictionary)
    bus.close()


TEXTS = st.text(max_size=12).map(lambda text: text.encode("utf-8", "ignore")) | st.sampled_from(
    [b"", b" ", b"a ;b", b"line\nline\r", b"\xc3\xa9", b"\xe9", b"\0", b"01 02", b"x\x85", b"\xff\xfe", b"[1000]"])



@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_data_type_survives_backup_and_restore(eds: Path, tmp_path: Path, data: st.DataObject) -> None:
    described = dictionary.read(eds, 5)
    parameters = list(dcf.parameters(described))
    strings = (DataType.VISIBLE_STRING, DataType.OCTET_STRING, DataType.DOMAIN)
    wanted = {entry.key: data.draw(TEXTS | values(entry) if entry.data_type in strings else values(entry))
              for entry in parameters}
    bus = CanBus()
    device = bus.add_node(eds, 5)
    device.device.values.update(wanted)
    untouched = {at: device.device.objects.upload(at) for at in wanted}
    with reached(bus, eds) as (node, entry):
        path = tmp_path / "node.dcf"
        path.write_text(dcf.as_dcf(entry.dictionary, 5, dcf.backup(node.link, entry)), encoding="utf-8", newline="")
        file = dictionary.read(path)
        assert file.node_id == 5
        assert dcf.compare(node.link, entry, file) == []
        for one in parameters:
            device.device.values[one.key] = data.draw(values(one))
        dcf.restore(node.link, entry, file)
    assert {at: device.device.objects.upload(at) for at in wanted} == untouched


@pytest.mark.parametrize("line", ["ParameterValue=12 34 5", "ParameterOctets=zz"])
def test_a_file_that_cannot_be_read_is_refused_before_the_first_write(eds: Path, tmp_path: Path, line: str) -> None:
    at = FIRST + TYPES.index(DataType.OCTET_STRING)
    path = tmp_path / "node.dcf"
    path.write_text(eds.read_text().replace("[2000]", "[2000]\nParameterValue=7").replace(
        f"[{at:X}]", f"[{at:X}]\n{line}"))
    bus = CanBus()
    bus.add_node(eds, 5)
    with reached(bus, eds) as (node, entry):
        began_ns = bus.now_ns
        with pytest.raises(InputError, match=rf"\[{at:X}\] .* is no OCTET_STRING; .* nothing was written"):
            dcf.restore(node.link, entry, dictionary.read(path, 5))
    assert not bus.frames(0x605, since_ns=began_ns)


def test_the_settings_of_pdos_are_saved_and_written_in_the_order_of_cia_301(tmp_path: Path) -> None:
    bus = CanBus()
    device = bus.add_node("knee_drive", 5)
    path = tmp_path / "node.dcf"
    with reached(bus, dictionary.packaged("knee_drive")) as (node, entry):
        before = node.map_pdo("tpdo1", "6041,6064,6077")
        path.write_text(dcf.as_dcf(entry.dictionary, 5, dcf.backup(node.link, entry)), encoding="utf-8")
        node.map_pdo("tpdo1", "6077")
        began_ns = bus.now_ns
        dcf.restore(node.link, entry, dictionary.read(path))
        writes = [frame.data[1:4].hex() for frame in bus.frames(0x605, since_ns=began_ns) if frame.data[0] >> 5 == 1]
        assert node.pdos()[-4].mapping == before.mapping
        assert dcf.compare(node.link, entry, dictionary.read(path)) == []
    assert writes[:7] == ["001801", "001a00", "001a01", "001a02", "001a03", "001a00", "001801"]
    assert device[0x1A00] == 3


def test_a_concise_dcf_configures_another_device(tmp_path: Path) -> None:
    bus = CanBus()
    bus.add_node("knee_drive", 5)
    path = tmp_path / "node.dcf"
    with reached(bus, dictionary.packaged("knee_drive")) as (node, entry):
        node.map_pdo("tpdo1", "6041,6064,6077")
        node.write("6065", "1234")
        path.write_text(dcf.as_dcf(entry.dictionary, 5, dcf.backup(node.link, entry)), encoding="utf-8")
    file = dictionary.read(path)
    concise = dcf.concise(file)
    other = CanBus()
    device = other.add_node("knee_drive", 5)
    with reached(other, dictionary.packaged("knee_drive")) as (node, entry):
        count, concise = int.from_bytes(concise[:4], "little"), concise[4:]
        for _ in range(count):
            index, sub, size = int.from_bytes(concise[:2], "little"), concise[2], int.from_bytes(concise[3:7], "little")
            node.link.sdo_write(5, index, sub, concise[7:7 + size])
            concise = concise[7 + size:]
        assert dcf.compare(node.link, entry, file) == []
    assert concise == b""
    assert (device[0x1A00], device[0x6065]) == (3, 1234)
    assert key(0x1A00, 3) in file.entries
