"""`bowden check eds`: each fault planted in a sound file is found where it is, with its remedy, and nothing else is."""

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import eds
from eds.files import check, ini
from parameters import InputError

SERVO = eds.packaged("servo_drive").read_text()
SENSOR = eds.packaged("tension_sensor").read_text()


def edit(text, section, **keys):
    """Set keys of a section."""
    head, body, tail = re.split(rf"(?<=\[{section}\]\n)((?:[^\[\n].*\n|\n)*)", text, maxsplit=1)
    for name, value in keys.items():
        body, count = re.subn(rf"^{name}=.*\n", f"{name}={value}\n", body, flags=re.MULTILINE)
        if not count:
            body = f"{name}={value}\n{body}"
    return head + body + tail


def without(text, section):
    return re.sub(rf"\[{section}\]\n(?:[^\[\n].*\n|\n)*", "", text)


def found(tmp_path, text, name="planted.eds"):
    path = tmp_path / name
    path.write_text(text)
    return check.findings(path)


PLANTED = {
    "not mappable": (SERVO, "1A00sub1", "DefaultValue", "0x60650020", "6065:00 .* PDOMapping=0", "in .6065."),
    "wrong length": (SERVO, "1A00sub1", "DefaultValue", "0x60640010", "16 bits, INTEGER32 has 32", "0x60640020"),
    "absent object": (SERVO, "1A00sub1", "DefaultValue", "0x55550010", "5555:00", "describe it"),
    "dummy in a TPDO": (SERVO, "1A00sub1", "DefaultValue", "0x00060010", "no dummy", "RPDO"),
    "dummy forbidden": (SERVO, "1600sub1", "DefaultValue", "0x00010001", "no dummy", "DummyUsage"),
    "sent, not readable": (SERVO, "1A00sub1", "DefaultValue", "0x607A0020", "is sent .* rww", "AccessType=ro"),
    "received, read-only": (SERVO, "1600sub1", "DefaultValue", "0x60410010", "is received .* ro", "AccessType=rww"),
    "RPDOs miscounted": (SERVO, "DeviceInfo", "NrOfRXPDO", "5", "4 PDOs .* says 5", "NrOfRXPDO=4"),
    "TPDOs uncounted": (SERVO, "DeviceInfo", "NrOfTXPDO", "", "4 PDOs .* says None", "NrOfTXPDO=4"),
    "statusword writable": (SERVO, "6041", "AccessType", "rw", "rw, but CiA 402 says ro", "AccessType=ro"),
    "controlword read-only": (SERVO, "6040", "AccessType", "ro", "ro, but CiA 402 says rw", "AccessType=rw"),
    "limit's type": (SERVO, "607Dsub1", "DataType", "0x0008", "REAL32, but CiA 402 says INTEGER32", "0x0004"),
    "sensor's type": (SENSOR, "6132sub1", "DataType", "0x0006", "CiA 404 says UNSIGNED8", "0x0005"),
    "sensor's access": (SENSOR, "6150sub1", "AccessType", "rw", "CiA 404 says ro", "AccessType=ro"),
    "core's type": (SERVO, "1017", "DataType", "0x0007", "CiA 301 says UNSIGNED16", "0x0006"),
    "identifier zero": (SERVO, "1800sub1", "DefaultValue", "0x0", "COB-ID 0", "bit 31"),
    "identifier twice": (SERVO, "1801sub1", "DefaultValue", "$NODEID+0x180", "1800:01 too", "bit 31"),
    "identifier reserved": (SERVO, "1800sub1", "DefaultValue", "0x180", "180h is reserved", r"\$NODEID"),
    "identifier too large": (SERVO, "1014", "DefaultValue", "0x880", "too large", "57Fh"),
    "transmission type": (SERVO, "1800sub2", "DefaultValue", "245", "245 is reserved", "254"),
    "list miscounted": (SERVO, "MandatoryObjects", "SupportedObjects", "2", "3 objects", "SupportedObjects=3"),
    "listed twice": (SERVO, "MandatoryObjects", "3", "0x1001", "listed already", "delete"),
    "listed as a word": (SERVO, "MandatoryObjects", "3", "identity", "no object index", "0x"),
    "listed wrongly": (SERVO, "ManufacturerObjects", "1", "0x1018", "listed already", "delete"),
    "listed, absent": (SERVO, "MandatoryObjects", "3", "0x10FF", "10FF is listed, but has no section", "add"),
    "SubNumber": (SERVO, "1018", "SubNumber", "4", "5 sub-objects", "SubNumber=5"),
    "highest sub-index": (SERVO, "1018sub0", "DefaultValue", "6", "highest sub-index 6", "=4"),
    "sub-index 0's type": (SERVO, "1018sub0", "DataType", "0x0006", "no UNSIGNED8", "0x0005"),
    "variable with subs": (SERVO, "1018", "ObjectType", "0x7", "sub-objects", "0x9"),
    "no name": (SERVO, "6064", "ParameterName", "", "no name", "name it"),
    "no type": (SERVO, "2014", "DataType", "", "missing", "CiA 301"),
    "no access type": (SERVO, "2014", "AccessType", "yes", "yes is no access type", "ro, wo"),
    "no number": (SERVO, "6072", "DefaultValue", "much", "much is no value of UNSIGNED16", "number"),
    "limits crossed": (SERVO, "6098", "LowLimit", "40", "40 is above HighLimit 37", "swap"),
    "default out of limits": (SERVO, "605A", "DefaultValue", "6", "6 is outside", "limits"),
    "limit out of type": (SERVO, "6098", "HighLimit", "400", "400 is no value of INTEGER8", "fits"),
    "vendors disagree": (SERVO, "DeviceInfo", "VendorNumber", "0x1", "1018:01 says B0DE00h", "agree"),
}


