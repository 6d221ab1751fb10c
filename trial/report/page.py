"""One HTML file that needs no network: text, tables and plots that zoom together.

Arrays are thinned to screen resolution and packed as base64. Thinning keeps the least and the greatest value of each
bin; a bin without a finite value stays unknown. Every text is escaped, every number arrives in bulk, and the page's
policy forbids loading anything. The caller supplies the content; trial reports and diagnosis reports both use it.
"""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parameters.files import write_whole
from trial.report.plot import Plot, Series

Floats = NDArray[np.float64]
Number = TypeVar("Number", bound=np.generic)


def thinned(x: Floats, columns: Sequence[Floats], bins: int) -> tuple[Floats, list[Floats]]:
    """Return at most two points of each of `bins` equal bins of `x`, which must not fall; unchanged if that is no gain.

    The two points stand at the first and last `x` of their bin, so a peak is at most one bin away from its place.
    """
    if len(x) <= 2 * bins:
        return x, list(columns)
    first = np.unique(np.searchsorted(x, np.linspace(x[0], x[-1], bins + 1)[:-1]))
    last = np.append(first[1:], len(x)) - 1
    return interleaved(x[first], x[last]), [extremes(column, first, last) for column in columns]


def extremes(values: Floats, first: NDArray[np.intp], last: NDArray[np.intp]) -> Floats:
    """Return least and greatest value of each bin, interleaved in the order in which the bin rises or falls.

    `first`, `last`: ends of the bins along the last axis of `values`, shape (…, rows).
    """
    low, high = np.fmin.reduceat(values, first, axis=-1), np.fmax.reduceat(values, first, axis=-1)
    falls = values[..., first] > values[..., last]
    return interleaved(np.where(falls, high, low), np.where(falls, low, high))


def interleaved(one: NDArray[Number], other: NDArray[Number]) -> NDArray[Number]:
    """Return the entries of two arrays in turns along the last axis."""
    return np.stack([one, other], axis=-1).reshape(*one.shape[:-1], -1)


def broken(x: Floats, columns: Sequence[Floats], gap: float) -> tuple[Floats, list[Floats]]:
    """Return the arrays with an unknown point in every step of `x` above `gap`, where a line must not go on."""
    places = np.flatnonzero(np.diff(x) > gap) + 1
    if not len(places):
        return x, list(columns)
    between = (x[places - 1] + x[places]) / 2
    return np.insert(x, places, between), [np.insert(column, places, np.nan) for column in columns]


class Pool:
    """The arrays of a page, each packed once, little-endian: float32 (f4); float64 (f8) where an abscissa needs it."""

    def __init__(self) -> None:
        self._numbers: dict[bytes, int] = {}
        self.packed: list[dict[str, str]] = []

    def abscissa(self, values: Floats) -> int:
        """Pack values that rise; float64 where float32 would merge neighbours.  Returns the array's number."""
        short = values.astype("<f4")
        merged = bool(np.any((np.diff(short) == 0) & (np.diff(values) > 0)))
        return self._number(values.astype("<f8") if merged else short)

    def ordinate(self, values: Floats) -> int:
        """Pack values as float32; returns the array's number."""
        with np.errstate(over="ignore"):
            return self._number(values.astype("<f4"))

    def _number(self, values: NDArray[np.floating]) -> int:
        data = values.tobytes()
        kind = f"f{values.itemsize}"
        key = kind.encode() + data
        if key not in self._numbers:
            self._numbers[key] = len(self.packed)
            self.packed.append({"type": kind, "data": base64.b64encode(data).decode()})
        return self._numbers[key]


Cell = str | int | float | None
POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"
ROWS_SHOWN = 5000
UNKNOWN = "–"
_FIGURE = re.compile(rf"{UNKNOWN}|−?[\d.]+(e[-+−]\d+)?")  # a number as text, or an unknown one


class NamedText(str):
    """Words for a thing that has a name in files: the page shows the words, and `tip`, the name, as their tooltip."""

    tip: str

    def __new__(cls, words: str, tip: str) -> NamedText:
        """Make the text `words`."""
        made = super().__new__(cls, words)
        made.tip = tip
        return made


class Tile(NamedTuple):
    """A figure in large type: its value as text, unit, label, and a reference to compare it with."""

    value: str
    unit: str
    label: str
    remark: str = ""


