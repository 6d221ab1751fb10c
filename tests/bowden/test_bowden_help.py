"""Every command explains itself: a first line that fits the list, and an example."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bowden.cli.app import whole


def names(group: object = None, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield every command as its words."""
    if group is None:
        group = whole()
    for name, command in getattr(group, "commands", {}).items():
        if getattr(command, "commands", None):
            yield from names(command, (*path, name))
        else:
            yield (*path, name)


@pytest.mark.parametrize("command", list(names()), ids=" ".join)
def test_help_has_a_line_and_an_example(bowden: Callable[..., tuple[int, str, str]], command: tuple[str, ...]) -> None:
    status, out, err = bowden(*command, "--help")
    assert (status, err) == (0, "")
    told = " ".join(out.split())
    assert "Example: bowden" in told
    assert f"bowden {' '.join(command)}" in told.split("Example: ")[1]


def test_the_list_of_commands_is_not_cut(bowden: Callable[..., tuple[int, str, str]]) -> None:
    status, out, _ = bowden("--help")
    assert status == 0
    assert not [line for line in out.splitlines() if line.startswith("  ") and line.endswith("...")]


def test_no_command_shows_the_help(bowden: Callable[..., tuple[int, str, str]]) -> None:
    assert bowden()[:2] == bowden("--help")[:2]


def test_an_unknown_command_is_one_sentence(bowden: Callable[..., tuple[int, str, str]]) -> None:
    status, out, err = bowden("trail")
    assert (status, out, err.count("\n")) == (2, "", 1)


@pytest.mark.parametrize(("words", "said"), [
    (("diagnose", "--help"), "--healthy TRIAL... Reference trials of the healthy bench"),
    (("logbook", "--help"), "Track a bench's constants over months."),
    (("--help",), "Track a bench's constants over months."),
])
def test_a_help_names_what_its_reader_has(
    bowden: Callable[..., tuple[int, str, str]], words: tuple[str, ...], said: str,
) -> None:
    assert said in " ".join(bowden(*words)[1].split())


@pytest.mark.parametrize(("words", "trials", "healthy"), [
    ("a b --healthy g h i --holdout k --json", ["a", "b"], ["g", "h", "i"]),
    ("a --healthy g --healthy h", ["a"], ["g", "h"]),
    ("--healthy g a b", ["a", "b"], ["g"]),  # an option before the trials takes one
    ("a --healthy g --json b", ["a", "b"], ["g"]),
])
def test_trials_that_a_shell_lists_behind_an_option_are_the_options(
    words: str, trials: list[str], healthy: list[str]
) -> None:
    given = whole().commands["diagnose"].make_context("diagnose", words.split()).params
    assert ([str(one) for one in given["trials"]], [str(one) for one in given["healthy"]]) == (trials, healthy)


PAGES = sorted((Path(__file__).parents[2] / "docs").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_first_paragraph_of_a_page_is_for_its_reader(page: Path) -> None:
    text = page.read_text(encoding="utf-8").partition("\n# ")[2] or page.read_text(encoding="utf-8")
    first = next(block for block in text.split("\n\n")[1:] if not block.startswith("<!--"))
    assert "hoever" in first