@pytest.mark.parametrize("fault", PLANTED)
def test_a_planted_fault_is_found_where_it_is(tmp_path, fault):
    base, section, key, value, said, remedy = PLANTED[fault]
    text = edit(base, section, **{key: value})
    findings = found(tmp_path, text)
    hits = [f for f in findings if (f.section, f.key) == (section, key) and re.search(said, f.text)]
    assert len(hits) == 1, findings
    assert re.search(remedy, hits[0].remedy)
    assert text.splitlines()[hits[0].line - 1] in (f"{key}={value}", f"[{section}]")
    assert str(hits[0]).startswith(f"{tmp_path}/planted.eds:{hits[0].line}: [{section}] {key}: {hits[0].text}")


def test_a_map_whose_entry_has_no_value_is_found(tmp_path):
    (finding,) = found(tmp_path, edit(SERVO, "1A00sub1", DefaultValue=""))
    assert (finding.section, finding.text) == ("1A00sub0", "1 objects are mapped, but sub-index 1 has no value")


def test_a_controlword_of_the_wrong_type_is_found_at_the_object_and_in_the_maps(tmp_path):
    findings = found(tmp_path, edit(SERVO, "6040", DataType="0x0007"))
    assert {f.section for f in findings} == {"6040", "1600sub1", "1601sub1", "1602sub1", "1603sub1"}
    assert "UNSIGNED32, but CiA 402 says UNSIGNED16" in [f.text for f in findings]


def test_a_key_twice_and_a_section_of_no_object_are_found(tmp_path):
    (finding,) = found(tmp_path, SERVO.replace("[6064]\n", "[6064]\nPDOMapping=1\n"))
    assert (finding.section, finding.key, finding.text) == ("6064", "pdomapping", "the key stands 2 times")
    (finding,) = found(tmp_path, SERVO.replace("[60FD]", "[60FDsubXX]\n[60FD]"))
    assert (finding.section, finding.text) == ("60FDsubXX", "neither an object nor a known section")


def test_an_object_in_the_wrong_list_is_found(tmp_path):
    text = edit(without(SERVO, "ManufacturerObjects"), "MandatoryObjects", SupportedObjects="4", **{"4": "0x2014"})
    assert ("MandatoryObjects", "4", "2014 stands in the wrong list") in [
        (f.section, f.key, f.text) for f in found(tmp_path, text)]


def test_an_over_long_map_is_found_once(tmp_path):
    text = edit(SERVO, "1A00sub0", DefaultValue="3")
    for sub, word in ((2, "0x60640020"), (3, "0x606C0020")):
        text = edit(text, f"1A00sub{sub}", DefaultValue=word)
    (finding,) = found(tmp_path, text)
    assert (finding.section, finding.key) == ("1A00sub0", "DefaultValue")
    assert "80 bits" in finding.text


