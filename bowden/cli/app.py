"""The Typer application, the help of its commands, and its exit statuses.

0: done, 1: the answer is bad, 2: bad input, 128 + n: ended by signal n.  Help shows arguments as words (`TRIAL`,
`[TRIAL]`, `TRIAL...`), without the type behind them; a command given without its arguments shows a short help.
"""

import importlib
import inspect
import os
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import pairwise
from types import MappingProxyType
from typing import Annotated, Any, Final, TextIO, TypeVar

import typer
import typer.exceptions
import typer.main
from typer.core import TyperCommand, TyperGroup

from bowden.cli import ending
from bowden.cli.options import grouped
from parameters import InputError, Remark

Registered = TypeVar("Registered", bound=Callable[..., Any])


class NothingGivenError(InputError):
    """A command got none of several alternative arguments; `needs` lists them as a usage line does."""

    def __init__(self, needs: str, sentence: str) -> None:
        super().__init__(sentence)
        self.needs = needs


class ShortHelpCommand(TyperCommand):
    """A command whose help shows arguments as words, and whose `--healthy good_*.mcap` takes several trials."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; trials that a shell lists behind an option are the option's, if others come first."""
        parameters, made, option = self.get_params(ctx), list(args[:1]), ""
        begins = not any(map(_is_argument, parameters)) or not args or not args[0].startswith("-")
        several = {name for one in parameters if begins and str(one.metavar).endswith("...") for name in one.opts}
        for last, word in pairwise(args):
            option = last if last in several else "" if word.startswith("-") else option
            made += [option, word] if option and last != option else [word]
        return super().parse_args(ctx, made)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the parts of the usage line."""
        return ["[OPTIONS]", *(_usage(one) for one in self.get_params(ctx) if _is_argument(one))]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments as words, then the options as Typer does."""
        parameters = self.get_params(ctx)
        arguments = [(_word(one), getattr(one, "help", None) or "") for one in parameters if _is_argument(one)]
        options = [told for one in parameters if not _is_argument(one) and (told := one.get_help_record(ctx))]
        for title, rows in (("Arguments", arguments), ("Options", options)):
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


PANELS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType({
    "Run": ("trial", "replay", "sweep", "verify", "bench"),
    "Data": ("report", "diagnose", "import", "export", "info", "compare", "cut", "merge", "recover", "live", "watch"),
    "Bench": ("init", "check", "doctor", "home", "tare", "jog", "release", "acknowledge", "safety-monitor",
              "monitor-bounds", "identify"),
    "Model": ("fit", "simulate", "plan", "discover", "mend"),
    "CAN": ("node", "lss", "monitor", "record"),
    "Logbook": ("logbook",),
})
"""Commands by panel of `bowden --help`, in the order of a first day."""


class Group(TyperGroup):
    """A group that lists every command with its whole first sentence, wrapped where the terminal is narrow.

    Commands of `PANELS` are listed by panel, others under "Commands".
    """

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands."""
        rows = {name: " ".join((command.help or "").partition("\n\n")[0].split())
                for name, command in self.commands.items()}
        panels = PANELS if "trial" in rows else {}
        others = [name for name in rows if name not in {one for names in panels.values() for one in names}]
        for title, names in {**panels, "Commands": others}.items():
            listed = [(name, rows[name]) for name in names if name in rows]
            if listed:
                with formatter.section(title):
                    formatter.write_dl(listed)


class CommandGroup(typer.Typer):
    """A Typer application of commands with short help."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**{"cls": Group, "rich_markup_mode": None, **given})

    def command(self, name: str | None = None, *, example: str = "", **given: Any
                ) -> Callable[[Registered], Registered]:
        """Register a command; its help ends with the `example`, and the answer that it returns is printed."""
        register = super().command

        def registered(function: Registered) -> Registered:
            help = "\n\n".join(filter(None, (inspect.getdoc(function), example and f"Example: {example}")))
            register(name, cls=ShortHelpCommand, help=help, **given)(grouped(function))
            return function

        return registered


def short_help(command: Any, path: str, needed: str = "") -> str:
    """Return the short help: purpose of a command, its needs (`needed` in addition to required options) and one
    example."""
    text = (command.help or "").strip()
    first, example = " ".join(text.split("\n\n")[0].split()), " ".join(text.partition("Example:")[2].split())
    below = getattr(command, "commands", {})
    needs = "COMMAND" if below else " ".join(
        _word(one) if _is_argument(one) else f"{one.opts[0]} {one.metavar or 'VALUE'}"
        for one in command.params if one.required)
    lines = [" ".join(filter(None, (path, needed or needs))), f"  {first}"]
    if below:
        lines.append(f"  COMMAND is one of {', '.join(below)}.")
    if example:
        lines.append(f"  Example: {example}")
    return "\n".join([*lines, f"{path} --help lists its {'commands' if below else 'options'}."])


def _is_argument(parameter: Any) -> bool:
    return bool(parameter.param_type_name == "argument")


def _word(argument: Any) -> str:
    return str(argument.metavar or argument.name).upper().strip("[]").removesuffix("…")


def _usage(argument: Any) -> str:
    word = _word(argument) if argument.required else f"[{_word(argument)}]"
    return word if argument.nargs == 1 else f"{word}..."


app = CommandGroup(
    name="bowden",
    help="Drive stack for a Bowden cable–fabric force-transfer bench on CAN.",
    add_completion=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 160},
    pretty_exceptions_enable=False,
    no_args_is_help=False,
)


MODULES = (
    "trials.trial", "trials.replay", "trials.sweep", "trials.recordings", "models.identify", "models.diagnose",
    "models.plan", "models.logbook", "bench.setup", "bench.bench", "bench.monitor", "bench.watch", "bench.node",
    "bench.node_serve", "bench.lss",
)
"""Modules of the commands; importing one registers its commands on `app`."""


@cache
def whole() -> Any:
    """Return the command line, built once; the packages behind a command are imported when the command runs."""
    for name in MODULES:
        importlib.import_module(f"bowden.cli.{name}")
    return typer.main.get_command(app)


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


def run(arguments: Sequence[str]) -> int:
    """Run one command line; messages are one sentence on stderr, never a box or a traceback."""
    ending.quiet_libraries()
    warnings.showwarning = _remark
    with ending.as_ctrl_c() as ended:
        try:
            return ended.status(_run(arguments))
        except (KeyboardInterrupt, typer.Abort):
            print(ended.sentence(), file=sys.stderr)
            return ended.status(ending.CTRL_C)


def _run(arguments: Sequence[str]) -> int:
    try:
        status = whole()(list(arguments) or ["--help"], standalone_mode=False, prog_name="bowden")
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
    command, left = whole(), list(arguments)
    while left and left[0] in getattr(command, "commands", {}):
        command = command.commands[left.pop(0)]
    if left:
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
