"""Help of commands: the full help, and the short help of a command given without arguments.

Arguments are shown as words (`TRIAL`, `[TRIAL]`, `TRIAL...`), without the type behind them.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, TypeVar

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup

from bowden.cli.option_groups import grouped
from parameters import InputError

Registered = TypeVar("Registered", bound=Callable[..., Any])


class NothingGivenError(InputError):
    """A command that needs one of several things was given none of them; `needs` as a usage line shows them."""

    def __init__(self, needs: str, sentence: str) -> None:
        super().__init__(sentence)
        self.needs = needs


class ShortHelpCommand(TyperCommand):
    """A command whose help shows arguments as words."""

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
    "Bench": ("init", "check", "doctor", "home", "tare", "jog", "release", "acknowledge", "safety-monitor", "identify"),
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
        super().__init__(**{"cls": Group, **given})

    def command(self, name: str | None = None, **given: Any) -> Callable[[Registered], Registered]:
        """Register a command; its option groups are spelt out, and the answer that it returns is printed."""
        register = super().command(name, **{"cls": ShortHelpCommand, **given})

        def registered(function: Registered) -> Registered:
            register(grouped(function))
            return function

        return registered


def found(application: typer.Typer, words: Sequence[str]) -> tuple[Any, bool]:
    """Return the command that the first of `words` name, and whether they name nothing else."""
    command: Any = typer.main.get_command(application)
    left = list(words)
    while left and left[0] in getattr(command, "commands", {}):
        command = command.commands[left.pop(0)]
    return command, not left


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
