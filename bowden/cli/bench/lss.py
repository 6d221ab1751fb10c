"""`bowden lss`: node ids and bit rates of devices by LSS (CiA 305)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

from bowden.cli.app import CommandGroup, app
from bowden.cli.bench.node import Force
from bowden.cli.options import Bus, argument, option
from bowden.cli.terminal import CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    from eds.cia305 import LssAddress
    from master.node_access import lss_master, remote_node

lss = CommandGroup(help="Node ids and bit rates of devices by LSS (CiA 305).")
app.add_typer(lss, name="lss")

Chosen = Annotated[int | None, option("The device with this node id.", "ID", "--node")]
Identity = Annotated[str | None, option("The device of this identity, hexadecimal.", "V:P:R:S")]
Store = Annotated[bool, option("Store it, so that it outlasts a power cycle.")]
Wait = Annotated[int, option("Time for an answer.", "MS", "--timeout", min=1, max=10_000)]


@lss.command(example="bowden lss scan")
def scan(reached: Bus, timeout: Wait = 100) -> CommandAnswer:
    """Find the devices that have no node id, by fastscan."""
    with _master(reached, timeout) as master:
        found = master.scan()
    return CommandAnswer({"unconfigured": [_identity(address) for address in found], "note": master.scan_note}, [
        *(f"{address}  " + " ".join(f"{name} 0x{number:08X}" for name, number in address._asdict().items())
          for address in found), f"{len(found)} unconfigured devices.", *filter(None, (master.scan_note,))])


@lss.command(example="bowden lss assign 9 --node 2")
def assign(
    node_id: Annotated[int, argument("NEWID", "Node id 1 … 127.")],
    reached: Bus, node: Chosen = None, identity: Identity = None, store: Store = False, force: Force = False,
    timeout: Wait = 100,
) -> CommandAnswer:
    """Give a device a node id: the only unconfigured one, or the one of --node or --identity."""
    with _master(reached, timeout, acts=not force) as master:
        lss_master.refuse_taken(master.link, node_id)
        address = _choose(master, node, identity)
        before = master.node_id()
        master.configure_node_id(node_id)
        if store:
            master.store()
        booted = master.booted(node_id) if before == 255 else False
        if before not in (255, None):
            master.leave()
            master.link.beats.pop(node_id, None)
            remote_node.nmt(master.link, before, "reset-comm", shown_by=node_id)
            booted = node_id in master.link.beats
    return CommandAnswer(
        {"node": node_id, "before": before, **_identity(address), "stored": store, "booted": booted},
        f"{address} is node {node_id}{', stored' * store}; {'booted' if booted else 'no boot-up came'}.",
        0 if booted else 1)


@lss.command(example="bowden lss bitrate 500000 --node 2")
def bitrate(
    rate: Annotated[int, argument("RATE", "bit/s: 1000000, 800000, 500000, 250000, 125000, …")],
    reached: Bus, node: Chosen = None, identity: Identity = None, store: Store = False,
    activate: Annotated[int | None, option(
        "Switch after MS, and stay silent for MS more, instead of at the next power-on.", "MS",
        min=1, max=65_535)] = None,
    force: Force = False, timeout: Wait = 100,
) -> CommandAnswer:
    """Give a device a bit rate, in force at its next power-on, or now by --activate."""
    with _master(reached, timeout, acts=not force) as master:
        address = _choose(master, node, identity)
        master.configure_bitrate(rate)
        if store:
            master.store()
        if activate is not None:
            master.activate(activate)
    return CommandAnswer(
        {**_identity(address), "bitrate": rate, "stored": store, "activated": activate is not None},
        f"{address}: {rate} bit/s{', stored' * store}" + (
            f", in force in {activate} ms." if activate is not None else "; in force once it is activated."))


@lss.command(example="bowden lss store --node 2")
def store(
    reached: Bus, node: Chosen = None, identity: Identity = None, force: Force = False, timeout: Wait = 100,
) -> CommandAnswer:
    """Let a device keep its node id and bit rate over a power cycle."""
    with _master(reached, timeout, acts=not force) as master:
        address = _choose(master, node, identity)
        master.store()
    return CommandAnswer({**_identity(address), "stored": True}, f"{address}: node id and bit rate stored.")


@contextmanager
def _master(reached: Bus, timeout_ms: int, *, acts: bool = False) -> Iterator[lss_master.LssMaster]:
    """Return an LSS master; a refusal by the device is reported as bad input."""
    with reached.linked(acts=acts) as link:
        master = lss_master.LssMaster(link, timeout_ms * 1_000_000)
        try:
            yield master
        except lss_master.LssRefusalError as error:
            raise InputError(f"{error}; see the device's manual, or give it more --timeout.") from None
        finally:
            master.leave()


def _choose(master: lss_master.LssMaster, node: int | None, identity: str | None) -> LssAddress:
    return master.choose(node, None if identity is None else lss_master.address_of(identity))


def _identity(address: LssAddress) -> dict[str, object]:
    return {"identity": str(address), **address._asdict()}
