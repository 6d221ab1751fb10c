"""CSV files as their writers made them: encoding, delimiter, decimal sign, comments, header, units, kind of time.

Properties that the caller does not give are detected from the text; unusual detections are reported. Properties that
the caller gives (`Dialect`) are not questioned. A date is accepted only if it is unambiguous (ISO 8601, year first,
or day.month.year). Rows are counted as an editor counts them. All CSV parsing is here: imports, curves and the
diagnosis read through this module.
"""

import csv
import datetime
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parameters import InputError, parameter
from parameters.files import content
from trial.convert.lab_table import Floats, LabTable, unique, unit_of
from trial.signals import UNITS

DELIMITERS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "blanks"}
COMMENTS = ("#", "%", "//")
UNKNOWN = frozenset(("", "nan", "na", "n/a", "null", "none", "-", "--", "–", "#n/a", "#nv", "nat"))
SAMPLE, CELLS = 40, 200  # lines and cells of each that a delimiter is judged by
MOST_PREAMBLE = 1000  # lines before a header
DEGREE_ALIAS = "knee_angle_deg"  # the one accepted alias
_NUMBER = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?\s*$|\s*[+-]?(?:nan|inf)\s*$", re.IGNORECASE)
_COMMA_NUMBER = re.compile(r"\s*[+-]?(?:\d+,\d*|,\d+)(?:[eE][+-]?\d+)?\s*$")
_COMMA_INSIDE = re.compile(r"\d,\d")


@dataclass(frozen=True)
class Dialect:
    """Format of a CSV file or workbook, the table [csv] of a map; an empty or −1 entry is detected."""

    encoding: str = parameter("", "", "such as utf-8, utf-16 or cp1252; detected where empty", source="the map file")
    delimiter: str = parameter("", "", "one character; \"\\t\" is a tab; detected where empty", source="the map file")
    decimal: str = parameter("", "", "\".\" or \",\"; detected where empty", source="the map file")
    comment: str = parameter("", "", "what a comment line begins with; # % // where empty", source="the map file")
    header_row: int = parameter(-1, "1", "row of the columns' names, 0 for none; detected where -1", low=-1,
                                source="the map file")
    sheet: str = parameter("", "", "sheet of a workbook; the first one with a table where empty", source="the map file")
    units_row: int = parameter(-1, "1", "row of the units, 0 for none; detected where -1", low=-1,
                               source="the map file")


def reserved(name: str) -> bool:
    """Return whether a column of this name is taken without a map."""
    return name in UNITS or name == DEGREE_ALIAS


