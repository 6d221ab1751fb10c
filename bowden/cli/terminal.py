"""Output of a command: one JSON object or a table on stdout, progress and remarks on stderr."""

import math
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple

from bowden import text_columns
from parameters.files import json_text


class AnswerTable(NamedTuple):
    """A table; the first column is text, the others are figures.

    `form` is the format of a number; a whole number is shown as it is, an undefined one as a dash.
    """

    title: str
    header: Sequence[str]
    rows: Iterable[Sequence[str | float | None]]
    form: str = ".2f"


class Paragraph(NamedTuple):
    """A text in lines of at most `WIDTH` columns."""

    text: str
    indent: str = ""


Words = Iterator[str | AnswerTable | Paragraph]
"""Lines, tables and paragraphs of an answer, in order."""


class CommandAnswer(NamedTuple):
    """Result of a command: one JSON object, the words that show it, and the exit status.

    An empty line of `words` is left out. Words that take time come from a generator, which does not run with --json.
    """

    result: Mapping[str, Any]
    words: str | Iterable[str | AnswerTable | Paragraph]
    status: int = 0


_QUIET: ContextVar[bool] = ContextVar("_QUIET", default=False)


def answered(command: Callable[[], CommandAnswer | int], *, json: bool) -> int:
    """Run a command, print its answer as JSON or in words, and return the exit status; with `json` no progress.

    A command that printed its lines as they came returns the exit status alone.
    """
    before = _QUIET.set(json)
    try:
        answer = command()
        return answer if isinstance(answer, int) else show(answer)
    finally:
        _QUIET.reset(before)


def show(answer: CommandAnswer) -> int:
    """Print an answer as JSON or in words, and return its exit status."""
    if quiet():
        print(json_text(answer.result))
    else:
        for part in [answer.words] if isinstance(answer.words, str) else answer.words:
            _print(part)
    return answer.status


def quiet() -> bool:
    """Return whether the command prints JSON and nothing else."""
    return _QUIET.get()


def _print(part: str | AnswerTable | Paragraph) -> None:
    if isinstance(part, AnswerTable):
        _draw(part)
    elif isinstance(part, Paragraph):
        print(textwrap.fill(part.text, WIDTH, initial_indent=part.indent, subsequent_indent=part.indent,
                            break_long_words=False, break_on_hyphens=False))
    elif part:
        print(part)


def _draw(table: AnswerTable) -> None:
    """Print a Rich table on stdout."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    drawn = Table()
    rows = [[str(cell) if isinstance(cell, str | int) else number(cell, table.form) for cell in row]
            for row in table.rows]
    console, padding = Console(), 3  # a column's two blanks and one line
    widths = text_columns.widths([table.header, *rows], console.width - 1 - padding * len(table.header))
    for i, (name, width) in enumerate(zip(table.header, widths, strict=True)):
        drawn.add_column(name, justify="left" if i == 0 else "right", overflow="fold", width=width)
    for row in rows:
        drawn.add_row(*map(Text, row))  # [g] in a name is no markup
    console.print(Text(table.title))
    console.print(drawn)


WIDTH = 80
"""Greatest width of a paragraph on stdout, columns of the terminal."""


def remark(text: str) -> None:
    """Print one line on stderr."""
    print(f"bowden: {text}", file=sys.stderr, flush=True)


def notice(text: str) -> None:
    """Print one line on stderr; none for an empty text or with --json."""
    if text and not quiet():
        remark(text)


def size(count: int) -> str:
    """Format the size of a file, bytes."""
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{count / 1e3:.0f} kB"


def number(value: float | None, form: str = ".2f") -> str:
    """Format a figure; an undefined one is a dash."""
    return "–" if value is None or not math.isfinite(value) else format(value, form)


class Terminal:
    """The `bowden.progress.Progress` of a command: bars where `shown` and stderr is a terminal; remarks always."""

    def __init__(self, *, shown: bool = True) -> None:
        self._shown = shown

    def running(self, what: str) -> AbstractContextManager[Callable[..., None]]:
        """Show a bar on stderr; yields a function of the share done, 0…1, and of the present step."""
        return _drawn(what, 1.0, self._shown)

    def waiting(self, what: str) -> AbstractContextManager[Any]:
        """Show a spinner on stderr with the elapsed time."""
        return _drawn(what, None, self._shown)

    remark = staticmethod(remark)


TERMINAL = Terminal()
"""Progress of every command but a watched trial, whose own lines a bar would cut."""
progress, waiting = TERMINAL.running, TERMINAL.waiting


@contextmanager
def fitting(what: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner with the number of steps of the fits inside; yields a function of the present work."""
    from estimation.forward_model import steps_counted

    present = [what]
    with waiting(what) as update:
        def show(work: str) -> None:
            present[0] = work
            update(0.0, work)

        with steps_counted(lambda count: update(0.0, f"{present[0]}, step {count}")):
            yield show


@contextmanager
def _drawn(text: str, total: float | None, shown: bool) -> Iterator[Callable[..., None]]:
    """Show a bar of length `total`, or a spinner; silent unless `shown` and stderr is a terminal."""
    if quiet() or not (shown and sys.stderr.isatty()):
        yield lambda share, step="": None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    bar = (BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeRemainingColumn()) if total else ()
    columns = (SpinnerColumn(), TextColumn("{task.description}"), *bar, TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as drawn:
        task = drawn.add_task(text, total=total)
        yield lambda share, step="": drawn.update(task, completed=share, description=step or text)
