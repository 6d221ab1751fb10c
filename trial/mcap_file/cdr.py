"""Bytes of each topic: ROS 2 CDR, little endian, every message of a topic equally long if possible.

A layout is declared once, as the `ros2msg` schema for readers and the numpy dtype for bulk access. A test holds the
two together: it decodes with a CDR reader that has the schema only. A dtype here is one complete MCAP message record,
opcode to payload.
"""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

FRAMES, CYCLE, EVENTS = "/can/frames", "/cycle", "/events"
LITTLE_ENDIAN = 0x00000100  # encapsulation header 00 01 00 00
MESSAGE = 0x05  # MCAP opcode
MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
REMOTE, EXTENDED, ERROR = 1, 2, 4  # flags of a frame
FRAME_IDS = np.frombuffer(b"".join(f"can{digit}/{way}\0".encode() for digit in "0123456789abcdef"
                                   for way in ("rx", "tx")), np.uint64)
"""`frame_id` by channel, then by whether the frame was sent from here: eight characters each."""

HEAD: list[tuple[str, str]] = [  # as MESSAGE_HEAD
    ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
    ("log_time", "<u8"), ("publish_time", "<u8"),
]
_RECORD = [*HEAD, ("cdr", "<u4"), ("sec", "<i4"), ("nanosec", "<u4")]

# What the recorder packs in the control thread, and what `Trial.frames` holds.
FRAME_ROW = np.dtype([
    ("time_ns", "<i8"), ("can_id", "<u4"), ("flags", "u1"), ("dlc", "u1"), ("channel", "u1"), ("sent", "?"),
    ("data", "u1", (8,)),
])
FRAME_STRUCT = struct.Struct("<qIBBB?8s")

FRAME_RECORD = np.dtype([
    *_RECORD, ("frame_id_length", "<u4"), ("frame_id", "u1", (8,)),
    ("id", "<u4"), ("is_rtr", "u1"), ("is_extended", "u1"), ("is_error", "u1"), ("dlc", "u1"), ("data", "u1", (8,)),
])
_TIME = """\
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
FRAME_SCHEMA_NAME = "can_msgs/msg/Frame"
FRAME_SCHEMA = f"""\
std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_TIME}"""

CYCLE_SCHEMA_NAME = "bowden/msg/Cycle"
EVENT_SCHEMA_NAME = "bowden/msg/Event"
EVENT_SCHEMA = f"builtin_interfaces/Time stamp\nstring kind\nstring source\nstring text\n{_TIME}"


def cycle_schema(names: Sequence[str]) -> str:
    """Return the `ros2msg` schema of a table: a stamp, then one float64 a column.

    Columns `<part>.<name>`, those of a part side by side, are fields of a message `part`: readers show the same name,
    and float64 stay where they are.
    """
    fields: list[str] = []
    parts: dict[str, list[str]] = {}
    for name in names:
        part, dot, rest = name.partition(".")
        if not dot:
            fields.append(f"float64 {name}\n")
        elif part not in parts:
            fields.append(f"{_part_type(part)} {part}\n")
        if dot:
            parts.setdefault(part, []).append(f"float64 {rest}\n")
    nested = "".join(f"{'=' * 80}\nMSG: {_part_type(part)}\n{''.join(lines)}" for part, lines in parts.items())
    return "builtin_interfaces/Time stamp\n" + "".join(fields) + _TIME + nested


def _part_type(part: str) -> str:
    return f"bowden_msgs/{''.join(word.capitalize() for word in part.split('_'))}Cycle"


def cycle_columns(schema: str) -> tuple[str, ...] | None:
    """Return the columns of a table's schema, or None where it is not a stamp and then only float64."""
    first, *rest = ([line for text in block.splitlines() if (line := text.split("#")[0].split())]
                    for block in schema.split("=" * 80))
    nested = {block[0][1]: block[1:] for block in rest if block and block[0][:1] == ["MSG:"] and len(block[0]) == 2}
    if not first or first[0] != ["builtin_interfaces/Time", "stamp"]:
        return None
    columns: list[str] = []
    for field in first[1:]:
        if len(field) != 2:
            return None
        kind, name = field
        inner = [[kind, ""]] if kind == "float64" else nested.get(kind)
        if inner is None or any(len(each) != 2 or each[0] != "float64" for each in inner):
            return None
        columns += [f"{name}.{each[1]}" if each[1] else name for each in inner]
    return tuple(columns)


def cycle_record(columns: int) -> np.dtype[np.void]:
    """Return the dtype of one `/cycle` message record of `columns` float64 values."""
    return np.dtype([*_RECORD, ("values", "<f8", (columns,))])


def cycle_row(columns: int) -> struct.Struct:
    """Return the struct the recorder packs a cycle with: time in ns, then its values."""
    return struct.Struct(f"<q{columns}d")


