"""The Typer application and its exit statuses: 0 done, 1 the answer is bad, 2 bad input, 128 + n ended by signal n."""

from __future__ import annotations

import importlib
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Annotated, Final, TextIO

import typer
import typer.exceptions

from bowden.cli import ending
from bowden.cli.command import CommandGroup, NothingGivenError, found, short_help
from parameters import InputError, Remark

app = CommandGroup(
    name="bowden",
    help="Drive stack for a Bowden cable–fabric force-transfer bench on CAN.",
    add_completion=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 160},
    pretty_exceptions_enable=False,
    no_args_is_help=False,
    rich_markup_mode=None,
)


MODULES = (
    "trials.trial", "trials.replay", "trials.sweep", "trials.convert", "trials.recordings", "models.identify",
    "models.diagnose", "models.plan", "models.simulate", "models.logbook", "bench.setup", "bench.bench",
    "bench.commission", "bench.monitor", "bench.watch", "bench.node", "bench.node_serve", "bench.lss",
)
"""Modules of the commands; importing one registers its commands on `app`."""


def load() -> None:
    """Register every command; the packages behind a command are imported when the command runs."""
    for name in MODULES:
        importlib.import_module(f"bowden.cli.{name}")


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"bowden {version('bowden-bench')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True,
                                          help="Print the version and end.")] = False,
) -> None:
    """Drive stack for a Bowden cable–fabric force-transfer bench on CAN."""


_REMARKED: Final[set[str]] = set()
"""Remarks of this process: a file that two readers read is remarked on once."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command line and end the process with its exit status."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: Sequence[str]) -> int:
    """Run one command line; messages are one sentence on stderr, never a box or a traceback."""
    load()
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
        status = app(list(arguments) or ["--help"], standalone_mode=False, prog_name="bowden")
    except InputError as error:
        return _short_help(arguments, error) or _refuse(str(error))
    except typer.exceptions.TyperException as error:
        return _short_help(arguments, error) or _refuse(_sentence(error))
    except BrokenPipeError:
        sys.stderr.close()
        return 1
    except ModuleNotFoundError as error:
        from parameters import extras

        sentence = extras.missing(error)
        return _failed(error) if sentence is None else _refuse(sentence)
    except MemoryError:
        return _refuse("this computer's memory is too small for that; cut the input.")
    except RecursionError:
        return _refuse("the input is nested too deeply to be read; give another.")
    except Exception as error:  # a plug-in's, or a fault of this program: never a traceback
        if os.environ.get("BOWDEN_TRACEBACK"):
            raise
        return _failed(error)
    return status if isinstance(status, int) else 0


def _short_help(arguments: Sequence[str], error: Exception) -> int:
    """Print the short help of a command given without its arguments, and return 2; return 0 in any other case."""
    if isinstance(error, InputError) and not isinstance(error, NothingGivenError):
        return 0
    command, alone = found(app, arguments)
    if not alone:
        return 0
    print(short_help(command, f"bowden {' '.join(arguments)}", getattr(error, "needs", "")), file=sys.stderr)
    return 2


def _failed(error: Exception) -> int:
    """Print where an unexpected exception was raised: in a plug-in, or in this program."""
    import traceback

    last = traceback.extract_tb(error.__traceback__)[-1]
    said = " ".join(str(error).split())[:300]
    print(f"bowden: {type(error).__name__} in {last.filename}, line {last.lineno}: {said or 'no text'}; "
          "BOWDEN_TRACEBACK=1 shows all of it.", file=sys.stderr)
    return 1


def _remark(message: Warning | str, category: type[Warning], filename: str, lineno: int, file: TextIO | None = None,
            line: str | None = None) -> None:
    """Print a remark on an input file as one line; any other warning as Python does."""
    if issubclass(category, Remark):
        if str(message) not in _REMARKED:
            print(f"bowden: {message}", file=sys.stderr)
        _REMARKED.add(str(message))
    else:
        print(warnings.formatwarning(message, category, filename, lineno, line), file=file or sys.stderr)


def _refuse(sentence: str) -> int:
    print(f"bowden: {sentence}", file=sys.stderr)
    return 2


def _sentence(error: typer.exceptions.TyperException) -> str:
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    context = getattr(error, "ctx", None)
    return f"{text.strip().rstrip('.')}; see {'bowden' if context is None else context.command_path} --help."
