"""A CAN frame as this project passes it about.

The rule of this file: a frame is a value. Devices and the wire exchange nothing else; python-can's
`Message` is met only where a bus is.
"""

from __future__ import annotations

from typing import NamedTuple


class Frame(NamedTuple):
    """One classical CAN frame; `dlc` is given only where a remote or malformed frame says more than `len(data)`."""

    can_id: int
    data: bytes = b""
    remote: bool = False
    extended: bool = False
    error: bool = False
    dlc: int | None = None