def headed(
    dtype: np.dtype[np.void], channel: int, first_sequence: int, times: NDArray[np.int64], **same: Any
) -> NDArray[np.void]:
    """Return message records with the fields common to all: lengths, sequence numbers, stamps; `same`: equal fields.

    Equal fields are written once and copied as a block: field by field takes several times as long.
    """
    first = np.zeros(1, dtype)
    for name, value in {"opcode": MESSAGE, "length": dtype.itemsize - 9, "channel": channel, "cdr": LITTLE_ENDIAN,
                        **same}.items():
        first[name] = value
    records = np.empty(len(times), dtype)
    whole = f"V{dtype.itemsize}"
    records.view(whole)[:] = first.view(whole)
    records["sequence"] = np.arange(first_sequence, first_sequence + len(times), dtype=np.uint32)
    records["log_time"] = times
    records["publish_time"] = times
    seconds = times // 1_000_000_000
    records["sec"] = seconds
    records["nanosec"] = times - seconds * 1_000_000_000
    return records


def frame_records(rows: NDArray[np.void], channel: int, first_sequence: int) -> NDArray[np.void]:
    """Turn `FRAME_ROW`s into message records; ValueError on a DLC above 8 or a channel above 15."""
    if rows["dlc"].max(initial=0) > 8 or rows["channel"].max(initial=0) > 15:
        raise ValueError("a CAN frame has at most 8 data bytes and a channel number below 16")
    records = headed(FRAME_RECORD, channel, first_sequence, rows["time_ns"], frame_id_length=8)
    records["frame_id"].view(np.uint64)[:, 0] = FRAME_IDS[2 * rows["channel"] + rows["sent"]]
    records["id"] = rows["can_id"]
    flags = rows["flags"]
    if flags.any():
        records["is_rtr"] = flags & REMOTE != 0
        records["is_extended"] = flags & EXTENDED != 0
        records["is_error"] = flags & ERROR != 0
    records["dlc"] = rows["dlc"]
    records["data"].view(np.uint64)[:] = rows["data"].view(np.uint64)
    return records


def frame_rows(records: NDArray[np.void]) -> NDArray[np.void]:
    """Convert message records of `/can/frames` to `FRAME_ROW`s."""
    rows = np.empty(len(records), FRAME_ROW)
    rows["time_ns"] = records["log_time"]
    rows["can_id"] = records["id"]
    rows["flags"] = (records["is_rtr"] != 0) * REMOTE | (records["is_extended"] != 0) * EXTENDED \
        | (records["is_error"] != 0) * ERROR
    rows["dlc"] = records["dlc"]
    digit = records["frame_id"][:, 3]
    rows["channel"] = np.where(digit >= ord("a"), digit - ord("a") + 10, digit - ord("0"))
    rows["sent"] = records["frame_id"][:, 5] == ord("t")
    rows["data"] = records["data"]
    return rows


def cycle_records(rows: NDArray[np.void], channel: int, first_sequence: int) -> NDArray[np.void]:
    """Convert rows of time and values to message records of `/cycle`."""
    records = headed(cycle_record(rows["values"].shape[1]), channel, first_sequence, rows["time_ns"])
    records["values"] = rows["values"]
    return records


def pack_string(body: bytearray, text: str) -> None:
    """Append a CDR string: aligned length with its NUL, then the bytes."""
    raw = text.encode(errors="backslashreplace") + b"\0"
    body.extend(b"\0" * (-len(body) % 4))
    body.extend(struct.pack("<I", len(raw)))
    body.extend(raw)


def event_message(time_ns: int, kind: str, source: str, text: str) -> bytes:
    """Return one `/events` payload."""
    body = bytearray(struct.pack("<iI", *divmod(time_ns, 1_000_000_000)))
    for part in (kind, source, text):
        pack_string(body, part)
    return struct.pack("<I", LITTLE_ENDIAN) + bytes(body)


def event_strings(payload: bytes) -> tuple[str, str, str]:
    """Return kind, source and text of an `/events` payload; ValueError where it is not one."""
    if len(payload) < 12 or payload[:4] != b"\0\1\0\0":
        raise ValueError("not a little-endian CDR message")
    body, at, parts = payload[4:], 8, []
    for _ in range(3):
        at += -at % 4
        if at + 4 > len(body):
            raise ValueError("a string is cut off")
        (length,) = struct.unpack_from("<I", body, at)
        raw = body[at + 4:at + 4 + length]
        if len(raw) != length or not raw.endswith(b"\0"):
            raise ValueError("a string is cut off")
        parts.append(raw[:-1].decode())
        at += 4 + length
    return parts[0], parts[1], parts[2]
