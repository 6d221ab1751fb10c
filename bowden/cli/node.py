"""`bowden node backup`, `compare`, `restore`: a node's parameters as DCF."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, grouped

if TYPE_CHECKING:
    from eds.bench import NodeEntry
    from eds.dictionary import Dictionary
    from master.network.dcf import Difference
    from master.network.link import Link

node = typer.Typer(help="Parameters of one node, as DCF.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(node, name="node")

Name = Annotated[str, typer.Argument(metavar="NODE", help="servo, knee, start or end.", show_default=False)]
File = Annotated[Path, typer.Argument(metavar="FILE", help="DCF of the node.", show_default=False)]


@node.command()
@grouped
def backup(
    name: Name,
    output: options.Output,
    reached: Bus,
    config: options.Config = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> int:
    """Read a node's parameters and write them as DCF.

    Example: bowden node backup servo -o servo.dcf
    """
    from bowden import output_files
    from master.network import dcf
    from parameters.files import write_whole

    output_files.refuse([output], overwrite=overwrite)
    with _bench(name, reached, config) as (link, entry):
        dcf.refuse_other(link, entry, entry.dictionary, entry.dictionary.path)
        unread: list[str] = []
        values = {**dcf.backup(link, entry, unread), **dcf.stamp(entry.dictionary, datetime.datetime.now())}
    write_whole(output, dcf.as_dcf(entry.dictionary, entry.node_id, values), overwrite=True)
    if json:
        terminal.emit({"node": name, "file": str(output), "parameters": len(values), "unread": unread})
    else:
        print(f"{output}: {len(values)} parameters of {name}; {len(unread)} could not be read.")
        for one in unread:
            print(f"  not read: {one}")
    return 1 if unread else 0


@node.command()
@grouped
def compare(
    name: Name,
    file: File,
    reached: Bus,
    config: options.Config = None,
    json: options.Json = False,
) -> int:
    """Say which parameters of a node differ from a DCF; exit status 1 where any does.

    Example: bowden node backup servo -o servo.dcf && bowden node compare servo servo.dcf
    """
    from master.network import dcf

    given = _read(file)
    with _bench(name, reached, config) as (link, entry):
        dcf.refuse_other(link, entry, given, str(file))
        found = dcf.compare(link, entry, given)
    return _tell(name, file, found, "differ", json=json)


@node.command()
@grouped
def restore(
    name: Name,
    file: File,
    reached: Bus,
    config: options.Config = None,
    json: options.Json = False,
) -> int:
    """Write what differs from a DCF into the node and store it there.

    Example: bowden node backup servo -o servo.dcf && bowden node restore servo servo.dcf
    """
    from master.network import dcf

    given = _read(file)
    with _bench(name, reached, config) as (link, entry):
        dcf.refuse_other(link, entry, given, str(file))
        found = dcf.restore(link, entry, given)
    _tell(name, file, found, "restored", json=json)
    return 0


def _read(file: Path) -> Dictionary:
    from eds.dictionary import read

    return read(file)


@contextmanager
def _bench(name: str, reached: Bus, config: Path | None) -> Iterator[tuple[Link, NodeEntry]]:
    """A link to the bus and the node's entry; the node is in PRE-OPERATIONAL, as parameters want it."""
    from bowden import buses
    from eds.bench import wire
    from eds.cia301 import NmtCommand
    from master.network.link import Link, LinkError
    from master.network.sdo import SdoError
    from parameters import InputError

    network = reached.sections(config)["network"]
    nodes = {entry.name: entry for entry in wire(network).nodes.values()}
    if name not in nodes:
        raise InputError(f"{name!r} is no node of the bench; expected one of {', '.join(nodes)}.")
    with buses.opened_one(reached.chosen(), network.bitrate) as opened:
        link = Link(opened, buses.clock_of(opened), heartbeat_ms=None)
        try:
            link.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, nodes[name].node_id)
            link.sdo_read(nodes[name].node_id, 0x1000)
            yield link, nodes[name]
        except (SdoError, LinkError) as error:
            raise InputError(f"{name} does not answer ({error}); see bowden doctor.") from None


def _tell(name: str, file: Path, found: list[Difference], what: str, *, json: bool) -> int:
    if json:
        terminal.emit({"node": name, "file": str(file), what: [
            {"index": f"{d.object:04X}:{d.subindex:02X}", "name": d.name, "in_file": _plain(d.in_file),
             "on_node": _plain(d.on_node)} for d in found]})
    else:
        for d in found:
            print(f"{d.object:04X}:{d.subindex:02X} {d.name}: {d.in_file!r} in the file, {d.on_node!r} on the node")
        print(f"{len(found)} parameters {what}.")
    return 1 if found else 0


def _plain(value: object) -> object:
    return value.decode("latin-1") if isinstance(value, bytes) else value
