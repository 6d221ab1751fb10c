"""A bench over months as one offline HTML page: alarms first, a sparkline per constant, trials one click away.

`export_table` writes a table of the logbook as CSV or Parquet.
"""

import csv
import io
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from logbook.bench_state import CANNOT, CONSTANTS, BenchState, ConstantCourse, DatedChange, state_of
from logbook.database import Logbook, TrialEntry
from parameters import InputError
from parameters.files import write_whole
from trial.report.words import quantity, words

WIDTH, HEIGHT = 420.0, 44.0
TRIALS: Final = 500
"""Newest trials on the page: the whole list is what `bowden logbook export` writes."""
STYLE: Final = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:70em;padding:0 1em;color:#1c2430}
h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}table{border-collapse:collapse;width:100%}
td,th{padding:.25em .6em;text-align:left;border-bottom:1px solid #e3e7ec;vertical-align:middle}
.said{overflow-wrap:anywhere}.day{white-space:nowrap}
.alarm{background:#fdecea;border-left:5px solid #c62828;padding:.6em 1em;margin:.6em 0}
.calm{background:#e8f5e9;border-left:5px solid #2e7d32;padding:.6em 1em;margin:.6em 0}
.unknown{background:#fff8e1;border-left:5px solid #8a6d00;padding:.6em 1em;margin:.6em 0}
.number{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}.missing{color:#c62828}
svg{display:block}.band{fill:#1f6fb2;opacity:.18}.line{fill:none;stroke:#1f6fb2;stroke-width:1.4}
.change{stroke:#c62828;stroke-width:1.6}.note{stroke:#8a6d00;stroke-width:1.2;stroke-dasharray:3 2}
.point{fill:#1f6fb2}.moved td{background:#fff6f5}small{color:#5b6673}
"""


def write(book: Logbook, state: BenchState, path: Path) -> int:
    """Write the page whole; return its bytes."""
    text = page(book, state)
    write_whole(path, text, overwrite=True)
    return len(text.encode())


def page(book: Logbook, state: BenchState) -> str:
    """Return the page as HTML."""
    counts = state.counts
    head = (f"{counts['trial']} trials in {counts['session']} sessions, {_duration(state.hours)} recorded, "
            f"{min(state.references, len(state.sessions))} reference sessions, {counts['note']} maintenance entries.")
    body = [f"<h1>Bench {escape(state.name)}</h1><p>{head}</p>", _alarms(state), _notes(state), _constants(state),
            _changes(state), _trials(book)]
    return ("<!doctype html><html lang='en'><head><meta charset='utf-8'><meta name='viewport' "
            f"content='width=device-width'><title>Bench {escape(state.name)}</title><style>{STYLE}</style></head>"
            f"<body>{''.join(body)}</body></html>\n")


def _alarms(state: BenchState) -> str:
    first, *further = map(escape, state.sentences())
    if not state.alarms:
        return f"<p class='{'unknown' if state.verdict == CANNOT else 'calm'}'>{first}</p>"
    since = f"<a href='#session-{state.alarms[0].since}'>Trials of that session.</a>"
    ahead = [_forecast(f) for f in state.forecasts]
    return f"<p class='alarm'><b>{first}</b> {since}<br>{'<br>'.join([*further, *ahead])}</p>"


def _forecast(f: Any) -> str:
    if f.sessions is None:
        return f"{escape(f.constant)} is not forecast to reach {f.limit:g}."
    high = "no limit" if f.high is None else f"{f.high:.0f}"
    return (f"{escape(f.constant)} reaches {f.limit:g} in {f.sessions:.0f} sessions (95 %: {f.low or 0:.0f} … {high}).")


def _notes(state: BenchState) -> str:
    if not state.notes:
        return ""
    rows = "".join(f"<tr><td class='day'>{escape(n.made[:10])}</td>"
                   f"<td class='day'>after {escape(str(state.labels.get(n.after, 'none')))}</td>"
                   f"<td class='said'>{escape(n.text)}</td><td>{escape(', '.join(n.resets) or 'nothing')}</td></tr>"
                   for n in state.notes)
    return ("<h2>Maintenance</h2><table><tr><th>entered</th><th>session</th><th>entry</th><th>resets</th></tr>"
            f"{rows}</table>")


def _constants(state: BenchState) -> str:
    if not state.courses:
        return ""
    changed: DatedChange | None = state.alarms[0] if state.alarms else None
    moved = set() if changed is None else {CONSTANTS[k] for k in np.flatnonzero(changed.departure)}
    rows = []
    for name in sorted(state.courses, key=lambda n: n not in moved):
        course = state.courses[name]
        (now, low, high, scatter, published), unit = course.newest()
        rows.append(
            f"<tr id='constant-{name}'{' class=moved' if name in moved else ''}><td><b>{name}</b><br><small>"
            f"{escape(course.meaning)}</small></td><td>{_sparkline(state, course, changed if name in moved else None)}"
            f"</td><td class='number'>{now} {escape(unit)}<br><small>{low} … {high}</small></td>"
            f"<td class='number'>{scatter} {escape(unit)}<br><small>published {published}</small></td></tr>")
    return ("<h2>Constants over sessions</h2><p><small>Band: 95 % interval of a session. Red: begin of the change, in "
            "the constants that it moves. Dashed: maintenance.</small></p><table><tr>"
            "<th>constant</th><th>sessions</th><th>now, 95 %</th>"
            f"<th>1σ between sessions</th></tr>{''.join(rows)}</table>")


def _duration(hours: float) -> str:
    return f"{hours:.1f} h" if hours >= 1.0 else f"{60.0 * hours:.1f} min"


def _sparkline(state: BenchState, course: ConstantCourse, change: DatedChange | None) -> str:
    """Return one constant as SVG; each point leads to its session's trials."""
    count = course.value.size
    low, high = float(course.low.min()), float(course.high.max())
    span = (high - low) or 1.0

    def x(k: float) -> float:
        return 4.0 + (WIDTH - 8.0) * (k / max(count - 1, 1))

    def y(v: float) -> float:
        return HEIGHT - 3.0 - (HEIGHT - 6.0) * (v - low) / span

    line = " ".join(f"{x(k):.1f},{y(float(v)):.1f}" for k, v in enumerate(course.value))
    band = " ".join([*(f"{x(k):.1f},{y(float(v)):.1f}" for k, v in enumerate(course.high)),
                     *(f"{x(k):.1f},{y(float(course.low[k])):.1f}" for k in range(count - 1, -1, -1))])
    marks = []
    for note in state.notes:
        if course.name in note.resets and note.after in state.sessions[:-1]:
            marks.append(("note", state.sessions.index(note.after) + 0.5))
    if change is not None:
        marks.append(("change", state.sessions.index(change.since) - 0.5))
    drawn = "".join(f"<line class='{kind}' x1='{x(k):.1f}' x2='{x(k):.1f}' y1='0' y2='{HEIGHT:.0f}'/>"
                    for kind, k in marks)
    points = "".join(
        f"<a href='#session-{number}'><circle class='point' cx='{x(k):.1f}' cy='{y(float(course.value[k])):.1f}' r='2'>"
        f"<title>{escape(state.labels.get(number, str(number)))}: {quantity(float(course.value[k]), course.unit)}"
        "</title></circle></a>"
        for k, number in enumerate(state.sessions))
    return (f"<svg width='{WIDTH:.0f}' height='{HEIGHT:.0f}' role='img' aria-label='{course.name} over sessions'>"
            f"<polygon class='band' points='{band}'/><polyline class='line' points='{line}'/>{drawn}{points}</svg>")


def _changes(state: BenchState) -> str:
    if not state.changes:
        return ""
    rows = "".join(
        f"<tr><td>{escape(words(c.effect))}</td><td>{c.course}</td><td>{escape(str(state.labels.get(c.since)))}</td>"
        f"<td class='number'>{c.nats:.1f}</td></tr>" for c in state.changes[:8])
    return ("<h2>Evidence of a change over all sessions</h2><p><small>Linear in the effect: it dates a change. The "
            "diagnosis of recorded trials names it where one session alone shows it.</small></p>"
            "<table><tr><th>effect</th><th>course</th><th>likeliest begin</th>"
            f"<th class='number'>ln B (nats)</th></tr>{rows}</table>")


def _trials(book: Logbook) -> str:
    """Return the newest trials by session, each a link to its file; a missing file is marked."""
    groups: dict[int, list[TrialEntry]] = {}
    for entry in book.trials(TRIALS):
        groups.setdefault(entry.session, []).append(entry)
    parts = [f"<h2>Trials</h2><p><small>The newest {TRIALS} at most.</small></p><table><tr><th>session</th><th>trial"
             "</th><th>experiment</th><th>outcome</th><th class='number'>RMSE (%)</th></tr>"]
    for session, entries in groups.items():
        for k, entry in enumerate(entries):
            place = f" id='session-{session}'" if k == 0 else ""
            link = f"<a href='{escape(book.place(entry.path).absolute().as_uri())}'>{escape(entry.path)}</a>"
            gone = "" if entry.there else " <span class='missing'>file not found</span>"
            unfit = "" if entry.estimated else f"<br><small>{escape(entry.remark)}</small>"
            parts.append(f"<tr{place}><td>{escape(entry.label)}</td><td>{entry.id} {link}{gone}{unfit}</td><td>"
                         f"{escape(entry.experiment)}</td><td>{escape(entry.outcome or '–')}</td><td class='number'>"
                         f"{_figure(entry.figures)}</td></tr>")
    return "".join([*parts, "</table>"])


def _figure(figures: Mapping[str, Any]) -> str:
    value = figures.get("relative_rmse_percent")
    return "–" if not isinstance(value, float) else f"{value:.2f}"


TABLES: Final = {"trials": "trial", "sessions": "session", "verdicts": "verdict", "notes": "note", "models": "model"}
CONSTANTS_TABLE: Final = "constants"
CONSTANT_HEADER: Final = ("session", "label", "constant", "unit", "value", "low", "high")


def export_table(book: Logbook, what: str, path: Path) -> int:
    """Write one table to a .csv or .parquet file; return its number of rows."""
    header, rows = _content(book, what)
    if path.suffix.lower() == ".parquet":
        _write_parquet(path, header, rows)
    else:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
        write_whole(path, text.getvalue(), overwrite=True)
    return len(rows)


def _content(book: Logbook, what: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    if what in TABLES:
        return book.table(TABLES[what])
    if what != CONSTANTS_TABLE:
        raise InputError(f"--table {what}: expected one of {', '.join((*TABLES, CONSTANTS_TABLE))}.")
    state = state_of(book)
    rows = [(number, state.labels[number], c.name, c.unit, float(c.value[k]), float(c.low[k]), float(c.high[k]))
            for c in state.courses.values() for k, number in enumerate(state.sessions)]
    return list(CONSTANT_HEADER), rows


def _write_parquet(path: Path, header: list[str], rows: list[tuple[Any, ...]]) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(f"{path}: Parquet needs pyarrow; say pip install 'bowden-bench[parquet]', or name a .csv "
                         "file.") from None
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(header)
    table = pyarrow.table({name: list(column) for name, column in zip(header, columns, strict=True)})
    out = io.BytesIO()
    pyarrow.parquet.write_table(table, out)
    write_whole(path, out.getvalue(), overwrite=True)
