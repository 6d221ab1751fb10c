"""Widths of a table's columns on a terminal, apart from the drawing so that no library of terminals is needed."""

from collections.abc import Sequence


def widths(rows: Sequence[Sequence[str]], room: int) -> list[int]:
    """Return the width of each column of `rows`, header first, so that together they need at most `room` characters.

    The widest column is narrowed first, as long as its words stay whole.  If that is not enough, words are cut in the
    widest of the other columns; those of the first column only where they need more than half of the room.  Each
    column keeps one character, so that more columns than `room` need more.
    """
    room = max(room, len(rows[0]))
    columns = [[row[i] for row in rows if i < len(row)] for i in range(len(rows[0]))]
    whole = [max((len(word) for cell in cells for word in cell.split()), default=0) for cells in columns]
    shared = [min(room, max(map(len, cells))) for cells in columns]

    def spare(i: int) -> tuple[bool, bool, int]:
        return shared[i] > whole[i], i > 0 or shared[i] > room // 2, shared[i]

    while sum(shared) > room:
        shared[max((i for i in range(len(shared)) if shared[i] > 1), key=spare)] -= 1
    return shared
