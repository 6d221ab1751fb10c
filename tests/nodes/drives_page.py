"""Generator of the tables in docs/drives.md: `python -m tests.nodes.drives_page [FILE]`.

The tables are printed between markers; the sentences around them are written by hand and kept.
"""

import re
import sys
from pathlib import Path
from typing import Final

from eds.cia402 import TRANSITIONS, State
from nodes.drives.modes import BITS
from nodes.drives.state_machine import GUARDS

_BLOCK: Final = re.compile(r"(<!-- (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def states() -> str:
    """Return the state machine's table as a mermaid state diagram; parallel rows are one arrow."""
    lines = [f"    {state.name}: {state.title}\n" for state in State]
    for row in TRANSITIONS:
        sources = [State.OPERATION_ENABLED] if row.number == 13 else row.sources
        words = " / ".join(event.value for event in row.events)
        lines += [f"    {source.name if source else '[*]'} --> {row.target.name}: {row.number} {words}\n"
                  for source in sources]
    return f"```mermaid\nstateDiagram-v2\n{''.join(lines)}```\n"


def rows() -> str:
    """List the rows: event, condition and action of each."""
    lines = ["| row | from | on | to | needs | does |", "|---|---|---|---|---|---|"]
    for row in TRANSITIONS:
        sources = "any but the fault states" if row.number == 13 else ", ".join(
            source.title if source else "power-on" for source in row.sources)
        guard = GUARDS.get(row.number)
        events = " / ".join(event.value for event in row.events)
        lines.append(f"| {row.number} | {sources} | {events} | {row.target.title} | {guard.text if guard else '—'} "
                     f"| {row.text} |")
    return "\n".join(lines) + "\n"


def homing() -> str:
    """Return the table of the statusword bits of homing."""
    lines = ["| homing | axis | bit 10 | bit 12 | bit 13 |", "|---|---|---|---|---|"]
    for (phase, moving), bits in BITS.items():
        shown = " | ".join(str(int(bits) >> bit & 1) for bit in (10, 12, 13))
        lines.append(f"| {phase.value} | {'moves' if moving else 'rests'} | {shown} |")
    return "\n".join(lines) + "\n"


def page(text: str) -> str:
    """Return the page with its generated parts made anew; KeyError where a marker names none."""
    parts = {"states": states, "rows": rows, "homing": homing}
    return _BLOCK.sub(lambda block: block[1] + parts[block[2]]() + block[3], text)


if __name__ == "__main__":
    file = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/drives.md")
    file.write_text(page(file.read_text(encoding="utf-8")), encoding="utf-8")
