"""An EDS as its checkers see it: the text with its lines beside the dictionary read from it.

The rule of this file: a finding is a value, and only `EdsSheet.finding` makes one, so that each has its place.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from eds.dictionary import Dictionary
from eds.files.ini import Section
from eds.files.notation import object_section


@dataclass(frozen=True, slots=True)
class SheetFault:
    """One fault: `text` describes it, `remedy` is the remedy; `key` is "" if it concerns a whole section."""

    file: str
    section: str
    key: str
    text: str
    remedy: str
    line: int

    def __str__(self) -> str:
        key = f" {self.key}" if self.key else ""
        return f"{self.file}:{self.line}: [{self.section}]{key}: {self.text}; {self.remedy}."


class EdsSheet:
    """The parsed text and its dictionary; sections by lower-case name, first of two counting."""

    def __init__(self, path: str, sections: Sequence[Section], dictionary: Dictionary) -> None:
        self.path = path
        self.sections = sections
        self.dictionary = dictionary
        self.by_name: dict[str, Section] = {}
        self.objects: dict[tuple[int, int | None], Section] = {}
        for section in sections:
            self.by_name.setdefault(section.name.lower(), section)
            place = object_section(section.name)
            if place is not None:
                self.objects.setdefault(place, section)

    def section(self, index: int, subindex: int | None = None) -> Section:
        """Return the section of an object, or the nearest section for a report on it."""
        for place in ((index, subindex), (index, None), (index, 0)):
            if place in self.objects:
                return self.objects[place]
        return self.sections[0]

    def finding(self, section: Section, key: str, text: str, remedy: str) -> SheetFault:
        """Make a finding at a key of a section ("" for the section itself)."""
        return SheetFault(self.path, section.name, key, text, remedy, section.line_of(key) if key else section.line)

    def subsections(self, index: int) -> Iterator[tuple[int, Section]]:
        """Yield (sub-index, section) of an object's sub-objects."""
        for (at, sub), section in self.objects.items():
            if at == index and sub is not None:
                yield sub, section
