"""`bowden node`: any CANopen node by its id: objects, PDOs, errors, NMT, and its parameters as DCF."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from bowden.cli.app import CommandGroup, NothingGivenError, app
from bowden.cli.options import Bus, argument, below, keyed, new_file, option, parsed
from bowden.cli.terminal import CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError
from parameters.files import write_whole

with on_first_use():
    from bowden.bench.any_node import dictionary_of
    from eds import cia301, dictionary, emcy_codes
    from eds.bench.bench_network import wire
    from master.network.link import Link
    from master.node_access import dcf, node_scan, object_text, pdo_settings, remote_node

node = CommandGroup(help="Any CANopen node by its id: objects, PDOs, errors, NMT, parameters as DCF.")
app.add_typer(node, name="node")

Name = Annotated[str, argument("NODE", "Node id 1 … 127, or servo, knee, start, end.")]
File = Annotated[Path, argument("FILE", "DCF of the node.")]
ObjectOf = Annotated[str, argument("OBJECT", "6041, 1018:01, or a name of the EDS.")]
Eds = Annotated[Path | None, option("EDS or DCF, or a folder of them.", "FILE")]
Force = Annotated[bool, option("Act even while another master is on the bus.")]
Block = Annotated[bool, option("Use SDO block transfer.")]
Type = Annotated[str | None, option("Data type: u8 … u64, i8 … i64, f32, f64, str, hex.", "TYPE")]


@node.command(example="bowden node scan")
def scan(reached: Bus, eds: Eds = None) -> CommandAnswer:
    """Find the nodes of a bus: heartbeats, identities, and names of EDS files that fit."""
    files = node_scan.files_of(eds)
    with reached.linked() as link:
        found = node_scan.scan(link, files)
    identities = ["no SDO answer" if one.identity is None else " ".join(
        f"{name} 0x{value:08X}" for name, value in one.identity.items()) for one in found]
    return CommandAnswer({"nodes": [
        {"node": one.node_id, "state": one.state, "identity": one.identity, "name": one.name,
         "eds": None if one.dictionary is None else one.dictionary.path} for one in found]},
        [*(f"{one.node_id:3}  {one.state or 'no heartbeat':16}  {identity}  {one.name}".rstrip()
           for one, identity in zip(found, identities, strict=True)), f"{len(found)} nodes."], 0 if found else 1)


@node.command(example="bowden node info 1")
def info(name: Name, reached: Bus, eds: Eds = None) -> CommandAnswer:
    """Show a node's identity, versions, NMT state and drive state."""
    with _node(name, reached, eds) as one:
        about = one.info()
    hexadecimal = ("device_type", "vendor", "product", "revision", "serial")
    return CommandAnswer({"node": one.node_id, **about}, [
        f"{key.replace('_', ' '):13} {f'0x{value:08X}' if key in hexadecimal else _listed(value)}"
        for key, value in about.items()])


@node.command(example="bowden node read 1 1018:01")
def read(
    name: Name, place: ObjectOf, reached: Bus, eds: Eds = None, type: Type = None,
    output: Annotated[Path | None, new_file("File for the bytes.")] = None, block: Block = False,
) -> CommandAnswer:
    """Read one object, typed by the EDS or by --type."""
    with _node(name, reached, eds) as one:
        at = one.find(place)
        kind = one.kind(at, type)
        data = one.read_bytes(at, block=block)
        scaled = one.units.get(at)
    value = object_text.value_of(kind, data)
    if output is not None:
        output.write_bytes(data)
    shown = f"{len(data)} bytes in {output}" if output is not None else object_text.shown(value, kind, scaled, at)
    return CommandAnswer({
        "node": one.node_id, "object": object_text.shown_key(at), "name": one.name(at),
        "type": None if kind is None else kind.name, "value": object_text.plain(value),
        "si": value * scaled[0] if scaled and isinstance(value, int | float) else None,
        "unit": scaled[1] if scaled else None, "bytes": len(data)}, f"{one.label(at)} = {shown}")


