"""The packaged EDS files: accepted by independent readers, and holding what the devices promise."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import canopen
import pytest

from eds import dictionary
from eds.cia402 import Mode
from eds.dictionary import key
from eds.files import check

NODE = 5
CORE = (
    0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1007, 0x1008, 0x1009, 0x100A, 0x1010, 0x1011, 0x1014, 0x1015, 0x1016,
    0x1017,
    0x1018, 0x1019, 0x1020, 0x1029, 0x1200, 0x1800, 0x1801, 0x1A00, 0x1A01,
)
DRIVE = (
    0x1400, 0x1401, 0x1402, 0x1403, 0x1600, 0x1601, 0x1602, 0x1603, 0x1802, 0x1803, 0x1A02, 0x1A03, 0x2020, 0x6007,
    0x603F,
    0x6040, 0x6041, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6060, 0x6061, 0x6062, 0x6064, 0x6065, 0x6066, 0x606B,
    0x606C,
    0x6071, 0x6072, 0x6074, 0x6076, 0x6077, 0x607A, 0x607C, 0x607D, 0x6080, 0x6084, 0x6085, 0x608F, 0x6091, 0x6092,
    0x6098,
    0x6099, 0x609A, 0x60A8, 0x60A9, 0x60B1, 0x60B2, 0x60C2, 0x60E0, 0x60E1, 0x60F4, 0x60F9, 0x60FB, 0x60FD, 0x60FF,
    0x6502,
)
SERVO = (0x2010, 0x2011, 0x2012, 0x2013, 0x2014, 0x2015, 0x2016)
SENSOR = (
    0x6110, 0x6112, 0x6114, 0x6120, 0x6121, 0x6122, 0x6123, 0x6124, 0x6125, 0x6126, 0x6127, 0x6130, 0x6131, 0x6132,
    0x6148,
    0x6149, 0x6150, 0x61A0, 0x61A1, 0x7130, 0x9130,
)
ENCODER = (0x6000, 0x6001, 0x6002, 0x6004, 0x6010, 0x6020)
PROMISED = {"servo_drive": (*CORE, *DRIVE, *SERVO), "knee_drive": (*CORE, *DRIVE), "tension_sensor": (*CORE, *SENSOR),
            "joint_encoder": (*CORE, *ENCODER)}
TYPES = {"servo_drive": 0x00020192, "knee_drive": 0x00020192, "tension_sensor": 0x00020194,
         "joint_encoder": 0x00010196}


def read(name):
    return dictionary.read(dictionary.packaged(name), NODE)


@pytest.mark.parametrize("name", dictionary.PACKAGED)
def test_a_device_holds_every_object_it_promises(name):
    found = read(name)
    assert [f"{index:04X}" for index in PROMISED[name] if index not in found.objects] == []
    assert found.initial(0x1000) == TYPES[name]


@pytest.mark.parametrize("name", dictionary.PACKAGED)
def test_dcfchk_accepts_the_file(name):
    command = [Path(sys.executable).with_name("dcfchk"), "-n", str(NODE), dictionary.packaged(name)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("name", dictionary.PACKAGED)
def test_our_own_check_finds_nothing(name):
    assert check.findings(dictionary.packaged(name)) == []


@pytest.mark.parametrize("name", ["servo_drive", "knee_drive"])
def test_drives_offer_their_modes_and_take_every_dummy(name):
    found = read(name)
    modes = Mode.HOMING, Mode.CSP, Mode.CSV, Mode.CST
    assert found.initial(0x6502) == sum(mode.supported_bit for mode in modes)
    assert found.dummies == {2, 3, 4, 5, 6, 7}


def test_the_servo_refuses_stops_that_hold_the_rope():
    assert read("servo_drive").entries[key(0x605A)].high == 2
    assert read("knee_drive").entries[key(0x605A)].high == 6


def test_files_stay_plain_ascii_text():
    for name in dictionary.PACKAGED:
        data = dictionary.packaged(name).read_bytes()
        assert data.isascii()
        assert b"\r" not in data


SCRIPT = """
const { Eds } = require('canopen');
const rows = {};
for (const [key, object] of Object.entries(Eds.fromFile(process.argv[1]).dataObjects)) {
  const single = object.subNumber === undefined;
  const parts = single ? [[0, object]] : Array.from({ length: 255 }, (_, sub) => [sub, object.at(sub)]);
  for (const [sub, part] of parts) if (part) rows[Number(key) * 256 + sub] =
    [part.parameterName, part.dataType, part.accessType, part.lowLimit ?? 0, part.highLimit ?? 0, part.pdoMapping,
     part.defaultValue ?? '', part.raw.toString('hex'), object.parameterName, object.objectType];
}
console.log(JSON.stringify(rows));
"""


def node_modules():
    """Where npm's canopen is: BOWDEN_NODE_MODULES, else `npm root`; None where node or the package is absent."""
    given = os.environ.get("BOWDEN_NODE_MODULES")
    if given is None and shutil.which("npm"):
        given = subprocess.run(["npm", "root"], capture_output=True, text=True, check=True).stdout.strip()
    return Path(given) if given and shutil.which("node") and (Path(given) / "canopen").is_dir() else None


def by_npm(name, modules):
    command = ["node", "-e", SCRIPT, str(dictionary.packaged(name))]
    environment = {**os.environ, "NODE_PATH": str(modules)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {int(at): tuple(row) for at, row in json.loads(done.stdout).items()}


def by_canopen(name):
    """canopen's dictionary in the same shape; limits of zero and absent limits are one thing to npm's reader."""
    rows = {}
    for index, item in canopen.import_od(str(dictionary.packaged(name)), NODE).items():
        single = isinstance(item, canopen.objectdictionary.ODVariable)
        kind = 7 if single else 8 if isinstance(item, canopen.objectdictionary.ODArray) else 9
        for part in [item] if single else item.values():
            default = getattr(part, "default_raw", "")
            raw = part.encode_raw(part.default).hex() if part.default is not None else ""
            rows[key(index, part.subindex)] = (
                part.name, part.data_type, part.access_type, part.min or 0, part.max or 0,
                str(int(part.pdo_mappable)), default, raw, item.name, kind)
    return {at: row for at, row in rows.items() if at >> 8 >= 0x1000}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", dictionary.PACKAGED)
def test_npm_canopen_reads_the_same_dictionary(name):
    modules = node_modules()
    if modules is None:
        pytest.skip("npm's canopen is absent; name a node_modules that has it in BOWDEN_NODE_MODULES, node on the path")
    theirs, ours = by_npm(name, modules), by_canopen(name)
    assert sorted(theirs) == sorted(ours)
    for at, row in ours.items():
        assert theirs[at][:7] == row[:7], f"{at:06X}"
        assert theirs[at][8:] == row[8:], f"{at:06X}"
        counted = at & 0xFF == 0 and row[9] != 7  # npm raises sub-index 0 to the last sub-object of the file
        if row[6] and "$NODEID" not in row[6] and not counted:  # $NODEID has no number before a node has an id
            assert theirs[at][7] == row[7], f"{at:06X}"
