"""bench.toml: one table per room's declaration; values and bounds are declared in those rooms.

A section is a declared dataclass of the room that uses it, found in `SECTIONS`; options on the command line replace
fields of those dataclasses and are checked by the same bounds.  `held_limits` is the table of safety functions and
their holders, for `check config`, `doctor` and a trial's file.
"""

from __future__ import annotations

import csv
import dataclasses
import importlib
import io
import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bowden.deferred import on_first_use
from parameters import InputError, checked, declarations, from_table, read_toml, template

with on_first_use():
    import safety_monitor
    from eds import declaration as bench_declaration
    from eds.bench.bench_network import wire
    from eds.declaration import as_tables, declared, packaged, text_of
    from master import limit_holders
    from master.limit_holders import HeldLimit, holders, unheld
    from master.own_limits import checked as checked_own
    from master.own_limits import of_path

SECTIONS: dict[str, tuple[str, str]] = {
    "network": ("eds.bench.bench_network", "Network"),
    "gait": ("master.settings", "Gait"),
    "walk": ("master.settings", "Walk"),
    "impedance": ("master.settings", "Impedance"),
    "limits": ("master.settings", "Limits"),
    "homing": ("master.settings", "Homing"),
    "record": ("master.settings", "Record"),
}
OPTIONAL = ("walk",)
"""Sections that a trial carries only where one of their values is not the default."""
DEVICES: dict[str, tuple[str, str]] = {
    "servo": ("eds.device_mapping", "ServoMapping"),
    "knee": ("eds.device_mapping", "KneeMapping"),
    "start": ("eds.device_mapping", "SensorMapping"),
    "end": ("eds.device_mapping", "SensorMapping"),
}
"""Tables of bench.toml that map the objects of a foreign device: class of each, by name of the device."""
MONITOR = {"monitor": ("eds.bench.network", "Monitor")}
"""Table of the safety monitor, which becomes part of the network."""
TABLES = {**SECTIONS, **MONITOR, **DEVICES}
PERSON = "person.toml"
"""Name under which a trial has the person's file of its safety monitor."""
ARRAYS = ("device", "joint", "force_path")
"""Arrays of tables that declare the bench; `eds.declaration` reads them."""


def declaration(section: str) -> type[Any]:
    """Return the dataclass that declares one section."""
    module, name = TABLES[section]
    found: type[Any] = getattr(importlib.import_module(module), name)
    return found


def force_paths(path: Path) -> list[str]:
    """Return the names of the force paths of a bench.toml; none where it cannot be read."""
    try:
        return [declared.name for declared in read(path, any_shape=True)["network"].bench.force_paths]
    except InputError:
        return []


def read(path: Path | None, *, any_shape: bool = False, person: Path | None = None) -> dict[str, Any]:
    """Return every section as its checked dataclass; sections absent from the file, or no file, give the defaults.

    Raises `InputError` for a declared bench of a shape that does not run, unless `any_shape`: the wire of every shape
    can be planned. `person`: the file of the safety monitor's bounds, in place of the one that the file names.
    """
    given = read_toml(path) if path else {}
    arrays = {name: given.pop(name) for name in ARRAYS if name in given}
    for name, content in given.items():
        if name not in TABLES and not isinstance(content, dict | list):
            raise InputError(f"{path}: {name} = {content!r} stands before the first table; write it below the [table] "
                             "that it belongs to, such as [network].")
        if name not in TABLES:
            raise InputError(
                f"{path}: unknown table [{name}]; expected one of {', '.join((*TABLES, *ARRAYS))}.")
        if not isinstance(content, dict):
            raise InputError(f"{path}: {name} = {content!r} is not a table; write it as [{name}].")
    given["limits"], own = _apart(given.get("limits", {}))
    read = {name: from_table(declaration(name), given.get(name, {}), where=f"{path} [{name}]")
            for name in TABLES if name in SECTIONS or name in MONITOR or name in given}
    named = read.pop("monitor").file
    monitor = monitored(named, path) if person is None else monitored(str(person), None)
    mappings = {name: _beside(path, read.pop(name)) for name in DEVICES if name in read}
    bench = _bench(mappings, arrays, path, any_shape)
    return read | {"network": dataclasses.replace(read["network"], bench=bench, monitor=monitor),
                   "limits": _with_own(read["limits"], own, bench, path)}