@node.command(example="bowden node write 1 1017 500")
def write(
    name: Name, place: ObjectOf, reached: Bus,
    value: Annotated[str | None, typer.Argument(metavar="VALUE", help="Decimal, 0x…, text or hex bytes.")] = None,
    given: Annotated[Path | None, option("File with the bytes.", "FILE", "--input")] = None,
    eds: Eds = None, type: Type = None, block: Block = False, force: Force = False,
) -> CommandAnswer:
    """Write one object, typed by the EDS or by --type, and read it back."""
    if (value is None) == (given is None):
        raise NothingGivenError("NODE OBJECT VALUE", "write: give either VALUE or --input FILE.")
    try:
        content = None if given is None else given.read_bytes()
    except OSError as error:
        raise InputError(f"{given}: cannot be read ({error.strerror}); give a readable file.") from None
    with _node(name, reached, eds, force=force, acts=True) as one:
        at = one.find(place)
        data = one.encoded(at, value or "", type) if content is None else content
        one.write_bytes(at, data, block=block)
        kind = one.kind(at, type)
        now, scaled = one.value(at, kind, block=block), one.units.get(at)
    return CommandAnswer(
        {"node": one.node_id, "object": object_text.shown_key(at), "name": one.name(at), "written": len(data),
         "value": object_text.plain(now)}, one.label(at) + (
            f": {len(data)} bytes written." if now is None else f" = {object_text.shown(now, kind, scaled, at)}"))


@node.command(example="bowden node objects 3 --changed")
def objects(
    name: Name, reached: Bus, eds: Eds = None,
    changed: Annotated[bool, option("Only values that are not the EDS's default.")] = False,
) -> CommandAnswer:
    """List a node's objects with their live values; * marks one that is not the EDS's default."""
    with _node(name, reached, eds) as one:
        found = [each for each in one.objects() if each.changed or not changed]
        units = one.units
    shown = [each.refusal or object_text.shown(
        each.value, each.entry.data_type, units.get(each.entry.key), each.entry.key) for each in found]
    return CommandAnswer({"node": one.node_id, "objects": [
        {"object": object_text.shown_key(each.entry.key), "name": one.name(each.entry.key),
         "access": each.entry.access, "type": each.entry.data_type.name, "value": object_text.plain(each.value),
         "default": object_text.plain(each.entry.default), "changed": each.changed,
         "refused": each.refusal or None} for each in found]}, [
        *(f"{'*' if each.changed else ' '} {object_text.shown_key(each.entry.key)} {each.entry.access:3} "
          f"{one.name(each.entry.key)} = {text}" for each, text in zip(found, shown, strict=True)),
        f"{len(found)} objects, {sum(bool(each.changed) for each in found)} not at their default."])


@node.command(example="bowden node pdo 2 --map tpdo1=6041,6064 --set tpdo1.type=1")
def pdo(
    name: Name, reached: Bus, eds: Eds = None,
    mapped: Annotated[list[str] | None, option("Map objects: tpdo1=6041,6064.", "PDO=OBJECTS", "--map")] = None,
    given: Annotated[list[str] | None, option(
        "cob_id, type, inhibit (100 µs) or event_timer (ms): tpdo1.type=1.", "PDO.KEY=N", "--set")] = None,
    force: Force = False,
) -> CommandAnswer:
    """Show a node's PDOs with names and values, or change them in the order of CiA 301."""
    settings: dict[int, dict[str, int]] = {}
    for index, key, number in keyed(
            "--set", given, f"PDO.KEY=NUMBER with one of {', '.join(pdo_settings.PARAMETERS)} and a number that fits "
            "it; write for instance tpdo1.type=1", _setting):
        settings.setdefault(index, {})[key] = number
    with _node(name, reached, eds, force=force, acts=bool(mapped or given)) as one:
        known = one.dictionary
        maps = dict(keyed("--map", mapped, "PDO=OBJECTS; write for instance tpdo1=6041,6064", lambda pdo, listed: (
            pdo_settings.index_of(pdo), pdo_settings.words(listed, known))))
        for index in dict.fromkeys((*maps, *settings)):
            pdo_settings.configure(one.link, one.node_id, index, maps.get(index), settings.get(index))
        states = one.pdos()
        values = {at: one.value(at, one.kind(at)) for at in {word >> 8 for state in states for word in state.mapping}}
        units = one.units
    lines = [line for state in states for line in (state.in_words(), *(
        f"    {object_text.shown_key(at)} {one.name(at)}, {word & 0xFF} bits = "
        f"{object_text.shown(values[at], one.kind(at), units.get(at), at)}"
        for word in state.mapping for at in (word >> 8,)))]
    return CommandAnswer({"node": one.node_id, "pdos": [
        {"pdo": state.name, "valid": state.valid, **state.parameters, "mapping": [
            {"object": object_text.shown_key(word >> 8), "name": one.name(word >> 8), "bits": word & 0xFF,
             "value": object_text.plain(values[word >> 8])} for word in state.mapping]} for state in states]},
        [*lines, f"{len(states)} PDOs, {sum(state.valid for state in states)} in use."])


