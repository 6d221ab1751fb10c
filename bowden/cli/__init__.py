"""The command line: each command parses its options, calls the library and prints."""

import gc
import sys
from collections.abc import Sequence

from bowden import own_packages

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command line (None: the process's) and end the process; status 2 where a package of ours is hidden."""
    hidden = own_packages.hidden()
    if hidden is not None:
        print(f"bowden: {hidden}", file=sys.stderr)
        raise SystemExit(2)
    from bowden.cli.app import run

    if arguments is None:
        for stream in (sys.stdout, sys.stderr):
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]  # a console of cp1252 has no σ
    try:
        sys.exit(run(sys.argv[1:] if arguments is None else arguments))
    finally:
        if arguments is None:
            gc.freeze()  # the process ends: to look for garbage among its imports takes 0.3 s of CPU
