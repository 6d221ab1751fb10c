"""The reader agrees with canopen's on sound files, and survives what vendors write."""

import re

import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eds import dictionary
from eds.datatype import BY_CODE, DataType, decode, encode
from eds.dictionary import key
from eds.files import ini
from eds.files.notation import limit, number, value
from parameters import InputError

NODE = 3


def flat(od):
    """canopen's dictionary as {key: variable}, without its stand-ins for dummies."""
    found = {}
    for index, item in od.items():
        if index >= 0x1000:
            parts = [item] if isinstance(item, canopen.objectdictionary.ODVariable) else item.values()
            found |= {key(index, part.subindex): part for part in parts}
    return found


def as_bytes(item):
    return item.encode("latin-1") if isinstance(item, str) else item


@pytest.mark.parametrize("name", dictionary.PACKAGED)
def test_every_object_reads_as_canopen_reads_it(name):
    path = dictionary.packaged(name)
    ours, od = dictionary.read(path, NODE), canopen.import_od(str(path), NODE)
    theirs = flat(od)
    assert set(ours.entries) == set(theirs)
    for at, entry in ours.entries.items():
        peer = theirs[at]
        assert (entry.name, entry.data_type, entry.access) == (peer.name, peer.data_type, peer.access_type)
        assert (entry.low, entry.high, entry.mappable) == (peer.min, peer.max, peer.pdo_mappable)
        assert entry.default == as_bytes(peer.default)
        assert (entry.readable, entry.writable) == (peer.readable, peer.writable)
    assert ours.dummies == {index for index in od if index < 0x1000}


def test_vendor_text_in_any_dress_reads_the_same(tmp_path):
    text = dictionary.packaged("tension_sensor").read_text(encoding="utf-8")
    plain = dictionary.build("", list(ini.parse(text)), NODE)
    dressed = {
        "crlf": text.replace("\n", "\r\n").encode(),
        "cr": text.replace("\n", "\r").encode(),
        "bom": text.encode("utf-8-sig"),
        "utf16": text.encode("utf-16"),
        "cp1252": text.replace("[FileInfo]", "; Gerät für Kräfte\n[FileInfo]").encode("cp1252"),
        "shouting": re.sub(r"sub(?=[0-9A-F]+\])", "SUB", text).replace("ParameterName", "PARAMETERNAME").encode(),
        "spaced": text.replace("=", " = ").replace("\n", "  \n").encode(),
        "commented": text.replace("AccessType=ro", "AccessType=ro ; may be read").encode(),
        "ended": text.encode() + b"\x1a",
    }
    for name, data in dressed.items():
        path = tmp_path / f"{name}.eds"
        path.write_bytes(data)
        read = dictionary.read(path, NODE)
        assert read.entries == plain.entries, name
        assert read.objects == plain.objects, name


@pytest.mark.parametrize(("text", "expected"), [
    ("0x10", 16), ("0X1f", 31), (" 12 ", 12), ("-5", -5), ("-0x80", -128), ("0x-80", -128), ("017", 15), ("0", 0),
    ("00", 0),
    ("80h", 128), ("+7", 7), ("$NODEID", 9), ("$NODEID+0x180", 0x189), ("0x180+$NODEID", 0x189),
    ("$NodeId + 384", 0x189),
    ("NODEID+0x600", 0x609), ("$NODEID+0x80000200", 0x80000209), ("", None), (None, None), ("abc", None),
    ("1_000", None),
    ("5-3", None), ("0x", None), ("$NODEID+x", None), ("1.5", None), ("٣", None),
])
def test_numbers_as_vendors_write_them(text, expected):
    assert number(text, 9) == expected


def test_a_node_id_that_nobody_gave_leaves_no_value():
    assert number("$NODEID+0x180") is None


@pytest.mark.parametrize(("kind", "text", "expected"), [
    (DataType.INTEGER16, "0xFFFF", -1), (DataType.INTEGER16, "0xFFFFFFFF", -1), (DataType.INTEGER8, "0x80", -128),
    (DataType.INTEGER32, "0x80000000", -(2**31)), (DataType.INTEGER16, "70000", None),
    (DataType.UNSIGNED16, "-1", 0xFFFF),
    (DataType.UNSIGNED8, "256", None), (DataType.INTEGER64, "0xFFFFFFFFFFFFFFFF", -1),
    (DataType.UNSIGNED32, "-0x1", 2**32 - 1),
    (DataType.VISIBLE_STRING, "Kraft", b"Kraft"), (DataType.OCTET_STRING, "0aFF", b"\x0a\xff"),
    (DataType.DOMAIN, "zz", None),
    (DataType.REAL32, "1.5", 1.5), (DataType.REAL32, "0xC1A00000", None), (DataType.BOOLEAN, "1", 1),
    (DataType.UNICODE_STRING, "é", b"\xe9\x00"),
])
def test_values_are_brought_into_their_type(kind, text, expected):
    assert value(kind, text) == expected


def test_limits_have_an_order_or_none():
    assert limit(DataType.INTEGER8, "0xFF") == -1
    assert limit(DataType.REAL32, "-2.5") == -2
    assert limit(DataType.REAL32, "inf") is None
    assert limit(DataType.VISIBLE_STRING, "1") is None


