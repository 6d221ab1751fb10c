"""The Typer application and its exit statuses: 0 done, 1 the answer is bad, 2 bad input, 130 Ctrl-C."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import TextIO

import typer
import typer.exceptions

from parameters import InputError, Remark

app = typer.Typer(
    name="bowden",
    help="Drive stack for a Bowden cable–fabric force-transfer bench on CAN.",
    add_completion=False,
    pretty_exceptions_enable=False,
    no_args_is_help=False,
    rich_markup_mode=None,
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command line and end the process with its exit status."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: Sequence[str]) -> int:
    """Run one command line; messages are one sentence on stderr, never a box or a traceback."""
    from bowden.cli import commands

    commands.load()
    warnings.showwarning = _remark
    try:
        status = app(list(arguments) or ["--help"], standalone_mode=False)
    except InputError as error:
        return _refuse(str(error))
    except typer.exceptions.TyperException as error:
        return _refuse(_sentence(error))
    except (KeyboardInterrupt, typer.Abort):
        print("bowden: interrupted.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stderr.close()
        return 1
    return status if isinstance(status, int) else 0


def _remark(message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
            line: str | None = None) -> None:
    """Say a remark on what was read as one line; any other warning as Python does."""
    if issubclass(category, Remark):
        print(f"bowden: {message}", file=sys.stderr)
    else:
        print(warnings.formatwarning(message, category, filename, lineno, line), file=file or sys.stderr)


def _refuse(sentence: str) -> int:
    print(f"bowden: {sentence}", file=sys.stderr)
    return 2


def _sentence(error: typer.exceptions.TyperException) -> str:
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    return f"{text.strip().rstrip('.')}; see bowden --help."
