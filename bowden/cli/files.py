"""Commands on recorded files: `bowden recover`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app

Torn = Annotated[Path, typer.Argument(metavar="FILE", help="A torn recording.", show_default=False)]


@app.command()
def recover(
    torn: Torn, output: options.Output, overwrite: options.Overwrite = False, json: options.Json = False
) -> int:
    """Make a torn recording whole.

    Every message that survived is written, indexed again.

    Example: bowden recover torn.mcap -o whole.mcap
    """
    from dataclasses import asdict

    from bowden import output_files
    from trial.recover import recover as recovered

    output_files.refuse_ending(output, ".mcap", what="a recording")

    with terminal.progress(f"recovering {torn}", shown=not json) as update:
        found = recovered(torn, output, overwrite=overwrite, progress=update)
    if json:
        terminal.emit({"trial": str(output), **asdict(found)})
    else:
        print(f"{output}: {found.messages} messages from {found.chunks} chunks; {found.damaged} chunks damaged, "
              f"{found.bytes_skipped} bytes left out.")
    return 0
