"""The command line: composes the rooms, decides nothing.

The rule of this package: importing it costs what Typer costs; every other import is inside the
command that needs it.  A command raises `InputError` for bad input (one sentence, exit status 2)
and returns 0 (done) or 1 (it ran and the answer is bad); Ctrl-C ends with 130.
"""

from bowden.cli.app import main

__all__ = ["main"]
