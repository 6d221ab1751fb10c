"""Docstrings of the product: what can be held mechanically of how the project writes.

A docstring is counted if its summary opens with a relative word, if a thing speaks or knows in it, if it has a private
term, or if a sentence is longer than thirty words.  The share of a room may fall, never rise beyond its ceiling.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CEILING_PERCENT = {
    "parameters": 2, "eds": 2, "physics": 2, "nodes": 2, "trial": 2, "master": 3, "virtual_bus": 2,
    "estimation": 3, "diagnosis": 3, "logbook": 3, "bowden": 3}
"""Largest share of counted docstrings by room, in percent: 2 if the room was rewritten, else its share and five points.

A ceiling only falls.  A share above it means that docstrings were added against the rules.
"""
LONGEST_SENTENCE = 30
OPENING = re.compile(
    r"(What|Where|How|The same|That|Those|It|There|Which|As|Its|Their|They|Both|Say|Tell|Hear"
    r"|(?:Let|Return|Keep|Give|Take|Whether) (?:it|them|they|these))\b")
"""First words of a summary line that does not stand alone: relative clauses, pronouns, verbs of speech."""
SPEECH = re.compile(
    r"\b(says?|said|saying|tells?|told|knows?|teach(?:es)?|taught|speaks?|swallows?|outlives?|wants?|believes?|pays?"
    r"|forgets?|remembers?)\b")
"""Verbs of people; a function returns, a file contains, an engineer decides."""
PRIVATE = re.compile(
    r"\b(nameless|strained|bends? to|stands? (?:in )?for|is none|leaves?|strangers?|takers?|heed|witness\w*|rivals?"
    r"|strange|floors?|taken away|of its own|what (?:is|was|it|the|a|an|one|no|other|nothing))\b", re.IGNORECASE)
"""Words of everyday English that had become private terms of the project, and relative clauses without a noun."""


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of each docstring: of the module, of classes and functions, and of constants."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        body = getattr(node, "body", None)
        for before, item in zip([None, *body], body, strict=False) if isinstance(body, list) else ():
            after = before is None or isinstance(before, ast.Assign | ast.AnnAssign)
            text = item.value.value if isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant) else None
            if after and isinstance(text, str):
                yield item.lineno, text


def faults(text: str) -> list[str]:
    """Return why a docstring is counted; empty if it is not."""
    found = [f"opens with {m[0]!r}" for m in [OPENING.match(text.strip())] if m]
    found += [f"{word!r} of a thing" for word in SPEECH.findall(text)[:1]]
    found += [f"the private term {word!r}" for word in PRIVATE.findall(text)[:1]]
    sentences = re.split(r"(?<=[.:;])\s", text)
    return found + ["a sentence of more than 30 words"] * any(len(s.split()) > LONGEST_SENTENCE for s in sentences)


def counted(room: str) -> tuple[list[str], int]:
    """Return the counted docstrings of a room, with their places, and the number of all."""
    every = [(path, line, text) for path in sorted((ROOT / room).rglob("*.py")) for line, text in docstrings(path)]
    return [f"{path.relative_to(ROOT)}:{line}: {', '.join(why)}" for path, line, text in every
            if (why := faults(text))], len(every)


@pytest.mark.parametrize("room", CEILING_PERCENT)
def test_docstrings_of_a_room_keep_its_ceiling(room: str) -> None:
    wrong, every = counted(room)
    assert 100.0 * len(wrong) <= CEILING_PERCENT[room] * every, "\n".join(wrong)


@pytest.mark.parametrize(("text", "count"), [
    ("Return the force, in N.", 0), ("What a bench does.", 2), ("It tells the force.", 2),
    ("Return the force, None if it is none.", 1),
    ("Return " + "a " * 31 + "force.", 1)])
def test_each_rule_is_seen(text: str, count: int) -> None:
    assert len(faults(text)) == count
