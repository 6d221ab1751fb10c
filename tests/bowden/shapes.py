"""Every command on every packaged declaration: which runs, and the sentence of each refusal.

`python -m tests.bowden.shapes` prints the table of docs/bench.md; `--shape NAME` that of one declaration.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from bowden.bench import configuration
from bowden.cli.app import run
from eds.declaration import packaged

SHAPES: Final = ("bench", "bench_start_only", "bench_no_knee_drive", "bench_antagonists", "bench_two_legs")
GAIT: Final = ("trial", "--config", "bench.toml", "--peak", "30", "--period", "1", "--cycles", "3", "--settle", "0")
AGAIN: Final = ("--calibration", "own.toml")


class Command(NamedTuple):
    """One row of the table: what is done, the command line, and whether it is of one force path."""

    what: str
    line: Sequence[str]
    of_path: bool = False


COMMANDS: Final = (
    Command("trial", (*GAIT, "--day", "0", "-o", "good.mcap")),
    Command("identify all", ("identify", "all", "--config", "bench.toml", "-o", "own.toml")),
    *(Command(f"trial --controller {name}",
              (*GAIT, *AGAIN, "--day", str(day), "--controller", name, "-o", f"{name}.mcap"))
      for day, name in enumerate(("paper", "extended", "none", "friction", "impedance"), 1)),
    Command("trial --dry-run", (*GAIT, "--dry-run", "-o", "dry.mcap")),
    Command("trial --picture", (*GAIT, "--picture", "gait.png", "-o", "drawn.mcap")),
    Command("trial --web", (*GAIT, "--web", "0", "-o", "web.mcap")),
    Command("trial --watch", (*GAIT, "--day", "7", "--watch", "--healthy", "good.mcap", "-o", "watched.mcap")),
    Command("trial --experiment",
            ("trial", "--config", "bench.toml", "--experiment", "locked_angles", "-o", "angles.mcap")),
    Command("trial --motion-of", ("trial", "--config", "bench.toml", "--motion-of", "good.mcap", "-o", "again.mcap")),
    Command("identify gait", ("identify", "gait", "--config", "bench.toml", "-o", "gait.toml", *AGAIN)),
    Command("fit", ("fit", "good.mcap", "paper.mcap", "-o", "fitted.toml"), of_path=True),
    Command("diagnose", ("diagnose", "extended.mcap", "--healthy", "good.mcap"), of_path=True),
    Command("discover", ("discover", "extended.mcap", "--healthy", "good.mcap"), of_path=True),
    Command("simulate", ("simulate", "good.mcap"), of_path=True),
    Command("plan", ("plan", "extended.mcap", "--healthy", "good.mcap"), of_path=True),
    Command("verify", ("verify", "worn.toml", *GAIT[1:], *AGAIN, "-o", "verified.mcap"), of_path=True),
    Command("replay --onto controller", ("replay", "paper.mcap", "--onto", "controller"), of_path=True),
    Command("report", ("report", "paper.mcap", "-o", "page.html")),
    Command("compare", ("compare", "good.mcap", "paper.mcap")),
    Command("watch", ("watch", "paper.mcap", "--healthy", "good.mcap"), of_path=True),
    Command("logbook init", ("logbook", "init", "book"), of_path=True),
    Command("logbook add", ("logbook", "add", "book", "good.mcap", "paper.mcap", "extended.mcap", "impedance.mcap")),
    Command("logbook show", ("logbook", "show", "book")),
    Command("compare --logbook", ("compare", "extended.mcap", "--logbook", "book")),
)


class Answer(NamedTuple):
    """Exit status of a command, and its last line on stderr."""

    what: str
    status: int
    said: str

    @property
    def refused(self) -> bool:
        """Return whether the command did not do what it is for; `compare` says by 1 that trials differ."""
        return self.status not in ((0, 1) if self.what == "compare" else (0,))


def answers(shape: str, folder: Path) -> Iterator[Answer]:
    """Yield the answer to each command on a packaged declaration, in the order of the table, inside `folder`."""
    (folder / "bench.toml").write_text(configuration.as_template(shape=shape), encoding="utf-8")
    paths = [path.name for path in packaged(shape).force_paths]
    worn = f"worn.{paths[-1]}.toml" if len(paths) > 1 else "worn.toml"
    (folder / worn).write_text("[effects.presliding]\npresliding = 3e-4\n", encoding="utf-8")
    before = Path.cwd()
    os.chdir(folder)
    try:
        for command in COMMANDS:
            line = [*command.line, *(("--path", paths[-1]) if command.of_path and len(paths) > 1 else ())]
            err = io.StringIO()
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
                status = run(line)
            yield Answer(command.what, status, (err.getvalue().strip().splitlines() or [""])[-1])
    finally:
        os.chdir(before)


def main() -> None:
    """Print the table of the declarations that are named, or of all."""
    shapes = sys.argv[2:] if sys.argv[1:2] == ["--shape"] else SHAPES
    columns = {}
    for shape in shapes:
        with tempfile.TemporaryDirectory() as folder:
            columns[shape] = [f"refused: {one.said}" if one.refused else "runs"
                              for one in answers(shape, Path(folder))]
    print("| command | " + " | ".join(columns) + " |\n|---|" + "---|" * len(columns))
    for number, command in enumerate(COMMANDS):
        print(f"| `{command.what}`{', by `--path`' * command.of_path} | "
              + " | ".join(column[number] for column in columns.values()) + " |")


if __name__ == "__main__":
    main()
