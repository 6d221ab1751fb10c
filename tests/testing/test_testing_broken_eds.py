"""Classes of defects of vendors' EDS files, and EDS files that are broken at random: a node boots, or `InputError`."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import nodes
from bowden.testing import CanBus
from bowden.testing.conversation import SdoStep, converse
from eds.dictionary import packaged
from parameters import InputError

TEXT = packaged("tension_sensor").read_text()
DEFECTS = {
    "no sub-objects": "[2500]\nParameterName=a\nObjectType=9\nSubNumber=3\n",
    "unknown data type": "[2500]\nParameterName=a\nDataType=0x0040\nAccessType=rw\nDefaultValue=1\n",
    "no data type": "[2500]\nParameterName=a\nAccessType=rw\n",
    "value that its type cannot hold": "[2500]\nDataType=5\nAccessType=rw\nDefaultValue=300\n",
    "value that is no number": "[2500]\nDataType=7\nAccessType=rw\nDefaultValue=many\n",
    "limits turned round": "[2500]\nDataType=5\nAccessType=rw\nDefaultValue=5\nLowLimit=9\nHighLimit=1\n",
    "unknown access": "[2500]\nDataType=5\nAccessType=rx\n",
    "two sections of one object": "[2500]\nDataType=5\n[2500]\nDataType=7\n",
    "sub-index beyond 8 bits": "[2500sub1FF]\nDataType=5\n",
    "compact array of any length": "[2500]\nObjectType=8\nDataType=5\nCompactSubObj=300\n",
    "mapping of an absent object": "[1A09]\nObjectType=9\nSubNumber=2\n[1A09sub0]\nDataType=5\nDefaultValue=1\n"
                                   "[1A09sub1]\nDataType=7\nDefaultValue=0x55550010\n",
    "mapping over 64 bits": "[1A09]\nObjectType=9\n[1A09sub0]\nDataType=5\nDefaultValue=64\n[1A09sub1]\nDataType=7\n",
    "formula in a COB-ID": "[1809sub1]\nDataType=7\nDefaultValue=$NODEID + 0x180 + 1\n",
    "octal and signed hexadecimal": "[2500]\nDataType=3\nDefaultValue=-0x10\nLowLimit=010\n",
    "byte order mark and no line end": "[2500]\nDataType=9\nDefaultValue=\ufeff",
    "not a section": "[2500\nDataType=5\n]\n=\n==\n;\n",
}


def boots(path: Path) -> bool:
    """Boot a node and read some of it; False where the file is refused with `InputError`."""
    bus = CanBus()
    try:
        node = bus.add_node(path, 5, profile=nodes.GenericDrive())
        faults = node.eds_faults
    except InputError:
        return False
    assert all(isinstance(fault, str) for fault in faults)
    answers = converse(bus, 5, [SdoStep(index, sub) for index, sub in ((0x1000, 0), (0x2500, 0), (0x1A09, 1))])
    assert not any(answer.silent for answer in answers)
    return True


@pytest.mark.parametrize("defect", DEFECTS.values(), ids=DEFECTS)
def test_a_node_boots_in_spite_of_each_defect(tmp_path: Path, defect: str) -> None:
    path = tmp_path / "vendor.eds"
    path.write_text(TEXT + "\n" + defect, encoding="utf-8")
    assert boots(path)


LINES = TEXT.split("\n")
KINDS = ("drop", "twice", "cut", "value", "noise")
CHANGES = st.lists(st.tuples(st.integers(0, len(LINES) - 1), st.sampled_from(KINDS), st.text(max_size=8)), min_size=1,
                   max_size=30)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(CHANGES)
def test_a_broken_eds_boots_or_is_refused_in_a_sentence(tmp_path: Path, changes: list[tuple[int, str, str]]) -> None:
    lines = list(LINES)
    for place, kind, text in changes:
        line = lines[place]
        lines[place] = {"drop": "", "twice": f"{line}\n{line}", "cut": line[:len(line) // 2],
                        "value": f"{line.partition('=')[0]}={text}", "noise": text}[kind]
    path = tmp_path / "broken.eds"
    path.write_text("\n".join(lines), encoding="utf-8", errors="surrogateescape")
    boots(path)
