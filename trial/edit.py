"""Parts and unions of MCAP recordings: `bowden cut` and `bowden merge`.

Messages keep their bytes, times and channels. Sequence numbers are counted anew, since messages left out on purpose
are not lost ones. Any MCAP file will do; mcap's own reader and writer are used, since speed does not matter here.
"""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError

from parameters import InputError
from parameters.files import refuse_special, replaced
from trial import read
from trial.mcap_file import cdr, records
from trial.mcap_file.container import MAGIC

CHUNK = 64 << 10
TOLD_OF_A_WHOLE = ("cycles", "settle")  # of a trial's metadata: does not hold for a part


@dataclass
class EditSummary:
    """Result of an edit: messages by topic, and the duration of the written recording, s."""

    messages: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0


def cut(
    source: Path, target: Path, *, from_s: float = 0.0, to_s: float | None = None,
    gait: tuple[int, int] | None = None, overwrite: bool = False,
) -> EditSummary:
    """Write what lies from `from_s` until before `to_s`, s after the first control cycle (or the first message).

    `gait` gives the first and the last gait cycle instead.  Raises `InputError` where nothing lies there.
    """
    with _reader(source) as reader:
        first_ns = _first(reader)
        begin, end = first_ns + round(from_s * 1e9), None if to_s is None else first_ns + round(to_s * 1e9)
        if gait is not None:
            begin, end = _gait_span(source, gait)
        if from_s == 0.0 and gait is None:
            begin = 0  # bring-up belongs to what begins at the beginning
        if end is not None and end <= begin:
            raise InputError(f"{source}: --to is not after --from; give a later one.")
        span = {"cut_from_s": (begin - first_ns) / 1e9 if begin else 0.0,
                "cut_to_s": None if end is None else (end - first_ns) / 1e9}
        with replaced(target, overwrite=overwrite) as part, part.open("wb") as file:
            writer = _Writer(file)
            _carry(reader, writer, "", {})
            for schema, channel, message in reader.iter_messages():
                if begin <= message.log_time and (end is None or message.log_time < end):
                    writer.message(schema, channel, message)
            if not writer.found.messages:
                raise InputError(f"{source}: nothing was recorded there; it lasts {_length(reader, first_ns):.3f} s.")
            writer.finish({"outcome": "cut", **span})
    return writer.found


def merge(sources: Sequence[Path], target: Path, *, overwrite: bool = False) -> EditSummary:
    """Write several recordings as one, by time.

    Topics that several of them have are joined if they follow each other and have one schema. Raises `InputError` if
    they overlap, since messages could not be attributed to a recording.
    """
    if len(sources) < 2:
        raise InputError("merge: needs two recordings or more.")
    with ExitStack() as stack:
        readers = {path: stack.enter_context(_reader(path)) for path in sources}
        _refuse_overlap(readers)
        with replaced(target, overwrite=overwrite) as part, part.open("wb") as file:
            writer, known = _Writer(file), dict[str, object]()
            for path, reader in readers.items():
                _carry(reader, writer, f"{path.name}/", known)
            streams = [reader.iter_messages() for reader in readers.values()]
            for schema, channel, message in heapq.merge(*streams, key=lambda one: one[2].log_time):
                writer.message(schema, channel, message)
            writer.finish({"outcome": "merged", "merged_from": [path.name for path in sources]})
    return writer.found


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    from mcap.reader import SeekingReader

    refuse_special(path)
    try:
        with path.open("rb") as file:
            records.magic(file.read(len(MAGIC)), path)
            file.seek(0)
            reader = SeekingReader(file)
            if reader.get_summary() is None:
                raise InputError(f"{path}: has no summary; say bowden recover {path} -o FILE.")
            yield reader
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a recording.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a recording.") from None
    except InputError:
        raise
    except (McapError, ValueError, KeyError) as error:
        raise InputError(f"{path}: is torn, damaged or no MCAP file ({type(error).__name__}); say bowden recover "
                         f"{path} -o FILE.") from None


def _first(reader: Any) -> int:
    """Return the time of the first control cycle, or of the first message without any."""
    summary = reader.get_summary()
    if any(channel.topic == cdr.CYCLE for channel in summary.channels.values()):
        for _, _, message in reader.iter_messages(topics=cdr.CYCLE):
            return int(message.log_time)
    return int(summary.statistics.message_start_time) if summary.statistics else 0


def _length(reader: Any, first_ns: int) -> float:
    statistics = reader.get_summary().statistics
    return (statistics.message_end_time - first_ns) / 1e9 if statistics else 0.0


