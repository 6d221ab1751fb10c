"""The Typer application and its exit statuses: 0 done, 1 the answer is bad, 2 bad input, 128 + n ended by signal n."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import TextIO

import typer
import typer.exceptions

from parameters import InputError, RenamedWarning

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
    from bowden.cli import commands, ending

    commands.load()
    ending.quiet_libraries()
    warnings.showwarning = _remark
    with ending.as_ctrl_c() as ended:
        try:
            return ended.status(_run(arguments))
        except (KeyboardInterrupt, typer.Abort):
            print(ended.told(), file=sys.stderr)
            return ended.status(ending.CTRL_C)


def _run(arguments: Sequence[str]) -> int:
    try:
        status = app(list(arguments) or ["--help"], standalone_mode=False)
    except InputError as error:
        return _refuse(str(error))
    except typer.exceptions.TyperException as error:
        return _refuse(_sentence(error))
    except BrokenPipeError:
        sys.stderr.close()
        return 1
    except MemoryError:
        return _refuse("this computer's memory is too small for that; cut the input.")
    except RecursionError:
        return _refuse("the input is nested too deeply to be read; give another.")
    return status if isinstance(status, int) else 0


def _remark(message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
            line: str | None = None) -> None:
    """Say a remark on what was read as one line; any other warning as Python does."""
    if issubclass(category, RenamedWarning):
        print(f"bowden: {message}", file=sys.stderr)
    else:
        print(warnings.formatwarning(message, category, filename, lineno, line), file=file or sys.stderr)


def _refuse(sentence: str) -> int:
    print(f"bowden: {sentence}", file=sys.stderr)
    return 2


def _sentence(error: typer.exceptions.TyperException) -> str:
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    return f"{text.strip().rstrip('.')}; see bowden --help."
