"""Requirements of the profiles on their objects: data type, access, and mandatory objects.

Tables, one per profile, in the profile's own order; `eds.files.check` reads them. A row is `index[.sub] type access
[m]`: `.*` means every sub-index from 1, `m` mandatory.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from eds.cia402 import Mode
from eds.datatype import DataType

_TYPES: Final = MappingProxyType({
    "I8": DataType.INTEGER8, "I16": DataType.INTEGER16, "I24": DataType.INTEGER24, "I32": DataType.INTEGER32,
    "U8": DataType.UNSIGNED8, "U16": DataType.UNSIGNED16, "U32": DataType.UNSIGNED32, "F32": DataType.REAL32,
    "VS": DataType.VISIBLE_STRING,
})
_ACCESS: Final = MappingProxyType({
    "ro": frozenset({"ro", "const"}),
    "rw": frozenset({"rw", "rwr", "rww"}),
    "wo": frozenset({"wo", "rw", "rwr", "rww"}),
    "any": frozenset({"ro", "const", "rw", "rwr", "rww"}),
})


@dataclass(frozen=True, slots=True)
class Rule:
    """Requirement of a profile on an object; `subindex` None means every one from 1."""

    index: int
    subindex: int | None
    data_type: DataType
    access: frozenset[str]
    mandatory: bool

    @property
    def place(self) -> str:
        """index:sub, as messages show it."""
        return f"{self.index:04X}" if self.subindex == 0 else f"{self.index:04X}:{self.subindex or 1:02X}"


def _rules(table: str) -> Iterator[Rule]:
    for line in table.strip().splitlines():
        at, kind, access, *mandatory = line.split()
        index, _, sub = at.partition(".")
        subindex = None if sub == "*" else int(sub or "0", 16)
        yield Rule(int(index, 16), subindex, _TYPES[kind], _ACCESS[access], bool(mandatory))


CIA301: Final = tuple(_rules("""
1000   U32 ro m
1001   U8  ro m
1002   U32 ro
1003.0 U8  any
1003.* U32 ro
1005   U32 any
1006   U32 rw
1007   U32 rw
1008   VS  ro
1009   VS  ro
100A   VS  ro
100C   U16 any
100D   U8  any
1010.* U32 any
1011.* U32 any
1012   U32 any
1014   U32 any
1015   U16 rw
1016.* U32 any
1017   U16 any
1018.1 U32 ro m
1018.2 U32 ro
1018.3 U32 ro
1018.4 U32 ro
1019   U8  any
1020.* U32 rw
1028.* U32 any
1029.* U8  any
1200.1 U32 any
1200.2 U32 any
"""))

CIA402: Final = tuple(_rules("""
6007   I16 rw
603F   U16 ro
6040   U16 rw m
6041   U16 ro m
605A   I16 rw
605B   I16 rw
605C   I16 rw
605D   I16 rw
605E   I16 rw
6060   I8  any m
6061   I8  ro m
6062   I32 ro
6063   I32 ro
6064   I32 ro
6065   U32 rw
6066   U16 rw
6067   U32 rw
6068   U16 rw
606B   I32 ro
606C   I32 ro
606D   U16 rw
606E   U16 rw
606F   U16 rw
6070   U16 rw
6071   I16 rw
6072   U16 rw
6073   U16 any
6074   I16 ro
6075   U32 any
6076   U32 any
6077   I16 ro
6078   I16 ro
6079   U32 ro
607A   I32 rw
607C   I32 rw
607D.* I32 rw
607E   U8  rw
607F   U32 rw
6080   U32 any
6081   U32 rw
6083   U32 rw
6084   U32 rw
6085   U32 rw
6086   I16 any
608F.* U32 any
6090.* U32 any
6091.* U32 any
6092.* U32 any
6098   I8  any
6099.* U32 rw
609A   U32 rw
60A8   U32 any
60A9   U32 any
60B0   I32 rw
60B1   I32 rw
60B2   I16 rw
60C1.* I32 rw
60C2.1 U8  any
60C2.2 I8  any
60C5   U32 rw
60C6   U32 rw
60E0   U16 rw
60E1   U16 rw
60F4   I32 ro
60FA   I32 ro
60FC   I32 ro
60FD   U32 ro
60FE.* U32 any
60FF   I32 rw
6402   U16 any
6502   U32 ro m
67FF   U32 ro
"""))

MODE_OBJECTS: Final = MappingProxyType({
    Mode.PROFILE_POSITION: (0x607A, 0x6064, 0x6081, 0x6083),
    Mode.PROFILE_VELOCITY: (0x60FF, 0x606C),
    Mode.PROFILE_TORQUE: (0x6071,),
    Mode.HOMING: (0x6098, 0x6099),
    Mode.CSP: (0x607A, 0x6064),
    Mode.CSV: (0x60FF, 0x606C),
    Mode.CST: (0x6071, 0x6077),
})
"""Objects that a mode of 0x6502 needs (CiA 402-2)."""

CIA404: Final = tuple(_rules("""
6100.* F32 ro
7100.* I16 ro
8100.* I24 ro
9100.* I32 ro
6110.* U16 any
6112.* U8  any
6114.* U32 any
6120.* F32 any
6121.* F32 any
6122.* F32 any
6123.* F32 any
6124.* F32 any
6125.* U32 wo
6126.* F32 any
6127.* F32 any
6130.* F32 ro
7130.* I16 ro
8130.* I24 ro
9130.* I32 ro
6131.* U32 any
6132.* U8  any
6148.* F32 any
9148.* I32 any
6149.* F32 any
9149.* I32 any
6150.* U8  ro
61A0.* U8  any
61A1.* U8  any
"""))

PROFILES: Final = MappingProxyType({402: CIA402, 404: CIA404})
"""Rules beyond CiA 301's by the profile number, the lower half of 0x1000."""
