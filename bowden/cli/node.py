"""`bowden node backup`, `compare`, `restore`: a node's parameters as DCF."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.command import CommandGroup
from bowden.cli.option_groups import Bus, grouped

if TYPE_CHECKING:
    from eds.bench_network import NodeEntry
    from eds.dictionary import Dictionary
    from master.network.dcf import ParameterDifference
    from master.network.link import Link

Act = Callable[["Link", "NodeEntry", "Dictionary"], "list[ParameterDifference]"]
node = CommandGroup(help="Parameters of one node, as DCF.", rich_markup_mode=None)
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
    output_files.refuse_ending(output, ".dcf", what="a node's parameters")
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


def _against_a_dcf(what: str, *, status: int) -> Callable[[Act], Callable[..., int]]:
    """Make a command of what is done with a node and a DCF of it; it ends with `status` where anything differed.

    `what` was done with the parameters that differed, in a word; the command's name and help are those of the act.
    """
    def command_of(act: Act) -> Callable[..., int]:
        @grouped
        def command(
            name: Name, file: File, reached: Bus, config: options.Config = None, json: options.Json = False
        ) -> int:
            from eds.dictionary import read
            from master.network import dcf

            given = read(file)
            with _bench(name, reached, config) as (link, entry):
                dcf.refuse_other(link, entry, given, str(file))
                found = act(link, entry, given)
            _tell(name, file, found, what, json=json)
            return status if found else 0

        command.__name__, command.__doc__ = act.__name__, act.__doc__
        return command

    return command_of


@node.command()
@_against_a_dcf("differ", status=1)
def compare(link: Link, entry: NodeEntry, given: Dictionary) -> list[ParameterDifference]:
    """Say which parameters of a node differ from a DCF; exit status 1 where any does.

    Example: bowden node backup servo -o servo.dcf && bowden node compare servo servo.dcf
    """
    from master.network import dcf

    return dcf.compare(link, entry, given)


@node.command()
@_against_a_dcf("restored", status=0)
def restore(link: Link, entry: NodeEntry, given: Dictionary) -> list[ParameterDifference]:
    """Write what differs from a DCF into the node and store it there.

    Example: bowden node backup servo -o servo.dcf && bowden node restore servo servo.dcf
    """
    from master.network import dcf

    return dcf.restore(link, entry, given)


@contextmanager
def _bench(name: str, reached: Bus, config: Path | None) -> Iterator[tuple[Link, NodeEntry]]:
    """A link to the bus and the node's entry; the node is in PRE-OPERATIONAL, as parameters want it."""
    from bowden import buses
    from eds.bench_network import wire
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


def _tell(name: str, file: Path, found: list[ParameterDifference], what: str, *, json: bool) -> None:
    if json:
        terminal.emit({"node": name, "file": str(file), what: [
            {"index": f"{d.object:04X}:{d.subindex:02X}", "name": d.name, "in_file": _plain(d.in_file),
             "on_node": _plain(d.on_node)} for d in found]})
    else:
        for d in found:
            print(f"{d.object:04X}:{d.subindex:02X} {d.name}: {d.in_file!r} in the file, {d.on_node!r} on the node")
        print(f"{len(found)} parameters {what}.")


def _plain(value: object) -> object:
    return value.decode("latin-1") if isinstance(value, bytes) else value