class Page:
    """A page under construction; elements appear in the order of the calls, under the last `section`."""

    def __init__(self, title: str, subtitle: str = "", *, badge: tuple[str, str] | None = None) -> None:
        """`badge` is a word beside the title and its kind: good, bad, warn or plain."""
        self.title, self.prefix = title, ""
        word = "" if badge is None else f'<span class="badge {_kind(badge[1])}">{_text(badge[0])}</span>'
        below = f'<p class="subtitle">{_text(subtitle)}</p>' if subtitle else ""
        self._head = f"<h1>{_text(title)}{word}</h1>{below}"
        self._sections: list[tuple[str, list[str]]] = []
        self._pool = Pool()
        self._plots: list[dict[str, Any]] = []

    def section(self, title: str) -> None:
        """Begin a section, `prefix` before its title; the page's navigation lists it."""
        self._sections.append((f"{self.prefix}{title}", []))

    def text(self, text: str, kind: str = "") -> None:
        """Add a paragraph; `kind` is empty, lead (large), note (small) or warning."""
        self._add(f'<p class="{_kind(kind)}">{_text(text)}</p>')

    def heading(self, text: str) -> None:
        """Add a heading inside the section."""
        self._add(f"<h3>{_text(text)}</h3>")

    def tiles(self, tiles: Sequence[Tile]) -> None:
        """Add figures in large type."""
        self._add('<div class="tiles">' + "".join(
            f'<div class="tile"><div class="value">{_text(one.value)} <span class="unit">{_text(one.unit)}</span></div>'
            f'<div class="label">{_text(one.label)}</div><div class="remark">{_text(one.remark)}</div></div>'
            for one in tiles) + "</div>")

    def facts(self, facts: Mapping[str, Cell]) -> None:
        """Add names with one value each, in columns."""
        self._add("<dl>" + "".join(
            f"<div{_long(value)}><dt>{_text(name)}</dt><dd>{_text(_cell(value))}</dd></div>"
            for name, value in facts.items()) + "</dl>")

    def table(self, header: Sequence[str], rows: Sequence[Sequence[Cell]], *, tall: bool = False) -> None:
        """Add a table; columns of numbers (None: unknown) are right-aligned. `tall` makes the table scroll.

        More than 5000 rows are cut, with a note under the table.
        """
        figure = [bool(rows) and all(not isinstance(cell, str) or _FIGURE.fullmatch(cell)
                                     for cell in (row[place] for row in rows)) for place in range(len(header))]
        kinds = [' class="figure"' if right else "" for right in figure]
        head = "".join(f"<th{kind}>{_text(name)}</th>" for kind, name in zip(kinds, header, strict=True))
        body = "".join("<tr>" + "".join(f"<td{kind}>{_text(_cell(value))}</td>"
                                        for kind, value in zip(kinds, row, strict=True)) + "</tr>"
                       for row in rows[:ROWS_SHOWN])
        self._add(f'<div class="{"tall" if tall else "wide"}"><table><thead><tr>{head}</tr></thead>'
                  f"<tbody>{body}</tbody></table></div>")
        if len(rows) > ROWS_SHOWN:
            self.text(f"The first {ROWS_SHOWN} of {len(rows)} rows.", "note")

    def attachment(self, name: str, text: str) -> None:
        """Add a file's text, collapsed under its name."""
        self._add(f"<details><summary>{_text(name)}</summary><pre>{_text(text)}</pre></details>")

    def plot(self, plot: Plot) -> None:
        """Add a plot.  Drag zooms, a double click shows all.

        ValueError where x is unknown somewhere or falls (but in a loop), or a series has another length.
        """
        along, drawn = _floats(plot.x), [one for one in plot.series if np.isfinite(_floats(one.values)).any()]
        if not plot.loop and (not np.isfinite(along).all() or (np.diff(along) < 0).any()):
            raise ValueError(f"plot {plot.title!r}: x must be known and must not fall")
        lengths = {len(_floats(one)) for each in plot.series for one in (each.values, each.high) if one is not None}
        if lengths - {len(along)}:
            raise ValueError(f"plot {plot.title!r}: {len(along)} values of x, but series of {sorted(lengths)}")
        title = _text(plot.title)
        if not drawn:
            self._add(f'<figure><figcaption>{title}</figcaption><div class="plot empty">Nothing was recorded '
                      "for this plot.</div></figure>")
            return
        number = f"plot-{len(self._plots)}"
        x = self._pool.ordinate(along) if plot.loop else self._pool.abscissa(along)
        self._plots.append({**plot._asdict(), "id": number, "x": x, "marks": [float(mark) for mark in plot.marks],
                            "series": [self._packed(one) for one in drawn]})
        self._add(f'<figure><figcaption>{title}</figcaption><div class="legend"></div>'
                  f'<div class="plot" id="{number}" role="img" aria-label="{title}"></div></figure>')

    def drawing(self, title: str, svg: str) -> None:
        """Add a picture as an SVG element, whose texts the caller has escaped."""
        self._add(f"<figure><figcaption>{_text(title)}</figcaption>{svg}</figure>")

    def _packed(self, one: Series) -> dict[str, Any]:
        high = None if one.high is None else self._pool.ordinate(_floats(one.high))
        own = None if one.x is None else self._pool.ordinate(_floats(one.x))
        style = {name: value for name, value in one._asdict().items() if name != "values"}
        return style | {"x": own, "y": self._pool.ordinate(_floats(one.values)), "high": high}

    def _add(self, html: str) -> None:
        if not self._sections:
            self.section("Summary")
        self._sections[-1][1].append(html)

    def html(self) -> str:
        """Return the whole page."""
        data = json.dumps({"arrays": self._pool.packed, "plots": self._plots}, ensure_ascii=True, allow_nan=False)
        links = "".join(f'<a href="#section-{number}">{_text(title)}</a>'
                        for number, (title, _) in enumerate(self._sections))
        content = "".join(f'<section id="section-{number}"><h2>{_text(title)}</h2>{"".join(parts)}</section>'
                          for number, (title, parts) in enumerate(self._sections))
        return (
            f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{_text(self.title)}</title>\n'
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<!-- With uPlot:\n{asset('uPlot.LICENSE')}-->\n"
            f"<style>{asset('uPlot.min.css')}</style>\n<style>{asset('page.css')}</style>\n</head>\n<body>\n"
            f"<header>{self._head}<noscript><p>The plots need JavaScript; the tables do not.</p></noscript></header>\n"
            f"<nav><div>{links}</div></nav>\n<main>{content}</main>\n"
            "<footer>Drag across a plot to zoom, double-click to show all; plots over the same axis move together. "
            "Click a name above a plot to hide or show it.</footer>\n"
            '<div class="window" hidden><span></span><button type="button">show all</button></div>\n'
            f'<script type="application/json" id="page-data">{data.replace("<", chr(92) + "u003c")}</script>\n'
            f"<script>{asset('uPlot.iife.min.js')}</script>\n<script>{asset('page.js')}</script>\n</body>\n</html>\n")

    def write(self, path: str | Path, *, overwrite: bool = False) -> int:
        """Write the page and return its bytes; the file appears whole or not at all.  Raises `InputError`."""
        return write_whole(Path(path), self.html(), overwrite=overwrite)


def asset(name: str) -> str:
    """Return the text of a file that every page carries."""
    return resources.files("trial").joinpath("assets", name).read_text(encoding="utf-8")


def number(value: float | None, digits: int = 4) -> str:
    """Return a number with `digits` significant digits, the minus typographic; a dash where it is unknown."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if 1e-6 <= abs(value) < 1e6:  # neither 1.2e+03 nor 2.7e-05
        places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        text = f"{value:.{places}f}"
        return (text.rstrip("0").rstrip(".") if "." in text else text).replace("-", "−")
    return f"{value:.{digits}g}".replace("-", "−")


def _cell(value: Cell) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, bool | int):
        return str(value)
    return number(value, 3)


def _long(value: Cell) -> str:
    return ' class="long"' if isinstance(value, str) and len(value) > 32 else ""


def _floats(values: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(values, np.float64)


def _kind(word: str) -> str:
    if word not in ("", "lead", "note", "warning", "good", "bad", "warn", "plain"):
        raise ValueError(f"{word!r} is no kind of text or badge")
    return word


def _text(text: str) -> str:
    shown = escape(text, quote=True).replace("\0", "␀")
    return f'<span title="{escape(text.tip, quote=True)}">{shown}</span>' if isinstance(text, NamedText) else shown