def _gait_span(source: Path, gait: tuple[int, int]) -> tuple[int, int]:
    """Return the time of the first cycle of gait cycle `gait[0]`, and of the first one after `gait[1]`."""
    opened = read.open(source)
    cycle = opened.columns.get("cycle")
    if cycle is None:
        raise InputError(f"{source}: does not say which gait cycle is which; cut it by --from and --to.")
    rows = ((cycle >= gait[0]) & (cycle <= gait[1])).nonzero()[0]
    if not len(rows):
        raise InputError(f"{source}: has no gait cycle from {gait[0]} to {gait[1]}; give others.")
    return int(opened.time_ns[rows[0]]), int(opened.time_ns[rows[-1]]) + 1


def _refuse_overlap(readers: Mapping[Path, Any]) -> None:
    spans: dict[str, list[tuple[int, int, Path, tuple[str, bytes]]]] = {}
    for path, reader in readers.items():
        summary = reader.get_summary()
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            kind = ("", b"") if schema is None else (schema.name, schema.data)
            span = _span(reader, channel.topic)
            if span is not None:
                spans.setdefault(channel.topic, []).append((*span, path, kind))
    for topic, found in spans.items():
        found.sort(key=lambda one: one[0])
        for one, other in pairwise(found):
            if other[0] <= one[1]:
                raise InputError(f"{other[2]}: its {topic} overlaps that of {one[2]} in time, so the two cannot be "
                                 "told apart in one file; compare them, or cut one.")
            if one[3] != other[3]:
                raise InputError(f"{other[2]}: its {topic} is of another kind or has other columns than that of "
                                 f"{one[2]}; such topics cannot be one.")


def _span(reader: Any, topic: str) -> tuple[int, int] | None:
    first = next(reader.iter_messages(topics=topic), None)
    last = next(reader.iter_messages(topics=topic, reverse=True), None)
    return None if first is None or last is None else (first[2].log_time, last[2].log_time)


def _carry(reader: Any, writer: _Writer, prefix: str, known: dict[str, object]) -> None:
    """Copy metadata and attachments; of several files' the first keeps its name, others that differ get a `prefix`."""
    for record in reader.iter_metadata():
        if record.name == "result":
            continue
        entries = dict(record.metadata)
        if record.name == "trial":
            entries = {name: text for name, text in entries.items() if name not in TOLD_OF_A_WHOLE}
        name = _named(f"metadata {record.name}", entries, prefix, known)
        if name is not None:
            writer.metadata(name.removeprefix("metadata "), entries)
    for attachment in reader.iter_attachments():
        name = _named(attachment.name, attachment.data, prefix, known)
        if name is not None:
            writer.attachment(name, attachment)


def _named(name: str, content: object, prefix: str, known: dict[str, object]) -> str | None:
    if name not in known:
        known[name] = content
        return name
    if known[name] == content:
        return None
    kind, _, rest = name.rpartition(" ")
    return f"{kind} {prefix}{rest}".strip()


class _Writer:
    """An MCAP file whose channels are those of the files that messages come from."""

    def __init__(self, file: Any) -> None:
        from mcap.writer import Writer

        self._writer: Any = Writer(file, chunk_size=CHUNK)
        self._writer.start("ros2", "bowden-bench")
        self._channels: dict[tuple[object, ...], int] = {}
        self._schemas: dict[tuple[object, ...], int] = {}
        self._sequence: dict[int, int] = {}
        self._span: tuple[int, int] | None = None
        self.found = EditSummary()

    def metadata(self, name: str, entries: Mapping[str, str]) -> None:
        self._writer.add_metadata(name, dict(entries))

    def attachment(self, name: str, file: Any) -> None:
        self._writer.add_attachment(file.create_time, file.log_time, name, file.media_type, file.data)

    def message(self, schema: Any, channel: Any, message: Any) -> None:
        number = self._channel(schema, channel)
        sequence = self._sequence.get(number, 0)
        self._sequence[number] = sequence + 1
        self._writer.add_message(number, message.log_time, message.data, message.publish_time, sequence)
        self.found.messages[channel.topic] = self.found.messages.get(channel.topic, 0) + 1
        first, last = self._span or (message.log_time, message.log_time)
        self._span = min(first, message.log_time), max(last, message.log_time)

    def _channel(self, schema: Any, channel: Any) -> int:
        kind = ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
        key = (channel.topic, channel.message_encoding, kind)
        if key not in self._channels:
            if schema is not None and kind not in self._schemas:
                self._schemas[kind] = self._writer.register_schema(*kind)
            self._channels[key] = self._writer.register_channel(
                channel.topic, channel.message_encoding, self._schemas.get(kind, 0), dict(channel.metadata))
        return self._channels[key]

    def finish(self, result: Mapping[str, object]) -> None:
        """Write the metadata record "result", each value as JSON, and the summary that ends the file."""
        self._writer.add_metadata("result", {name: json.dumps(value) for name, value in result.items()})
        self._writer.finish()
        if self._span is not None:
            self.found.seconds = (self._span[1] - self._span[0]) / 1e9
