"""Reading and writing of files that a user names: sizes are bounded, and a file is replaced only by a whole one.

A named pipe, device or socket is refused before it is opened, since reading it may never end.  New content is written
beside its target, under a random name, and then renamed.
"""

import gzip
import io
import json
import math
import os
import stat
import tempfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from parameters.declared import InputError

UNPACKED_FLOOR = 64 << 20  # bytes that a packed file may always unpack to: a reader needs about three times that …
UNPACKED_RATIO = 64  # … or this many times the file's size; a bench standing still packs about 40:1
READ_LIMIT = 2 << 30  # bytes of a file that is read into memory
LONGEST_LINE = 8 << 20  # bytes of one line of text
_KINDS = {stat.S_IFIFO: "a named pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket",
          stat.S_IFDIR: "a directory"}


def refuse_special(path: str | Path) -> None:
    """Raise `InputError` where `path` is there and is no regular file (links are followed)."""
    try:
        kind = stat.S_IFMT(os.stat(path).st_mode)
    except OSError:
        return  # whoever opens it says what is wrong
    if kind != stat.S_IFREG:
        raise InputError(f"{path}: cannot be read, it is {_KINDS.get(kind, 'no file')}; give the path of a file.")


def refuse_large(path: Path) -> None:
    """Raise `InputError` for a file longer than `READ_LIMIT`, since its content would take as much memory or more."""
    if path.stat().st_size > READ_LIMIT:
        raise InputError(f"{path}: is longer than {READ_LIMIT} bytes; cut it.")


def content(path: Path, what: str, *, limit: int = READ_LIMIT, lines: bool = False) -> bytes:
    """Return the bytes of a file, unpacked if its name ends in .gz; `what` names the expected kind of file.

    Raises `InputError` for a file that is absent, no regular file, unreadable, longer than `limit` bytes or, packed,
    much longer than it looks; where `lines` are expected also for one that is endless.
    """
    refuse_special(path)
    try:
        if path.suffix.lower() == ".gz":
            raw = _unpacked(path)
        elif path.stat().st_size > limit:
            raise InputError(f"{path}: is longer than {limit} bytes; cut it, or give {what}.")
        else:
            with path.open("rb") as file:
                head = file.read(2 * LONGEST_LINE) if lines else b""
                if lines:
                    refuse_long_lines(path, head)
                raw = head + file.read()
        if lines:
            refuse_long_lines(path, raw)
        return raw
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of {what}.") from None
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read ({error}); give {what}.") from None
    except MemoryError:
        raise InputError(f"{path}: is too large for this computer's memory; cut it.") from None


def _unpacked(path: Path) -> bytes:
    limit = unpacked_limit(path)
    with gzip.open(path) as file:
        raw = file.read(limit + 1)
    if len(raw) > limit:
        raise InputError(f"{path}: unpacks to more than {limit} bytes; it is no measured data, do not open it.")
    return raw


def unpacked_limit(path: Path) -> int:
    """Return the largest unpacked size of a packed file, bytes."""
    return most_unpacked(path.stat().st_size)


def most_unpacked(size: int) -> int:
    """Return the largest unpacked size of a packed file of `size` bytes."""
    return max(UNPACKED_FLOOR, UNPACKED_RATIO * size)


def unpacked_ending(path: Path) -> str:
    """Return the ending of a file's name in lower case; of a file packed by gzip the one before .gz."""
    endings = [ending.lower() for ending in path.suffixes] or [""]
    return endings[-2] if endings[-1] == ".gz" and len(endings) > 1 else endings[-1]


class BoundedFile(io.RawIOBase):
    """A CAN log read as a stream, unpacked if its name ends in .gz, within bounds.

    Reading raises `InputError` beyond the largest unpacked size and, of `lines`, where one is longer than any that
    somebody wrote.
    """

    def __init__(self, path: Path, *, lines: bool) -> None:
        self._file = path.open("rb")
        self._source = gzip.GzipFile(fileobj=self._file) if path.suffix.lower() == ".gz" else self._file
        self._path, self._size, self._lines = path, path.stat().st_size, lines
        self._read = self._line = 0

    def readable(self) -> bool:
        return True

    def readinto(self, room: Any) -> int:
        data = self._source.read(len(room))
        room[:len(data)] = data
        self._read += len(data)
        end = data.rfind(b"\n")
        self._line = self._line + len(data) if end < 0 else len(data) - end
        if self._read > most_unpacked(self._size):
            raise InputError(f"{self._path}: unpacks to more than {most_unpacked(self._size)} bytes; it is no measured "
                             "log, do not open it.")
        if self._lines and self._line > LONGEST_LINE:
            raise InputError(f"{self._path}: a line is longer than {LONGEST_LINE} bytes; it is no log.")
        return len(data)

    def share(self) -> float:
        """Return the share of the file that has been read, 0 … 1."""
        return min(1.0, self._file.tell() / max(1, self._size))

    def close(self) -> None:
        self._file.close()
        super().close()


def refuse_long_lines(path: Path, raw: bytes) -> None:
    """Raise `InputError` where a line of `raw` is certainly no line of a text that somebody wrote."""
    for at in range(0, max(0, len(raw) - LONGEST_LINE), LONGEST_LINE):
        if raw.find(b"\n", at, at + LONGEST_LINE) < 0 and raw.find(b"\r", at, at + LONGEST_LINE) < 0:
            raise InputError(f"{path}: a line is longer than {LONGEST_LINE} bytes; it is no text that can be read.")


@contextmanager
def replaced(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a new file beside `path`; it replaces `path` at the end of the block, and is deleted if the block raises.

    A link at `path` is replaced, never written through.  Raises `InputError` for a `path` that is there (unless
    `overwrite`), is no file, or cannot be written.
    """
    if path.exists() or path.is_symlink():
        refuse_special(path)
        if not overwrite:
            raise InputError(f"{path}: the file exists; give another name or --overwrite.")
    part: Path | None = None
    try:
        part = _fresh(path)
        yield part
        part.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); give a writable path.") from None
    finally:
        if part is not None:
            part.unlink(missing_ok=True)


def write_whole(path: Path, text: str | bytes, *, overwrite: bool = False) -> int:
    """Write a file that appears whole or not at all; returns its bytes."""
    data = text.encode("utf-8", "backslashreplace") if isinstance(text, str) else text
    with replaced(path, overwrite=overwrite) as part:
        part.write_bytes(data)
    return len(data)


def _fresh(path: Path) -> Path:
    number, name = tempfile.mkstemp(prefix=f".part-{path.name[:100]}-", suffix=path.suffix, dir=path.parent)
    try:
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(number if os.chmod in os.supports_fd else name, 0o666 & ~mask)
    finally:
        os.close(number)
    return Path(name)


def json_text(content: Mapping[str, Any], otherwise: Callable[[Any], Any] | None = None) -> str:
    """Return a JSON object, keys as given; an undefined number (NaN, infinite) is null.

    `otherwise`: turns a value that JSON has not into one that it has; without it such a value raises TypeError.
    """
    return json.dumps(_defined(content), ensure_ascii=False, allow_nan=False, default=otherwise)


def _defined(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _defined(v) for k, v in value.items()}
    return [_defined(v) for v in value] if isinstance(value, list | tuple) else value


__all__ = [
    "LONGEST_LINE",
    "READ_LIMIT",
    "UNPACKED_FLOOR",
    "UNPACKED_RATIO",
    "BoundedFile",
    "content",
    "json_text",
    "most_unpacked",
    "refuse_large",
    "refuse_long_lines",
    "refuse_special",
    "replaced",
    "unpacked_limit",
    "write_whole",
]
