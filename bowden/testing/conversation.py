"""SDO conversations: a client's steps, and a server's answer to each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import canopen

if TYPE_CHECKING:
    from bowden.testing.can_bus import CanBus



@dataclass(frozen=True, slots=True)
class SdoStep:
    """One transfer: a read without `data`, else a write of these bytes; `block` requests block transfer."""

    index: int
    subindex: int
    data: bytes | None = None
    block: bool = False


class SdoAnswer(NamedTuple):
    """Outcome of a step: `data` read (None for a write), or `abort`, the abort code; `silent` if no answer came."""

    data: bytes | None = None
    abort: int | None = None
    silent: bool = False


def converse(bus: CanBus, node_id: int, steps: Sequence[SdoStep]) -> list[SdoAnswer]:
    """Take the steps one after another with python canopen's SDO client; return one answer for each."""
    with bus.virtual_time():
        network = canopen.Network(bus.open())
        client = network.add_node(node_id, canopen.ObjectDictionary()).sdo  # type: ignore[no-untyped-call]
        try:
            return [_take(client, step) for step in steps]
        finally:
            network.disconnect()


def _take(client: Any, step: SdoStep) -> SdoAnswer:
    place = step.index, step.subindex
    try:
        if step.data is None:
            with client.open(*place, "rb", block_transfer=step.block) as stream:
                return SdoAnswer(stream.read())
        with client.open(*place, "wb", size=len(step.data), block_transfer=step.block) as stream:
            stream.write(step.data)
        return SdoAnswer()
    except canopen.SdoAbortedError as refused:
        return SdoAnswer(abort=refused.code)
    except canopen.SdoCommunicationError:
        return SdoAnswer(silent=True)