def test_an_object_mapped_twice_is_found_at_its_second_place(tmp_path):
    text = edit(edit(SERVO, "1A00sub0", DefaultValue="2"), "1A00sub2", DefaultValue="0x60410010")
    (finding,) = found(tmp_path, text)
    assert (finding.section, finding.text) == ("1A00sub2", "6041:00 is mapped twice")


def test_a_section_twice_is_found_with_the_line_of_the_first(tmp_path):
    (finding,) = found(tmp_path, SERVO + "\n[6064]\nParameterName=Again\n")
    assert finding.section == "6064"
    assert finding.text.endswith(f"in line {SERVO[: SERVO.index('[6064]')].count(chr(10)) + 1}")


MISSING = {
    "communication record": (without(SERVO, "1402"), ["sub-object of 1402", "listed, but has no section"]),
    "modes": (without(SERVO, "6502"), ["CiA 402 demands 6502", "6502 is listed"]),
    "a mode's objects": (without(without(SERVO, "60FF"), "606C"), ["CSV is offered without 60FF", "without 606C"]),
    "sub-index 0": (without(SERVO, "1018sub0"), ["sub-index 0 is missing"]),
    "a list": (without(SERVO, "OptionalObjects"), [r"\[OptionalObjects\] is missing", "in none of the lists"]),
    "DeviceInfo": (without(SERVO, "DeviceInfo"), [r"\[DeviceInfo\] is missing"]),
    "map entries": (edit(SERVO, "1A00sub0", DefaultValue="99"), ["99 mapped objects", "sub-index 9 has no value"]),
}


@pytest.mark.parametrize("what", MISSING)
def test_what_is_missing_is_found(tmp_path, what):
    text, expected = MISSING[what]
    texts = [f.text for f in found(tmp_path, text)]
    for said in expected:
        assert any(re.search(said, t) for t in texts), texts


def test_a_map_without_its_communication_record_is_found(tmp_path):
    text = SERVO
    for section in ("1403", *(f"1403sub{sub}" for sub in (0, 1, 2, 5))):
        text = without(text, section)
    assert "1603 is there without 1403" in [f.text for f in found(tmp_path, text)]


DRESSES = {
    "crlf": lambda text: text.replace("\n", "\r\n").encode(),
    "utf16": lambda text: text.encode("utf-16"),
    "umlauts": lambda text: text.replace("Servo drive", "Antrieb für Seilzüge").encode("cp1252"),
    "signed hex": lambda text: text.replace("LowLimit=-1\n", "LowLimit=0xFF\n").encode(),
    "node id last": lambda text: text.replace("$NODEID+0x80\n", "0x80+$NODEID\n").encode(),
    "node id spaced": lambda text: text.replace("$NODEID+", "$NodeID + ").encode(),
    "lower case": lambda text: text.replace("ParameterName", "parametername").replace("DataType", "datatype").encode(),
    "empty default": lambda text: edit(text, "6064", DefaultValue="").encode(),
}


@pytest.mark.parametrize("dress", DRESSES)
def test_a_sound_file_in_a_vendors_dress_has_no_findings(tmp_path, dress):
    path = tmp_path / "vendor.eds"
    path.write_bytes(DRESSES[dress](SERVO))
    assert check.findings(path) == []


@settings(max_examples=60)
@given(st.data())
def test_no_damage_stops_the_search(tmp_path_factory, data):
    lines = SENSOR.splitlines()
    for _ in range(data.draw(st.integers(1, 30))):
        at = data.draw(st.integers(0, len(lines) - 1))
        lines[at] = data.draw(st.sampled_from([
            "", "[", "[6130sub1]", "DataType=", "DefaultValue=-", "SubNumber=$NODEID", lines[at][::-1], f"{lines[at]}0",
        ]))
    path = tmp_path_factory.getbasetemp() / "damaged.eds"
    path.write_text("\n".join(lines))
    for finding in check.findings(path):
        assert finding.text
        assert finding.remedy
        assert 1 <= finding.line <= len(lines)


def test_a_binary_file_is_refused_and_utf_16_is_read(tmp_path: Path) -> None:
    path = tmp_path / "trial.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)) * 9 + b"\n[1000]\nParameterName=Device type\n")
    with pytest.raises(InputError, match="is binary, no text"):
        ini.read(path)
    path.write_bytes("[1000]\nParameterName=Ger\u00e4tetyp\n".encode("utf-16"))
    assert [section.line for section in ini.read(path)] == [1]
