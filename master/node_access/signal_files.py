"""The PDOs of a CANopen bus in the files of other tools: their layout as DBC, their decoded values as MF4.

Names, places, scales and units are those of a `FrameReader`, so that a file agrees with the monitor's lines.
"""

import importlib
import re
import struct
from pathlib import Path
from typing import Any, NamedTuple

from eds.pdo_plan import Field
from master.node_access.frame_words import FrameReader, KnownPdo
from parameters import InputError
from parameters.files import replaced, write_whole


class PlacedField(NamedTuple):
    """A mapped object in its frame: name unique there, first bit, and value of a count in `unit`."""

    name: str
    start_bit: int
    field: Field
    scale: float
    unit: str


def placed(reader: FrameReader, cob_id: int) -> list[PlacedField]:
    """Return the objects of a PDO in their places; gaps that belong to another receiver are left out."""
    known = reader.plans[cob_id]
    objects = iter(known.objects)
    found, names, bit = list[PlacedField](), set[str](), 0
    for field in known.plan.fields:
        if not field.dummy:
            told, unit = next(objects)
            name = re.sub(r"\W+", "_", told, flags=re.ASCII).strip("_") or f"object_{field.key >> 8:04X}"
            name = f"_{name}" if name[0].isdigit() else name
            name = name if name not in names else f"{name}_{field.key & 0xFF}"
            names.add(name)
            found.append(PlacedField(name, bit, field, *(unit or (1.0, ""))))
        bit += field.bits
    return found


def write_dbc(reader: FrameReader, path: Path, *, overwrite: bool = False) -> int:
    """Write a message for each PDO of the reader; return their number. Raises `InputError` without cantools."""
    can = _library("cantools.database.can", "cantools", "dbc")
    conversion = importlib.import_module("cantools.database.conversion").BaseConversion
    messages = [can.Message(cob_id, _name(known), known.plan.size, [
        can.Signal(one.name, one.start_bit, one.field.bits, is_signed=one.field.signed, unit=one.unit or None,
                   conversion=conversion.factory(scale=one.scale)) for one in placed(reader, cob_id)],
        senders=[f"node{known.node_id}"] if known.name.startswith("tpdo") else [])
        for cob_id, known in sorted(reader.plans.items()) if known.plan.keys]
    nodes = [can.Node(f"node{node}") for node in sorted(reader.dictionaries)]
    database = can.Database(messages=messages, nodes=nodes, version="")
    write_whole(path, database.as_dbc_string(), overwrite=overwrite)
    return len(messages)


class SignalRecording:
    """Gathers the decoded values of the PDOs of a bus, by COB-ID, in the units of their objects."""

    def __init__(self, reader: FrameReader) -> None:
        self._reader = reader
        self._rows: dict[int, list[tuple[int, tuple[int, ...]]]] = {}

    def take(self, time_ns: int, cob_id: int, data: bytes) -> None:
        """Take a frame; a frame that is not a PDO, or shorter than its mapping, is left out."""
        known = self._reader.plans.get(cob_id)
        if known is None:
            return
        try:
            self._rows.setdefault(cob_id, []).append((time_ns, known.plan.unpack(data)))
        except struct.error:
            return

    def write(self, path: Path, *, overwrite: bool = False) -> int:
        """Write a channel group for each PDO, over its own times in s from the first one; return the frames.

        Raises `InputError` without asammdf.
        """
        import numpy as np

        library = _library("asammdf", "asammdf", "mf4")
        rows = {cob_id: one for cob_id, one in self._rows.items() if one}
        first_ns = min((one[0][0] for one in rows.values()), default=0)
        with library.MDF(version="4.10") as file:
            for cob_id, taken in rows.items():
                time_s = np.array([time_ns - first_ns for time_ns, _ in taken]) * 1e-9
                values = np.array([raw for _, raw in taken], dtype=np.float64)
                file.append([library.Signal(values[:, i] * one.scale, time_s, unit=one.unit,
                                            name=f"{_name(self._reader.plans[cob_id])}.{one.name}")
                             for i, one in enumerate(placed(self._reader, cob_id))])
            with replaced(path, overwrite=overwrite) as part:
                file.save(part, overwrite=True)
        return sum(map(len, rows.values()))


def _name(known: KnownPdo) -> str:
    return f"node{known.node_id}_{known.name}" if known.node_id else known.name


def _library(module: str, name: str, extra: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"{extra.upper()} needs {name}; say pip install 'bowden-bench[{extra}]'.") from None