@given(st.sampled_from([kind for kind in DataType if kind.integer]), st.data())
def test_integers_survive_the_wire(kind, data):
    given_value = data.draw(st.integers(kind.low, kind.high))
    assert decode(kind, encode(kind, given_value)) == given_value
    assert len(encode(kind, given_value)) == kind.size


def test_values_of_the_wrong_kind_are_not_encoded():
    wrongs = ((DataType.UNSIGNED8, 1.0), (DataType.UNSIGNED8, b"1"), (DataType.REAL32, b"1"), (DataType.DOMAIN, 1))
    for kind, wrong in wrongs:
        with pytest.raises(TypeError):
            encode(kind, wrong)
    with pytest.raises(OverflowError):
        encode(DataType.UNSIGNED8, 256)
    with pytest.raises(ValueError, match="2 bytes"):
        decode(DataType.UNSIGNED16, b"1")
    assert decode(DataType.REAL64, encode(DataType.REAL64, 0.1)) == 0.1
    assert decode(DataType.DOMAIN, encode(DataType.DOMAIN, b"abc")) == b"abc"
    assert {kind.zero for kind in BY_CODE.values()} == {0, b"", bytes(6)}


BROKEN = """
stray=1
[DeviceComissioning]
NodeID=0x11
[DummyUsage]
Dummy0002=1
Dummy0005=0
nonsense=1
[6040]
ParameterName=Controlword
DataType=6
AccessType=RWW
PDOMapping=1
[6040]
ParameterName=Second
DataType=7
[2000]
ObjectType=0x8
ParameterName=Tension
CompactSubObj=3
DataType=0x3
AccessType=ro
DefaultValue=-7
[2000Name]
NrOfEntries=1
2=Middle
[2000Value]
NrOfEntries=1
3=12
[2001]
ParameterName=No type
[2002]
ParameterName=File
ObjectType=2
[2003]
ParameterName=Own type
DataType=0x00A0
[A0sub1]
DefaultValue=0x5
[2004]
ParameterName=Unknown type
DataType=0x0055
[2005]
ParameterName=From DCF
DataType=7
DefaultValue=$NODEID+0x180
ParameterValue=0x99
[2006sub1]
ParameterName=Orphan
DataType=5
DefaultValue=
[2007
not a line
"""


def test_a_broken_file_gives_what_can_be_read():
    found = dictionary.build("broken.dcf", list(ini.parse(BROKEN)))
    at = found.entries
    assert found.node_id == 0x11
    assert found.dummies == {2}
    assert (at[key(0x6040)].name, at[key(0x6040)].data_type, at[key(0x6040)].access) == ("Controlword", 6, "rww")
    names = [at[key(0x2000, sub)].name for sub in range(4)]
    assert names == ["Number of entries", "Tension1", "Middle", "Tension3"]
    assert [at[key(0x2000, sub)].initial for sub in range(4)] == [3, -7, -7, 12]
    assert key(0x2001) not in at
    assert found.objects[0x2001].subindices == ()
    assert at[key(0x2002)].data_type is DataType.DOMAIN
    assert at[key(0x2003)].data_type is DataType.UNSIGNED8
    assert at[key(0x2004)].data_type is DataType.DOMAIN
    assert (at[key(0x2005)].default, at[key(0x2005)].initial, at[key(0x2005)].relative) == (0x191, 0x99, True)
    assert at[key(0x2006, 1)].initial == 0
    assert found.objects[0x2006].object_type == dictionary.RECORD


def test_a_file_that_is_none_is_refused_with_its_name(tmp_path):
    missing, empty, other = tmp_path / "missing.eds", tmp_path / "empty.eds", tmp_path / "other.eds"
    empty.write_text("")
    other.write_text("[General]\na=1\n")
    for path, said in (
        (missing, "no such file"), (empty, "no section"), (other, "no object section"), (tmp_path, "cannot be read"),
    ):
        with pytest.raises(InputError, match=said):
            dictionary.read(path)
    with pytest.raises(InputError, match="no packaged EDS"):
        dictionary.packaged("brake")


def test_asking_for_what_a_device_lacks_is_bad_input():
    device = dictionary.read(dictionary.packaged("knee_drive"), 2)
    assert device.mapping(0x1A00) == [0x60410010]
    assert device.mapping(0x1AFF) == []
    with pytest.raises(InputError, match="9999:01"):
        device.initial(0x9999, 1)
    with pytest.raises(InputError, match="1008:00"):
        device.initial(0x1008)


SOUP = st.text(alphabet="[]=0x1aSub6040$NODEID\n\r; -ParmetDyTcsVlu", max_size=400).map(str.encode)


@given(st.binary(max_size=400) | SOUP)
def test_no_text_stops_the_reader(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "soup.eds"
    path.write_bytes(b"[1000]\nParameterName=Device type\nDataType=7\n" + data)
    try:
        assert key(0x1000) in dictionary.read(path).entries
    except InputError as refused:
        assert "is binary, no text" in str(refused)  # noqa: PT017 - either answer is right
        assert any(byte < 32 and byte not in b"\t\n\f\r\x1a\0" for byte in data)
