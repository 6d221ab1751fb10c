"""What `bowden.testing` loads: no compiler, no SciPy; devices, bus and a generic drive work without them."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("numba", "llvmlite", "scipy", "matplotlib", "threadpoolctl")
USED = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent!r}:
            raise ModuleNotFoundError("No module named " + repr(name), name=name)
sys.meta_path.insert(0, Absent())
{program}
print(sorted(set(sys.modules) & set({heavy!r})))
"""
IMPORT = "import bowden.testing"
BUS = """
import nodes
from bowden.testing import CanBus
from bowden.testing.conversation import SdoStep, converse
bus = CanBus()
drive = bus.add_node("knee_drive", 5, profile=nodes.GenericDrive())
converse(bus, 5, [SdoStep(0x6040, 0, b"\\x06\\x00")])
assert drive[0x6041] & 0x6F == 0x21
"""


@pytest.mark.parametrize("program", [IMPORT, BUS], ids=["import", "bus"])
@pytest.mark.parametrize("absent", [(), HEAVY], ids=["installed", "absent"])
def test_no_compiler_is_loaded(program: str, absent: tuple[str, ...]) -> None:
    text = USED.format(program=program, absent=absent, heavy=(*HEAVY, "numpy") if program == IMPORT else HEAVY)
    done = subprocess.run([sys.executable, "-c", text], text=True, capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (0, "[]\n"), done.stderr
