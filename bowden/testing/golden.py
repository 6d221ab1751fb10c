"""Golden assertions: frames against a text file, a trial against another, with readable differences."""

import difflib
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

from parameters import InputError

LINES = 12
"""Greatest number of differences shown; the rest is counted."""


def assert_same_frames(frames: Sequence[object], path: Path, *, update: bool = False) -> None:
    """Compare frames with a golden file of one line each: time (s), COB-ID, length, data.

    `update` writes the file instead. Raises `AssertionError` with the first difference and a diff, and `InputError`
    where the file is missing.
    """
    lines = [str(frame) for frame in frames]
    if update:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        return
    if not path.exists():
        raise InputError(f"{path}: no such golden file; run pytest with --golden-update once and read what it wrote.")
    expected = path.read_text(encoding="utf-8").splitlines()
    if lines != expected:
        raise AssertionError(differences(expected, lines, str(path)))


def differences(expected: Sequence[str], actual: Sequence[str], name: str) -> str:
    """Return the first difference in words and a unified diff, at most `LINES` lines."""
    pairs = enumerate(zip_longest(expected, actual))
    place, (wanted, got) = next((n, pair) for n, pair in pairs if pair[0] != pair[1])
    text = [f"{name}: frame {place + 1} of {len(expected)} differs ({len(actual)} were sent)",
            f"  expected: {wanted or 'no further frame'}", f"  actual:   {got or 'no further frame'}"]
    if wanted and got:
        text.append("  " + _what(wanted.split(" "), got.split(" ")))
    diff = list(difflib.unified_diff(list(expected), list(actual), "expected", "actual", lineterm="", n=1))
    text += diff[:LINES]
    if len(diff) > LINES:
        text.append(f"… {len(diff) - LINES} more lines")
    return "\n".join(text)


def _what(wanted: list[str], got: list[str]) -> str:
    """Return which part of a frame differs."""
    if wanted[1:2] != got[1:2]:
        return f"COB-ID {got[1]} instead of {wanted[1]}"
    if wanted[2:] != got[2:]:
        return f"data of {wanted[1]}: {' '.join(got[3:])} instead of {' '.join(wanted[3:])}"
    late_ns = round((float(got[0]) - float(wanted[0])) * 1e9)
    return f"{wanted[1]} has the same data and came {abs(late_ns)} ns {'later' if late_ns > 0 else 'earlier'}"


def assert_same_trial(actual: str | Path, expected: str | Path) -> None:
    """Compare two trials, every channel bit for bit; raise `AssertionError` that lists what differs and by how much."""
    import trial
    from trial.compare import compare

    found = compare(trial.open(actual), trial.open(expected))
    if found.same:
        return
    text = [f"{actual} differs from {expected} (rows matched by {found.matched})"]
    text += [f"  {signal.name}: RMS {signal.rms:.6g} {signal.unit}, largest {signal.largest:.6g} {signal.unit} at "
             f"{signal.largest_at_s:.6f} s" for signal in found.signals if signal.largest]
    text += [f"  only in {path}: {name}" for path, names in ((actual, found.only_a), (expected, found.only_b))
             for name in names]
    text += [f"  {row.key}: {row.a} instead of {row.b}" for row in (*found.metadata, *found.result)
             if row.a != row.b]
    raise AssertionError("\n".join(text[:LINES + 1] + ([f"… {len(text) - LINES - 1} more"] if len(text) > LINES + 1
                                                       else [])))
