"""SDO client for a master with a single thread: canopen's client, whose wait for a response receives from the bus.

canopen's own client waits on a queue that a second thread fills. No other module of the master imports canopen.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol, cast

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from eds.cia301 import SDO_REQUEST_BASE, SDO_RESPONSE_BASE, Abort

TIMEOUT_NS = 300_000_000
_ABORTED = 0x80


class SdoError(Exception):
    """A node refused or did not answer an SDO; the text names node, object and reason.

    `code` is the abort code of a refusal, None where no usable answer came.
    """

    def __init__(self, text: str, code: int | None = None) -> None:
        super().__init__(text)
        self.code = code


class Pump(Protocol):
    """Interface of the link towards the SDO client."""

    def send(self, can_id: int, data: bytes) -> None: ...

    def forget_response(self, can_id: int) -> None: ...

    def await_response(self, can_id: int, timeout_ns: int) -> bytes | None: ...


class _Client(SdoClient):
    """Client of one transfer.

    canopen's streams go on sending when they are closed after an abort, and report the abort of that. So the first
    abort ends the transfer: nothing more is sent, and every further response is that abort.
    """

    RETRY_DELAY = 0.0

    def __init__(self, pump: Pump, node_id: int) -> None:
        empty = cast(Any, canopen.ObjectDictionary)()
        cast(Any, super()).__init__(SDO_REQUEST_BASE + node_id, SDO_RESPONSE_BASE + node_id, empty)
        self._pump = pump
        self.refusal: SdoAbortedError | None = None
        self.failed = self.over = False
        self.network = cast(Any, self)

    def send_message(self, can_id: int, data: bytes) -> None:
        if self.refusal is None and not self.over:
            self._pump.send(can_id, bytes(data))

    def request_response(self, sdo_request: bytes) -> bytes:
        self._pump.forget_response(self.tx_cobid)
        return bytes(cast(Any, super()).request_response(sdo_request))

    def read_response(self) -> bytes:
        if self.refusal is not None:
            raise self.refusal
        data = None if self.over else self._pump.await_response(self.tx_cobid, TIMEOUT_NS)
        if data is None or len(data) != 8:
            self.failed = True
            raise SdoCommunicationError("no answer")
        if data[0] == _ABORTED:
            self.failed = True
            self.refusal = SdoAbortedError(int.from_bytes(data[4:8], "little"))
            raise self.refusal
        return data


class Sdo:
    """SDO up- and downloads to one node, expedited, segmented or block; raises `SdoError`, and the pump's exceptions.
    """

    def __init__(self, pump: Pump, node_id: int) -> None:
        self._pump, self._node_id = pump, node_id

    def read(self, index: int, subindex: int, block: bool = False) -> bytes:
        """Return the bytes of an object."""
        with self._transfer(index, subindex) as client:
            if block:
                with client.open(index, subindex, "rb", block_transfer=True) as stream:
                    return bytes(stream.read())
            return bytes(client.upload(index, subindex))

    def write(self, index: int, subindex: int, data: bytes, block: bool = False) -> None:
        """Write the bytes of an object."""
        with self._transfer(index, subindex) as client:
            if block:
                with client.open(index, subindex, "wb", size=len(data), block_transfer=True) as stream:
                    stream.write(data)
            else:
                client.download(index, subindex, data)

    @contextmanager
    def _transfer(self, index: int, subindex: int) -> Iterator[Any]:
        """Return the client of one transfer; its failure raises `SdoError`."""
        client = _Client(self._pump, self._node_id)
        try:
            yield client
        except (SdoAbortedError, SdoCommunicationError, RuntimeError, AttributeError) as error:
            if not isinstance(error, SdoAbortedError | SdoCommunicationError) and not client.failed:
                raise
            code = None if client.refusal is None else int(client.refusal.code)
            where = f"node {self._node_id}, object 0x{index:04X}:{subindex:02X}"
            raise SdoError(f"{where}: {_reason(error, code)}", code) from error
        finally:
            client.over = True


def _reason(error: Exception, code: int | None) -> str:
    """Return the reason of a failure; canopen's streams raise RuntimeError or AttributeError after a missing answer."""
    if code is None:
        return str(error) if isinstance(error, SdoCommunicationError) else "no answer"
    known = next((abort for abort in Abort if int(abort) == code), None)
    return f"refused with 0x{code:08X}, {known.text if known else 'no code of CiA 301'}"