def _setting(place: str, value: str) -> tuple[int, str, int]:
    """Return index, key and number of PDO.KEY=NUMBER."""
    name, _, key = place.partition(".")
    return pdo_settings.index_of(name), key, below(1 << 8 * pdo_settings.PARAMETERS[key][1], int(value, 0))


@node.command(example="bowden node errors 1 || true")
def errors(
    name: Name, reached: Bus, eds: Eds = None,
    clear: Annotated[bool, option("Clear the history 0x1003.")] = False,
    force: Force = False,
) -> CommandAnswer:
    """Show a node's error register and error history in words; exit status 1 where an error is present."""
    with _node(name, reached, eds, force=force, acts=clear) as one:
        if clear:
            one.clear_errors()
        bits, history = one.errors()
    return CommandAnswer({"node": one.node_id, "register": bits, "history": [
        {"code": f"{each.code:04X}", "text": each.text, "manufacturer": each.more} for each in history]}, [
        f"1001 error register: {', '.join(bits) or 'no error'}",
        *(f"{each.code:04X} {each.text}" + (f" (manufacturer's word {each.more:04X})" if each.more else "")
          for each in history), f"{len(history)} errors in the history."], 1 if bits else 0)


@node.command(example="bowden node nmt 3 start")
def nmt(
    name: Annotated[str, argument("NODE", "Node id, name, or all.")],
    command: Annotated[str, argument("COMMAND", "start, stop, preop, reset or reset-comm.")],
    reached: Bus, force: Force = False,
) -> CommandAnswer:
    """Command the NMT state of a node or of all nodes; exit status 1 if a node does not show the new state."""
    node_id = 0 if name == "all" else node_id_of(name, reached)
    with reached.linked(acts=not force) as link:
        answer = remote_node.nmt(link, node_id, command)
    states = list(answer.states.values()) if node_id else [f"{one} {state}" for one, state in answer.states.items()]
    return CommandAnswer(
        {"node": name, "command": command, "state": answer.states.get(node_id), "obeyed": answer.obeyed,
         "states": {str(one): state for one, state in answer.states.items()}},
        f"{name}: {command} sent; {', '.join(states) or 'no node shows its state'}.", 0 if answer.obeyed else 1)


@node.command(example="bowden node emcy 8611 --profile 402")
def emcy(
    code: Annotated[str, argument("CODE", "Error code, hexadecimal.")],
    eds: Eds = None,
    profile: Annotated[int | None, option("402 or 404: profile of the device.", "NUMBER")] = None,
) -> CommandAnswer:
    """Show an EMCY error code in words: the EDS's own, CiA 301, 402 and 404."""
    number = parsed("emcy", code, "is no error code; give four hexadecimal digits such as 8611",
                    lambda text: below(1 << 16, int(text.removesuffix("h"), 16)))
    text = emcy_codes.emcy_text(number, profile, {} if eds is None else dictionary.read(eds).emergencies)
    return CommandAnswer({"code": f"{number:04X}", "text": text}, f"{number:04X} {text}")


@node.command(example="bowden node backup servo -o servo.dcf")
def backup(
    name: Name, output: Annotated[Path, new_file("File to write.", "a node's parameters", ".dcf")], reached: Bus,
    eds: Eds = None,
    concise: Annotated[Path | None, new_file("Write them as concise DCF (1F22), too.", name="--concise")] = None,
) -> CommandAnswer:
    """Read a node's parameters and PDO settings and write them as DCF."""
    with _described(name, reached, eds) as (link, entry):
        dcf.refuse_other(link, entry, entry.dictionary, entry.dictionary.path)
        unread: list[str] = []
        values = {**dcf.backup(link, entry, unread), **dcf.stamp(entry.dictionary, datetime.datetime.now())}
    write_whole(output, dcf.as_dcf(entry.dictionary, entry.node_id, values), overwrite=True)
    if concise is not None:
        write_whole(concise, dcf.concise(dictionary.read(output)), overwrite=True)
    return CommandAnswer({"node": name, "file": str(output), "parameters": len(values), "unread": unread}, [
        f"{output}: {len(values)} parameters of {name}; {len(unread)} could not be read.",
        *(f"  not read: {place}" for place in unread)], 1 if unread else 0)