def read(path: Path, dialect: Dialect | None = None) -> LabTable:
    """Read a CSV file, gzipped or not; raises `InputError` with the row where it makes no sense."""
    dialect = dialect or Dialect()
    raw = content(path, "a CSV file, gzipped or not", lines=True)
    try:
        return _Reading(path, raw, dialect).sheet()
    except (csv.Error, RecursionError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a CSV file.") from None
    except MemoryError:
        raise InputError(f"{path}: is too large for this computer's memory; cut it.") from None


def read_text(path: Path, text: str) -> LabTable:
    """Read a table from the text of comma-separated rows; `path` is what messages name."""
    return _Reading(path, text.encode(), Dialect(delimiter=",", decimal=".")).sheet()


def decoded(path: Path, raw: bytes, encoding: str = "") -> tuple[str, str]:
    """Return text and the name of its encoding; raises `InputError` if the bytes are not text."""
    name = encoding or _encoding(raw)
    try:
        text = raw.decode(name)
    except (UnicodeDecodeError, LookupError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a text file, or its encoding in a map's [csv]."
                         ) from None
    if "\0" in text[:1 << 16]:
        raise InputError(f"{path}: cannot be read (zero bytes in it); give a CSV file.")
    return text, name


def _encoding(raw: bytes) -> str:
    for mark, name in ((b"\xff\xfe\0\0", "utf-32"), (b"\0\0\xfe\xff", "utf-32"), (b"\xff\xfe", "utf-16"),
                       (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig")):
        if raw.startswith(mark):
            return name
    head = raw[:4096]
    for first, name in ((1, "utf-16-le"), (0, "utf-16-be")):
        if len(head) > 8 and head[first::2].count(0) > 0.4 * len(head) / 2 and not head[1 - first::2].count(0):
            return name
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252" if not re.search(rb"[\x00-\x08\x0e-\x1f]", head) else "utf-8"
    return "utf-8"


class _Line(NamedTuple):
    row: int
    text: str


def _whole_lines(lines: Sequence[str], most: int = 20) -> Iterable[_Line]:
    """Yield lines, those of a quoted cell that has line ends as one, if its end is within `most` lines."""
    row = 0
    while row < len(lines):
        end = row + 1
        if lines[row].count('"') % 2:
            end = next((k + 1 for k in range(row + 1, min(row + most, len(lines))) if lines[k].count('"') % 2), end)
        yield _Line(row + 1, " ".join(lines[row:end]))
        row = end


class _Reading:
    """One file on its way from bytes to a sheet."""

    def __init__(self, path: Path, raw: bytes, dialect: Dialect) -> None:
        self.path, self.dialect = path, dialect
        text, encoding = decoded(path, raw, dialect.encoding)
        self.remarks: list[str] = [] if encoding in ("utf-8", "utf-8-sig") else [encoding.upper()]
        self.counts: dict[str, int] = {}
        self.encoding, self.units_row, self.comma = encoding, 0, False
        every = text.replace("\r\n", "\n").replace("\r", "\n").replace("\u2212", "-").split("\n")  # a true minus
        marks = (dialect.comment,) if dialect.comment else COMMENTS
        self.lines, self.comments = list[_Line](), list[_Line]()
        for row, line in _whole_lines(every) if '"' in text else enumerate(every, start=1):
            if line and not line.isspace():
                (self.comments if line.lstrip().startswith(marks) else self.lines).append(_Line(row, line))
        if self.comments:
            self.counts["comment_lines"] = len(self.comments)
            self.remarks.append(_many(len(self.comments), "comment line"))
        self.delimiter = dialect.delimiter or _delimiter(self._sample())
        if len(self.delimiter) != 1:
            raise InputError(f"{path}: the map's delimiter {self.delimiter!r} is not one character.")
        if self.delimiter != ",":
            self.remarks.insert(0, f"delimiter {DELIMITERS.get(self.delimiter, repr(self.delimiter))}")

    def _sample(self) -> list[str]:
        step = max(1, len(self.lines) // SAMPLE)
        return [line.text for line in self.lines[::step][-SAMPLE:]]

    def cells(self, text: str) -> list[str]:
        """Return the cells of one line."""
        if self.delimiter == " ":
            return text.split()
        if '"' not in text:
            return text.split(self.delimiter)
        return next(csv.reader([text], delimiter=self.delimiter), [])

    def sheet(self) -> LabTable:
        if not self.lines:
            raise InputError(f"{self.path}: row 1 is no header, the file is empty; name the columns there.")
        header, names, begin = self._header()
        body = self.lines[begin:]
        units, body = self._units(body, names)
        body = self._without_repeats(header, units, body, names)
        if not body:
            raise InputError(f"{self.path}: a header and no rows; give at least one.")
        if not names:
            names = [f"column {place}" for place in range(1, len(self.cells(body[0].text)) + 1)]
            self.remarks.append("no header, so columns are numbered")
        names, units = self._trimmed(names, units, body)
        rows = np.fromiter((line.row for line in body), np.int64, len(body))
        found = LabTable(self.path, unique(names, reserved), [], units or [""] * len(names), rows, counts=self.counts,
                         remarks=self.remarks, header_row=header)
        self._read_numbers(found, body)
        first = self.comments[0].text.lstrip() if self.comments else "#"
        found.dialect = {
            "encoding": self.encoding, "delimiter": self.delimiter, "decimal": "," if self.comma else ".",
            "comment": self.dialect.comment or next(mark for mark in COMMENTS if first.startswith(mark)),
            "header_row": header, "units_row": self.units_row}
        return found

    # ---- the rows above the numbers ----

    def _header(self) -> tuple[int, list[str], int]:
        """Return the row that names the columns (0: none), the names, and how many lines stand up to it."""
        if self.dialect.header_row == 0:
            return 0, [], 0
        if self.dialect.header_row > 0:
            for at, line in enumerate(self.lines):
                if line.row == self.dialect.header_row:
                    return line.row, self._names(line.text), at + 1
            raise InputError(f"{self.path}: the map's header_row = {self.dialect.header_row} is no row of the file.")
        found = self._found_header()
        if found is None:
            above = [line for line in self.comments if line.row < self.lines[0].row]
            width = len(self.cells(self.lines[0].text))
            bare = [self._names(line.text.lstrip().lstrip("#%/").strip()) for line in above]
            for names in reversed(bare):
                if len(names) == width and width > 1 and not _numeric_share(names):
                    return above[-1].row, names, 0
            return 0, [], 0
        if found:
            self.counts["preamble_lines"] = found
            self.remarks.append(f"{_many(found, 'line')} before the header in row {self.lines[found].row}")
        return self.lines[found].row, self._names(self.lines[found].text), found + 1

    def _names(self, text: str) -> list[str]:
        return [name.strip().strip('"').strip() for name in self.cells(text)]

    def _found_header(self) -> int | None:
        """Return the line of the header: one with a signal's name, or the last above the numbers; None without."""
        width = len(self.cells(self.lines[len(self.lines) // 2].text))
        above: list[list[str]] = []
        for line in self.lines[:MOST_PREAMBLE]:
            names = self._names(line.text)
            if any(map(reserved, names)):
                return len(above)
            if len(names) == width and _numeric_share(names) >= 0.5:
                break
            above.append(names)
        at = len(above) - 1
        if at > 0 and self._are_units(above[at]) and len(above[at - 1]) >= len(above[at]):
            at -= 1
        return at if above else None

    def _are_units(self, cells: Sequence[str]) -> bool:
        filled = [cell for cell in cells[:CELLS] if cell not in ("", "-")]
        units = [cell for cell in filled if cell != "1"]
        known = sum(bool(unit_of(cell)) or cell[:1] in "[(" for cell in units)
        return bool(units) and known >= 0.5 * len(units) and not any(_NUMBER.match(cell) for cell in units)

    def _units(self, body: list[_Line], names: list[str]) -> tuple[list[str], list[_Line]]:
        if self.dialect.units_row == 0 or not body or not names:
            return [], body
        if self.dialect.units_row > 0:
            units_line = next((line for line in self.lines if line.row == self.dialect.units_row), None)
            if units_line is None:
                raise InputError(f"{self.path}: the map's units_row = {self.dialect.units_row} is no row of the file.")
            body = [line for line in body if line.row != units_line.row]
        else:
            units_line = body[0]
            if len(cells := self._names(units_line.text)) > len(names) or not self._are_units(cells):
                return [], body
            body = body[1:]
        self.units_row = units_line.row
        self.remarks.append(f"units in row {units_line.row}")
        units = self._names(units_line.text)
        return units + [""] * (len(names) - len(units)), body

    def _without_repeats(
        self, header: int, units: list[str], body: list[_Line], names: list[str]
    ) -> list[_Line]:
        """Drop header and units rows that occur again, as in files appended to one another."""
        first = next((line.text for line in self.lines if line.row == header), None)
        if first is None:
            return body
        again = {line.row for line in body if line.text == first}
        if not again:
            return body
        if units:
            again |= {line.row for line in body if line.row - 1 in again and self._names(line.text) == units[:len(
                self._names(line.text))]}
        self.counts["repeated_headers"] = sum(line.text == first for line in body)
        self.remarks.append(f"the header {_many(self.counts['repeated_headers'], 'more time')}")
        return [line for line in body if line.row not in again]

    def _trimmed(self, names: list[str], units: list[str], body: list[_Line]) -> tuple[list[str], list[str]]:
        """Allow for rows that end in a delimiter: a last column without name and content."""
        width = len(self.cells(body[0].text))
        if self.delimiter != " " and all(line.text.rstrip(" ").endswith(self.delimiter) for line in body):
            if not names[-1] and width == len(names):
                names, units = names[:-1], units[:-1]
            if width == len(names) + 1:
                body[:] = [_Line(line.row, line.text.rstrip(" ")[:-1]) for line in body]
        return names, units

    # ---- the numbers ----

    def _read_numbers(self, found: LabTable, body: Sequence[_Line]) -> None:
        """Read every column of the rows into `found`; a row of another length raises `InputError`."""
        columns = list(zip(*self._rows(body, len(found.names)), strict=True))
        self.comma = self.dialect.decimal == "," or (not self.dialect.decimal and self._has_decimal_comma(columns))
        self.remarks += ["decimal comma"] if self.comma else []
        absolute, marks, glued = list[str](), "marks between thousands", "units in the cells"
        for place, cells in enumerate(columns):
            name = found.names[place]
            whole = _thousands(cells, "." if self.comma else ",")
            values, fault = _parsed(whole or cells, self.comma)
            if fault is not None and _THOUSANDS.match(fault[1]):
                whole = [_THOUSANDS.sub(lambda number: number[0].replace(number[1], ""), cell) for cell in cells]
                values, fault = _parsed(whole, self.comma)
            self.remarks += [marks] if whole and marks not in self.remarks else []
            if fault is not None and (unit := _unit_in(cells)):
                values, fault = _parsed([_UNITED.sub(r"\1", cell) for cell in cells], self.comma)
                found.units[place] = unit
                self.remarks += [glued] if glued not in self.remarks else []
            timed = None if fault is None else time_column(cells)
            if timed is not None:
                values, found.begins_ns[name], found.units[place] = timed.seconds, timed.begins_ns, "s"
                absolute.append(f"{name} is {started(timed.begins_ns)}")
            elif fault is not None:
                found.faults[name] = body[fault[0]].row, fault[1]
            found.values.append(values)
        self.remarks += absolute

    def _has_decimal_comma(self, columns: Sequence[Sequence[str]]) -> bool:
        """Return whether numbers have a decimal comma; in rows that commas separate, only a quoted cell can."""
        if not any(_COMMA_INSIDE.search(line.text) and (self.delimiter != "," or '"' in line.text)
                   for line in self.lines):
            return False
        return any(any(map(_COMMA_NUMBER.match, cells)) and not _thousands(cells, ",") for cells in columns)

    def _rows(self, body: Sequence[_Line], width: int) -> Iterable[list[str]]:
        for line in body:
            cells = self.cells(line.text)
            if len(cells) != width:
                raise InputError(f"{self.path}: row {line.row} has {len(cells)} cells, the header {width}; "
                                 "mend that row.")
            yield cells


def _many(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _numeric_share(cells: Sequence[str]) -> float:
    """Return the share of cells, of those that hold something, that are numbers or times."""
    filled = [cell for cell in cells[:CELLS] if cell.strip().lower() not in UNKNOWN]
    return sum(bool(_NUMBER.match(cell) or _COMMA_NUMBER.match(cell) or is_time(cell) or _unit_in([cell]))
               for cell in filled) / max(1, len(filled))


def _delimiter(sample: Sequence[str]) -> str:
    """Return the delimiter by which most of the sample's cells are numbers, the rows of equal length."""
    best, found = 0.0, ""
    for delimiter in DELIMITERS:
        rows = [line.split(delimiter) if delimiter != " " else line.split() for line in sample]
        widths = [len(row) for row in rows if len(row) > 1]
        if not widths:
            continue
        width = max(set(widths), key=widths.count)
        score = sum(_plain_share(row, delimiter) for row in rows if len(row) == width) / len(rows)
        if score > best * 1.001:
            best, found = score, delimiter
    if best >= 0.3:
        return found
    first = sample[0] if sample else ""
    return max(DELIMITERS, key=lambda one: first.count(one) if one != " " else 0)


def _plain_share(cells: Sequence[str], delimiter: str) -> float:
    share = _numeric_share(cells)
    if delimiter == ",":  # what has a decimal comma is no comma-separated number
        share *= not any(_COMMA_NUMBER.match(cell) for cell in cells[:CELLS])
    return share


_THOUSANDS = re.compile(r"\s*[+-]?\d{1,3}([.,])\d{3}(?:\1\d{3})*(?!\1)[.,]\d+\s*$")
"""Number with marks between its thousands and another decimal mark: 1.234,5 or 1,234.5."""


_UNITED = re.compile(r"\s*([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)\s*([^\W\d][\w/]*|%|°)\s*$")
"""Number with a unit behind it."""


def _unit_in(cells: Sequence[str]) -> str:
    """Return the known unit that every number of a column has behind it; "" without one."""
    parted = [_UNITED.match(cell) for cell in cells if cell.strip().lower() not in UNKNOWN]
    units = {one and one[2] for one in parted}
    unit = units.pop() if len(units) == 1 else None
    return unit if unit and unit_of(unit) else ""


_WHOLE = {mark: re.compile(rf"\s*[+-]?[1-9]\d{{0,2}}(?:\{mark}\d{{3}})+\s*$") for mark in ".,"}
"""Whole number with marks between its thousands, by the mark."""


def _thousands(cells: Sequence[str], mark: str) -> list[str]:
    """Return whole numbers without the marks between their thousands; [] of a column that is not one of such numbers.

    Numbers below 1000 tell it from one with a decimal mark and three digits behind each.
    """
    marked = [cell for cell in cells if mark in cell]
    if not marked or not all(map(_WHOLE[mark].match, marked)):
        return []
    plain = [cell.strip() for cell in cells if mark not in cell and cell.strip().lower() not in UNKNOWN]
    small = all(cell.lstrip("+-").isdigit() and len(cell.lstrip("+-")) < 4 for cell in plain)
    return [cell.replace(mark, "") for cell in cells] if plain and small else []


def _parsed(cells: Sequence[str], comma: bool) -> tuple[Floats, tuple[int, str] | None]:
    """Return a column's numbers and its first cell that is not a finite number."""
    try:
        dotted = (cell.replace(",", ".") for cell in cells) if comma else cells
        plain = np.fromiter(map(float, dotted), np.float64, len(cells))
        if not np.isinf(plain).any():
            return plain, None
    except ValueError:
        pass  # a wrong cell, a word for an unknown value, or a time: cell by cell then
    values, fault = np.empty(len(cells)), None
    for at, cell in enumerate(cells):
        try:
            value = float(cell.replace(",", ".") if comma else cell)
            wrong = math.isinf(value)
        except ValueError:
            value, wrong = math.nan, fault is None and cell.strip().lower() not in UNKNOWN
        values[at] = value
        if wrong and fault is None:
            fault = (at, cell)
    return values, fault


_PARTS = ("year", "month", "day", "minute", "second")
_TIME = r"[T ]+(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,](?P<fraction>\d{1,9}))?)?\s*"
_HALF = r"(?P<half>[AP]M)"
_ISO = re.compile(r"\s*(?P<year>\d{4})[-/](?P<month>\d{1,2})[-/](?P<day>\d{1,2})" + _TIME
                  + r"(?P<zone>Z|[+-]\d{2}:?\d{2})?\s*$", re.IGNORECASE)
_DOTTED = re.compile(r"\s*(?P<day>\d{1,2})\.(?P<month>\d{1,2})\.(?P<year>\d{4})" + _TIME + "(?P<zone>)$")
_AMERICAN = re.compile(r"\s*(?P<month>\d{1,2})/(?P<day>\d{1,2})/(?P<year>\d{4})" + _TIME + _HALF + r"\s*(?P<zone>)$",
                       re.IGNORECASE)
"""Of dates with slashes only those with AM or PM: without it, day and month have no certain order."""
_CLOCK = re.compile(r"\s*(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,9}))?\s*" + _HALF + r"?\s*$", re.IGNORECASE)
DAY_NS, SECOND_NS = 86_400_000_000_000, 1_000_000_000
_EPOCH = datetime.datetime(1970, 1, 1)


class TimeColumn(NamedTuple):
    """A column of times: seconds since the first known one, and when that was, ns since 1970 (−1: day unknown)."""

    seconds: NDArray[np.float64]
    begins_ns: int


def is_time(cell: str) -> bool:
    """Return whether a cell is a date with a time, or a time of day."""
    return ":" in cell and bool(_dated(cell) or _CLOCK.match(cell))


def _dated(cell: str) -> re.Match[str] | None:
    return _ISO.match(cell) or _DOTTED.match(cell) or _AMERICAN.match(cell)


def started(begins_ns: int) -> str:
    """Return a sentence with the start of a column's times."""
    if begins_ns < 0:
        return "a time of day, taken from the first on"
    seconds, rest = divmod(begins_ns, SECOND_NS)
    at = _EPOCH + datetime.timedelta(seconds=seconds)
    return f"absolute, from {at.isoformat()}.{rest // 1000:06d} on"


def time_column(cells: Sequence[str]) -> TimeColumn | None:
    """Return a column's times; None if a cell is not a time."""
    found: list[int | None] = []
    days, before, dated = 0, -1, True
    for cell in cells:
        if cell.strip().lower() in UNKNOWN:
            found.append(None)
            continue
        at = _absolute(cell)
        if at is None:
            clock = _CLOCK.match(cell)
            if clock is None:
                return None
            hours, minutes, second, fraction, half = clock.groups()
            at = ((_hour(hours, half) * 60 + int(minutes)) * 60 + int(second)) * SECOND_NS + _fraction(fraction)
            days += before >= 0 and at < before - DAY_NS // 2  # past midnight
            before, dated = at, False
            at += days * DAY_NS
        found.append(at)
    first = next((at for at in found if at is not None), 0)
    values = np.array([np.nan if at is None else (at - first) / 1e9 for at in found])
    return TimeColumn(values, first if dated else -1)


def _hour(hour: str, half: str | None) -> int:
    """Return the hour of the day; 12 AM is midnight."""
    return int(hour) if half is None else int(hour) % 12 + 12 * (half.upper() == "PM")


def _fraction(digits: str | None) -> int:
    return int((digits or "0").ljust(9, "0"))


def _absolute(cell: str) -> int | None:
    """Return a date with a time as ns since 1970, UTC where it states no zone; None if the cell is neither."""
    found = _dated(cell)
    if found is None:
        return None
    try:
        year, month, day, minute, second = (int(found[part] or 0) for part in _PARTS)
        at = datetime.datetime(year, month, day, _hour(found["hour"], found.groupdict().get("half")), minute, second)
    except ValueError:
        return None
    zone, away_s = found["zone"] or "Z", 0
    if zone.upper() != "Z":
        away_s = (-60 if zone[0] == "-" else 60) * (int(zone[1:3]) * 60 + int(zone[-2:]))
    past = at - _EPOCH
    return (past.days * 86_400 + past.seconds - away_s) * SECOND_NS + _fraction(found["fraction"])
