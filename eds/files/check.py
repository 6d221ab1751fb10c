"""`bowden check eds`: faults of an EDS or DCF, beyond those that other checkers find.

Every finding has its place (file, section, key, line) and a remedy, and no file, however broken, stops the search.
The searches are in `check_sections` (sections and keys), `check_pdos` (maps and COB-IDs) and `check_profiles`
(objects against their profile).
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from eds.dictionary import build
from eds.files import check_pdos, check_profiles, check_sections, ini
from eds.files.sheet import EdsSheet, SheetFault

__all__ = ["SheetFault", "findings"]

_SEARCHES: Sequence[Callable[[EdsSheet], Iterator[SheetFault]]] = (
    *check_sections.SEARCHES, *check_pdos.SEARCHES, *check_profiles.SEARCHES,
)
_ANY_NODE = 1
"""Node id for `$NODEID` where the file names none; no finding depends on which."""


def findings(path: str | Path) -> list[SheetFault]:
    """List everything found in an EDS or DCF, by line; `InputError` only where it cannot be read at all."""
    sections = ini.read(Path(path))
    own = build(str(path), sections)
    sheet = EdsSheet(str(path), sections, own if own.node_id else build(str(path), sections, _ANY_NODE))
    found = {finding for search in _SEARCHES for finding in search(sheet)}
    return sorted(found, key=lambda f: (f.line, f.section, f.key, f.text))