def monitored(file: str, config: Path | None) -> str:
    """Return the person's file of a safety monitor, relative to the configuration's folder; "packaged" is the own one.

    Raises `InputError` for a file that cannot be used.
    """
    if not file:
        return ""
    beside = Path(file) if config is None else config.parent / file
    found = safety_monitor.packaged() if file == "packaged" else beside
    try:
        safety_monitor.read(found)
    except safety_monitor.PersonError as error:
        raise InputError(f"monitor {error}") from None
    return str(found)


def with_monitor(network: Any, option: str | None) -> Any:
    """Return the network with the safety monitor that `--monitor` names; None leaves that of the configuration."""
    return network if option is None else dataclasses.replace(network, monitor=monitored(option, None))


def _apart(limits: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split `[limits]`: values of the whole bench, and its sub-tables by the name of a device, joint or force path."""
    own = {name: content for name, content in limits.items() if isinstance(content, dict)}
    return {name: value for name, value in limits.items() if name not in own}, own


def _with_own(limits: Any, own: Mapping[str, Any], bench: Any, path: Path | None) -> Any:
    """Return the bench's limits with those of devices, joints and force paths; a single path's replace the bench's."""
    found = dataclasses.replace(limits, own=checked_own(own, bench, where=str(path)))
    return found if len(bench.force_paths) > 1 else of_path(found, bench, bench.force_paths[0])


def _bench(mappings: Mapping[str, Any], arrays: Mapping[str, Any], path: Path | None, any_shape: bool) -> Any:
    """Return the declared bench, or the packaged one, with the devices of the tables `mappings`."""
    paper = packaged()
    bench = paper if path is None or not arrays else declared(arrays, where=str(path), folder=path.parent)
    same = bench.shape == paper.shape
    for name in mappings:
        if not same or name in bench.other_devices:
            raise InputError(f"{path}: [{name}] stands beside [[device]]; move its keys into the [[device]] of "
                             f"{name}.")
    refused = bench.refusal()
    if refused is not None and not any_shape:
        raise InputError(f"{path}: {refused}; bowden check config plans the wire of such a bench, and no command "
                         "runs it: declare another one.")
    return bench.mapped({bench.named(name).node_id: mapping for name, mapping in mappings.items()})


def drawn(walk: Any, seed: int | None) -> Any:
    """Return the walk section with the seed of an option, where strides are drawn."""
    return walk if seed is None or not walk.strides else dataclasses.replace(walk, seed=seed)


def homing(section: Any, least_n: float | None) -> Any:
    """Return the homing section with the START tension, N, that `--homing-n` allows it whatever the peak is."""
    if least_n is None:
        return section
    return override(section, {"least_n": ("--homing-n", least_n), "top_n": ("--homing-n", max(section.top_n, least_n))})


def refuse_raised(limits: Any, where: str) -> None:
    """Raise `InputError` for limits above the packaged ones without a reason, which a trial carries with it."""
    above = limits.above_packaged()
    if above and not limits.raised.strip():
        raise InputError(f"{where}: {'; '.join(above)}: above what is packaged; lower it, or say why with "
                         "--raise-limits REASON.")


def _beside(path: Path | None, mapping: Any) -> Any:
    """Return a device's file, named relative to the folder of the configuration."""
    file = Path(mapping.file)
    return mapping if not mapping.file or path is None else dataclasses.replace(mapping, file=str(path.parent / file))


def override(section: Any, options: Mapping[str, tuple[str, Any]]) -> Any:
    """Replace fields by command-line options {field: (option, value)}; None means not given."""
    for field, (option, value) in options.items():
        if value is not None:
            section = checked(dataclasses.replace(section, **{field: value}), where=option)
    return section


def as_text(sections: Mapping[str, Any]) -> str:
    """Return the configuration in use, as TOML, for attachment to a trial."""
    bench = sections["network"].bench
    same = bench.shape == packaged().shape
    tables = {name: section for name, section in sections.items() if name not in OPTIONAL or section != type(section)()}
    tables |= bench.other_devices if same else {}
    return "\n".join((*(f"[{name}]\n{_lines(section)}" for name, section in tables.items()),
                      *_own_lines(sections.get("limits")),
                      *([f'[monitor]\nfile = "{PERSON}"\n'] if sections["network"].monitor else []),
                      *(() if same else _arrays(as_tables(bench)))))


def _own_lines(limits: Any) -> list[str]:
    found: dict[str, str] = {}
    for own in () if limits is None else limits.own:
        found[own.of] = found.get(own.of, f"[limits.{own.of}]\n") + f"{own.name} = {_shown(own.value)}\n"
    return list(found.values())


def _arrays(tables: Mapping[str, Any]) -> list[str]:
    return [f"[[{name}]]\n" + "".join(f"{key} = {_shown(value)}\n" for key, value in row.items())
            for name, rows in tables.items() for row in rows]


def _lines(section: Any) -> str:
    lines = []
    for field, _, _ in declarations(type(section)):
        lines.append(f"{field} = {_shown(getattr(section, field))}\n")
    return "".join(lines)


def _shown(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else _quoted(value) if isinstance(value, str) else str(value)


def _quoted(text: str) -> str:
    """Return a TOML string: JSON's escapes are among TOML's."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def as_template(told: Mapping[str, str] | None = None, shape: str = "bench") -> str:
    """Return the text of a bench.toml: every key with default, unit, range and source, and the devices of `shape`.

    `told`: values of the section `[record]`.  Raises `InputError` for a shape that is not packaged.
    """
    if shape not in bench_declaration.SHAPES:
        raise InputError(f"--shape {shape}: expected one of {', '.join(bench_declaration.SHAPES)}; choose the shape "
                         "of the bench.")
    arrays = text_of(shape)
    text = "\n".join((*(template(declaration(name), name) for name in (*SECTIONS, *MONITOR)), arrays))
    for line in tomllib.loads(arrays).get("network", {}).items():
        text = text.replace("[network]\n{} = {}\n\n".format(*line), "")
        text = re.sub(rf"^{line[0]} = .*$", "{} = {}".format(*line), text, flags=re.MULTILINE)
    for field, said in (told or {}).items():
        text = text.replace(f'\n{field} = ""', f"\n{field} = {_quoted(said)}")
    return text


SAFETY_TABLE = "safety_functions.csv"
"""Name of the table in a trial's file."""


def held_limits(sections: Mapping[str, Any]) -> list[HeldLimit]:
    """Return the table of a checked configuration; raises `InputError` for devices that do not fit their places."""
    network = sections["network"]
    return holders(wire(network), sections["limits"], _held_by_monitor(getattr(network, "monitor", "")))


def _held_by_monitor(person: str) -> dict[str, str]:
    """Return the bounds that the safety monitor of a person's file holds, by function; none without a file."""
    if not person:
        return {}
    bounds = read_toml(Path(person))
    held = {
        "START tension": "{start_n} N", "START tension without the master": "{start_n} N", "END tension": "{end_n} N",
        "rope speed": "{rope_m_s} m/s", "knee angle": "{knee_low_deg}° … {knee_high_deg}°",
        "knee speed": "{knee_deg_s} °/s", "master lost": "{heartbeat_ms} ms"}
    return {function: text.format_map(bounds) for function, text in held.items()}


def held_as_csv(rows: list[HeldLimit]) -> bytes:
    """Return the table as CSV with a header."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(limit_holders.COLUMNS)
    writer.writerows(row.cells for row in rows)
    return text.getvalue().encode()


def held_as_objects(rows: list[HeldLimit]) -> list[dict[str, str]]:
    """Return the table as JSON objects, one a row."""
    return [{**row._asdict(), "held_by": row.held_by} for row in rows]


def refuse_unheld(sections: Mapping[str, Any], where: str) -> None:
    """Raise `InputError` for a safety function that nobody holds, without a reason that a trial carries with it."""
    if sections["limits"].raised.strip():
        return
    functions = unheld(held_limits(sections))
    if functions:
        raise InputError(f"{where}: nobody holds {'; '.join(functions)}: use a drive that has the objects (bowden "
                         "check config lists them), declare a monitor, or say why with --raise-limits REASON.")