@node.command(example="bowden node backup servo -o servo.dcf && bowden node compare servo servo.dcf")
def compare(name: Name, file: File, reached: Bus) -> CommandAnswer:
    """List the parameters of a node that differ from a DCF; exit status 1 where any does."""
    found = _against_a_dcf(name, file, reached, dcf.compare)
    return _differences(name, file, found, "differ", 1 if found else 0)


@node.command(example="bowden node backup servo -o servo.dcf && bowden node restore servo servo.dcf")
def restore(name: Name, file: File, reached: Bus, force: Force = False) -> CommandAnswer:
    """Write what differs from a DCF into the node and store it there."""
    found = _against_a_dcf(name, file, reached, dcf.restore, force=force, acts=True)
    return _differences(name, file, found, "restored")


def _against_a_dcf(
    name: str, file: Path, reached: Bus,
    act: Callable[[Link, dcf.DescribedNode, dictionary.Dictionary], list[dcf.ParameterDifference]], **guarded: bool,
) -> list[dcf.ParameterDifference]:
    """Return the result of `act` on a node and the node's DCF."""
    node_id = node_id_of(name, reached)
    given = dictionary.read(file, node_id)
    with _described(name, reached, file, **guarded) as (link, entry):
        dcf.refuse_other(link, entry, given, str(file))
        return act(link, entry, given)


@contextmanager
def _described(name: str, reached: Bus, eds: Path | None,
               **guarded: bool) -> Iterator[tuple[Link, dcf.DescribedNode]]:
    """Return a link and the entry of a node that has a dictionary, in PRE-OPERATIONAL where nothing else is live."""
    known = {entry.name: entry for entry in wire(reached.network()).nodes.values()}
    if eds is None and name in known:
        eds = Path(known[name].dictionary.path)
    with _node(name, reached, eds, **guarded) as one:
        if one.dictionary is None:
            raise InputError(f"node {one.node_id}: no EDS fits it; give --eds FILE or a folder of them.")
        if name in known:
            one.link.nmt(cia301.NmtCommand.ENTER_PRE_OPERATIONAL, one.node_id)
        yield one.link, dcf.NamedNode(one.node_id, name if name in known else f"node {one.node_id}", one.dictionary)


@contextmanager
def _node(name: str, reached: Bus, eds: Path | None, *, force: bool = False,
          acts: bool = False) -> Iterator[remote_node.NodeAccess]:
    """Return a node on its bus; `acts`: refuse while another master is there, unless `force`."""
    node_id = node_id_of(name, reached)
    with reached.linked(acts=acts and not force) as link:
        link.sdo_read(node_id, 0x1000)
        yield remote_node.NodeAccess(link, node_id, dictionary_of(link, node_id, eds))


def node_id_of(name: str, reached: Bus) -> int:
    """Return the node id of a number or of a name of the configuration; `InputError` for another word."""
    if name.isdecimal() and 1 <= int(name) <= 127:
        return int(name)
    known = {entry.name: node_id for node_id, entry in wire(reached.network()).nodes.items()}
    if name not in known:
        raise InputError(f"{name!r} is no node; expected an id from 1 to 127, or one of {', '.join(known)}.")
    return known[name]


def _listed(value: object) -> str:
    if value is None:
        return "–"
    return (", ".join(map(str, value)) or "none") if isinstance(value, list) else str(value)


def _differences(name: str, file: Path, found: list[dcf.ParameterDifference], what: str, status: int = 0
                 ) -> CommandAnswer:
    return CommandAnswer({"node": name, "file": str(file), what: [
        {"index": f"{d.object:04X}:{d.subindex:02X}", "name": d.name, "in_file": _plain(d.in_file),
         "on_node": _plain(d.on_node)} for d in found]}, [
        *(f"{d.object:04X}:{d.subindex:02X} {d.name}: {d.in_file!r} in the file, {d.on_node!r} on the node"
          for d in found), f"{len(found)} parameters {what}."], status)


def _plain(value: object) -> object:
    return value.decode("latin-1") if isinstance(value, bytes) else value
