"""canopen's SDO client, which expects a second thread, adapted once to a master with one.

Nothing else of the master imports canopen; a response is waited for by pumping the bus.
"""

from __future__ import annotations

from typing import Any, Protocol, cast

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from eds.cia301 import SDO_REQUEST_BASE, SDO_RESPONSE_BASE, Abort

TIMEOUT_NS = 300_000_000
_ABORTED = 0x80


class SdoError(Exception):
    """A node refused or did not answer an SDO; the text names node, object and reason."""


class Pump(Protocol):
    """Interface of the link towards the SDO client."""

    def send(self, can_id: int, data: bytes) -> None: ...

    def forget_response(self, can_id: int) -> None: ...

    def await_response(self, can_id: int, timeout_ns: int) -> bytes | None: ...


class _Client(SdoClient):
    RETRY_DELAY = 0.0

    def __init__(self, pump: Pump, node_id: int) -> None:
        empty = cast(Any, canopen.ObjectDictionary)()
        cast(Any, super()).__init__(SDO_REQUEST_BASE + node_id, SDO_RESPONSE_BASE + node_id, empty)
        self._pump = pump
        self.network = cast(Any, self)

    def send_message(self, can_id: int, data: bytes) -> None:
        self._pump.send(can_id, bytes(data))

    def request_response(self, sdo_request: bytes) -> bytes:
        self._pump.forget_response(self.tx_cobid)
        return bytes(cast(Any, super()).request_response(sdo_request))

    def read_response(self) -> bytes:
        data = self._pump.await_response(self.tx_cobid, TIMEOUT_NS)
        if data is None or len(data) != 8:
            raise SdoCommunicationError("no answer")
        if data[0] == _ABORTED:
            raise SdoAbortedError(int.from_bytes(data[4:8], "little"))
        return data


class Sdo:
    """SDO up- and downloads to one node, expedited, segmented or block; raises `SdoError`, and the pump's exceptions.
    """

    def __init__(self, pump: Pump, node_id: int) -> None:
        self._client = _Client(pump, node_id)
        self._node_id = node_id

    def read(self, index: int, subindex: int, block: bool = False) -> bytes:
        """Return the bytes of an object."""
        try:
            if block:
                with cast(Any, self._client).open(index, subindex, "rb", block_transfer=True) as stream:
                    return bytes(stream.read())
            return bytes(self._client.upload(index, subindex))
        except (SdoAbortedError, SdoCommunicationError) as error:
            raise self._named(index, subindex, error) from error

    def write(self, index: int, subindex: int, data: bytes, block: bool = False) -> None:
        """Write the bytes of an object."""
        try:
            if block:
                with cast(Any, self._client).open(
                        index, subindex, "wb", size=len(data), block_transfer=True) as stream:
                    stream.write(data)
            else:
                self._client.download(index, subindex, data)
        except (SdoAbortedError, SdoCommunicationError) as error:
            raise self._named(index, subindex, error) from error

    def _named(self, index: int, subindex: int, error: Exception) -> SdoError:
        return SdoError(f"node {self._node_id}, object 0x{index:04X}:{subindex:02X}: {_reason(error)}")


def _reason(error: Exception) -> str:
    if not isinstance(error, SdoAbortedError):
        return str(error)
    code = int(error.code)
    known = next((abort for abort in Abort if int(abort) == code), None)
    return f"refused with 0x{code:08X}, {known.text if known else 'no code of CiA 301'}"
