"""The command line, one file a command: each parses its options, calls the library and prints."""

from bowden.cli.app import main

__all__ = ["main"]
