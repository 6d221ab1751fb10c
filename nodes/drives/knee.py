"""The knee drive: a CiA 402 drive behind a 1:20 reducer, in thousandths of a degree of the knee.

The rule of this file: the reducer is in the objects 0x6091 and 0x6092, and nowhere in the code.
"""

from __future__ import annotations

from nodes.drives.drive import Drive


class KneeDrive(Drive):
    """The drive that moves the knee; angles in rad of the knee (flexion negative), torques in N·m at the knee."""
